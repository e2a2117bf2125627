//! A lag with a delay, fitted to a recording by least squares.

use super::{Loop, Sample};

/// `gain e^(-delay s) / (lag s + 1)`, and for a position another `1 / s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Which loop it is the motor of.
    pub of: Loop,
    /// Steady speed per duty, rad/s or m/s.
    pub gain: f64,
    /// s
    pub lag_s: f64,
    /// s
    pub delay_s: f64,
}

/// A model, and how well it tells the recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// The best there is.
    pub model: Model,
    /// Root mean square of what it does not tell, as a share of the output's own.
    pub residual: f64,
}

/// Why a recording has no model.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Too few samples.
    #[error("{samples} samples are too few to fit a motor to")]
    TooShort {
        /// In the recording.
        samples: usize,
    },
    /// The input or the output is the same all the time.
    #[error("duty or measurement does not change: nothing can be fitted")]
    Flat,
    /// More duty, less speed.
    #[error("the motor turns against its duty: check `inverted` of motor and encoder")]
    Backwards,
    /// The model leaves too much untold.
    #[error("a lag with a delay leaves {:.0} % of the motion untold, allowed are {:.0} %", residual * 100.0, allowed * 100.0)]
    Poor {
        /// As in [`Fit::residual`].
        residual: f64,
        /// The most it may be.
        allowed: f64,
    },
}

/// Fewer samples say nothing of three numbers.
const LEAST_SAMPLES: usize = 20;
/// Lags and delays tried at once, and how often the grid is drawn closer around the best.
const LAGS: usize = 32;
const DELAYS: usize = 24;
const ROUNDS: usize = 5;
/// How much closer it is drawn.
const CLOSER: f64 = 4.0;
/// No delay is longer, s; nor than a quarter of the recording.
const LONGEST_DELAY_S: f64 = 0.2;

impl Fit {
    /// The model of `samples` that leaves least of the output untold, by least squares; its share must be at most `allowed`.
    ///
    /// The recording must begin in a steady state: at rest for a position.
    ///
    /// # Errors
    /// [`FitError`].
    pub fn of(samples: &[Sample], of: Loop, allowed: f64) -> Result<Self, FitError> {
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
            return Err(FitError::TooShort { samples: 0 });
        };
        let span_s = last.time_s - first.time_s;
        if samples.len() < LEAST_SAMPLES || span_s.is_nan() || span_s <= 0.0 {
            return Err(FitError::TooShort { samples: samples.len() });
        }
        let varies = |of: fn(&Sample) -> f64| samples.iter().any(|sample| of(sample) != of(first));
        if !varies(|sample| sample.input) || !varies(|sample| sample.output) {
            return Err(FitError::Flat);
        }
        let step_s = span_s / (samples.len() - 1) as f64;
        let mut lags = ((step_s / 4.0).ln(), span_s.ln());
        let mut delays = (0.0, LONGEST_DELAY_S.min(span_s / 4.0));
        let (shortest, widest) = (lags.0, delays.1);
        let mut best: Option<(f64, f64, Linear)> = None;
        for _ in 0..ROUNDS {
            for delay in 0..DELAYS {
                let delay_s = between(delays, delay, DELAYS);
                let delayed = delayed(samples, delay_s);
                for lag in 0..LAGS {
                    let log_lag = between(lags, lag, LAGS);
                    let linear = Linear::of(samples, &respond(samples, &delayed, log_lag.exp(), of));
                    if best.is_none_or(|(.., known)| linear.residual < known.residual) {
                        best = Some((log_lag, delay_s, linear));
                    }
                }
            }
            let Some((log_lag, delay_s, _)) = best else { return Err(FitError::Flat) };
            let around = |(low, high): (f64, f64), middle: f64| {
                let half = (high - low) / (2.0 * CLOSER);
                (middle - half, middle + half)
            };
            lags = around(lags, log_lag);
            lags.0 = lags.0.max(shortest);
            delays = around(delays, delay_s);
            delays = (delays.0.max(0.0), delays.1.min(widest));
        }
        let Some((log_lag, delay_s, Linear { gain, residual })) = best else { return Err(FitError::Flat) };
        if residual.is_nan() || residual > allowed {
            return Err(FitError::Poor { residual, allowed });
        }
        if gain <= 0.0 {
            return Err(FitError::Backwards);
        }
        Ok(Self { model: Model { of, gain, lag_s: log_lag.exp(), delay_s }, residual })
    }
}

fn between((low, high): (f64, f64), index: usize, count: usize) -> f64 {
    low + (high - low) * index as f64 / (count - 1) as f64
}

/// The input in the middle of each step between two samples, `delay_s` earlier; before the recording as at its start.
fn delayed(samples: &[Sample], delay_s: f64) -> Vec<f64> {
    let mut at = 0;
    let steps = samples.windows(2).map(|pair| {
        let time_s = (pair[0].time_s + pair[1].time_s) / 2.0 - delay_s;
        while at + 1 < samples.len() && samples[at + 1].time_s <= time_s {
            at += 1;
        }
        let before = samples[at];
        let Some(after) = samples.get(at + 1).filter(|_| time_s > before.time_s) else { return before.input };
        let share = (time_s - before.time_s) / (after.time_s - before.time_s);
        before.input + share * (after.input - before.input)
    });
    steps.collect()
}

/// What a motor of gain 1 answers.
fn respond(samples: &[Sample], delayed: &[f64], lag_s: f64, of: Loop) -> Vec<f64> {
    let mut speed = delayed.first().copied().unwrap_or(0.0);
    let mut position = 0.0;
    let mut answer = Vec::with_capacity(samples.len());
    answer.push(if of == Loop::Position { position } else { speed });
    for (pair, input) in samples.windows(2).zip(delayed) {
        let step_s = pair[1].time_s - pair[0].time_s;
        let kept = (-step_s / lag_s).exp();
        position += input * step_s + (speed - input) * lag_s * (1.0 - kept);
        speed = input + (speed - input) * kept;
        answer.push(if of == Loop::Position { position } else { speed });
    }
    answer
}

/// `output = gain answer + offset`.
#[derive(Clone, Copy)]
struct Linear {
    gain: f64,
    residual: f64,
}

impl Linear {
    fn of(samples: &[Sample], answer: &[f64]) -> Self {
        let count = samples.len() as f64;
        let mean_answer = answer.iter().sum::<f64>() / count;
        let mean_output = samples.iter().map(|sample| sample.output).sum::<f64>() / count;
        let (mut own, mut common, mut whole) = (0.0, 0.0, 0.0);
        for (sample, answer) in samples.iter().zip(answer) {
            let (answer, output) = (answer - mean_answer, sample.output - mean_output);
            own += answer * answer;
            common += answer * output;
            whole += output * output;
        }
        if !(own > 0.0 && whole > 0.0) {
            return Self { gain: 0.0, residual: f64::INFINITY };
        }
        Self { gain: common / own, residual: ((whole - common * common / own).max(0.0) / whole).sqrt() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motor stepped finely on duties that change as the board lets them, seen each 2 ms.
    fn recording(model: Model, noise: f64) -> Vec<Sample> {
        const STEP_S: f64 = 1e-4;
        let duty = |time_s: f64| {
            let wanted: [(f64, f64); 4] = [(0.1, 0.0), (0.5, 0.5), (1.0, -0.4), (9.0, 0.1)];
            let index = wanted.iter().position(|(until_s, _)| time_s < *until_s).unwrap_or(3);
            let (begin_s, before) = if index == 0 { (0.0, 0.0) } else { (wanted[index - 1].0, wanted[index - 1].1) };
            let change = wanted[index].1 - before;
            let most = 20.0 * (time_s - begin_s).max(0.0);
            before + change.clamp(-most, most)
        };
        let (mut speed, mut position) = (0.0, 0.0);
        let mut dice = 1_u64;
        let mut samples = Vec::new();
        for step in 0..15_000 {
            let time_s = f64::from(step) * STEP_S;
            if step % 20 == 0 {
                dice = dice.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                let noise = noise * ((dice >> 33) as f64 / f64::from(1_u32 << 30) - 1.0);
                let output = noise + if model.of == Loop::Position { position + 3.0 } else { speed };
                samples.push(Sample { time_s: 100.0 + time_s, input: duty(time_s), output });
            }
            speed += (model.gain * duty(time_s - model.delay_s) - speed) / model.lag_s * STEP_S;
            position += speed * STEP_S;
        }
        samples
    }

    #[test]
    fn known_motors_are_found() {
        for (of, gain, lag_s, delay_s) in [
            (Loop::Speed, 9.0, 0.021, 0.004),
            (Loop::Speed, 0.02, 0.1, 0.03),
            (Loop::Position, 9.0, 0.07, 0.002),
            (Loop::Position, 0.02, 0.02, 0.02),
        ] {
            let model = Model { of, gain, lag_s, delay_s };
            let fit = Fit::of(&recording(model, 0.0), of, 0.05).expect("it fits");
            let Model { gain: found, lag_s: lag, delay_s: delay, .. } = fit.model;
            // Two milliseconds between samples hide up to half of one of delay.
            assert!((found / gain - 1.0).abs() < 0.01, "{model:?} {fit:?}");
            assert!((lag - lag_s).abs() < 0.03 * lag_s + 0.5e-3, "{model:?} {fit:?}");
            assert!((delay - delay_s).abs() < 0.03 * delay_s + 0.5e-3, "{model:?} {fit:?}");
            let noisy = Fit::of(&recording(model, 0.02 * gain), of, 0.2).expect("it fits");
            assert!((noisy.model.gain / gain - 1.0).abs() < 0.05, "{model:?} {noisy:?}");
        }
    }

    #[test]
    fn what_is_no_such_motor_is_said() {
        let model = Model { of: Loop::Speed, gain: 9.0, lag_s: 0.02, delay_s: 0.004 };
        let good = recording(model, 0.0);
        assert_eq!(Fit::of(&good[..5], Loop::Speed, 0.1), Err(FitError::TooShort { samples: 5 }));
        assert_eq!(Fit::of(&[], Loop::Speed, 0.1), Err(FitError::TooShort { samples: 0 }));
        let flat: Vec<_> = good.iter().map(|sample| Sample { output: 1.0, ..*sample }).collect();
        assert_eq!(Fit::of(&flat, Loop::Speed, 0.1), Err(FitError::Flat));
        let backwards: Vec<_> = good.iter().map(|sample| Sample { output: -sample.output, ..*sample }).collect();
        assert_eq!(Fit::of(&backwards, Loop::Speed, 0.1), Err(FitError::Backwards));
        let other: Vec<_> =
            good.iter().map(|sample| Sample { output: (40.0 * sample.time_s).sin(), ..*sample }).collect();
        assert!(matches!(Fit::of(&other, Loop::Speed, 0.1), Err(FitError::Poor { .. })));
    }
}
