//! Relay feedback: the limit cycle of a motor under a relay gives its gain and phase at one frequency.

use std::f64::consts::{PI, TAU};

use super::Sample;

/// Relay with hysteresis: high below the centre, low above it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relay {
    centre: f64,
    hysteresis: f64,
    high: bool,
}

impl Relay {
    /// Makes a relay that is high.
    #[must_use]
    pub fn new(centre: f64, hysteresis: f64) -> Self {
        Self { centre, hysteresis, high: true }
    }

    /// Updates the relay with `output` and returns true while it is high. NaN changes nothing.
    pub fn step(&mut self, output: f64) -> bool {
        if output > self.centre + self.hysteresis {
            self.high = false;
        } else if output < self.centre - self.hysteresis {
            self.high = true;
        }
        self.high
    }
}

/// Frequency response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Frequency of the point, rad/s.
    pub frequency_rad_s: f64,
    /// Gain as output amplitude per input amplitude.
    pub gain: f64,
    /// Phase of the output relative to the input, in -2π..=0, rad.
    pub phase_rad: f64,
}

impl Point {
    /// Returns the proportional gain that gives a loop gain of 1 at this frequency.
    #[must_use]
    pub fn ultimate_gain(&self) -> f64 {
        1.0 / self.gain
    }
}

/// Steady limit cycle of a relay experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillation {
    /// Number of cycles averaged.
    pub cycles: usize,
    /// Mean period of a cycle, s.
    pub period_s: f64,
    /// Amplitude of the output's first harmonic, in the output's unit.
    pub amplitude: f64,
    /// Largest deviation of a cycle's period or height from the mean, as a share of it.
    pub spread: f64,
    /// Motor's frequency response at the oscillation.
    pub point: Point,
}

/// Reason why a recording has no steady oscillation.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RelayError {
    /// The recording is too short, or the motor does not oscillate.
    #[error("{seen} whole cycles were seen of {wanted}: the motor does not swing")]
    TooFew {
        /// Whole cycles in the recording.
        seen: usize,
        /// Number of cycles that must agree.
        wanted: usize,
    },
    /// The last cycles differ too much.
    #[error("the last cycles differ by {:.0} % of their mean, allowed are {:.0} %: the swing does not settle", spread * 100.0, allowed * 100.0)]
    Unsettled {
        /// Largest deviation from the mean, as a share of it.
        spread: f64,
        /// Largest deviation accepted, as a share of the mean.
        allowed: f64,
    },
    /// The input or output has no first harmonic.
    #[error("duty or measurement does not swing at all")]
    Flat,
    /// A cycle has too few samples for its phase.
    #[error("{samples:.1} samples in a cycle are too few: the motor swings too fast for the telemetry")]
    TooFast {
        /// Mean number of samples per cycle.
        samples: f64,
    },
}

/// Least number of samples per cycle.
const LEAST_SAMPLES: f64 = 8.0;

impl Oscillation {
    /// Averages the last `cycles` cycles of `samples` around `centre`, if no period and no height differs from the mean
    /// by more than the share `allowed`. A crossing counts only after the output was `hysteresis` below the centre.
    ///
    /// # Errors
    /// [`RelayError`] names the reason.
    pub fn of(
        samples: &[Sample],
        centre: f64,
        hysteresis: f64,
        cycles: usize,
        allowed: f64,
    ) -> Result<Self, RelayError> {
        let crossings = crossings(samples, centre, hysteresis);
        let cycles = cycles.max(1);
        let seen = crossings.len().saturating_sub(1);
        if seen < cycles {
            return Err(RelayError::TooFew { seen, wanted: cycles });
        }
        let crossings = &crossings[seen - cycles..];
        let (begin_s, end_s) = (crossings[0], crossings[cycles]);
        let period_s = (end_s - begin_s) / cycles as f64;
        let within = |from_s: f64, to_s: f64| {
            samples.iter().filter(move |sample| (from_s..to_s).contains(&sample.time_s)).copied()
        };
        let per_cycle = within(begin_s, end_s).count() as f64 / cycles as f64;
        if per_cycle < LEAST_SAMPLES {
            return Err(RelayError::TooFast { samples: per_cycle });
        }
        let heights = crossings.windows(2).map(|pair| {
            let outputs = || within(pair[0], pair[1]).map(|sample| sample.output);
            outputs().fold(f64::MIN, f64::max) - outputs().fold(f64::MAX, f64::min)
        });
        let heights: Vec<f64> = heights.collect();
        let periods: Vec<f64> = crossings.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let spread = spread(&heights).max(self::spread(&periods));
        if spread > allowed {
            return Err(RelayError::Unsettled { spread, allowed });
        }
        let frequency_rad_s = TAU / period_s;
        let span = cut(samples, begin_s, end_s);
        let input = harmonic(&span, frequency_rad_s, |sample| sample.input);
        let output = harmonic(&span, frequency_rad_s, |sample| sample.output);
        let (input_size, output_size) = (input.0.hypot(input.1), output.0.hypot(output.1));
        if !(input_size > 0.0 && output_size > 0.0) {
            return Err(RelayError::Flat);
        }
        let phase_rad = (output.1.atan2(output.0) - input.1.atan2(input.0)).rem_euclid(TAU) - TAU;
        let point = Point { frequency_rad_s, gain: output_size / input_size, phase_rad };
        Ok(Self { cycles, period_s, amplitude: output_size, spread, point })
    }

    /// Returns the phase by which hysteresis alone reduces the half turn at which an ideal relay oscillates, rad.
    #[must_use]
    pub fn hysteresis_phase(&self, hysteresis: f64) -> f64 {
        (hysteresis / self.amplitude).clamp(0.0, 1.0).asin()
    }

    /// Returns the delay between relay and motor, s: the part of the half turn that neither the motor nor the
    /// hysteresis accounts for.
    #[must_use]
    pub fn outside_delay_s(&self, hysteresis: f64) -> f64 {
        (PI + self.point.phase_rad - self.hysteresis_phase(hysteresis)) / self.point.frequency_rad_s
    }
}

/// Returns the times at which the output rises through `centre` after it was `hysteresis` below, s.
fn crossings(samples: &[Sample], centre: f64, hysteresis: f64) -> Vec<f64> {
    let mut crossings = Vec::new();
    let mut below = false;
    for pair in samples.windows(2) {
        let [before, after] = [pair[0], pair[1]];
        below |= before.output < centre - hysteresis;
        if below && before.output < centre && after.output >= centre {
            let share = (centre - before.output) / (after.output - before.output);
            crossings.push(before.time_s + share * (after.time_s - before.time_s));
            below = false;
        }
    }
    crossings
}

fn spread(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| ((value - mean) / mean).abs()).fold(0.0, f64::max)
}

/// Returns the samples from `begin_s` to `end_s`, with an interpolated one at each end.
fn cut(samples: &[Sample], begin_s: f64, end_s: f64) -> Vec<Sample> {
    let mut span = Vec::new();
    for pair in samples.windows(2) {
        let [before, after] = [pair[0], pair[1]];
        for time_s in [begin_s, end_s] {
            if (before.time_s..after.time_s).contains(&time_s) {
                let share = (time_s - before.time_s) / (after.time_s - before.time_s);
                let between = |a: f64, b: f64| a + share * (b - a);
                let input = between(before.input, after.input);
                span.push(Sample { time_s, input, output: between(before.output, after.output) });
            }
        }
        if after.time_s > begin_s && after.time_s < end_s {
            span.push(after);
        }
    }
    span
}

/// Returns the first harmonic as (real, imaginary); its phase is relative to a cosine at time 0.
fn harmonic(span: &[Sample], frequency_rad_s: f64, of: impl Fn(&Sample) -> f64) -> (f64, f64) {
    let (mut real, mut imaginary) = (0.0, 0.0);
    for pair in span.windows(2) {
        let step_s = pair[1].time_s - pair[0].time_s;
        let turned = |sample: &Sample| {
            let (sin, cos) = (frequency_rad_s * sample.time_s).sin_cos();
            (of(sample) * cos, -of(sample) * sin)
        };
        let (first, second) = (turned(&pair[0]), turned(&pair[1]));
        real += (first.0 + second.0) / 2.0 * step_s;
        imaginary += (first.1 + second.1) / 2.0 * step_s;
    }
    let duration_s = span.last().map_or(0.0, |last| last.time_s) - span.first().map_or(0.0, |first| first.time_s);
    let scale = if duration_s > 0.0 { 2.0 / duration_s } else { 0.0 };
    (real * scale, imaginary * scale)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f64 = 1e-4;

    /// Simulates `gain / (s (lag s + 1))` under a relay of height `height` whose decisions arrive `delay_s` late. The
    /// samples, one per millisecond, have the input at the motor as a board's telemetry does, so without that delay.
    fn swing(gain: f64, lag_s: f64, delay_s: f64, height: f64, hysteresis: f64, seconds: f64) -> Vec<Sample> {
        let mut relay = Relay::new(0.0, hysteresis);
        let late = (delay_s / STEP_S) as usize;
        let mut decided = vec![height; late + 1];
        let (mut speed, mut position) = (0.0, 0.0);
        let mut samples = Vec::new();
        for step in 0..(seconds / STEP_S) as usize {
            decided.push(if relay.step(position) { height } else { -height });
            let input = decided[decided.len() - 1 - late];
            if step % 10 == 0 {
                samples.push(Sample { time_s: 7.0 + step as f64 * STEP_S, input, output: position });
            }
            speed += (gain * input - speed) / lag_s * STEP_S;
            position += speed * STEP_S;
        }
        samples
    }

    #[test]
    fn a_known_motor_is_told_without_the_delay_of_the_relay() {
        for (lag_s, delay_s, hysteresis) in [(0.07, 0.008, 0.0), (0.07, 0.03, 0.01), (0.02, 0.02, 0.005)] {
            let samples = swing(6.0, lag_s, delay_s, 0.5, hysteresis, 4.0);
            let seen = Oscillation::of(&samples, 0.0, hysteresis, 5, 0.05).expect("it swings");
            let omega = seen.point.frequency_rad_s;
            let gain = 6.0 / (omega * (omega * lag_s).hypot(1.0));
            let phase_rad = -PI / 2.0 - (omega * lag_s).atan();
            // Samples every millisecond locate the edges of the input within half of that.
            assert!((seen.point.gain / gain - 1.0).abs() < 0.02, "{seen:?} {gain}");
            assert!((seen.point.phase_rad - phase_rad).abs() < omega * 0.7e-3, "{seen:?} {phase_rad}");
            // The describing function assumes a sinusoidal output, which limits the accuracy of the delay.
            let outside_s = seen.outside_delay_s(hysteresis);
            assert!((outside_s - delay_s).abs() < 0.15 * delay_s + 1e-3, "{outside_s} {delay_s}");
        }
    }

    #[test]
    fn the_ultimate_point_of_an_integrator_with_a_delay() {
        // An integrator with a delay oscillates with a period of four delays; at relay height h and gain k its
        // amplitude is k h L.
        let samples = swing(2.0, 1e-4, 0.05, 0.5, 0.0, 4.0);
        let seen = Oscillation::of(&samples, 0.0, 0.0, 5, 0.05).expect("it swings");
        assert!((seen.period_s - 0.2).abs() < 0.002, "{seen:?}");
        // The first harmonic of a triangle wave is 8/pi² of its height.
        assert!((seen.amplitude - 0.05 * 8.0 / (PI * PI)).abs() < 0.001, "{seen:?}");
        assert!((seen.point.ultimate_gain() - seen.point.frequency_rad_s / 2.0).abs() < 0.4, "{seen:?}");
    }

    #[test]
    fn what_does_not_settle_is_rejected() {
        let mut samples = swing(6.0, 0.07, 0.02, 0.5, 0.005, 4.0);
        let of = |samples: &[Sample]| Oscillation::of(samples, 0.0, 0.005, 4, 0.1);
        assert!(of(&samples).is_ok());
        assert_eq!(of(&samples[..200]).err(), Some(RelayError::TooFew { seen: 0, wanted: 4 }));
        let begin_s = samples[0].time_s;
        for sample in &mut samples {
            sample.output *= (0.5 * (sample.time_s - begin_s)).exp();
        }
        assert!(matches!(of(&samples), Err(RelayError::Unsettled { .. })), "{:?}", of(&samples));
        let standing: Vec<_> =
            (0..4000).map(|index| Sample { time_s: f64::from(index) * 1e-3, input: 0.5, output: 0.0 }).collect();
        assert_eq!(of(&standing).err(), Some(RelayError::TooFew { seen: 0, wanted: 4 }));
        let fast: Vec<_> = (0..400)
            .map(|index| Sample { time_s: f64::from(index) * 1e-3, input: 0.5, output: f64::from(index % 4) - 1.5 })
            .collect();
        assert!(matches!(of(&fast), Err(RelayError::TooFast { .. })));
        assert!(of(&[]).is_err());
    }

    #[test]
    fn a_relay_keeps_its_side_within_the_hysteresis() {
        let mut relay = Relay::new(1.0, 0.1);
        let seen: Vec<bool> = [0.0, 1.05, 1.2, 0.95, f64::NAN, 0.8].map(|output| relay.step(output)).to_vec();
        assert_eq!(seen, [true, true, false, false, false, true]);
    }
}
