//! Slip compliances from a recording: by the paper's formulas, by the repaired one, and the ratio by ours.
//!
//! Our estimate of `c_long` is in [`bristle`].

use nalgebra::DMatrix;
use r4_maths::{least_squares, statistics::Interval};
use r4_world::GRAVITY_M_S2;

use super::{
    bristle,
    protocol::{LEAD_S, Recording, Run, SPIN_RAD_S},
};

/// An estimate, with an interval where the method has one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Compliance, 1/N, or ratio of compliances; the ratio is dimensionless.
    pub value: f64,
    /// 95 % confidence interval, by Student's t.
    pub interval: Option<Interval>,
}

/// Duration of the paper's longitudinal test, s.
const PAPER_TEST_S: f64 = 1.0;
/// Bisection steps of the paper's search: a resolution of 1e-15 of the bound.
const BISECTIONS: usize = 50;
/// Share of the available friction from which on a computed wheel force counts as sliding.
const SLIDES_FROM: f64 = 0.95;

/// Estimates `c_long` by the paper's equation (2) as printed, 1/N.
#[must_use]
pub fn printed(recording: &Recording) -> Option<Estimate> {
    bisected(recording, 4.0)
}

/// Estimates `c_long` by the repaired equation on the same data, 1/N.
#[must_use]
pub fn repaired(recording: &Recording) -> Option<Estimate> {
    bisected(recording, 0.25)
}

/// The paper's search: solves `d_t = int v / (1 - factor a c m) dt` for `c`, with `v` and `a` from differentiated
/// positions.
fn bisected(recording: &Recording, factor: f64) -> Option<Estimate> {
    let run = recording.straight.first()?;
    let along = along(run);
    // The test is the first step up from the slow speed.
    let begin_s = run.wheels.first()?.time_s + LEAD_S;
    let is_in = |time_s: f64| (begin_s..=begin_s + PAPER_TEST_S).contains(&time_s);
    let test: Vec<[f64; 2]> = along.into_iter().filter(|[time_s, _]| is_in(*time_s)).collect();
    let slopes = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
        let slope = |pair: &[[f64; 2]]| {
            [(pair[0][0] + pair[1][0]) / 2.0, (pair[1][1] - pair[0][1]) / (pair[1][0] - pair[0][0])]
        };
        points.windows(2).map(slope).collect()
    };
    let speeds = slopes(&test);
    let accelerations = slopes(&speeds);
    let (first, last) = (accelerations.first()?[0], accelerations.last()?[0]);
    let wheels_m = |time_s| Some(wheels_at(run, time_s)?.iter().sum::<f64>() / 2.0);
    let travelled_m = (wheels_m(last)? - wheels_m(first)?).abs();
    let most = accelerations.iter().map(|[_, acceleration]| *acceleration).fold(0.0, f64::max);
    let mass_kg = recording.robot.mass_kg;
    // Speeds at the times of the accelerations: means of their neighbours.
    let distance_m = |c: f64| -> f64 {
        let integrand = |(index, [time_s, acceleration]): (usize, &[f64; 2])| {
            let speed = (speeds[index][1] + speeds[index + 1][1]) / 2.0;
            [*time_s, speed / (1.0 - factor * acceleration * c * mass_kg)]
        };
        let values: Vec<_> = accelerations.iter().enumerate().map(integrand).collect();
        values.windows(2).map(|pair| (pair[1][0] - pair[0][0]) * (pair[0][1] + pair[1][1]) / 2.0).sum()
    };
    let (mut low, mut high) = (0.0, 1.0 / (factor * most * mass_kg));
    for _ in 0..BISECTIONS {
        let middle = (low + high) / 2.0;
        if distance_m(middle) < travelled_m { low = middle } else { high = middle }
    }
    Some(Estimate { value: (low + high) / 2.0, interval: None })
}

/// Times, s, and tracked displacements along the run's mean heading, m.
pub(super) fn along(run: &Run) -> Vec<[f64; 2]> {
    let count = run.tracked.len().max(1) as f64;
    let heading = run.tracked.iter().map(|tracked| tracked.measured()[2]).sum::<f64>() / count;
    let (sin, cos) = heading.sin_cos();
    let displacement = |[x_m, y_m, _]: [f64; 3]| cos * x_m + sin * y_m;
    run.tracked.iter().map(|tracked| [tracked.time_s, displacement(tracked.measured())]).collect()
}

/// Travel of both sides at a time, m, linearly interpolated; `None` outside the samples.
pub(super) fn wheels_at(run: &Run, time_s: f64) -> Option<[f64; 2]> {
    let after = run.wheels.partition_point(|sample| sample.time_s < time_s);
    let (left, right) = (run.wheels.get(after.checked_sub(1)?)?, run.wheels.get(after)?);
    let share = (time_s - left.time_s) / (right.time_s - left.time_s);
    Some([0, 1].map(|side| left.travel_m[side] + share * (right.travel_m[side] - left.travel_m[side])))
}

/// Estimates `c_lat / c_long` by the paper's equation (3), with the commanded rate and the time of whole rotations.
#[must_use]
pub fn commanded_ratio(recording: &Recording) -> Option<Estimate> {
    let headings: Vec<[f64; 2]> =
        recording.spin.tracked.iter().map(|tracked| [tracked.time_s, tracked.measured()[2]]).collect();
    let first = headings.first()?;
    let turned = headings.last()?[1] - first[1];
    let rotations = (turned.abs() / std::f64::consts::TAU).floor();
    if rotations < 1.0 {
        return None;
    }
    let wanted = first[1] + rotations * std::f64::consts::TAU * turned.signum();
    let crosses = |pair: &&[[f64; 2]]| (pair[0][1] - wanted) * (pair[1][1] - wanted) <= 0.0;
    let pair = headings.windows(2).find(crosses)?;
    let share = (wanted - pair[0][1]) / (pair[1][1] - pair[0][1]);
    let at_s = pair[0][0] + share * (pair[1][0] - pair[0][0]);
    let rate = rotations * std::f64::consts::TAU / (at_s - first[0]);
    Some(Estimate { value: ratio_of(recording.robot.half_m, SPIN_RAD_S, rate), interval: None })
}

/// Equation (3) of the paper: ratio of the compliances from the rates of rims and robot, rad/s.
fn ratio_of([half_base_m, half_track_m]: [f64; 2], rim_rad_s: f64, rate_rad_s: f64) -> f64 {
    half_base_m * half_base_m * rate_rad_s / (half_track_m * half_track_m * (rim_rad_s - rate_rad_s))
}

/// Turning rates of the spin, rad/s: that of wheels without slip, that of the robot, and the standard error of the
/// latter.
pub(super) fn rates(recording: &Recording) -> Option<(f64, f64, f64)> {
    let Run { wheels, tracked, .. } = &recording.spin;
    let half_track_m = recording.robot.half_m[1];
    let turned = |[left_m, right_m]: [f64; 2]| (right_m - left_m) / 2.0 / half_track_m;
    let rim: Vec<_> = wheels.iter().map(|sample| (sample.time_s, turned(sample.travel_m))).collect();
    let heading: Vec<_> = tracked.iter().map(|tracked| (tracked.time_s, tracked.measured()[2])).collect();
    let (rim_rad_s, _) = slope(&rim)?;
    let (rate_rad_s, error_rad_s) = slope(&heading)?;
    Some((rim_rad_s, rate_rad_s, error_rad_s))
}

/// Slope of a straight line through points, with its standard error.
fn slope(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let origin = points.first()?.0;
    let design =
        DMatrix::from_fn(points.len(), 2, |row, column| if column == 0 { 1.0 } else { points[row].0 - origin });
    let observed: Vec<f64> = points.iter().map(|point| point.1).collect();
    let fit = least_squares::linear(&design, &observed).ok()?;
    Some((fit.parameters[1], fit.standard_errors()[1]))
}

/// Estimates `c_lat / c_long` by ours: equation (3) with slopes over all samples, and the wheels' measured rate in
/// place of the commanded one.
#[must_use]
pub fn ratio(recording: &Recording) -> Option<Estimate> {
    let (rim_rad_s, rate_rad_s, error_rad_s) = rates(recording)?;
    let of = |rate_rad_s| ratio_of(recording.robot.half_m, rim_rad_s, rate_rad_s);
    // The ratio is monotone in the robot's rate, up to that of the wheels: the ends of one interval map to those of the
    // other. 1.96 because there are hundreds of samples.
    let ends = [-1.96, 1.96].map(|times| rate_rad_s + times * error_rad_s);
    let high = if ends[1] < rim_rad_s { of(ends[1]) } else { f64::INFINITY };
    Some(Estimate { value: of(rate_rad_s), interval: Some(Interval { low: of(ends[0]), high }) })
}

/// Returns true when wheels slide in the spin: their estimated forces reach `friction` times the weight on each wheel.
///
/// Under the linear law the forces follow from the compliances alone, not from the rate: a slower spin does not help,
/// contrary to the paper.
#[must_use]
pub fn reaches_friction(recording: &Recording, friction: f64) -> bool {
    let (Some((rim_rad_s, rate_rad_s, _)), Some(c_long)) = (rates(recording), bristle::c_long(recording)) else {
        return false;
    };
    let along_n = (1.0 - rate_rad_s / rim_rad_s) / c_long.value;
    // Balance of moments: b F_long = l F_lat.
    let [half_base_m, half_track_m] = recording.robot.half_m;
    let force_n = along_n.hypot(along_n * half_track_m / half_base_m);
    force_n >= SLIDES_FROM * friction * recording.robot.mass_kg * GRAVITY_M_S2 / 4.0
}
