//! Records of a study as Parquet, for programs that read tables: a row for each metric of each trial.
//!
//! | column | is |
//! | --- | --- |
//! | `system`, `arm`, `board` | names, as in [`Record`] |
//! | `seed` | unsigned integer |
//! | `failed` | why the trial could not be run; null otherwise |
//! | `metric`, `value` | name and value; null for a trial without any |

use std::{fs::File, path::Path, sync::Arc};

use parquet::{
    data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int64Type},
    errors::ParquetError,
    file::{
        properties::WriterProperties,
        reader::{FileReader, SerializedFileReader},
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    record::{Field, Row},
    schema::parser::parse_message_type,
};

use crate::{Error, Record, Values};

const SCHEMA: &str = "message record {
    required binary system (UTF8);
    required binary arm (UTF8);
    required binary board (UTF8);
    required int64 seed (INTEGER(64, false));
    optional binary failed (UTF8);
    optional binary metric (UTF8);
    optional double value;
}";
/// Records in a group of rows: a few megabytes.
const GROUP: usize = 10_000;

/// Writes records into a new file.
pub(crate) fn write(path: &Path, records: &[Record]) -> Result<(), Error> {
    let file = File::create(path).map_err(|source| Error::File { path: path.to_owned(), source })?;
    written(file, records).map_err(|error| Error::Parquet { path: path.to_owned(), why: error.to_string() })
}

fn written(file: File, records: &[Record]) -> Result<(), ParquetError> {
    let schema = Arc::new(parse_message_type(SCHEMA)?);
    let mut writer = SerializedFileWriter::new(file, schema, Arc::new(WriterProperties::default()))?;
    for records in records.chunks(GROUP) {
        let rows: Vec<_> = records.iter().flat_map(rows).collect();
        let mut group = writer.next_row_group()?;
        let text = |text: &str| Some(ByteArray::from(text));
        column::<ByteArrayType>(&mut group, rows.iter().map(|(record, _)| text(&record.system)))?;
        column::<ByteArrayType>(&mut group, rows.iter().map(|(record, _)| text(&record.arm)))?;
        column::<ByteArrayType>(&mut group, rows.iter().map(|(record, _)| text(&record.board)))?;
        column::<Int64Type>(&mut group, rows.iter().map(|(record, _)| Some(record.seed.cast_signed())))?;
        column::<ByteArrayType>(&mut group, rows.iter().map(|(record, _)| record.failed.as_deref().and_then(text)))?;
        column::<ByteArrayType>(&mut group, rows.iter().map(|(_, metric)| metric.and_then(|(name, _)| text(name))))?;
        column::<DoubleType>(&mut group, rows.iter().map(|(_, metric)| metric.map(|(_, value)| *value)))?;
        group.close()?;
    }
    writer.close()?;
    Ok(())
}

/// A record with each of its metrics, or with none.
fn rows(record: &Record) -> Vec<(&Record, Option<(&String, &f64)>)> {
    if record.values.is_empty() {
        return vec![(record, None)];
    }
    record.values.iter().map(|metric| (record, Some(metric))).collect()
}

/// Writes the next column of a group.
fn column<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: impl Iterator<Item = Option<T::T>>,
) -> Result<(), ParquetError> {
    let all: Vec<Option<T::T>> = values.collect();
    // Of a required column they are not looked at.
    let is_there: Vec<i16> = all.iter().map(|value| i16::from(value.is_some())).collect();
    let values: Vec<T::T> = all.into_iter().flatten().collect();
    let Some(mut writer) = group.next_column()? else {
        return Err(ParquetError::General("the schema has fewer columns".to_owned()));
    };
    writer.typed::<T>().write_batch(&values, Some(&is_there), None)?;
    writer.close()
}

/// Reads the records of a file.
pub(crate) fn read(path: &Path) -> Result<Vec<Record>, Error> {
    let file = File::open(path).map_err(|source| Error::File { path: path.to_owned(), source })?;
    let bad = |why: String| Error::Parquet { path: path.to_owned(), why };
    let reader = SerializedFileReader::new(file).map_err(|error| bad(error.to_string()))?;
    let rows = reader.get_row_iter(None).map_err(|error| bad(error.to_string()))?;
    let mut records: Vec<Record> = Vec::new();
    for row in rows {
        let row = row.map_err(|error| bad(error.to_string()))?;
        let (record, metric) = parsed(&row).ok_or_else(|| bad(format!("{row} is no row of a study's records")))?;
        let is_same = |last: &Record| {
            (&last.system, &last.arm, &last.board, last.seed)
                == (&record.system, &record.arm, &record.board, record.seed)
        };
        if !records.last().is_some_and(is_same) {
            records.push(record);
        }
        if let (Some(last), Some((name, value))) = (records.last_mut(), metric) {
            last.values.insert(name, value);
        }
    }
    Ok(records)
}

/// A row's record without its values, and its metric.
fn parsed(row: &Row) -> Option<(Record, Option<(String, f64)>)> {
    let fields: Vec<&Field> = row.get_column_iter().map(|(_, field)| field).collect();
    let [Field::Str(system), Field::Str(arm), Field::Str(board), Field::ULong(seed), failed, metric, value] =
        fields[..]
    else {
        return None;
    };
    let failed = match failed {
        Field::Null => None,
        Field::Str(why) => Some(why.clone()),
        _ => return None,
    };
    let metric = match (metric, value) {
        (Field::Null, Field::Null) => None,
        (Field::Str(name), Field::Double(value)) => Some((name.clone(), *value)),
        _ => return None,
    };
    let (system, arm, board) = (system.clone(), arm.clone(), board.clone());
    Some((Record { system, arm, board, seed: *seed, values: Values::new(), failed }, metric))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_come_back_from_parquet_to_the_bit() {
        let record = |seed: u64| Record {
            system: "skidcal".into(),
            arm: "ours".into(),
            board: "sim".into(),
            seed,
            values: Values::from([("a".to_owned(), 0.1 + seed as f64), ("b".to_owned(), f64::MIN_POSITIVE)]),
            failed: None,
        };
        let failed = Record { values: Values::new(), failed: Some("no [body]".into()), ..record(u64::MAX) };
        let records = vec![record(1), record(2), failed];
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("records.parquet");
        write(&path, &records).expect("written");
        assert_eq!(read(&path).expect("read"), records);
    }

    #[test]
    fn a_file_of_something_else_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("other.parquet");
        std::fs::write(&path, "{}").expect("written");
        let problem = read(&path).expect_err("no Parquet").to_string();
        assert!(problem.contains("other.parquet"), "{problem}");
        let schema = Arc::new(parse_message_type("message other { required int64 seed; }").expect("a schema"));
        let file = File::create(&path).expect("a file");
        let mut writer = SerializedFileWriter::new(file, schema, Arc::default()).expect("a writer");
        let mut group = writer.next_row_group().expect("a group");
        column::<Int64Type>(&mut group, [Some(1)].into_iter()).expect("a column");
        group.close().expect("closed");
        writer.close().expect("closed");
        let problem = read(&path).expect_err("another table").to_string();
        assert!(problem.contains("no row of a study's records"), "{problem}");
    }
}
