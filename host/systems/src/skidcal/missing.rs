//! Search for unmodelled effects in the residuals of both tests. Each effect changes another residual.
//!
//! | effect | residual that it changes | its size |
//! | --- | --- | --- |
//! | [`Effect::GyroScale`] | tracked heading of the spin minus the integral of the gyroscope, corrected for its bias | rad/s shown per rad/s |
//! | [`Effect::WheelRadius`] | tracked travel of straight runs minus that of the wheels and the slip by the tyres' law | true radius over the configured one |
//! | [`Effect::CentreOfMass`] | tracked positions of a spin with sliding wheels, minus those of a robot that turns about its middle | m, forwards |
//!
//! Sizes are fitted to one half of a recording, and an effect is claimed when its interval at `CONFIDENCE` excludes its
//! absence. The reported errors are those of the other half.
//!
//! # The centre of mass
//!
//! A spin turns about the point at which the lateral forces of front and rear wheels balance. As long as no wheel
//! slides these do not depend on weight, and this point is the middle. Where wheels slide it moves towards the heavier
//! axle: `centre_of_mass_m` solves the balance of lateral forces and of moments for the centre of mass and the lateral
//! compliance. One axle on a slippery floor has the same effect: only a scale under each axle can separate the two
//! causes.

use nalgebra::DMatrix;
use r4_maths::{
    least_squares::{linear, newey_west_lag},
    root::bisect,
    statistics::{mean, rms},
};
use r4_world::GRAVITY_M_S2;

use super::{
    bristle, estimate,
    protocol::{Recording, Run},
};

/// Confidence level at which an effect is claimed: of a thousand recordings of a robot without effects, three claim one
/// of the three.
const CONFIDENCE: f64 = 0.999;

/// An effect that the base model of a robot lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Scale error of the gyroscope.
    GyroScale,
    /// Radius of all wheels, against the configured one.
    WheelRadius,
    /// Centre of mass before or behind the middle of the wheels.
    CentreOfMass,
}

/// An effect detected in a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finding {
    /// Effect that was detected.
    pub effect: Effect,
    /// Size of the effect, as in the table above.
    pub size: f64,
    /// Root mean square error of the held-out half without the effect, rad or m.
    pub before: f64,
    /// Root mean square error of the held-out half with the effect, rad or m.
    pub after: f64,
}

/// Searches a recording on a floor of known `friction` for effects. The first result is the one that explains most of
/// its residual.
#[must_use]
pub fn findings(recording: &Recording, friction: f64) -> Vec<Finding> {
    let found = [gyro_scale(recording), wheel_radius(recording), centre_of_mass(recording, friction)];
    let mut found: Vec<Finding> = found.into_iter().flatten().collect();
    found.sort_by(|a, b| (a.after / a.before).total_cmp(&(b.after / b.before)));
    found
}

/// Regression of one half of a spin: `observed = size · effect + others · parameters`, row by row. The parameters, such
/// as the start of the half, are its own.
#[derive(Default)]
struct Half {
    observed: Vec<f64>,
    effect: Vec<f64>,
    others: Vec<Vec<f64>>,
}

impl Half {
    /// Size of the effect, if the data exclude 0.
    fn size(&self) -> Option<f64> {
        let columns = 1 + self.others.first()?.len();
        let row = |row: usize, column: usize| match column {
            0 => self.effect[row],
            _ => self.others[row][column - 1],
        };
        let fit = linear(&DMatrix::from_fn(self.observed.len(), columns, row), &self.observed).ok()?;
        // A gyroscope's noise accumulates in its integral, so that the residual is not white.
        let fit = fit.autocorrelated(newey_west_lag(self.observed.len()));
        let is_another = !fit.intervals(CONFIDENCE).ok()?.first()?.contains(0.0);
        is_another.then(|| fit.parameters[0])
    }

    /// Root mean square of the residual with an effect of this size.
    fn error(&self, size: f64) -> Option<f64> {
        let rest: Vec<f64> = self.observed.iter().zip(&self.effect).map(|(y, x)| y - size * x).collect();
        let columns = self.others.first()?.len();
        let fit = linear(&DMatrix::from_fn(rest.len(), columns, |row, column| self.others[row][column]), &rest).ok()?;
        rms(fit.residuals.as_slice()).ok()
    }
}

/// Size of an effect by the first half, if its data exclude 0, and the errors of the other half without and with it.
fn claimed([fit_to, held_out]: &[Half; 2]) -> Option<(f64, f64, f64)> {
    let size = fit_to.size()?;
    Some((size, held_out.error(0.0)?, held_out.error(size)?))
}

/// Splits the spin into its first and second half.
fn spins(recording: &Recording) -> [Run; 2] {
    let Run { wheels, tracked, felt, turned } = &recording.spin;
    let begin_s = tracked.first().map_or(0.0, |first| first.time_s);
    let middle_s = f64::midpoint(begin_s, tracked.last().map_or(0.0, |last| last.time_s));
    [true, false].map(|first| {
        let is_in = |time_s: f64| (time_s < middle_s) == first;
        Run {
            wheels: wheels.iter().filter(|sample| is_in(sample.time_s)).copied().collect(),
            tracked: tracked.iter().filter(|sample| is_in(sample.time_s)).copied().collect(),
            felt: felt.iter().filter(|sample| is_in(sample.time_s)).copied().collect(),
            turned: turned.iter().filter(|sample| is_in(sample.time_s)).copied().collect(),
        }
    })
}

/// Scale of the gyroscope: `heading - integral = (1 / scale - 1) integral`, with the integral corrected for the bias at
/// rest.
fn gyro_scale(recording: &Recording) -> Option<Finding> {
    let rest: Vec<f64> = recording.rest.turned.iter().map(|sample| sample.rate_rad_s).collect();
    let bias_rad_s = mean(&rest).ok()?;
    let (size, before, after) = claimed(&spins(recording).map(|spin| headings(&spin, bias_rad_s)))?;
    Some(Finding { effect: Effect::GyroScale, size: 1.0 / (1.0 + size), before, after })
}

fn headings(run: &Run, bias_rad_s: f64) -> Half {
    let mut turned_rad = vec![0.0];
    for pair in run.turned.windows(2) {
        let step_s = pair[1].time_s - pair[0].time_s;
        let before_rad = turned_rad[turned_rad.len() - 1];
        let rate_rad_s = f64::midpoint(pair[0].rate_rad_s, pair[1].rate_rad_s) - bias_rad_s;
        turned_rad.push(before_rad + step_s * rate_rad_s);
    }
    let mut half = Half::default();
    for tracked in &run.tracked {
        let after = run.turned.partition_point(|sample| sample.time_s < tracked.time_s);
        let (Some(before), Some(right)) = (after.checked_sub(1), run.turned.get(after)) else { continue };
        let left = run.turned[before];
        let share = (tracked.time_s - left.time_s) / (right.time_s - left.time_s);
        let gyro_rad = turned_rad[before] + share * (turned_rad[after] - turned_rad[before]);
        half.observed.push(tracked.measured()[2] - gyro_rad);
        half.effect.push(gyro_rad);
        half.others.push(vec![1.0]);
    }
    half
}

/// Radius of the wheels, fitted together with the tyres' law. The slip in acceleration and deceleration differs, so
/// that without the law soft tyres would appear as wheels that are 0.3 % smaller.
fn wheel_radius(recording: &Recording) -> Option<Finding> {
    let pairs = recording.straight.chunks_exact(2);
    // Alternating directions: each half has one run of each pair there and back.
    let [fit_to, held_out] = [0, 1].map(|half| {
        let straight = pairs.clone().enumerate().map(|(index, pair)| pair[(index + half) % 2].clone()).collect();
        Recording { straight, ..Recording::new(recording.robot.clone(), recording.clock_s) }
    });
    let found = bristle::wheel_radius(&fit_to, &held_out, CONFIDENCE)?;
    let bristle::Radius { scale, before_m, after_m, .. } = found;
    found.is_another.then_some(Finding { effect: Effect::WheelRadius, size: scale, before: before_m, after: after_m })
}

fn centre_of_mass(recording: &Recording, friction: f64) -> Option<Finding> {
    // The circle gives the robot's middle relative to the point about which it turns.
    let (forward_m, before, after) = claimed(&spins(recording).map(|spin| circle(&spin)))?;
    let size = centre_of_mass_m(recording, friction, -forward_m)?;
    Some(Finding { effect: Effect::CentreOfMass, size, before, after })
}

/// Regression of the robot's middle on a circle about the point of rotation: `x = x0 + a cos - b sin`, `y = y0 + a sin
/// + b cos`.
fn circle(run: &Run) -> Half {
    let mut half = Half::default();
    for tracked in &run.tracked {
        let [x_m, y_m, yaw_rad] = tracked.measured();
        let (sin, cos) = yaw_rad.sin_cos();
        half.observed.extend([x_m, y_m]);
        half.effect.extend([cos, sin]);
        half.others.extend([vec![-sin, 1.0, 0.0], vec![cos, 0.0, 1.0]]);
    }
    half
}

/// Centre of mass before the middle of the wheels, m, of a robot that spins about a point `ahead_m` before it. `None`
/// where no wheel slides: the point then carries no information.
fn centre_of_mass_m(recording: &Recording, friction: f64, ahead_m: f64) -> Option<f64> {
    let [half_base_m, half_track_m] = recording.robot.half_m;
    let (rim_rad_s, rate_rad_s, _) = estimate::rates(recording)?;
    let c_long_per_n = bristle::c_long(recording)?.value;
    let weight_n = recording.robot.mass_kg * GRAVITY_M_S2;
    // The slip along the wheels is the same for all, that across them depends on the axle. Slip velocity over rim
    // speed; dimensionless.
    let along = 1.0 - rate_rad_s / rim_rad_s;
    let across = [1.0, -1.0].map(|axle| (axle * half_base_m - ahead_m) * rate_rad_s / (half_track_m * rim_rad_s));
    // Forces on one wheel of each axle, front first: along and across, N.
    let forces = |c_lat_per_n: f64, centre_m: f64| {
        [0, 1].map(|axle| {
            let share = 0.5 + [0.5, -0.5][axle] * centre_m / half_base_m;
            let most_n = friction * weight_n * share / 2.0;
            let adheres_n = [along / c_long_per_n, across[axle] / c_lat_per_n];
            let size_n = adheres_n[0].hypot(adheres_n[1]);
            let slides = if size_n > most_n { most_n / size_n } else { 1.0 };
            (adheres_n.map(|force_n| force_n * slides), slides < 1.0)
        })
    };
    let most_m = 0.99 * half_base_m;
    // The heavier the front, the larger its forces: the function is monotone.
    let balanced_m = |c_lat_per_n: f64| {
        let lateral_n = |centre_m: f64| forces(c_lat_per_n, centre_m).iter().map(|([_, across_n], _)| across_n).sum();
        bisect(lateral_n, -most_m, most_m, 1e-6).ok()
    };
    // The driving moment of the longitudinal forces equals the resisting moment of the lateral ones.
    let moment_nm = |power: f64| {
        let c_lat_per_n = c_long_per_n * 10f64.powf(power);
        let centre_m = balanced_m(c_lat_per_n).unwrap_or(0.0);
        let [front, rear] = forces(c_lat_per_n, centre_m).map(|(force_n, _)| force_n);
        half_track_m * (front[0] + rear[0]) - half_base_m * (front[1] - rear[1])
    };
    let power = bisect(moment_nm, -1.0, 3.0, 1e-6).ok()?;
    let c_lat_per_n = c_long_per_n * 10f64.powf(power);
    let centre_m = balanced_m(c_lat_per_n)?;
    forces(c_lat_per_n, centre_m).iter().any(|(_, slides)| *slides).then_some(centre_m)
}
