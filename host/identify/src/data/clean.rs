//! Cleaning of runs: reports faults of their samples, and repairs those whose repair loses nothing.

use std::f64::consts::{PI, TAU};

use r4_maths::statistics::{self, QuantileRule};

use super::{Mapping, Note, Quantity, read::Raw, runs::Piece};

/// Number of samples on each side that an outlier is compared with.
const AROUND: usize = 5;

/// Smallest distance of an outlier from its neighbours, as a multiple of the largest step around it …
const SPIKE: f64 = 10.0;

/// … and as a multiple of the 95 % quantile of all steps of the run.
const STEP: f64 = 4.0;

/// Share of outliers above which they belong to the signal.
const RARE: f64 = 0.02;

/// Returns the quantile of `values`, none of which is NaN, at `share`; `None` if there are none.
pub(super) fn quantile(values: &[f64], share: f64) -> Option<f64> {
    statistics::quantile(values, share, QuantileRule::NearestPosition).ok()
}

pub(super) fn clean(file: &str, raw: &Raw, roles: &[Mapping], pieces: &mut Vec<Piece>, notes: &mut Vec<Note>) {
    let rows: usize = pieces.iter().map(|piece| piece.time_s.len()).sum();
    let missing = |pieces: &[Piece], at: usize| -> usize {
        pieces.iter().map(|piece| piece.values[at].iter().filter(|value| value.is_nan()).count()).sum()
    };
    // Missing cells are counted before [`bridge`] fills those of inputs.
    for (at, (mapping, (column, ..))) in roles.iter().zip(&raw.columns).enumerate() {
        let cells = missing(pieces, at);
        if cells > 0 {
            let (file, column) = (file.to_owned(), column.clone());
            notes.push(if mapping.driving {
                Note::Bridged { file, column, cells, of: rows }
            } else {
                Note::Missing { file, column, cells, of: rows }
            });
        }
    }
    for piece in &mut *pieces {
        bridge(piece, roles);
    }
    // Time is checked on the bridged rows, so that rows before the first input count as no gap.
    pieces.retain(|piece| !piece.time_s.is_empty());
    time(file, raw, pieces, notes);
    for (at, (mapping, (column, quantity, _))) in roles.iter().zip(&raw.columns).enumerate() {
        if mapping.driving {
            constant(file, column, at, pieces, notes);
        } else {
            if *quantity == Quantity::Angle {
                unwrap(file, column, at, pieces, notes);
            }
            outliers(file, column, at, pieces, notes);
            held(file, column, at, pieces, notes);
        }
    }
}

/// Fills missing values of inputs with the value before (zero-order hold), and removes rows before the first value.
fn bridge(piece: &mut Piece, roles: &[Mapping]) {
    let driving = || roles.iter().enumerate().filter(|(_, mapping)| mapping.driving).map(|(at, _)| at);
    let known = |at: usize| piece.values[at].iter().position(|value| !value.is_nan());
    let from = driving().map(|at| known(at).unwrap_or(piece.time_s.len())).max().unwrap_or(0);
    if from > 0 {
        piece.time_s.drain(..from);
        let first_s = piece.time_s.first().copied().unwrap_or(0.0);
        piece.time_s.iter_mut().for_each(|time_s| *time_s -= first_s);
        piece.origin_s = piece.origin_s.map(|origin_s| origin_s + first_s);
        piece.values.iter_mut().for_each(|values| drop(values.drain(..from)));
    }
    for at in driving() {
        let mut last = f64::NAN;
        for value in &mut piece.values[at] {
            if value.is_nan() {
                *value = last;
            }
            last = *value;
        }
    }
}

/// Notes irregular sampling and gaps in time.
fn time(file: &str, raw: &Raw, pieces: &[Piece], notes: &mut Vec<Note>) {
    let Some((column, stated)) = &raw.time else { return };
    let steps = || pieces.iter().flat_map(|piece| piece.time_s.windows(2).map(|pair| pair[1] - pair[0]));
    let Some(median_s) = quantile(&steps().collect::<Vec<_>>(), 0.5) else { return };
    let off: Vec<f64> = steps().map(|step| (step - median_s).abs()).collect();
    // The quantile ignores gaps, which are noted below.
    let jitter_s = quantile(&off, 0.95).unwrap_or(0.0);
    if !stated {
        notes.push(Note::TimeUnit { file: file.to_owned(), column: column.clone(), step_s: median_s });
    }
    if jitter_s > 0.05 * median_s {
        notes.push(Note::Irregular { file: file.to_owned(), median_s, jitter_s });
    }
    // A regular clock that skips one sample makes a step of two periods; an irregular clock may do so by itself.
    let longest = if jitter_s < 0.2 * median_s { 1.8 * median_s } else { 5.0 * median_s.max(jitter_s) };
    let gaps: Vec<f64> = steps().filter(|step| *step > longest).collect();
    if let Some(longest_s) = gaps.iter().copied().reduce(f64::max) {
        let samples = gaps.iter().map(|step| (step / median_s).round().max(1.0) - 1.0).sum::<f64>() as usize;
        notes.push(Note::Gaps { file: file.to_owned(), gaps: gaps.len(), samples, longest_s });
    }
}

/// Notes runs in which an input is constant.
fn constant(file: &str, column: &str, at: usize, pieces: &[Piece], notes: &mut Vec<Note>) {
    let still = |piece: &&Piece| piece.time_s.len() > 1 && piece.values[at].windows(2).all(|pair| pair[0] == pair[1]);
    let runs = pieces.iter().filter(still).count();
    let Some(value) = pieces.iter().find(still).and_then(|piece| piece.values[at].first().copied()) else { return };
    // A constant in the whole file is a condition, such as a gain; [`super::check`] refuses it where it must vary.
    if runs < pieces.len() {
        let (file, column) = (file.to_owned(), column.to_owned());
        notes.push(Note::Constant { file, column, value, runs, of: pieces.len() });
    }
}

/// Unwraps an angle that is kept within one turn.
fn unwrap(file: &str, column: &str, at: usize, pieces: &mut [Piece], notes: &mut Vec<Note>) {
    let all = || pieces.iter().flat_map(|piece| piece.values[at].iter().copied()).filter(|value| !value.is_nan());
    let (least, most) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    // Rounding of printed values may exceed the range by a little.
    let margin = 0.01 * TAU;
    let centred = least >= -PI - margin && most <= PI + margin;
    let positive = least >= -margin && most <= TAU + margin;
    if !centred && !positive {
        return;
    }
    let mut times = 0;
    for piece in pieces {
        let (mut turns, mut last) = (0.0, f64::NAN);
        for value in piece.values[at].iter_mut().filter(|value| !value.is_nan()) {
            // More than three quarters of a turn between two samples is taken as a wrap, not as motion.
            let step = *value - last;
            if step.abs() > 0.75 * TAU {
                turns -= step.signum();
                times += 1;
            }
            last = *value;
            *value += turns * TAU;
        }
    }
    if times > 0 {
        notes.push(Note::Unwrapped { file: file.to_owned(), column: column.to_owned(), times });
    }
}

/// Replaces lone spikes by NaN and notes them.
fn outliers(file: &str, column: &str, at: usize, pieces: &mut [Piece], notes: &mut Vec<Note>) {
    let (mut samples, mut first_s) = (0, None);
    for piece in pieces {
        let found = spikes(&piece.values[at]);
        // Frequent spikes belong to the signal.
        if found.len() as f64 > RARE * piece.time_s.len() as f64 {
            continue;
        }
        for spike in found {
            first_s = first_s.or(Some(piece.time_s[spike]));
            samples += 1;
            piece.values[at][spike] = f64::NAN;
        }
    }
    if let Some(first_s) = first_s {
        notes.push(Note::Outliers { file: file.to_owned(), column: column.to_owned(), samples, first_s });
    }
}

/// Returns the indexes of spikes: values far from both neighbours, on one side of them, where the signal is smooth.
fn spikes(values: &[f64]) -> Vec<usize> {
    let known: Vec<usize> = (0..values.len()).filter(|&at| !values[at].is_nan()).collect();
    let value = |place: usize| values[known[place]];
    let steps: Vec<f64> = known.windows(2).map(|pair| (values[pair[1]] - values[pair[0]]).abs()).collect();
    let changes: Vec<f64> = steps.iter().copied().filter(|step| *step > 0.0).collect();
    let (Some(usual), Some(grain)) = (quantile(&steps, 0.95), quantile(&changes, 0.05)) else {
        return Vec::new();
    };
    let lone = |place: &usize| {
        let place = *place;
        let (before, after) = (value(place) - value(place - 1), value(place) - value(place + 1));
        let leg = before.abs().min(after.abs());
        if before * after <= 0.0 || leg <= STEP * usual || leg <= SPIKE * grain {
            return false;
        }
        // The signal returns to where it was before the spike, and no step around is nearly as large.
        let around = (place - AROUND..place - 1).chain(place + 1..place + AROUND);
        let mut near: Vec<f64> = around.map(|at| (value(at + 1) - value(at)).abs()).collect();
        near.push((value(place + 1) - value(place - 1)).abs());
        leg > SPIKE * quantile(&near, 1.0).unwrap_or(0.0)
    };
    (AROUND..known.len().saturating_sub(AROUND)).filter(lone).map(|place| known[place]).collect()
}

/// Notes values that repeat although the measured quantity moves: a sample-and-hold slower than the file.
fn held(file: &str, column: &str, at: usize, pieces: &[Piece], notes: &mut Vec<Note>) {
    let steps = |piece: &Piece| -> Vec<f64> {
        piece.values[at]
            .windows(2)
            .map(|pair| (pair[1] - pair[0]).abs())
            .map(|step| if step.is_nan() { 0.0 } else { step })
            .collect()
    };
    let changes: Vec<f64> = pieces.iter().flat_map(steps).filter(|step| *step > 0.0).collect();
    let Some(grain) = quantile(&changes, 0.05) else { return };
    let (mut lengths, mut seconds) = (Vec::new(), 0.0);
    for piece in pieces {
        let mut since: Option<usize> = None;
        for (step, size) in steps(piece).into_iter().enumerate().filter(|(_, size)| *size > 0.0) {
            // A stretch between two changes of several quantisation steps: the quantity moves, so resolution does not
            // explain the repeated values. Stretches longer than ten samples are rest.
            let moves = size >= 4.0 * grain;
            if let Some(from) = since.filter(|from| moves && step - from <= 10) {
                lengths.push((step - from) as f64);
                seconds += piece.time_s[step] - piece.time_s[from];
            }
            since = moves.then_some(step);
        }
    }
    let (stretches, samples) = (lengths.len() as f64, lengths.iter().sum::<f64>());
    let length = samples / stretches;
    let spread = (lengths.iter().map(|other| (other - length).powi(2)).sum::<f64>() / stretches).sqrt();
    let rows: usize = pieces.iter().map(|piece| piece.time_s.len()).sum();
    // A slower clock makes stretches of nearly one length; a mechanism that stops now and then does not.
    let clock = spread < f64::max(0.6, 0.35 * length) && samples > 0.2 * rows as f64;
    if stretches >= 20.0 && length > 1.3 && clock {
        notes.push(Note::Held {
            file: file.to_owned(),
            column: column.to_owned(),
            share: 1.0 - 1.0 / length,
            rate_hz: stretches / seconds,
        });
    }
}
