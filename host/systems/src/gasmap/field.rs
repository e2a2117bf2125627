//! Measurements of the map itself: errors of means, over-confidence of variances, and computing time of a reading.

use std::time::Instant;

use r4_maps::{
    field::{Field, FieldError, Reading, Weights},
    grid::{Frame, Grid},
    pose::Pose,
};

use super::survey::PUBLISHED;
use crate::{Limit, Row, Statistic};

/// Number of readings of the timed map, one each second along a lane.
const READINGS: usize = 100;
/// Number of cells that messages may update after a reading, and the change at which they stop, ppm.
const BUDGET: usize = 20_000;
const THRESHOLD: f64 = 1.0;
/// Tolerance of the means after each reading, ppm: a solve after the messages reaches it.
const TOLERANCE: f64 = 1e-3;

/// The hall of the published maps, 60 m by 50 m in cells of 0.2 m, without shelves: 75 000 cells.
fn hall() -> Result<Grid<bool>, FieldError> {
    Ok(Grid::filled(Frame::new(Pose::default(), 0.2, 300, 250)?, true))
}

/// Reading number `number` along a lane through the hall.
fn reading(number: usize) -> Reading {
    let (lane, along) = (number / 45, number % 45);
    let column = if lane % 2 == 0 { 15 + 6 * along } else { 285 - 6 * along };
    Reading { cell: [column, 30 + 25 * lane], value: 45.0 + 35.0 * (number as f64 * 0.37).sin(), at_s: number as f64 }
}

/// Measures the computing time of each reading, including the update of the means, ms.
///
/// # Errors
/// [`FieldError`] when a solve does not converge.
pub fn times_ms(readings: usize) -> Result<Vec<f64>, FieldError> {
    let mut field = Field::new(&hall()?, PUBLISHED)?;
    let mut times_ms = Vec::with_capacity(readings);
    for number in 0..readings {
        let begin = Instant::now();
        field.observe(reading(number))?;
        field.wildfire(THRESHOLD, BUDGET);
        field.solve(TOLERANCE)?;
        times_ms.push(begin.elapsed().as_secs_f64() * 1e3);
    }
    Ok(times_ms)
}

/// Largest and median factor by which the variances of belief propagation are below the exact ones.
///
/// # Errors
/// [`FieldError`] for weights or readings that define no field.
pub fn over_confidence(free: &Grid<bool>, weights: Weights, readings: &[Reading]) -> Result<[f64; 2], FieldError> {
    let mut field = Field::new(free, weights)?;
    for reading in readings {
        field.observe(*reading)?;
    }
    // The precisions of messages converge without their means.
    field.settle(1e-9, 40 * field.cells());
    let (exact, propagated) = (field.variances(), field.propagated_variances());
    let pairs = exact.values().iter().zip(propagated.values());
    let mut factors: Vec<f64> = pairs.filter_map(|(exact, propagated)| Some((*exact)? / (*propagated)?)).collect();
    factors.sort_by(f64::total_cmp);
    Ok([factors[factors.len() - 1], factors[factors.len() / 2]])
}

/// Benchmark row: the computing time of a reading on this computer.
///
/// # Errors
/// [`crate::Error::Unsuitable`] when a solve does not converge; [`crate::Error::Statistics`] when the statistic cannot
/// be computed.
pub(super) fn rows(is_quick: bool) -> Result<Vec<Row>, crate::Error> {
    let readings = if is_quick { READINGS / 5 } else { READINGS };
    let failed = |error: FieldError| crate::Error::Unsuitable {
        system: super::NAME,
        board: "the map".into(),
        why: error.to_string(),
    };
    let summary = Statistic::Quantile(0.5).of(&times_ms(readings).map_err(failed)?)?;
    let names = [super::NAME, super::OURS];
    Ok(vec![Row::timed(names, ["update_75000_cells_ms", "ms"], readings, [0, 0], summary, Limit::AtMost(50.0))])
}
