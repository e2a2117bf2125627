//! Trial on perfect actuators: the motor follows the profile of its file exactly, measured by the sensor of its seed.

use super::{
    Driven,
    calibration::{self, Calibration, Reading},
    response::{Look, Purpose, Response, Segment},
    scene::{Motor, size},
};
use crate::sampler::Sampler;

/// Period of the samples, s: that of the board's telemetry.
const PERIOD_S: f64 = 0.01;
/// Rest at a set point before the next one, s.
const REST_S: f64 = 0.5;

/// Characteristic of the motor's sensor.
fn sensor(motor: &Motor) -> Calibration {
    match &motor.truth {
        Some(truth) if truth.name == "encoder-scale" => Calibration { gain: size(truth), ..Calibration::NONE },
        Some(truth) if truth.name == "encoder-offset" => Calibration { offset: size(truth), ..Calibration::NONE },
        _ => Calibration::NONE,
    }
}

/// Runs the evaluation of a motor with perfect actuators.
pub(super) fn driven(motor: &Motor, seed: u64) -> Driven {
    let bench = &motor.bench;
    let (sensor, mut noise) = (sensor(motor), Sampler::new(seed, super::OF_INSTRUMENT));
    let up = bench.set_points.iter().chain(bench.set_points.iter().rev());
    let readings: Vec<Reading> = up
        .clone()
        .chain(up)
        .map(|set| {
            let sensed = set / bench.per_si();
            let truth = (sensed - sensor.offset) / sensor.gain;
            Reading { sensed, measured: calibration::read(bench, truth, &mut noise) }
        })
        .collect();
    let error = |reading: &Reading| ((reading.sensed - sensor.offset) / sensor.gain - reading.sensed) * bench.per_si();
    let uncalibrated = readings.iter().map(|reading| error(reading).abs()).reduce(f64::max);
    let found = calibration::found(bench, &readings).map_or(Calibration::NONE, |found| found.calibration);
    let mut response = Response::default();
    let (mut at_s, mut position) = (0.0, 0.0);
    let points = bench.set_points.iter().map(|set| (Purpose::SetPoint, *set));
    let steps = bench.step.into_iter().flat_map(|step| [(Purpose::Return, 0.0), (Purpose::Step, step)]);
    for (purpose, set) in points.chain(steps) {
        // Corrected as the board's configuration would be.
        let set = found.command(bench, set / bench.per_si());
        let (from_s, start) = (at_s, position);
        let way = set - start;
        let moves_s = profile_s(motor.profile, way.abs());
        while at_s < from_s + moves_s + REST_S {
            let gone = gone(motor.profile, way.abs(), at_s - from_s).copysign(way);
            position = start + gone;
            let sensed = (position / bench.count).round() * bench.count;
            // The simulated position is the board's corrected one; the raw reading follows by the found calibration,
            // the truth by the sensor's.
            let raw = if bench.step.is_some() { position * found.gain } else { position * found.gain + found.offset };
            response.looks.push(Look { at_s, sensed, truth: (raw - sensor.offset) / sensor.gain, duty: 0.0 });
            at_s += PERIOD_S;
        }
        position = set;
        response.segments.push(Segment { purpose, set, from_s, until_s: at_s, settled: true });
    }
    Driven { response, calibration: found, uncalibrated }
}

/// Duration of a trapezoidal profile over a distance, s.
fn profile_s([speed, acceleration]: [f64; 2], distance: f64) -> f64 {
    if distance * acceleration < speed * speed {
        2.0 * (distance / acceleration).sqrt()
    } else {
        distance / speed + speed / acceleration
    }
}

/// Travel along the profile after a time, in the distance's unit.
fn gone(limits: [f64; 2], distance: f64, after_s: f64) -> f64 {
    let [speed, acceleration] = limits;
    let whole_s = profile_s(limits, distance);
    let ramp_s = (speed / acceleration).min(whole_s / 2.0);
    let after_s = after_s.clamp(0.0, whole_s);
    let left_s = whole_s - after_s;
    if after_s < ramp_s {
        0.5 * acceleration * after_s * after_s
    } else if left_s < ramp_s {
        distance - 0.5 * acceleration * left_s * left_s
    } else {
        0.5 * acceleration * ramp_s * ramp_s + acceleration * ramp_s * (after_s - ramp_s)
    }
}
