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
        writer::{SerializedFileWriter, SerializedRowGroupWriter},
    },
    schema::parser::parse_message_type,
};

use crate::{Error, Record};

const SCHEMA: &str = "message record {
    required binary system (UTF8);
    required binary arm (UTF8);
    required binary board (UTF8);
    required int64 seed (INTEGER(64, false));
    optional binary failed (UTF8);
    optional binary metric (UTF8);
    optional double value;
}";
/// Records in one row group: a few megabytes.
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

/// A record paired with each of its metrics, or with `None` when it has no values.
fn rows(record: &Record) -> Vec<(&Record, Option<(&String, &f64)>)> {
    if record.values.is_empty() {
        return vec![(record, None)];
    }
    record.values.iter().map(|metric| (record, Some(metric))).collect()
}

/// Writes the next column of a row group; `None` makes a null.
fn column<T: DataType>(
    group: &mut SerializedRowGroupWriter<'_, File>,
    values: impl Iterator<Item = Option<T::T>>,
) -> Result<(), ParquetError> {
    let all: Vec<Option<T::T>> = values.collect();
    // Definition levels: 1 for a value, 0 for null. The writer ignores them for a required column.
    let is_there: Vec<i16> = all.iter().map(|value| i16::from(value.is_some())).collect();
    let values: Vec<T::T> = all.into_iter().flatten().collect();
    let Some(mut writer) = group.next_column()? else {
        return Err(ParquetError::General("the schema has fewer columns".to_owned()));
    };
    writer.typed::<T>().write_batch(&values, Some(&is_there), None)?;
    writer.close()
}

#[cfg(test)]
mod tests {
    use parquet::{
        file::reader::{FileReader, SerializedFileReader},
        record::Field,
    };

    use super::*;
    use crate::Values;

    #[test]
    fn each_metric_of_each_trial_is_a_row() {
        let record = |seed: u64| Record {
            system: "skidcal".into(),
            arm: "ours".into(),
            board: "sim".into(),
            seed,
            values: Values::from([("a".to_owned(), 0.1 + seed as f64), ("b".to_owned(), f64::MIN_POSITIVE)]),
            failed: None,
        };
        let failed = Record { values: Values::new(), failed: Some("no [body]".into()), ..record(u64::MAX) };
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("records.parquet");
        write(&path, &[record(1), record(2), failed]).expect("written");
        let reader = SerializedFileReader::new(File::open(&path).expect("a file")).expect("Parquet");
        let rows = reader.get_row_iter(None).expect("rows").map(|row| {
            let row = row.expect("a row");
            row.get_column_iter().skip(3).map(|(_, field)| field.clone()).collect::<Vec<_>>()
        });
        let text = |text: &str| Field::Str(text.to_owned());
        let row = |seed, name: &str, value| vec![Field::ULong(seed), Field::Null, text(name), Field::Double(value)];
        let expected = [
            row(1, "a", 1.1),
            row(1, "b", f64::MIN_POSITIVE),
            row(2, "a", 2.1),
            row(2, "b", f64::MIN_POSITIVE),
            vec![Field::ULong(u64::MAX), text("no [body]"), Field::Null, Field::Null],
        ];
        assert_eq!(rows.collect::<Vec<_>>(), expected);
    }
}
