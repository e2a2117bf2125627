//! Maps of readings: by place and time, and the simpler maps that it is compared with.

use r4_maps::{
    grid::{Frame, Grid},
    pose::{Point, distance_m},
    process::{Kernel, Process, ProcessError, Sample},
};
use r4_maths::minimise::Effort;

/// Bounds of the kernel's parameters on a plot of 40 m: half again as wide as the sampled ranges of `About::sampled`.
/// Bells of a size s at random places have a covariance of length √2 s. The noise covers the displacement within a
/// reading and a cloud's changes over the plot.
const LEAST: Kernel = Kernel { place_deviation: 10.0, length_m: 3.5, time_deviation: 10.0, time_s: 40.0, noise: 0.5 };
const GREATEST: Kernel =
    Kernel { place_deviation: 60.0, length_m: 19.0, time_deviation: 60.0, time_s: 2000.0, noise: 8.0 };
/// Bounds of a kernel without a time term, for which all changes are noise.
const NO_TIME: f64 = 1e-3;
const NOISE_WITHOUT_TIME: f64 = 80.0;
/// Effort of the fit.
const EFFORT: Effort = Effort { points: 10, generations: 10, simplex: 180 };
const FIT_SEED: u64 = 14;
/// Largest number of readings for the kernel's fit: every n-th is used, since the time of a fit grows with their cube.
const FITTED: usize = 220;
/// Period at which the temporal part is averaged over the mission, s.
const AVERAGED_S: f64 = 20.0;

/// A map of the mean over a mission, with its components.
#[derive(Clone, Debug)]
pub struct Map {
    /// Mean of the field over the mission in each cell, V/m.
    pub mean: Grid<f64>,
    /// Kernel that fits the readings best.
    pub kernel: Kernel,
    /// Temporal part every `AVERAGED_S`: time, s, and difference from the readings' mean, V/m.
    pub time_part: Vec<(f64, f64)>,
    /// Standard deviation of the pattern in each cell, the spatial part less its mean over the map, V/m.
    pub deviation: Grid<f64>,
}

/// Computes the map by place and time; without a time term all changes count as noise.
///
/// # Errors
/// [`ProcessError`] for readings that define no regression.
pub fn by_process(frame: Frame, readings: &[Sample], until_s: f64, has_time: bool) -> Result<Map, ProcessError> {
    // The process has a mean of 0.
    let offset = readings.iter().map(|sample| sample.value).sum::<f64>() / readings.len().max(1) as f64;
    let centred: Vec<Sample> =
        readings.iter().map(|sample| Sample { value: sample.value - offset, ..*sample }).collect();
    // The fit factorises a matrix at every step, with a cost cubic in the readings; the map needs that only once.
    let few: Vec<Sample> = centred.iter().step_by(centred.len().div_ceil(FITTED).max(1)).copied().collect();
    let (low, high) = if has_time {
        (LEAST, GREATEST)
    } else {
        let of = |kernel: Kernel| Kernel { time_deviation: NO_TIME, time_s: LEAST.time_s, ..kernel };
        (of(LEAST), Kernel { noise: NOISE_WITHOUT_TIME, ..of(GREATEST) })
    };
    let kernel = *Process::of(LEAST, &few)?.fitted(low, high, EFFORT, FIT_SEED)?.kernel();
    let process = Process::of(kernel, &centred)?;
    let steps = (until_s / AVERAGED_S).ceil().max(1.0) as usize;
    let middle = frame.centre(frame.cell(frame.cells() / 2));
    let time_part: Vec<(f64, f64)> = (0..steps)
        .map(|step| (step as f64 + 0.5) * until_s / steps as f64)
        .map(|at_s| (at_s, process.predict(middle, at_s).time.mean))
        .collect();
    let time_mean = time_part.iter().map(|(_, mean)| mean).sum::<f64>() / steps as f64;
    let mut mean = Grid::filled(frame, 0.0);
    let mut deviation = Grid::filled(frame, 0.0);
    let places: Vec<Point> = (0..frame.cells()).map(|index| frame.centre(frame.cell(index))).collect();
    let covariance = process.pattern_covariance(&places);
    for (index, place) in places.into_iter().enumerate() {
        mean.values_mut()[index] = offset + time_mean + process.predict(place, 0.0).place.mean;
        // Rounding may make a variance of nearly nothing negative.
        deviation.values_mut()[index] = covariance[(index, index)].max(0.0).sqrt();
    }
    Ok(Map { mean, kernel, time_part, deviation })
}

/// Map of the mean of the readings in each square of `side_m`; a square without a reading takes the mean of the nearest
/// one with readings.
#[must_use]
pub fn per_cell(frame: Frame, readings: &[Sample], side_m: f64) -> Grid<f64> {
    let of = |at: Point| at.map(|metres| (metres / side_m).floor() as i64);
    let mut squares: std::collections::BTreeMap<[i64; 2], (f64, f64)> = std::collections::BTreeMap::new();
    for sample in readings {
        let (sum, count) = squares.entry(of(sample.at)).or_default();
        *sum += sample.value;
        *count += 1.0;
    }
    let middle = |square: &[i64; 2]| square.map(|number| (number as f64 + 0.5) * side_m);
    Grid::from_fn(frame, |cell| {
        let at = frame.centre(cell);
        let nearest = squares.get(&of(at)).or_else(|| {
            let far = |square: &[i64; 2]| distance_m(middle(square), at);
            squares.iter().min_by(|a, b| far(a.0).total_cmp(&far(b.0))).map(|(_, mean)| mean)
        });
        nearest.map_or(0.0, |(sum, count)| sum / count)
    })
}

/// Root mean square difference of two maps, in their unit; NaN when their sizes differ.
#[must_use]
pub fn rmse(map: &Grid<f64>, truth: &Grid<f64>) -> f64 {
    r4_maths::statistics::rmse(truth.values(), map.values()).unwrap_or(f64::NAN)
}

/// Root mean square difference of two maps without the difference of their means: the error of the pattern alone.
#[must_use]
pub fn pattern_rmse(map: &Grid<f64>, truth: &Grid<f64>) -> f64 {
    let mean = |grid: &Grid<f64>| grid.values().iter().sum::<f64>() / grid.values().len() as f64;
    let shift = mean(map) - mean(truth);
    rmse(&map.map(|value| value - shift), truth)
}
