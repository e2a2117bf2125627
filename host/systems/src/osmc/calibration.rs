//! Scale and offset of a sensor, which no controller can see: found by a measurement beside the board.
//!
//! The declared procedure: set points up and down, twice. At each the board's reading is noted, and where the motor really is, by an
//! instrument: a protractor, or a caliper, read to [`DIVISION_DEG`] and [`DIVISION_MM`]. The identifier's `static-map` is fitted to the
//! first pass, the second is held out: `reading = gain · true + offset`. What its interval tells from 1 and 0 is corrected in the
//! board's configuration, and the set points are run again.

use r4_identify::{
    IdentifyError, Task,
    data::{Quantity, Run, Signal},
    statics::map::StaticMap,
};

use super::bench::Bench;
use crate::sampler::Sampler;

/// Reading error of the protractor, deg: uniform between plus and minus a half of it. Our choice: a dial with divisions of half a degree.
pub const DIVISION_DEG: f64 = 0.5;
/// Reading error of the caliper, mm, in the same way. Our choice: a vernier of a twentieth.
pub const DIVISION_MM: f64 = 0.05;
/// Standard errors that a scale is claimed from. 15 rows are read; at 4 one of 500 motors without a scale error is said to have one.
const CLAIMED: f64 = 4.0;

/// What a sensor reads: `gain · true + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration {
    /// 1
    pub gain: f64,
    /// rad or m
    pub offset: f64,
}

impl Calibration {
    /// A sensor that reads what is true.
    pub const NONE: Self = Self { gain: 1.0, offset: 0.0 };

    /// What to send a board to that has this calibration in its configuration, for a true position. A rotary sensor's zero is where
    /// power came on, which no configuration holds: the host adds it.
    #[must_use]
    pub fn command(&self, bench: &Bench, position: f64) -> f64 {
        if bench.step.is_some() { position + self.offset / self.gain } else { position }
    }

    /// The true position that a command of [`Calibration::command`] asks for.
    #[must_use]
    pub fn asked(&self, bench: &Bench, command: f64) -> f64 {
        if bench.step.is_some() { command - self.offset / self.gain } else { command }
    }
}

/// A set point at which both were read, rad or m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// By the board's sensor.
    pub sensed: f64,
    /// By the instrument.
    pub measured: f64,
}

/// What the instrument reads where the truth is known.
#[must_use]
pub fn read(bench: &Bench, truth: f64, noise: &mut Sampler) -> f64 {
    let division = if bench.step.is_some() { DIVISION_DEG } else { DIVISION_MM };
    truth + noise.uniform(-0.5, 0.5) * division / bench.per_si()
}

/// A calibration and what it is named after.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// What to correct.
    pub calibration: Calibration,
    /// Names of the effects that were claimed, as in the catalogue of plants.
    pub effects: Vec<&'static str>,
}

/// Fits the map to the first half of `readings`, with the second half held out.
///
/// # Errors
/// Too few readings.
pub fn found(bench: &Bench, readings: &[Reading]) -> Result<Found, IdentifyError> {
    let (first, second) = readings.split_at(readings.len() / 2);
    let quantity = if bench.step.is_some() { Quantity::Angle } else { Quantity::Length };
    let run = |name: &str, readings: &[Reading]| {
        let signal = |column: &str, of: fn(&Reading) -> f64| {
            let values = readings.iter().map(of).collect();
            (column.to_owned(), Signal { column: column.to_owned(), quantity, values })
        };
        let signals = [signal("input", |reading| reading.measured), signal("output", |reading| reading.sensed)];
        Run {
            name: name.to_owned(),
            time_s: (0..readings.len()).map(|row| row as f64).collect(),
            signals: signals.into_iter().collect(),
        }
    };
    let task = Task { model: StaticMap::NAME.to_owned(), seed: 1, ..Task::default() };
    let (train, holdout) = ([run("first pass", first)], [run("second pass", second)]);
    let report = r4_identify::identify(&task, &train, &holdout, Vec::new(), &|_| ())?.report;
    let offset = report.effects.iter().find(|effect| effect.name == "offset");
    let offset = offset.and_then(|effect| effect.parameters.values().next()).map_or(0.0, |number| number.value);
    let mut found = Found { calibration: Calibration { offset, ..Calibration::NONE }, effects: Vec::new() };
    if offset != 0.0 {
        found.effects.push("encoder-offset");
    }
    if let Some(gain) = report.parameters.get("gain")
        && gain.std.is_some_and(|std| (gain.value - 1.0).abs() > CLAIMED * std)
    {
        found.calibration.gain = gain.value;
        found.effects.push("encoder-scale");
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::{
        super::bench::{GEARED, LINEAR},
        *,
    };

    /// Set points up and down twice, by a sensor and an instrument of a seed.
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
            let mut wrong = 0;
            for seed in 1..=10 {
                let scaled = Calibration { gain: 0.985, ..Calibration::NONE };
                let by_scale = found(&bench, &readings(&bench, scaled, seed)).expect("enough rows");
                assert!(by_scale.effects.contains(&"encoder-scale"), "{} {seed}: {by_scale:?}", bench.name);
                // Of an interval of 4 standard errors: 0.5 deg / sqrt(12) in 8 rows of 270 deg in the mean.
                assert!((by_scale.calibration.gain - 0.985).abs() < 2.5e-3, "{} {seed}: {by_scale:?}", bench.name);
                let moved = Calibration { offset, ..Calibration::NONE };
                let by_offset = found(&bench, &readings(&bench, moved, seed)).expect("enough rows");
                assert!(by_offset.effects.contains(&"encoder-offset"), "{} {seed}: {by_offset:?}", bench.name);
                let none = found(&bench, &readings(&bench, Calibration::NONE, seed)).expect("enough rows");
                wrong += usize::from(!none.effects.is_empty());
            }
            assert!(wrong <= 1, "{}: {wrong} of 10", bench.name);
        }
    }
}
