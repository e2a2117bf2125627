//! Columns of numbers from a CSV file.

use std::borrow::Cow;

use csv::{ByteRecord, ReaderBuilder, Trim};

use super::{Columns, DataError, Note, Options, read::Raw, unit};

/// Words for a missing value.
const NOTHING: [&str; 6] = ["", "nan", "na", "n/a", "null", "none"];

pub(super) fn read(file: &str, bytes: &[u8], options: &Options, notes: &mut Vec<Note>) -> Result<Raw, DataError> {
    // Some spreadsheets begin a file with a byte order mark, which would become part of the first name.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if bytes.contains(&0) {
        return Err(DataError::NotText { file: file.to_owned() });
    }
    let mut reader = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .delimiter(delimiter(bytes))
        .from_reader(bytes);
    let mut record = ByteRecord::new();
    let next = |reader: &mut csv::Reader<&[u8]>, record: &mut ByteRecord| {
        reader.read_byte_record(record).map_err(|_| DataError::NotText { file: file.to_owned() })
    };
    if !next(&mut reader, &mut record)? {
        return Err(DataError::Empty { file: file.to_owned() });
    }
    let header: Vec<String> = record.iter().map(|cell| text(cell).into_owned()).collect();
    if header.iter().any(|name| !name.is_empty()) && header.iter().all(|name| number(name).is_some()) {
        return Err(DataError::NoHeader { file: file.to_owned() });
    }

    let place = |column: &str| find(file, &header, column);
    let roles = options.roles.iter().map(|mapping| place(&mapping.column)).collect::<Result<Vec<_>, _>>()?;
    let split = options.split.iter().map(|column| place(column)).collect::<Result<Vec<_>, _>>()?;
    let time = match &options.time {
        Some(column) => Some(place(column)?),
        None => header.iter().position(|name| unit::is_time(name)),
    };
    if time.is_none() && !options.untimed {
        return Err(DataError::NoTime { file: file.to_owned(), columns: Columns(header) });
    }
    // Without a unit in its name, the time is taken as seconds and noted.
    let factor = time.map(|time| unit::seconds(&header[time]));

    let units: Vec<_> = roles.iter().map(|&place| unit::unit(&header[place], options.counts_per_turn)).collect();
    let mut raw = Raw {
        time: time.map(|time| (header[time].clone(), factor.flatten().is_some())),
        columns: roles.iter().zip(&units).map(|(&at, unit)| (header[at].clone(), unit.quantity, Vec::new())).collect(),
        ..Raw::default()
    };
    if time.is_none() {
        notes.push(Note::Numbered { file: file.to_owned() });
    }
    while next(&mut reader, &mut record)? {
        let line = record.position().map_or(0, csv::Position::line);
        if record.len() != header.len() {
            let (found, expected) = (record.len(), header.len());
            // A recording that was interrupted ends within its last line; any other short line is an error.
            let cut = found < expected && !bytes.ends_with(b"\n") && !raw.lines.is_empty();
            if cut && !next(&mut reader, &mut record)? {
                notes.push(Note::CutLine { file: file.to_owned() });
                break;
            }
            return Err(DataError::RowLength { file: file.to_owned(), line, found, expected });
        }
        let value = |place: usize| {
            let cell = text(&record[place]);
            number(&cell).ok_or_else(|| DataError::Text {
                file: file.to_owned(),
                line,
                column: header[place].clone(),
                text: cell.chars().take(40).collect(),
            })
        };
        raw.time_s.push(match time {
            // Larger than any time; beyond it the differences of times lose all precision.
            Some(time) => finite(value(time)? * factor.flatten().unwrap_or(1.0), 1e18),
            None => raw.lines.len() as f64,
        });
        for ((&place, unit), (_, _, values)) in roles.iter().zip(&units).zip(&mut raw.columns) {
            values.push(finite(value(place)? * unit.factor, f64::MAX));
        }
        if !split.is_empty() {
            let cell = |&place: &usize| format!("{}={}", header[place], text(&record[place]));
            raw.keys.push(split.iter().map(cell).collect::<Vec<_>>().join(" "));
        }
        raw.lines.push(line);
    }
    if raw.lines.is_empty() {
        return Err(DataError::HeaderOnly { file: file.to_owned() });
    }
    Ok(raw)
}

/// Returns the delimiter of the first line.
fn delimiter(bytes: &[u8]) -> u8 {
    let line = bytes.split(|&byte| byte == b'\n').next().unwrap_or_default();
    *b",;\t".iter().find(|delimiter| line.contains(delimiter)).unwrap_or(&b',')
}

/// Returns the number in a cell, NaN for a missing value; `None` for text.
fn number(cell: &str) -> Option<f64> {
    match cell.parse::<f64>() {
        Ok(value) if value.is_finite() => Some(value),
        Ok(_) => Some(f64::NAN),
        Err(_) => match cell.to_lowercase().as_str() {
            "true" => Some(1.0),
            "false" => Some(0.0),
            word => NOTHING.contains(&word).then_some(f64::NAN),
        },
    }
}

/// Returns the text of a cell, without the quotes that the parser leaves if blanks precede them.
fn text(cell: &[u8]) -> Cow<'_, str> {
    match String::from_utf8_lossy(cell) {
        Cow::Borrowed(text) => Cow::Borrowed(text.trim_matches('"').trim()),
        lossy => lossy,
    }
}

/// Returns `value`, or NaN if its magnitude exceeds `largest`.
fn finite(value: f64, largest: f64) -> f64 {
    if value.abs() <= largest { value } else { f64::NAN }
}

/// Returns the index of a column.
fn find(file: &str, header: &[String], column: &str) -> Result<usize, DataError> {
    let mut places = header.iter().enumerate().filter(|(_, name)| *name == column).map(|(place, _)| place);
    match (places.next(), places.next()) {
        (Some(place), None) => Ok(place),
        (Some(_), Some(_)) => {
            Err(DataError::Ambiguous { file: file.to_owned(), column: column.to_owned(), one_of: None })
        }
        (None, _) => Err(no_column(file, column, header)),
    }
}

/// Returns the error for an unknown name, with the most similar one.
pub(super) fn no_column(file: &str, column: &str, names: &[String]) -> DataError {
    let wanted = column.to_lowercase();
    // Part of a name counts as similar, because users abbreviate.
    let likeness = |name: &String| {
        let name = name.to_lowercase();
        let within = !wanted.is_empty() && !name.is_empty() && (name.contains(&wanted) || wanted.contains(&name));
        strsim::normalized_damerau_levenshtein(&name, &wanted) + if within { 0.5 } else { 0.0 }
    };
    // At less than 0.5, half the letters differ: no similarity.
    let nearest = names.iter().map(|name| (likeness(name), name)).filter(|(likeness, _)| *likeness > 0.5);
    DataError::NoColumn {
        file: file.to_owned(),
        column: column.to_owned(),
        nearest: nearest.max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, name)| name.clone()),
        columns: Columns(names.to_vec()),
    }
}
