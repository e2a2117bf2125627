//! Detection of an output that does not react to the input.
//!
//! The output's rate, or the output itself if it is a speed, is regressed on the input, low-passed with time
//! constants from zero to infinity, as means over short blocks. Blocks without motion are left out: at an end stop no
//! input matters. Slow signals correlate by chance, so the regression is repeated with the input shifted by parts of
//! the recording: an output does not react if the input explains no more than the best of these shifts.

use nalgebra::{DMatrix, DVector};

use super::{Column, Fault};

/// Length of a block, s, and at least four samples: noise 30 dB below an angle is a third of the rate over 0.03 s,
/// and a twentieth over 0.1 s.
const BLOCK_S: f64 = 0.1;
const BLOCK_SAMPLES: usize = 4;
/// Smallest number of blocks in motion: five regressors for each input need several times as many.
const LEAST: usize = 40;
/// Time constants of the low-pass filters, s; the last one is an integral.
const FILTERS_S: [f64; 5] = [0.0, 0.1, 0.4, 1.6, f64::INFINITY];
/// Share of the largest rate below which a block is at rest.
const REST: f64 = 0.05;
/// Number of shifts, evenly distributed over each run.
const SHIFTS: usize = 24;
/// Explained share of the motion that is a reaction whatever the shifts explain. A motor with a resonant load has had
/// 0.3.
const REACTS: f64 = 0.25;

pub(super) fn none(output: &Column<'_>, inputs: &[Column<'_>]) -> Option<Fault> {
    let blocks = Blocks::of(output, inputs)?;
    let share = blocks.explained(0.0)?;
    // Saves the regressions of all shifts.
    if share >= REACTS {
        return None;
    }
    let shifts = (1..SHIFTS).filter_map(|shift| blocks.explained(shift as f64 / SHIFTS as f64));
    let chance = shifts.fold(0.0, f64::max);
    let input = inputs.iter().map(|input| input.name).collect::<Vec<_>>().join("`, `");
    // A reaction has a residual variance at least 5 % below that of the best shift.
    (1.0 - share >= 0.95 * (1.0 - chance)).then(|| Fault::NoReaction {
        output: output.name.to_owned(),
        input,
        share,
        chance,
    })
}

/// Means of one run's signals over blocks.
struct Part {
    period_s: f64,
    inputs: Vec<Vec<f64>>,
    /// Rate or speed that should react; NaN in blocks at rest.
    target: Vec<f64>,
}

struct Blocks(Vec<Part>);

impl Blocks {
    fn of(output: &Column<'_>, inputs: &[Column<'_>]) -> Option<Self> {
        if inputs.is_empty() || inputs.iter().any(|input| input.series.len() != output.series.len()) {
            return None;
        }
        let part = |run: usize| {
            let series = output.series[run];
            let samples = series.values.len().min(inputs.iter().map(|input| input.series[run].values.len()).min()?);
            let duration_s = series.time_s.last()? - series.time_s.first()?;
            let length = (BLOCK_S * samples as f64 / duration_s).round();
            let length = if length.is_finite() { (length as usize).max(BLOCK_SAMPLES) } else { return None };
            let means = |values: &[f64]| -> Vec<f64> {
                let mean = |block: &[f64]| block.iter().sum::<f64>() / block.len() as f64;
                values[..samples].chunks_exact(length).map(mean).collect()
            };
            let measured = means(series.values);
            let rate = |at: usize| {
                let (before, after) = (measured.get(at.checked_sub(1)?)?, measured.get(at + 1)?);
                Some(after - before)
            };
            let rates = || (0..measured.len()).map(|at| rate(at).unwrap_or(f64::NAN)).collect();
            Some(Part {
                period_s: duration_s / samples as f64 * length as f64,
                inputs: inputs.iter().map(|input| means(input.series[run].values)).collect(),
                target: if output.is_speed { measured } else { rates() },
            })
        };
        let mut parts: Vec<Part> = (0..output.series.len()).filter_map(part).collect();
        let most = parts.iter().flat_map(|part| &part.target).fold(0.0, |most, rate| f64::max(most, rate.abs()));
        let targets = parts.iter_mut().flat_map(|part| &mut part.target);
        targets.filter(|rate| rate.abs() <= REST * most).for_each(|rate| *rate = f64::NAN);
        let moving = parts.iter().flat_map(|part| &part.target).filter(|rate| rate.is_finite()).count();
        (moving >= LEAST.max(10 * inputs.len() * FILTERS_S.len())).then_some(Self(parts))
    }

    /// Returns the share of the squared motion that the regression explains, with the input shifted by a share of
    /// each run.
    fn explained(&self, shift: f64) -> Option<f64> {
        let (mut rows, mut target) = (Vec::new(), Vec::new());
        for part in &self.0 {
            let count = part.target.len();
            let by = (shift * count as f64) as usize;
            let mut columns: Vec<Vec<f64>> = Vec::new();
            for input in &part.inputs {
                let shifted =
                    |at: usize| input.get((at + by) % count).copied().filter(|value| value.is_finite()).unwrap_or(0.0);
                columns.extend(FILTERS_S.map(|filter_s| filtered((0..count).map(shifted), part.period_s, filter_s)));
            }
            columns.iter_mut().for_each(|column| centre(column));
            for (at, rate) in part.target.iter().enumerate().filter(|(_, rate)| rate.is_finite()) {
                rows.push(columns.iter().map(|column| column[at]).chain([1.0]).collect::<Vec<f64>>());
                target.push(*rate);
            }
        }
        let width = rows.first()?.len();
        let mut x = DMatrix::from_fn(rows.len(), width, |row, column| rows[row][column]);
        for mut column in x.column_iter_mut() {
            let norm = column.norm();
            if norm > 0.0 {
                column /= norm;
            }
        }
        let mut normal = x.transpose() * &x;
        // The filtered inputs are nearly collinear; this keeps the normal matrix invertible.
        (0..width).for_each(|at| normal[(at, at)] += 1e-6);
        let y = DVector::from_vec(target);
        let solution = normal.try_inverse()? * x.transpose() * &y;
        let share = 1.0 - (&y - &x * solution).norm_squared() / y.norm_squared();
        share.is_finite().then_some(share)
    }
}

fn centre(values: &mut [f64]) {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    values.iter_mut().for_each(|value| *value -= mean);
}

fn filtered(values: impl Iterator<Item = f64>, period_s: f64, filter_s: f64) -> Vec<f64> {
    let mut state = 0.0;
    let share = 1.0 - (-period_s / filter_s).exp();
    let step = |value: f64| {
        state += if filter_s.is_infinite() { value * period_s } else { share * (value - state) };
        state
    };
    values.map(step).collect()
}
