//! Simulation of a skid-steered robot: slip without memory, then limits, lags and the sensor.

use std::f64::consts::TAU;

use r4_maths::spline::Spline;
use r4_plants::Dependence;

use super::{Geometry, Output, SkidSteer, effect::Effect, run::SkidRun};
use crate::family::{Acts, Curve, Structure, Term};

/// Share of the usual speed at which the transition between driving forwards and backwards is smoothed.
const TRAVEL_KNEE: f64 = 0.01;

/// Motion of the body without slip.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ideal {
    /// Speed along the body, m/s.
    pub(super) forward: f64,
    /// Yaw rate, rad/s, positive to the left.
    pub(super) turn: f64,
}

impl Ideal {
    /// Returns the direction in the plane of the sides' speeds, rad: 0 straight ahead, a quarter turn for turning
    /// left on the spot.
    pub(super) fn direction(&self, geometry: &Geometry) -> f64 {
        (0.5 * geometry.track_m * self.turn).atan2(self.forward)
    }
}

impl Geometry {
    /// Returns the rim speed of a side's wheels, m/s; `side` is -1 on the left and 1 on the right.
    fn rim(&self, ideal: &Ideal, side: f64) -> f64 {
        ideal.forward + side * 0.5 * self.track_m * ideal.turn
    }

    /// Returns the motion without slip for the speeds of both sides, rad/s.
    pub(super) fn ideal(&self, left: f64, right: f64) -> Ideal {
        Ideal { forward: 0.5 * self.wheel_radius_m * (left + right), turn: self.turn(left, right) }
    }
}

/// Values of a structure by effect; `None` for an effect that was not added.
#[derive(Clone, Copy, Default)]
struct Values<'v> {
    effects: [Option<&'v [f64]>; Effect::COUNT],
}

impl Values<'_> {
    fn one(&self, effect: Effect) -> Option<f64> {
        self.effects[effect as usize].and_then(|values| values.first().copied())
    }

    fn two(&self, effect: Effect) -> Option<(f64, f64)> {
        match self.effects[effect as usize]? {
            &[a, b] => Some((a, b)),
            _ => None,
        }
    }
}

/// Advances a first-order lag by one step in which its input changes linearly from `before` to `now`.
fn lagged(state: f64, before: f64, now: f64, step_s: f64, time_constant_s: f64) -> f64 {
    let decay = (-step_s / time_constant_s).exp();
    if time_constant_s <= 0.0 || decay == 0.0 && time_constant_s < 1e-6 * step_s {
        return now;
    }
    // A ramp is followed with a lag of its slope times the time constant.
    let behind = (now - before) / step_s * time_constant_s;
    now - behind + (state - before + behind) * decay
}

/// Advances a slew limiter (`limit` per second) by one step in which its input changes linearly from `before` to
/// `now`. The output may meet the input within the step.
fn slewed(state: f64, before: f64, now: f64, step_s: f64, limit: f64) -> f64 {
    let slope = (now - before) / step_s;
    let towards = (before - state).signum();
    let gap = (before - state).abs();
    let closing = limit - towards * slope;
    if gap > closing.max(0.0) * step_s {
        return state + towards * limit * step_s;
    }
    let met_s = if gap > 0.0 { gap / closing } else { 0.0 };
    before + slope * met_s + slope.clamp(-limit, limit) * (step_s - met_s)
}

/// Speeds of both sides at a delayed time, interpolated between samples.
struct Sampled<'r> {
    run: &'r SkidRun,
    /// Delay that is subtracted from the requested time, s.
    delay_s: f64,
    /// Index of the last sample not after the delayed time, or of the first sample.
    below: usize,
}

impl Sampled<'_> {
    fn at(&mut self, sample: usize) -> (f64, f64) {
        let sides = &*self.run.sides;
        // Without a delay the samples are used as they are, without rounding.
        if self.delay_s == 0.0 {
            return (sides.left[sample], sides.right[sample]);
        }
        let at_s = sides.time_s[sample] - self.delay_s;
        while self.below + 1 < sides.time_s.len() && sides.time_s[self.below + 1] <= at_s {
            self.below += 1;
        }
        let (first, second) = (self.below, (self.below + 1).min(sides.time_s.len() - 1));
        let span_s = sides.time_s[second] - sides.time_s[first];
        let share = if span_s > 0.0 { ((at_s - sides.time_s[first]) / span_s).clamp(0.0, 1.0) } else { 0.0 };
        let between = |values: &[f64]| values[first] + share * (values[second] - values[first]);
        (between(&sides.left), between(&sides.right))
    }
}

struct Body<'f> {
    family: &'f SkidSteer,
    values: Values<'f>,
    curves: Vec<(&'f Curve, Spline)>,
    /// Time of the run's first sample, s.
    begin_s: f64,
}

impl Body<'_> {
    /// Returns the output without memory for the speeds of the sides, rad/s.
    fn output(&self, left: f64, right: f64, time_s: f64) -> f64 {
        let v = &self.values;
        let geometry = &self.family.geometry;
        let (mut left, mut right) = (left, right);
        if let Some(ratio) = v.one(Effect::EncoderScale) {
            // Each side takes half of the ratio, so that the mean speed stays.
            left /= ratio.sqrt();
            right *= ratio.sqrt();
        }
        if let Some(width) = v.one(Effect::DeadZone) {
            left = left.signum() * (left.abs() - width).max(0.0);
            right = right.signum() * (right.abs() - width).max(0.0);
        }
        let ideal = geometry.ideal(left, right);
        match self.family.output {
            Output::YawRate => self.turn(&ideal, time_s),
            Output::ForwardSpeed => self.forward(&ideal, time_s),
            Output::LateralSpeed => {
                self.curved(&ideal, time_s, v.one(Effect::Lateral).map_or(0.0, |centre_m| -centre_m * ideal.turn))
            }
        }
    }

    fn turn(&self, ideal: &Ideal, time_s: f64) -> f64 {
        let v = &self.values;
        let geometry = &self.family.geometry;
        let mut wide = v.one(Effect::Track).map_or(1.0, |track_m| track_m / geometry.track_m);
        if let Some((resistance, creep)) = v.two(Effect::StandingSide) {
            // The stiffness of a tyre is inversely proportional to its speed. Along, both sides carry the same force;
            // across, they resist with the sum. The balance of moments contains the squared sum of the speeds over
            // four times their product.
            let (left, right) = (geometry.rim(ideal, -1.0).hypot(creep), geometry.rim(ideal, 1.0).hypot(creep));
            wide += resistance * ((left + right).powi(2) / (4.0 * left * right) - 1.0);
        }
        let mut turn = ideal.turn / wide;
        if let Some(slip) = v.one(Effect::Turning) {
            turn /= 1.0 + slip * ideal.turn.abs();
        }
        if let Some(slip) = v.one(Effect::Driving) {
            turn *= (-slip * ideal.forward.abs()).exp();
        }
        if let Some(more) = v.one(Effect::TurnDirection) {
            turn *= 1.0 + more * turn.signum();
        }
        turn *= self.travel(ideal) * self.drift(time_s);
        turn = self.curved(ideal, time_s, turn);
        let limit = v.two(Effect::FrictionLimit).map(|(limit, less)| (limit - less * ideal.forward.abs()).max(0.0));
        if let Some(limit) = limit.or(v.one(Effect::RateLimit)) {
            turn = turn.clamp(-limit, limit);
        }
        if let Some((limit, forward_gain)) = v.two(Effect::WheelSaturation) {
            let fastest = (forward_gain * ideal.forward).abs() + 0.5 * geometry.track_m * turn.abs();
            turn *= (limit * geometry.wheel_radius_m / fastest.max(f64::MIN_POSITIVE)).min(1.0);
        }
        turn
    }

    fn forward(&self, ideal: &Ideal, time_s: f64) -> f64 {
        let v = &self.values;
        let mut forward = ideal.forward * v.one(Effect::Longitudinal).unwrap_or(1.0);
        if let Some(slip) = v.one(Effect::LongitudinalTurning) {
            forward *= (-slip * ideal.turn.abs()).exp();
        }
        self.curved(ideal, time_s, forward * self.travel(ideal) * self.drift(time_s))
    }

    fn travel(&self, ideal: &Ideal) -> f64 {
        let Some(more) = self.values.one(Effect::TravelDirection) else { return 1.0 };
        let knee = TRAVEL_KNEE * self.family.scales.speed;
        1.0 + more * ideal.forward / ideal.forward.hypot(knee)
    }

    fn drift(&self, time_s: f64) -> f64 {
        self.values.one(Effect::Drift).map_or(1.0, |change| (change * (time_s - self.begin_s)).exp())
    }

    fn curved(&self, ideal: &Ideal, time_s: f64, value: f64) -> f64 {
        let geometry = &self.family.geometry;
        self.curves.iter().fold(value, |value, (curve, spline)| {
            let at = match curve.over {
                Dependence::Input => ideal.turn,
                Dependence::Speed => ideal.forward,
                Dependence::Direction => ideal.direction(geometry),
                _ => time_s - self.begin_s,
            };
            match curve.acts {
                Acts::Gain => value * (1.0 + spline.value(at)),
                Acts::Push | Acts::Friction | Acts::Settling | Acts::Hysteresis => value + spline.value(at),
            }
        })
    }
}

/// Writes the mean output over each span of a run to `predicted`.
pub(super) fn simulate(family: &SkidSteer, structure: &Structure, run: &SkidRun, predicted: &mut [f64]) {
    predicted.fill(f64::NAN);
    let values = values(family, structure);
    let sides = &*run.sides;
    let body = Body {
        family,
        values,
        curves: structure.curves().map(|(curve, values)| (curve, curve.spline(values))).collect(),
        begin_s: sides.time_s[0],
    };
    let delay_s = values.one(Effect::InputDelay).unwrap_or(0.0) - values.one(Effect::EncoderDelay).unwrap_or(0.0);
    let mut sampled = Sampled { run, delay_s, below: 0 };
    let (slew, lag) = (values.one(Effect::SlewLimit), values.one(Effect::DriveLag));
    let (side_lags, sensor_lag) = (values.two(Effect::DriveLagSides), values.one(Effect::SensorLag));
    let offset = values.one(Effect::SensorOffset).unwrap_or(0.0);

    let Some(to) = run.spans.last().map(|span| span.end) else { return };
    let (mut row, mut sum) = (0, 0.0);
    let (mut before, mut lagging) = ((0.0, 0.0), (0.0, 0.0));
    // Values of the stages static, slew, lag and sensor; each feeds the next.
    let (mut still, mut ramped, mut driven, mut sensed) = (0.0, 0.0, 0.0, 0.0);
    for sample in run.from..to {
        let time_s = sides.time_s[sample];
        let now = sampled.at(sample);
        if sample == run.from {
            lagging = now;
            still = body.output(now.0, now.1, time_s);
            let start = run.start.map_or(still, |start| start - offset);
            // A missing stage has no state: it passes on its input.
            ramped = if slew.is_some() { start } else { still };
            driven = if lag.is_some() { start } else { ramped };
            sensed = if sensor_lag.is_some() { start } else { driven };
        } else {
            let step_s = time_s - sides.time_s[sample - 1];
            if let Some((left_s, right_s)) = side_lags {
                lagging.0 = lagged(lagging.0, before.0, now.0, step_s, left_s);
                lagging.1 = lagged(lagging.1, before.1, now.1, step_s, right_s);
            } else {
                lagging = now;
            }
            let still_before = still;
            still = body.output(lagging.0, lagging.1, time_s);
            let ramped_before = ramped;
            ramped = slew.map_or(still, |limit| slewed(ramped, still_before, still, step_s, limit));
            let driven_before = driven;
            driven = lag.map_or(ramped, |lag_s| lagged(driven, ramped_before, ramped, step_s, lag_s));
            sensed = sensor_lag.map_or(driven, |lag_s| lagged(sensed, driven_before, driven, step_s, lag_s));
        }
        before = now;
        // Spans may share a sample: the last of one is the first of the next.
        while let Some(span) = run.spans.get(row).filter(|span| span.start <= sample) {
            sum += sensed + offset;
            if sample + 1 < span.end {
                break;
            }
            predicted[row] = sum / span.len() as f64;
            (row, sum) = (row + 1, 0.0);
        }
    }
}

/// Returns the steady output for constant speeds of the sides, rad/s, by slip alone, without drives and sensors.
pub(super) fn settles_at(family: &SkidSteer, structure: &Structure, left: f64, right: f64) -> f64 {
    let mut values = values(family, structure);
    // These belong to the drives, which the body does not include.
    for elsewhere in [Effect::DeadZone, Effect::WheelSaturation] {
        values.effects[elsewhere as usize] = None;
    }
    let curves = structure.curves().map(|(curve, values)| (curve, curve.spline(values))).collect();
    Body { family, values, curves, begin_s: 0.0 }.output(left, right, 0.0)
}

/// Returns the values of a structure by effect.
fn values<'s>(family: &SkidSteer, structure: &'s Structure) -> Values<'s> {
    let mut values = Values::default();
    for (term, numbers) in structure.terms.iter().zip(&structure.added) {
        if let Term::Known(candidate) = term
            && let Some(effect) = family.effects.get(*candidate)
        {
            values.effects[*effect as usize] = Some(numbers);
        }
    }
    values
}

/// Returns the mean over each span of a series beside the output, computed from the ideal motion of each sample.
pub(super) fn mean_over_spans(geometry: &Geometry, run: &SkidRun, of: impl Fn(&Ideal, usize) -> f64) -> Vec<f64> {
    let sides = &*run.sides;
    let value = |at: usize| of(&geometry.ideal(sides.left[at], sides.right[at]), at);
    run.spans.iter().map(|span| span.clone().map(value).sum::<f64>() / span.len() as f64).collect()
}

/// Returns the direction of the mean motion in each span, rad.
pub(super) fn directions(geometry: &Geometry, run: &SkidRun) -> Vec<f64> {
    let forward = mean_over_spans(geometry, run, |ideal, _| ideal.forward);
    let turn = mean_over_spans(geometry, run, |ideal, _| ideal.turn);
    let mean = |(&forward, &turn): (&f64, &f64)| Ideal { forward, turn }.direction(geometry);
    forward.iter().zip(&turn).map(mean).collect()
}

/// Period of the angles of [`directions`], rad.
pub(super) const CIRCLE: f64 = TAU;
