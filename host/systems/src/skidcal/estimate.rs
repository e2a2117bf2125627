//! Slip compliances from a recording: the paper's formulas, the repaired one, and ours.
//!
//! # Ours
//! A bristle bends with the slip velocity and rolls out within the relaxation length `L`; its force moves a quarter of the robot:
//!
//! ```text
//! dz/dt = v_r - v - |v_r| z / L      F = z / (c L)      dv/dt = 4 F / m
//! ```
//!
//! With the wheels' measured speed `v_r` as input this predicts the robot's displacement. A nonlinear least-squares fit of tracked
//! positions gives `c`, with `L`, the scale of the wheels' radius and the offset of the tracker's clock beside it. Nothing is
//! differentiated twice, so that noise does not bias it, and the residual gives the interval.

use nalgebra::DMatrix;
use r4_maths::{least_squares, statistics::Interval};
use r4_world::GRAVITY_M_S2;

use super::protocol::{LEAD_S, Recording, Run, SPIN_RAD_S};

/// An estimate; an interval where the method has one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Compliance, 1/N, or ratio of compliances, 1.
    pub value: f64,
    /// 95 % confidence interval, by Student's t.
    pub interval: Option<Interval>,
}

/// Steps of the robot's speed between two samples of the wheels: 0.5 ms. The law swings with `sqrt(c L m / 4)`, 25 ms or more for the
/// robots that are sampled.
const SUBSTEPS: u32 = 20;
/// Compliance, 1/N, at which the fit begins: that of the paper's robot.
const START_PER_N: f64 = 0.005;
/// What a residual counts as 1, m, and guesses of the other numbers' scale: share of the radius, and offset of the clock, s.
const SCALE_M: f64 = 1e-3;
const RADIUS_SHARE: f64 = 1e-3;
/// Length of the paper's longitudinal test, s.
const PAPER_TEST_S: f64 = 1.0;
/// Steps of the paper's bisection: to 1e-15 of the bound.
const BISECTIONS: usize = 50;
/// Offset of the tracker's clock from the board's that is thought possible, s: a standard deviation.
const CLOCK_S: f64 = 5e-3;
/// Wheels whose computed force is this share of what friction gives count as sliding.
const SLIDES_FROM: f64 = 0.95;
/// Confidence of intervals.
const CONFIDENCE: f64 = 0.95;

/// `c_long` by the paper's equation (2) as it is printed, 1/N.
#[must_use]
pub fn printed(recording: &Recording) -> Option<Estimate> {
    bisected(recording, 4.0)
}

/// `c_long` by the repaired equation, on the same data, 1/N.
#[must_use]
pub fn repaired(recording: &Recording) -> Option<Estimate> {
    bisected(recording, 0.25)
}

/// The paper's search: `d_t = int v / (1 - factor a c m) dt`, with `v` and `a` from positions, differentiated.
fn bisected(recording: &Recording, factor: f64) -> Option<Estimate> {
    let run = recording.straight.first()?;
    let along = along(run);
    // The first step up from a slow speed.
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
    // Speeds in the middles between accelerations' neighbours.
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

/// Times, s, and displacements along the run's mean heading, m, as they were tracked.
fn along(run: &Run) -> Vec<[f64; 2]> {
    let count = run.tracked.len().max(1) as f64;
    let heading = run.tracked.iter().map(|tracked| tracked.measured()[2]).sum::<f64>() / count;
    let (sin, cos) = heading.sin_cos();
    let displacement = |[x_m, y_m, _]: [f64; 3]| cos * x_m + sin * y_m;
    run.tracked.iter().map(|tracked| [tracked.time_s, displacement(tracked.measured())]).collect()
}

/// Travel of both sides at a time, m, linear between samples.
fn wheels_at(run: &Run, time_s: f64) -> Option<[f64; 2]> {
    let after = run.wheels.partition_point(|sample| sample.time_s < time_s);
    let (left, right) = (run.wheels.get(after.checked_sub(1)?)?, run.wheels.get(after)?);
    let share = (time_s - left.time_s) / (right.time_s - left.time_s);
    Some([0, 1].map(|side| left.travel_m[side] + share * (right.travel_m[side] - left.travel_m[side])))
}

/// `c_long` by ours, 1/N.
#[must_use]
pub fn c_long(recording: &Recording) -> Option<Estimate> {
    let curves: Vec<Curve> = recording.straight.iter().filter_map(Curve::of).collect();
    let clock_s = recording.clock_s.max(CLOCK_S);
    let start = [0.0, 0.0, START_PER_N.ln(), (recording.robot.drive.wheel_radius_m / 2.0).ln()];
    let scaled = |numbers: &[f64]| {
        let law = Law { c_per_n: numbers[2].exp(), relaxation_m: numbers[3].exp(), mass_kg: recording.robot.mass_kg };
        let (radius, offset_s) = (numbers[0] * RADIUS_SHARE, numbers[1] * clock_s);
        let mut residuals: Vec<f64> =
            curves.iter().flat_map(|curve| curve.residuals_m(&law, radius, offset_s)).map(|m| m / SCALE_M).collect();
        // What is known of the clocks is one more observation: an offset of 0, as exact as they are.
        residuals.push(numbers[1]);
        residuals
    };
    let fit = least_squares::nonlinear(&start, scaled).ok()?;
    // Each run's mean has taken one observation.
    let free = fit.degrees_of_freedom as f64;
    let widened = (free / (free - curves.len() as f64).max(1.0)).sqrt();
    let interval = *fit.intervals(CONFIDENCE).ok()?.get(2)?;
    let (middle, half) = (fit.parameters[2], interval.width() / 2.0 * widened);
    let ends = Interval { low: (middle - half).exp(), high: (middle + half).exp() };
    Some(Estimate { value: middle.exp(), interval: Some(ends) })
}

/// Numbers of the law.
struct Law {
    c_per_n: f64,
    relaxation_m: f64,
    mass_kg: f64,
}

/// Wheels of a straight run at the moments of their samples, and where the robot was seen.
struct Curve {
    time_s: Vec<f64>,
    travel_m: Vec<f64>,
    speed_m_s: Vec<f64>,
    seen: Vec<Seen>,
}

/// A tracked place between two samples of the wheels.
struct Seen {
    /// The sample before.
    index: usize,
    /// Share of the time to the next.
    share: f64,
    /// Travel of the wheels, m.
    travel_m: f64,
    /// Displacement of the robot, m.
    displacement_m: f64,
}

impl Curve {
    fn of(run: &Run) -> Option<Self> {
        let travel_m: Vec<f64> = run.wheels.iter().map(|sample| sample.travel_m.iter().sum::<f64>() / 2.0).collect();
        let time_s: Vec<f64> = run.wheels.iter().map(|sample| sample.time_s).collect();
        let last = time_s.len().checked_sub(1)?;
        let speed = |index: usize| {
            let (from, to) = (index.saturating_sub(1), (index + 1).min(last));
            (travel_m[to] - travel_m[from]) / (time_s[to] - time_s[from])
        };
        let speed_m_s: Vec<f64> = (0..=last).map(speed).collect();
        let seen = along(run).into_iter().filter_map(|[at_s, displacement_m]| {
            let index = time_s.partition_point(|time_s| *time_s < at_s).checked_sub(1)?;
            let share = (at_s - time_s[index]) / (time_s.get(index + 1)? - time_s[index]);
            let [left_m, right_m] = wheels_at(run, at_s)?;
            Some(Seen { index, share, travel_m: f64::midpoint(left_m, right_m), displacement_m })
        });
        let seen = seen.collect();
        Some(Self { time_s, travel_m, speed_m_s, seen })
    }

    /// How much less than its wheels the robot has moved since the first sample, m, at each.
    fn slipped_m(&self, law: &Law) -> Vec<f64> {
        let Law { c_per_n, relaxation_m, mass_kg } = *law;
        let stiffness_s2 = 4.0 / (c_per_n * relaxation_m * mass_kg);
        let (mut bent_m, mut speed_m_s, mut slipped_m) = (0.0, self.speed_m_s.first().copied().unwrap_or(0.0), 0.0);
        let mut all = vec![0.0];
        for (times, travel_m) in self.time_s.windows(2).zip(self.travel_m.windows(2)) {
            let step_s = (times[1] - times[0]) / f64::from(SUBSTEPS);
            // The mean between two samples, which is exact: a smoother curve would move the robot less.
            let rim_m_s = (travel_m[1] - travel_m[0]) / (times[1] - times[0]);
            for _ in 0..SUBSTEPS {
                let before_m_s = speed_m_s;
                bent_m = (bent_m + (rim_m_s - speed_m_s) * step_s) / (1.0 + rim_m_s.abs() * step_s / relaxation_m);
                speed_m_s += stiffness_s2 * bent_m * step_s;
                slipped_m += (rim_m_s - f64::midpoint(before_m_s, speed_m_s)) * step_s;
            }
            all.push(slipped_m);
        }
        all
    }

    /// Tracked minus predicted displacements, m, less their mean: where a run begins is not known.
    fn residuals_m(&self, law: &Law, radius: f64, offset_s: f64) -> Vec<f64> {
        let slipped_m = self.slipped_m(law);
        let residual = |seen: &Seen| {
            let Seen { index, share, travel_m, displacement_m } = *seen;
            let between = |values: &[f64]| values[index] + share * (values[index + 1] - values[index]);
            let moved_m = travel_m * (1.0 + radius) - between(&slipped_m) + offset_s * between(&self.speed_m_s);
            displacement_m - moved_m
        };
        let mut residuals: Vec<f64> = self.seen.iter().map(residual).collect();
        let mean = residuals.iter().sum::<f64>() / residuals.len().max(1) as f64;
        residuals.iter_mut().for_each(|residual| *residual -= mean);
        residuals
    }
}

/// `c_lat / c_long` by the paper's equation (3), with the commanded rate and the time of whole rotations.
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

/// Equation (3).
fn ratio_of([half_base_m, half_track_m]: [f64; 2], rim_rad_s: f64, rate_rad_s: f64) -> f64 {
    half_base_m * half_base_m * rate_rad_s / (half_track_m * half_track_m * (rim_rad_s - rate_rad_s))
}

/// Turning rates of the spin, rad/s: that of wheels that do not slip, and the robot's with its standard error.
fn rates(recording: &Recording) -> Option<(f64, f64, f64)> {
    let Run { wheels, tracked } = &recording.spin;
    let half_track_m = recording.robot.half_m[1];
    let turned = |[left_m, right_m]: [f64; 2]| (right_m - left_m) / 2.0 / half_track_m;
    let rim: Vec<_> = wheels.iter().map(|sample| (sample.time_s, turned(sample.travel_m))).collect();
    let heading: Vec<_> = tracked.iter().map(|tracked| (tracked.time_s, tracked.measured()[2])).collect();
    let (rim_rad_s, _) = slope(&rim)?;
    let (rate_rad_s, error_rad_s) = slope(&heading)?;
    Some((rim_rad_s, rate_rad_s, error_rad_s))
}

/// Slope of a straight line through points, and its standard error.
fn slope(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let origin = points.first()?.0;
    let design =
        DMatrix::from_fn(points.len(), 2, |row, column| if column == 0 { 1.0 } else { points[row].0 - origin });
    let observed: Vec<f64> = points.iter().map(|point| point.1).collect();
    let fit = least_squares::linear(&design, &observed).ok()?;
    Some((fit.parameters[1], fit.standard_errors()[1]))
}

/// `c_lat / c_long` by ours: equation (3) with slopes of all samples, and the wheels' measured rate in place of the commanded one.
#[must_use]
pub fn ratio(recording: &Recording) -> Option<Estimate> {
    let (rim_rad_s, rate_rad_s, error_rad_s) = rates(recording)?;
    let of = |rate_rad_s| ratio_of(recording.robot.half_m, rim_rad_s, rate_rad_s);
    // Monotone in the rate, up to that of the wheels: its ends are those of the ratio. 1.96: hundreds of samples.
    let ends = [-1.96, 1.96].map(|times| rate_rad_s + times * error_rad_s);
    let high = if ends[1] < rim_rad_s { of(ends[1]) } else { f64::INFINITY };
    Some(Estimate { value: of(rate_rad_s), interval: Some(Interval { low: of(ends[0]), high }) })
}

/// Whether wheels slide in the spin: their forces by the estimates against `friction` times the weight on each.
///
/// Under the linear law forces follow from the compliances alone, and not from the rate: a slower spin does not help, other than the
/// paper says.
#[must_use]
pub fn reaches_friction(recording: &Recording, friction: f64) -> bool {
    let (Some((rim_rad_s, rate_rad_s, _)), Some(c_long)) = (rates(recording), c_long(recording)) else { return false };
    let along_n = (1.0 - rate_rad_s / rim_rad_s) / c_long.value;
    // Moments balance: b F_long = l F_lat.
    let [half_base_m, half_track_m] = recording.robot.half_m;
    let force_n = along_n.hypot(along_n * half_track_m / half_base_m);
    force_n >= SLIDES_FROM * friction * recording.robot.mass_kg * GRAVITY_M_S2 / 4.0
}
