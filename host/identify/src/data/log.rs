//! Columns of numbers from a log of `r4`.

use std::path::Path;

use r4_log::{Kind, Log};

use super::{Columns, DataError, Note, Options, read::Raw, table, unit};

/// First bytes of an MCAP file.
const MAGIC: &[u8] = b"\x89MCAP";

pub(super) fn is_log(file: &str, bytes: &[u8]) -> bool {
    bytes.starts_with(MAGIC)
        || Path::new(file).extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// Samples of one signal that are numbers.
struct Series {
    name: String,
    kind: Kind,
    samples: Vec<(f64, f64)>,
}

pub(super) fn read(file: &str, bytes: &[u8], options: &Options, notes: &mut Vec<Note>) -> Result<Raw, DataError> {
    if !options.split.is_empty() {
        return Err(DataError::SplitLog { file: file.to_owned() });
    }
    let log = Log::from_bytes(bytes).map_err(|why| DataError::Log { file: file.to_owned(), why })?;
    notes.extend(log.warnings.iter().map(|warning| Note::Log { file: file.to_owned(), warning: warning.clone() }));
    let signals = log.signals();
    let names: Vec<String> = signals.iter().map(|signal| signal.name.clone()).collect();
    let mut columns = Vec::new();
    for mapping in &options.roles {
        let signal = &signals[find(file, &names, &mapping.column)?];
        // Text such as a state is no signal for a model.
        let numbers = signal.samples.iter().filter_map(|(time_s, value)| Some((*time_s, value.number()?)));
        let samples: Vec<_> = numbers.filter(|(time_s, _)| time_s.is_finite()).collect();
        if samples.is_empty() {
            return Err(DataError::NoSamples { file: file.to_owned(), signal: signal.name.clone() });
        }
        columns.push((mapping, Series { name: signal.name.clone(), kind: signal.kind, samples }));
    }
    // The output sets the sampling times; without one, the most frequently sampled measured signal does.
    let rank = |(mapping, series): &&(_, Series)| {
        let mapping: &&super::Mapping = mapping;
        (mapping.role == "output", !mapping.driving, series.kind == Kind::Continuous, series.samples.len())
    };
    let Some((_, base)) = columns.iter().rev().max_by_key(rank) else {
        return Err(DataError::NoRole { role: "output".to_owned(), what: "what was measured".to_owned() });
    };
    let time_s: Vec<f64> = base.samples.iter().map(|(time_s, _)| *time_s).collect();
    let mut raw = Raw {
        time: Some(("time".to_owned(), true)),
        lines: (1..=time_s.len() as u64).collect(),
        time_s,
        by_board: true,
        ..Raw::default()
    };
    for (_, series) in &columns {
        if !series.samples.iter().map(|(time_s, _)| time_s).eq(&raw.time_s) {
            notes.push(Note::Aligned { file: file.to_owned(), column: series.name.clone(), base: base.name.clone() });
        }
        let unit = unit::unit(&series.name, options.counts_per_turn);
        // Zero-order hold: at each sampling time the latest value of the signal applies.
        let latest = |time_s: &f64| {
            let after = series.samples.partition_point(|(at, _)| at <= time_s);
            after.checked_sub(1).map_or(f64::NAN, |at| series.samples[at].1 * unit.factor)
        };
        raw.columns.push((series.name.clone(), unit.quantity, raw.time_s.iter().map(latest).collect()));
    }
    Ok(raw)
}

/// Returns the index of a signal by its name, or by the part after the channel if that is unique.
fn find(file: &str, names: &[String], column: &str) -> Result<usize, DataError> {
    if let Some(place) = names.iter().position(|name| name == column) {
        return Ok(place);
    }
    let short = |name: &String| name.split_once('.').is_some_and(|(_, field)| field == column);
    let places: Vec<usize> = (0..names.len()).filter(|&place| short(&names[place])).collect();
    match places[..] {
        [place] => Ok(place),
        [] => Err(table::no_column(file, column, names)),
        _ => Err(DataError::Ambiguous {
            file: file.to_owned(),
            column: column.to_owned(),
            one_of: Some(Columns(places.iter().map(|&place| names[place].clone()).collect())),
        }),
    }
}
