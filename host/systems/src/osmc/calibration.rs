//! Scale and offset of a sensor, which no controller can observe: they need a measurement beside the board.
//!
//! The declared procedure visits the set points up and down, twice. At each it records the board's reading and the true
//! position by an instrument: a protractor or a caliper, read to [`DIVISION_DEG`] and [`DIVISION_MM`]. A line is fitted
//! to the readings: `reading = gain · true + offset`. A gain or offset whose interval excludes 1 or 0, and which
//! amounts to more than a count, is corrected in the board's configuration, and the set points are run again.
//!
//! The identifier's `static-map` was tried for this. It searches an offset after a gain. On so few rows, all of one
//! sign, the gain absorbs the offset: an offset of 7 degrees was found as a scale of 4 %.

use nalgebra::DMatrix;
use r4_maths::least_squares::linear;

use super::bench::Bench;
use crate::sampler::Sampler;

/// Reading error of the protractor, deg: uniform between plus and minus a half of it. Our choice: a dial with divisions of half a degree.
pub const DIVISION_DEG: f64 = 0.5;
/// Reading error of the caliper, mm, in the same way. Our choice: a vernier of a twentieth.
pub const DIVISION_MM: f64 = 0.05;
/// Confidence level at which a scale and an offset are claimed: of a thousand motors with a good sensor, two get
/// another calibration.
const CONFIDENCE: f64 = 0.999;

/// Characteristic of a sensor: `reading = gain · true + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// Gain of the sensor; 1 for a correct one.
    pub gain: f64,
    /// Offset of the reading, rad or m.
    pub offset: f64,
}

impl Calibration {
    /// A sensor without error.
    pub const NONE: Self = Self { gain: 1.0, offset: 0.0 };

    /// Counts per turn of an encoder with this calibration, from its nominal `counts_per_turn`. Rounded: a
    /// configuration holds a whole number.
    #[must_use]
    pub fn counts_per_turn(&self, counts_per_turn: f64) -> u32 {
        (counts_per_turn * self.gain).round() as u32
    }

    /// Size of one count, rad or m, on a board whose configuration contains this calibration.
    #[must_use]
    pub fn count(&self, bench: &Bench) -> f64 {
        use std::f64::consts::TAU;
        // The actuator's metrics are in counts of the paper's converter, which no calibration changes.
        if bench.step.is_some() { TAU / f64::from(self.counts_per_turn(TAU / bench.count)) } else { bench.count }
    }

    /// Set point for a true position, rad or m, on a board whose configuration contains this calibration. The zero of a
    /// rotary sensor is its position at power-on, which no configuration holds: the host adds the offset.
    #[must_use]
    pub fn command(&self, bench: &Bench, position: f64) -> f64 {
        if bench.step.is_some() { position + self.offset / self.gain } else { position }
    }

    /// True position requested by a set point of [`Calibration::command`], rad or m.
    #[must_use]
    pub fn asked(&self, bench: &Bench, command: f64) -> f64 {
        if bench.step.is_some() { command - self.offset / self.gain } else { command }
    }
}

/// A set point at which sensor and instrument were read, rad or m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Reading of the board's sensor.
    pub sensed: f64,
    /// Reading of the instrument.
    pub measured: f64,
}

/// Reading of the instrument for a known true position, rad or m: uniform reading error of one division.
#[must_use]
pub fn read(bench: &Bench, truth: f64, noise: &mut Sampler) -> f64 {
    let division = if bench.step.is_some() { DIVISION_DEG } else { DIVISION_MM };
    truth + noise.uniform(-0.5, 0.5) * division / bench.per_si()
}

/// A calibration and the effects that it implies.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Gain and offset to be corrected.
    pub calibration: Calibration,
    /// Names of the claimed effects, as in the catalogue of plants.
    pub effects: Vec<&'static str>,
}

/// Fits the line; `None` for fewer than four readings, or readings at one position.
#[must_use]
pub fn found(bench: &Bench, readings: &[Reading]) -> Option<Found> {
    let sensed: Vec<f64> = readings.iter().map(|reading| reading.sensed).collect();
    let span = readings.iter().map(|reading| reading.measured.abs()).fold(0.0, f64::max);
    let line = DMatrix::from_fn(readings.len(), 2, |row, column| [readings[row].measured, 1.0][column]);
    let fit = linear(&line, &sensed).ok()?;
    let intervals = fit.intervals(CONFIDENCE).ok()?;
    let (gain, offset) = (*fit.parameters.get(0)?, *fit.parameters.get(1)?);
    // An error below one count is the sensor's quantisation.
    let is_scaled = !intervals.first()?.contains(1.0) && (gain - 1.0).abs() * span > bench.count;
    let is_moved = !intervals.get(1)?.contains(0.0) && offset.abs() > bench.count;
    // With only one of the two claimed, it is estimated again without the other, which narrows its interval.
    let calibration = match (is_scaled, is_moved) {
        (false, false) => Calibration::NONE,
        (true, true) => Calibration { gain, offset },
        (true, false) => {
            let through = |of: fn(&Reading) -> f64| readings.iter().map(of).sum::<f64>();
            let gain = through(|reading| reading.sensed * reading.measured)
                / through(|reading| reading.measured * reading.measured);
            Calibration { gain, ..Calibration::NONE }
        }
        (false, true) => {
            let difference: f64 = readings.iter().map(|reading| reading.sensed - reading.measured).sum();
            Calibration { offset: difference / readings.len() as f64, ..Calibration::NONE }
        }
    };
    let effects = [("encoder-scale", is_scaled), ("encoder-offset", is_moved)];
    let effects = effects.into_iter().filter_map(|(name, is)| is.then_some(name)).collect();
    Some(Found { calibration, effects })
}

#[cfg(test)]
mod tests {
    use super::{
        super::bench::{GEARED, LINEAR},
        *,
    };

    /// Simulated readings at the set points, up and down twice, by a sensor and an instrument of a seed.
    fn readings(bench: &Bench, sensor: Calibration, seed: u64) -> Vec<Reading> {
        let mut noise = Sampler::new(seed, 1);
        let up = bench.set_points.iter().chain(bench.set_points.iter().rev());
        let twice = up.clone().chain(up);
        twice
            .map(|set| {
                let truth = (set / bench.per_si() - sensor.offset) / sensor.gain;
                Reading { sensed: set / bench.per_si(), measured: read(bench, truth, &mut noise) }
            })
            .collect()
    }

    #[test]
    fn a_scale_and_an_offset_are_found_and_nothing_where_there_is_none() {
        for (bench, offset) in [(GEARED, 5.0_f64.to_radians()), (LINEAR, -1e-3)] {
            for seed in 1..=20 {
                let scaled = Calibration { gain: 0.985, ..Calibration::NONE };
                let by_scale = found(&bench, &readings(&bench, scaled, seed)).expect("enough rows");
                assert_eq!(by_scale.effects, ["encoder-scale"], "{} {seed}", bench.name);
                // Half a degree over the square root of 12, in 16 rows of 246 degrees RMS: a standard error of
                // 1.5e-4; the limit is four of them.
                assert!((by_scale.calibration.gain - 0.985).abs() < 6e-4, "{} {seed}: {by_scale:?}", bench.name);
                let moved = Calibration { offset, ..Calibration::NONE };
                let by_offset = found(&bench, &readings(&bench, moved, seed)).expect("enough rows");
                assert_eq!(by_offset.effects, ["encoder-offset"], "{} {seed}", bench.name);
                // 0.144 degrees over the square root of 16 is a standard error of 6e-4 rad; for the caliper 3.2e-6
                // m. The limits are four of them.
                let within = if bench == GEARED { 2.5e-3 } else { 1.4e-5 };
                assert!((by_offset.calibration.offset - offset).abs() < within, "{} {seed}: {by_offset:?}", bench.name);
                let none = found(&bench, &readings(&bench, Calibration::NONE, seed)).expect("enough rows");
                assert_eq!(none, Found { calibration: Calibration::NONE, effects: vec![] }, "{} {seed}", bench.name);
            }
        }
        assert_eq!(found(&GEARED, &readings(&GEARED, Calibration::NONE, 1)[..1]), None);
    }

    #[test]
    fn a_corrected_board_is_where_it_is_asked_to_be() {
        use r4_protocol::config::{Feedback, PotPoint};
        let sensor = Calibration { gain: 1.02, offset: 0.5e-3 };
        let point = |code, position_m| PotPoint { code, position_m };
        let mut feedback = Feedback::Potentiometer { analog: 0, low: point(2000, 0.0), high: point(62000, 0.1) };
        sensor.put_into(&mut feedback);
        let Feedback::Potentiometer { low, high, .. } = feedback else { panic!("{feedback:?}") };
        // A reading of 0.04 m by the old configuration was 0.0387 m.
        let share = 0.4;
        let now_m = f64::from(low.position_m) + share * f64::from(high.position_m - low.position_m);
        assert!((now_m - (0.04 - 0.5e-3) / 1.02).abs() < 1e-8, "{now_m}");
        let mut encoder = Feedback::Encoder { index: 0, counts_per_turn: 2400, inverted: false, counts_per_index: 0 };
        sensor.put_into(&mut encoder);
        assert_eq!(
            encoder,
            Feedback::Encoder { index: 0, counts_per_turn: 2448, inverted: false, counts_per_index: 0 }
        );
        // The board's size of a count, to the last bit but one.
        let count = sensor.count(&GEARED);
        assert!((count * 2448.0 / std::f64::consts::TAU - 1.0).abs() < 1e-15, "{count} rad");
        let back = sensor.asked(&GEARED, sensor.command(&GEARED, 1.0));
        assert!((back - 1.0).abs() < 1e-12);
    }
}
