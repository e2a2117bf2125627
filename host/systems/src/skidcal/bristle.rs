//! Our estimate of `c_long`: a least-squares fit of the tyres' law to the measurements, without differentiating them.
//!
//! A bristle bends with the slip velocity and relaxes within the relaxation length `L`; its force moves a quarter of
//! the robot:
//!
//! ```text
//! dz/dt = v_r - v - |v_r| z / L      F = z / (c L)      dv/dt = 4 F / m
//! ```
//!
//! With the wheels' measured speed `v_r` as input this predicts the robot's displacement, which [`c_long`] fits to
//! tracked positions, and its acceleration, which [`c_long_inertial`] fits to an inertial sensor. `L` and the offset of
//! the sensor's clock are fitted beside `c`, with the scale of the wheels' radius or the sensor's bias. Nothing is
//! differentiated twice, so that noise does not bias the estimate, and the residual gives its interval.

use r4_maths::{
    least_squares,
    statistics::{Interval, mean, mean_interval, rms},
};

use super::{
    estimate::{Estimate, along, wheels_at},
    protocol::{Recording, Run},
    scene::INERTIAL_M_S2,
};

/// Integration steps of the robot's speed between two samples of the wheels: 0.5 ms. The law oscillates on a time scale
/// of `sqrt(c L m / 4)`, 25 ms or more for the sampled robots.
const SUBSTEPS: u32 = 20;
/// Initial guess of the compliance, 1/N: that of the paper's robot.
const START_PER_N: f64 = 0.005;
/// Scale of displacement residuals, m.
const SCALE_M: f64 = 1e-3;
/// Scale of the error of the wheels' radius, as a share of the radius.
const RADIUS_SHARE: f64 = 1e-3;
/// Scale of an inertial sensor's bias, m/s²: 10 mg.
const BIAS_M_S2: f64 = 0.1;
/// Standard deviation, s, of the offset between a sensor's clock and the board's.
const CLOCK_S: f64 = 5e-3;
/// Confidence level of the intervals.
const CONFIDENCE: f64 = 0.95;
/// Indices of the scaled parameters.
const SYSTEMATIC: usize = 0;
const LOG_C: usize = 2;
/// Largest number of runs there and back for the inertial estimate: Student's t interval of four is 1.6 times as wide
/// as a normal one, that of two 6.5 times.
const INERTIAL_RUNS: usize = 4;

/// Estimates `c_long` from tracked positions, 1/N; `None` when the fit fails.
#[must_use]
pub fn c_long(recording: &Recording) -> Option<Estimate> {
    let (curves, fit) = fit_tracked(recording)?;
    // The mean of each run's residuals uses up one observation.
    Some(fit.estimate(curves.len()))
}

/// Estimates `c_long` from the acceleration along the robot, 1/N, in up to four runs there and back; `None` when no run
/// can be fitted.
///
/// Each run is fitted by itself, and the interval is Student's t of their logarithms. The error of the wheels'
/// quantised travel oscillates with the bristles, so that one run's residual makes its interval too narrow (92 % of
/// seeds 1 to 200 covered).
#[must_use]
pub fn c_long_inertial(recording: &Recording) -> Option<Estimate> {
    let fit = |there_and_back: &[Run]| {
        let curves: Vec<Curve> = there_and_back.iter().filter_map(Curve::felt).collect();
        let scaled = |curve: &Curve, numbers: &Numbers| {
            let residuals = numbers.acceleration_residuals_m_s2(curve).into_iter();
            residuals.map(|residual_m_s2| residual_m_s2 / INERTIAL_M_S2).collect()
        };
        Fit::of(recording, &curves, scaled)
    };
    let fits: Vec<Fit> = recording.straight.chunks_exact(2).take(INERTIAL_RUNS).filter_map(fit).collect();
    let logs: Vec<f64> = fits.iter().map(|fit| fit.numbers.law.c_per_n.ln()).collect();
    let Ok(interval) = mean_interval(&logs, CONFIDENCE) else { return Some(fits.first()?.estimate(0)) };
    let value = mean(&logs).ok()?.exp();
    Some(Estimate { value, interval: Some(Interval { low: interval.low.exp(), high: interval.high.exp() }) })
}

/// Radius of the wheels, estimated from one recording and tested on another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Radius {
    /// True radius over the configured one; dimensionless.
    pub(super) scale: f64,
    /// True when the interval at the requested level excludes the configured radius.
    pub(super) is_another: bool,
    /// Root mean square error of the held-out displacements with the configured radius, m.
    pub(super) before_m: f64,
    /// Root mean square error of the held-out displacements with the estimated radius, m.
    pub(super) after_m: f64,
}

/// Estimates the wheels' radius by the runs of one recording, and tests it on those of another.
pub(super) fn wheel_radius(fit_to: &Recording, held_out: &Recording, level: f64) -> Option<Radius> {
    let (curves, fit) = fit_tracked(fit_to)?;
    let error_m = |numbers: &Numbers| {
        let curves = held_out.straight.iter().filter_map(Curve::tracked);
        rms(&curves.flat_map(|curve| numbers.displacement_residuals_m(&curve)).collect::<Vec<_>>()).ok()
    };
    Some(Radius {
        scale: 1.0 + fit.numbers.systematic * RADIUS_SHARE,
        is_another: !fit.interval(SYSTEMATIC, level, curves.len())?.contains(0.0),
        before_m: error_m(&Numbers { systematic: 0.0, ..fit.numbers })?,
        after_m: error_m(&fit.numbers)?,
    })
}

fn fit_tracked(recording: &Recording) -> Option<(Vec<Curve>, Fit)> {
    let curves: Vec<Curve> = recording.straight.iter().filter_map(Curve::tracked).collect();
    let scaled = |curve: &Curve, numbers: &Numbers| {
        numbers.displacement_residuals_m(curve).into_iter().map(|residual_m| residual_m / SCALE_M).collect()
    };
    let fit = Fit::of(recording, &curves, scaled)?;
    Some((curves, fit))
}

/// The first straight run with the prediction of the fitted law.
pub struct FirstRun {
    curve: Curve,
    numbers: Numbers,
}

impl FirstRun {
    /// Takes the first run of a recording, with the law fitted to all of its tracked runs; `None` when the fit fails.
    #[must_use]
    pub fn of(recording: &Recording) -> Option<Self> {
        let (curves, fit) = fit_tracked(recording)?;
        Some(Self { curve: curves.into_iter().next()?, numbers: fit.numbers })
    }

    /// Time, s; speed of the wheels' rims, m/s; predicted speed of the robot, m/s.
    #[must_use]
    pub fn speeds(&self) -> Vec<(f64, f64, f64)> {
        let motion = self.curve.motion(&self.numbers.law).into_iter();
        let at = |(index, motion): (usize, Motion)| {
            (self.since_begin_s(self.curve.time_s[index]), self.curve.speed_m_s[index], motion.speed_m_s)
        };
        motion.enumerate().map(at).collect()
    }

    /// Time, s, and predicted slip, m: travel of the wheels minus that of the robot. `c_per_n` replaces the fitted
    /// compliance.
    #[must_use]
    pub fn slip_m(&self, c_per_n: Option<f64>) -> Vec<(f64, f64)> {
        let fitted = self.numbers.law;
        let law = Law { c_per_n: c_per_n.unwrap_or(fitted.c_per_n), ..fitted };
        let times = self.curve.time_s.iter().map(|time_s| self.since_begin_s(*time_s));
        times.zip(self.curve.motion(&law)).map(|(time_s, motion)| (time_s, motion.slipped_m)).collect()
    }

    /// Time, s, and tracked slip, m.
    #[must_use]
    pub fn tracked_slip_m(&self) -> Vec<(f64, f64)> {
        let motion = self.curve.motion(&self.numbers.law);
        let residuals_m = self.numbers.displacement_residuals_m(&self.curve);
        let at = |(seen, residual_m): (&Seen, f64)| {
            let time_s = self.since_begin_s(seen.between(|index| self.curve.time_s[index]));
            (time_s, seen.between(|index| motion[index].slipped_m) - residual_m)
        };
        self.curve.seen.iter().zip(residuals_m).map(at).collect()
    }

    fn since_begin_s(&self, time_s: f64) -> f64 {
        time_s - self.curve.time_s.first().copied().unwrap_or(time_s)
    }
}

/// Parameters of the tyres' law.
#[derive(Clone, Copy, Debug)]
struct Law {
    c_per_n: f64,
    relaxation_m: f64,
    mass_kg: f64,
}

/// Parameters of the fit.
#[derive(Clone, Copy, Debug)]
struct Numbers {
    law: Law,
    /// Relative error of the wheels' radius in units of `RADIUS_SHARE`, or bias of the inertial sensor in units of
    /// `BIAS_M_S2`.
    systematic: f64,
    /// Delay of the sensor's clock against the board's, s.
    offset_s: f64,
}

/// A fit of the law to observations of one kind.
struct Fit {
    numbers: Numbers,
    /// Fit of the scaled parameters: systematic error, offset, logarithms of `c` and of `L`.
    scaled: least_squares::Fit,
}

impl Fit {
    /// Fits `residuals`, which are in units of one standard deviation.
    fn of(recording: &Recording, curves: &[Curve], residuals: impl Fn(&Curve, &Numbers) -> Vec<f64>) -> Option<Self> {
        let clock_s = recording.clock_s.max(CLOCK_S);
        let start = [0.0, 0.0, START_PER_N.ln(), (recording.robot.drive.wheel_radius_m / 2.0).ln()];
        let scaled = |numbers: &[f64]| Numbers {
            law: Law { c_per_n: numbers[2].exp(), relaxation_m: numbers[3].exp(), mass_kg: recording.robot.mass_kg },
            systematic: numbers[0],
            offset_s: numbers[1] * clock_s,
        };
        let all = |numbers: &[f64]| {
            let mut all: Vec<f64> = curves.iter().flat_map(|curve| residuals(curve, &scaled(numbers))).collect();
            // Prior knowledge of the clocks as one more observation: an offset of 0, with their standard deviation.
            all.push(numbers[1]);
            all
        };
        let fit = least_squares::nonlinear(&start, all).ok()?;
        // The wheels' quantised travel is an input of the law, so that the residual is not white.
        let lag = least_squares::newey_west_lag(fit.residuals.len());
        Some(Self { numbers: scaled(fit.parameters.as_slice()), scaled: fit.autocorrelated(lag) })
    }

    /// Estimate of the compliance, with an interval for `taken` fewer degrees of freedom.
    fn estimate(&self, taken: usize) -> Estimate {
        let c_per_n = self.numbers.law.c_per_n;
        let interval = self.interval(LOG_C, CONFIDENCE, taken).map(|log| {
            let half = log.width() / 2.0;
            Interval { low: c_per_n * (-half).exp(), high: c_per_n * half.exp() }
        });
        Estimate { value: c_per_n, interval }
    }

    /// Interval of one of the scaled parameters.
    fn interval(&self, number: usize, level: f64, taken: usize) -> Option<Interval> {
        let interval = *self.scaled.intervals(level).ok()?.get(number)?;
        let free = self.scaled.degrees_of_freedom as f64;
        let half = interval.width() / 2.0 * (free / (free - taken as f64).max(1.0)).sqrt();
        let middle = f64::midpoint(interval.low, interval.high);
        Some(Interval { low: middle - half, high: middle + half })
    }
}

impl Numbers {
    /// Tracked minus predicted displacements, m, without their mean: the start of a run is unknown.
    fn displacement_residuals_m(&self, curve: &Curve) -> Vec<f64> {
        let motion = curve.motion(&self.law);
        let residual = |seen: &Seen| {
            let travelled_m = seen.travel_m * (1.0 + self.systematic * RADIUS_SHARE);
            let slipped_m = seen.between(|index| motion[index].slipped_m);
            // The robot's speed, not that of its wheels: with the latter the offset would absorb a part of the slip.
            let late_m = self.offset_s * seen.between(|index| motion[index].speed_m_s);
            seen.measured - (travelled_m - slipped_m + late_m)
        };
        let mut residuals: Vec<f64> = curve.seen.iter().map(residual).collect();
        let mean = residuals.iter().sum::<f64>() / residuals.len().max(1) as f64;
        residuals.iter_mut().for_each(|residual| *residual -= mean);
        residuals
    }

    /// Measured minus predicted accelerations, m/s².
    fn acceleration_residuals_m_s2(&self, curve: &Curve) -> Vec<f64> {
        let motion = curve.motion(&self.law);
        let last = motion.len() - 1;
        let jerk = |index: usize| {
            let (from, to) = (index.saturating_sub(1), (index + 1).min(last));
            let change_m_s2 = motion[to].acceleration_m_s2 - motion[from].acceleration_m_s2;
            change_m_s2 / (curve.time_s[to] - curve.time_s[from])
        };
        let residual = |seen: &Seen| {
            let predicted_m_s2 = seen.between(|index| motion[index].acceleration_m_s2);
            let late_m_s2 = self.offset_s * seen.between(jerk);
            seen.measured - (predicted_m_s2 + late_m_s2 + self.systematic * BIAS_M_S2)
        };
        curve.seen.iter().map(residual).collect()
    }
}

/// Wheels of a straight run at their samples, with the observations of a sensor.
struct Curve {
    time_s: Vec<f64>,
    travel_m: Vec<f64>,
    speed_m_s: Vec<f64>,
    seen: Vec<Seen>,
}

/// An observation between two samples of the wheels.
struct Seen {
    /// Index of the sample before it.
    index: usize,
    /// Share of the time from that sample to the next one.
    share: f64,
    /// Mean travel of the wheels, m.
    travel_m: f64,
    /// Displacement, m, or acceleration, m/s², of the robot.
    measured: f64,
}

impl Seen {
    /// Quantity of the wheels' samples at the time of the observation, linearly interpolated.
    fn between(&self, quantity: impl Fn(usize) -> f64) -> f64 {
        let (before, after) = (quantity(self.index), quantity(self.index + 1));
        before + self.share * (after - before)
    }
}

/// Predicted motion of the robot at a sample of the wheels.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Travel of the wheels minus that of the robot since the first sample, m.
    slipped_m: f64,
    speed_m_s: f64,
    acceleration_m_s2: f64,
}

impl Curve {
    /// Curve of a run with the tracked positions.
    fn tracked(run: &Run) -> Option<Self> {
        Self::of(run, &along(run))
    }

    /// Curve of a run with the inertial sensor's readings.
    fn felt(run: &Run) -> Option<Self> {
        Self::of(run, &run.felt.iter().map(|felt| [felt.time_s, felt.measured_m_s2()]).collect::<Vec<_>>())
    }

    /// Curve of a run with `observed`: times, s, and measurements.
    fn of(run: &Run, observed: &[[f64; 2]]) -> Option<Self> {
        let travel_m: Vec<f64> = run.wheels.iter().map(|sample| sample.travel_m.iter().sum::<f64>() / 2.0).collect();
        let time_s: Vec<f64> = run.wheels.iter().map(|sample| sample.time_s).collect();
        let last = time_s.len().checked_sub(1)?;
        let speed = |index: usize| {
            let (from, to) = (index.saturating_sub(1), (index + 1).min(last));
            (travel_m[to] - travel_m[from]) / (time_s[to] - time_s[from])
        };
        let speed_m_s: Vec<f64> = (0..=last).map(speed).collect();
        let seen = observed.iter().filter_map(|&[at_s, measured]| {
            let index = time_s.partition_point(|time_s| *time_s < at_s).checked_sub(1)?;
            let share = (at_s - time_s[index]) / (time_s.get(index + 1)? - time_s[index]);
            let [left_m, right_m] = wheels_at(run, at_s)?;
            Some(Seen { index, share, travel_m: f64::midpoint(left_m, right_m), measured })
        });
        let seen = seen.collect();
        Some(Self { time_s, travel_m, speed_m_s, seen })
    }

    /// Integrates the law and returns the predicted motion at each sample of the wheels.
    fn motion(&self, law: &Law) -> Vec<Motion> {
        let Law { c_per_n, relaxation_m, mass_kg } = *law;
        let stiffness_s2 = 4.0 / (c_per_n * relaxation_m * mass_kg);
        let (mut bent_m, mut slipped_m) = (0.0, 0.0);
        let mut speed_m_s = self.speed_m_s.first().copied().unwrap_or(0.0);
        let mut all = vec![Motion { slipped_m, speed_m_s, acceleration_m_s2: 0.0 }];
        for index in 1..self.time_s.len() {
            let sampled_s = self.time_s[index] - self.time_s[index - 1];
            let step_s = sampled_s / f64::from(SUBSTEPS);
            // A linear speed whose mean is that between two samples, which is exact. A constant speed over 10 ms would
            // make tyres appear stiffer by 1 %.
            let mean_m_s = (self.travel_m[index] - self.travel_m[index - 1]) / sampled_s;
            let change_m_s = self.speed_m_s[index] - self.speed_m_s[index - 1];
            for step in 0..SUBSTEPS {
                let share = (f64::from(step) + 0.5) / f64::from(SUBSTEPS) - 0.5;
                let rim_m_s = mean_m_s + change_m_s * share;
                let before_m_s = speed_m_s;
                // Semi-implicit step: stable for rims that roll farther than the relaxation length in one step.
                bent_m = (bent_m + (rim_m_s - speed_m_s) * step_s) / (1.0 + rim_m_s.abs() * step_s / relaxation_m);
                speed_m_s += stiffness_s2 * bent_m * step_s;
                slipped_m += (rim_m_s - f64::midpoint(before_m_s, speed_m_s)) * step_s;
            }
            all.push(Motion { slipped_m, speed_m_s, acceleration_m_s2: stiffness_s2 * bent_m });
        }
        all
    }
}
