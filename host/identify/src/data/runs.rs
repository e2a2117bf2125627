//! Division of rows into runs, by split columns and by restarts of the clock.

use std::collections::HashMap;

use super::{DataError, Note, read::Raw};

/// A run before cleaning.
#[derive(Clone, Debug, Default)]
pub(super) struct Piece {
    pub(super) name: String,
    pub(super) group: usize,
    /// Times in s from 0, strictly increasing.
    pub(super) time_s: Vec<f64>,
    /// Reading of the board's clock at the first sample, as in [`super::Run`].
    pub(super) origin_s: Option<f64>,
    /// Values in the order of the roles, each as long as the times.
    pub(super) values: Vec<Vec<f64>>,
}

/// Largest time of a row, as a share of the run before, at which it counts as a restart of the clock.
const RESTART: f64 = 0.05;

/// Rows before time may restart: with fewer, any two rows out of order would be two runs.
const RUN: usize = 3;

/// A key that returns after other keys continues its run if time goes on within this number of steps.
const APART: f64 = 5.0;

pub(super) fn split(file: &str, raw: &Raw, notes: &mut Vec<Note>) -> Result<Vec<Piece>, DataError> {
    let (mut stampless, mut repeated, mut restarts) = (0, 0, 0);
    let mut order: HashMap<&str, usize> = HashMap::new();
    let mut keys: Vec<(&str, Vec<usize>)> = Vec::new();
    for row in 0..raw.time_s.len() {
        if raw.time_s[row].is_nan() {
            stampless += 1;
            continue;
        }
        let key = raw.keys.get(row).map_or("", String::as_str);
        let place = *order.entry(key).or_insert_with(|| {
            keys.push((key, Vec::new()));
            keys.len() - 1
        });
        keys[place].1.push(row);
    }
    let mut found: Vec<(usize, Piece)> = Vec::new();
    for (group, (key, rows)) in keys.iter().enumerate() {
        let far = APART * median_step(&raw.time_s, rows);
        let mut parts: Vec<Vec<usize>> = Vec::new();
        for &row in rows {
            let time_s = raw.time_s[row];
            let Some((part, first, last)) = parts.last_mut().and_then(|part| {
                let (first, last) = (*part.first()?, *part.last()?);
                Some((part, first, last))
            }) else {
                parts.push(vec![row]);
                continue;
            };
            let (first_s, last_s) = (raw.time_s[first], raw.time_s[last]);
            let elsewhere = row > last + 1 && raw.keys.get(last + 1).is_some_and(|other| other != key);
            if time_s == last_s {
                repeated += 1;
            } else if time_s > last_s && !(elsewhere && time_s - last_s > far) {
                part.push(row);
            } else if time_s > last_s {
                parts.push(vec![row]);
            } else if part.len() >= RUN && time_s - first_s <= RESTART * (last_s - first_s) {
                restarts += 1;
                parts.push(vec![row]);
            } else {
                // Multiplying by the unit's factor adds digits that are not in the file.
                let shown = |seconds: f64| (seconds * 1e9).round() / 1e9;
                return Err(DataError::Backwards {
                    file: file.to_owned(),
                    line: raw.lines[row],
                    before_s: shown(last_s),
                    time_s: shown(time_s),
                });
            }
        }
        for (number, part) in parts.into_iter().enumerate() {
            let Some(&first) = part.first() else { continue };
            let mut name = file.to_owned();
            if !key.is_empty() {
                name = format!("{name} {key}");
            }
            if number > 0 {
                name = format!("{name} ({})", number + 1);
            }
            let of = |values: &Vec<f64>| part.iter().map(|&row| values[row]).collect();
            let time_s = part.iter().map(|&row| raw.time_s[row] - raw.time_s[first]).collect();
            let origin_s = raw.by_board.then_some(raw.time_s[first]);
            let values = raw.columns.iter().map(|(_, _, values)| of(values)).collect();
            // Without split columns, each restart of the clock is a run that can be held out by itself.
            let group = if raw.keys.is_empty() { number } else { group };
            found.push((first, Piece { name, group, time_s, origin_s, values }));
        }
    }
    // Runs in the order in which they begin in the file, across keys.
    found.sort_by_key(|(first, _)| *first);
    let file = || file.to_owned();
    if stampless > 0 {
        notes.push(Note::NoStamp { file: file(), rows: stampless });
    }
    if repeated > 0 {
        notes.push(Note::Repeated { file: file(), rows: repeated });
    }
    if restarts > 0 {
        notes.push(Note::Restarts { file: file(), times: restarts });
    }
    Ok(found.into_iter().map(|(_, piece)| piece).collect())
}

/// Returns the median of the forward steps between consecutive `rows`, s; infinite if there is none.
fn median_step(time_s: &[f64], rows: &[usize]) -> f64 {
    let steps = rows.windows(2).map(|pair| time_s[pair[1]] - time_s[pair[0]]).filter(|step| *step > 0.0);
    super::clean::quantile(&steps.collect::<Vec<_>>(), 0.5).unwrap_or(f64::INFINITY)
}
