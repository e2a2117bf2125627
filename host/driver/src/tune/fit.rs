//! A motor's model, fitted to recorded runs by least squares.

use super::Sample;

/// A motor as its loops see it: its speed follows the duty beyond friction, `gain e^(-delay s) / (lag s + 1)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Steady speed per duty beyond friction, rad/s or m/s.
    pub gain: f64,
    /// s
    pub lag_s: f64,
    /// s
    pub delay_s: f64,
}

/// Duty that friction and a dead zone take of a motor that turns, as a share of the supply.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Of one that turns upwards.
    pub up: f64,
    /// Of one that turns downwards.
    pub down: f64,
}

impl Friction {
    /// The mean of both directions; what they differ by is a load.
    #[must_use]
    pub fn mean(&self) -> f64 {
        (self.up + self.down) / 2.0
    }
}

/// A recording of a motor that is driven in one direction, and turns in it from some sample on. The duty changes while it turns.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Whether upwards.
    pub up: bool,
    /// Duty and position.
    pub samples: Vec<Sample>,
}

/// A model, and how well it describes the recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Best model.
    pub model: Model,
    /// Friction that goes with it.
    pub friction: Friction,
    /// Root mean square of the residual, as a share of the output's own after each run's beginning is taken out.
    pub residual: f64,
    /// The same in the unit of the position.
    pub residual_rms: f64,
    /// Models that the recording does not exclude: those with the least and the most of lag, delay and of gain over lag.
    pub plausible: Vec<Model>,
}

/// Why a recording has no model.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Too few samples with motion.
    #[error("{samples} samples of a turning motor are too few to fit it to: allow more --travel")]
    TooShort {
        /// In the recording.
        samples: usize,
    },
    /// The duty or the position is the same all the time.
    #[error("duty or position does not change: nothing can be fitted")]
    Flat,
    /// More duty, less speed.
    #[error("the motor turns against its duty: check `inverted` of motor and encoder")]
    Backwards,
    /// The model leaves too much of the motion.
    #[error(
        "no linear motor with friction describes the motion: {:.0} % of it are residual, allowed are {:.0} %",
        residual * 100.0, allowed * 100.0
    )]
    Poor {
        /// As in [`Fit::residual`].
        residual: f64,
        /// The most it may be.
        allowed: f64,
    },
}

/// Fewer samples say nothing of five numbers.
const LEAST_SAMPLES: usize = 40;
/// A run counts from when the position has moved by so many counts: play is over then.
const BEGIN_COUNTS: f64 = 3.0;
/// A shorter run has as many unknowns of its own as it has to say.
const LEAST_RUN: usize = 8;
/// Lags and delays tried at once, and how often the grid is drawn closer around the best.
const LAGS: usize = 20;
const DELAYS: usize = 12;
const ROUNDS: usize = 4;
/// How much closer it is drawn.
const CLOSER: f64 = 3.0;
/// No lag and no delay is longer, s.
const LONGEST_LAG_S: f64 = 3.0;
const LONGEST_DELAY_S: f64 = 0.08;
/// Neighbouring samples of a position that is counted have the same error: so many of them say as much as one of their own. An
/// assumption, not measured.
const ALIKE: f64 = 10.0;
/// 95 % of a chi-squared distribution with two degrees of freedom (lag and delay).
const CHI_SQUARED: f64 = 5.99;

/// A lag and a delay, what goes with them, and the sum of squares that they leave.
#[derive(Clone, Copy)]
struct Tried {
    log_lag: f64,
    delay_s: f64,
    linear: Linear,
}

impl Tried {
    fn model(&self) -> Model {
        Model { gain: self.linear.gain, lag_s: self.log_lag.exp(), delay_s: self.delay_s }
    }

    /// What the motor is far above its lag: an integrator of the duty.
    fn rise(&self) -> f64 {
        self.linear.gain / self.log_lag.exp()
    }
}

impl Fit {
    /// The model that leaves least of the position in `runs`, by least squares; `resolution` is a count of it. Where each run
    /// began and how fast is left open, so play before a run and what a run before it left do not matter. The residual's share
    /// must be at most `allowed`.
    ///
    /// # Errors
    /// [`FitError`].
    pub fn of(runs: &[Run], resolution: f64, allowed: f64) -> Result<Self, FitError> {
        let runs: Vec<Cut<'_>> = runs.iter().filter_map(|run| Cut::of(run, resolution)).collect();
        let samples: usize = runs.iter().map(Cut::len).sum();
        if samples < LEAST_SAMPLES {
            return Err(FitError::TooShort { samples });
        }
        if !runs.iter().any(Cut::varies) {
            return Err(FitError::Flat);
        }
        let steps = runs.iter().map(|run| run.duration_s() / (run.len() - 1) as f64);
        let shortest = (steps.fold(f64::INFINITY, f64::min) / 2.0).ln();
        let mut lags = (shortest, LONGEST_LAG_S.ln());
        let mut delays = (0.0, LONGEST_DELAY_S);
        let mut all: Vec<Tried> = Vec::new();
        let mut best: Option<Tried> = None;
        for _ in 0..ROUNDS {
            for delay in 0..DELAYS {
                let delay_s = between(delays, delay, DELAYS);
                let inputs: Vec<Vec<f64>> = runs.iter().map(|run| run.delayed(delay_s)).collect();
                for lag in 0..LAGS {
                    let log_lag = between(lags, lag, LAGS);
                    let Some(linear) = Linear::of(&runs, &inputs, log_lag.exp()) else { continue };
                    let tried = Tried { log_lag, delay_s, linear };
                    all.push(tried);
                    if best.is_none_or(|known| linear.left < known.linear.left) {
                        best = Some(tried);
                    }
                }
            }
            let Some(best) = best else { return Err(FitError::Flat) };
            let around = |(low, high): (f64, f64), middle: f64| {
                let half = (high - low) / (2.0 * CLOSER);
                (middle - half, middle + half)
            };
            let (low, high) = around(lags, best.log_lag);
            lags = (low.max(shortest), high.min(LONGEST_LAG_S.ln()));
            let (low, high) = around(delays, best.delay_s);
            delays = (low.max(0.0), high.min(LONGEST_DELAY_S));
        }
        let Some(best) = best else { return Err(FitError::Flat) };
        let residual = (best.linear.left / best.linear.whole).sqrt();
        if residual.is_nan() || residual > allowed {
            return Err(FitError::Poor { residual, allowed });
        }
        let Linear { gain, up, down, left, .. } = best.linear;
        if gain <= 0.0 {
            return Err(FitError::Backwards);
        }
        // A position is known to a count at best, even where the residual happens to be smaller.
        let variance = (left / samples as f64).max(resolution * resolution / 12.0);
        let limit = left + CHI_SQUARED * ALIKE * variance;
        let plausible: Vec<&Tried> =
            all.iter().filter(|tried| tried.linear.left <= limit && tried.linear.gain > 0.0).collect();
        let extremes: [fn(&Tried) -> f64; 3] = [|tried| tried.log_lag, |tried| tried.delay_s, Tried::rise];
        let ends = extremes.into_iter().flat_map(|of| {
            let order = |a: &&&Tried, b: &&&Tried| of(a).total_cmp(&of(b));
            [plausible.iter().min_by(order), plausible.iter().max_by(order)]
        });
        Ok(Self {
            model: best.model(),
            friction: Friction { up: (up / gain).max(0.0), down: (down / gain).max(0.0) },
            residual,
            residual_rms: (left / samples as f64).sqrt(),
            plausible: ends.flatten().map(|tried| tried.model()).collect(),
        })
    }
}

fn between((low, high): (f64, f64), index: usize, count: usize) -> f64 {
    low + (high - low) * index as f64 / (count - 1) as f64
}

/// A run from where its play is over; what was driven before is there for the delay.
struct Cut<'r> {
    sign: f64,
    samples: &'r [Sample],
    from: usize,
}

impl<'r> Cut<'r> {
    fn of(run: &'r Run, resolution: f64) -> Option<Self> {
        let first = run.samples.first()?;
        let sign = if run.up { 1.0 } else { -1.0 };
        let moved = |sample: &Sample| (sample.output - first.output) * sign >= BEGIN_COUNTS * resolution;
        let from = run.samples.iter().position(moved)?;
        let is_in_order = run.samples.windows(2).all(|pair| pair[1].time_s > pair[0].time_s);
        let is_finite = run.samples.iter().all(|sample| sample.input.is_finite() && sample.output.is_finite());
        (run.samples.len() - from >= LEAST_RUN && is_in_order && is_finite).then_some(Self {
            sign,
            samples: &run.samples,
            from,
        })
    }

    fn turning(&self) -> &'r [Sample] {
        &self.samples[self.from..]
    }

    fn len(&self) -> usize {
        self.samples.len() - self.from
    }

    fn duration_s(&self) -> f64 {
        let turning = self.turning();
        turning[turning.len() - 1].time_s - turning[0].time_s
    }

    fn varies(&self) -> bool {
        self.turning().iter().any(|sample| sample.input != self.turning()[0].input)
    }

    /// The duty in the middle of each step between two samples of the turning motor, `delay_s` earlier; before the run as at
    /// its start.
    fn delayed(&self, delay_s: f64) -> Vec<f64> {
        let mut at = 0;
        let steps = self.turning().windows(2).map(|pair| {
            let time_s = (pair[0].time_s + pair[1].time_s) / 2.0 - delay_s;
            while at + 1 < self.samples.len() && self.samples[at + 1].time_s <= time_s {
                at += 1;
            }
            let before = self.samples[at];
            let Some(after) = self.samples.get(at + 1).filter(|_| time_s > before.time_s) else { return before.input };
            let share = (time_s - before.time_s) / (after.time_s - before.time_s);
            before.input + share * (after.input - before.input)
        });
        steps.collect()
    }
}

/// `output = gain (answer to the duty) - sign friction (answer to 1) + speed (1 - e^(-t/lag)) lag + place`, of which speed and place
/// are each run's own, and friction is that of the run's direction.
#[derive(Clone, Copy)]
struct Linear {
    gain: f64,
    /// Gain times the duty that friction takes.
    up: f64,
    down: f64,
    /// Sum of squares of what is left, and of all that there was.
    left: f64,
    whole: f64,
}

impl Linear {
    /// `None` where the numbers cannot be told apart.
    fn of(runs: &[Cut<'_>], inputs: &[Vec<f64>], lag_s: f64) -> Option<Self> {
        let (mut normal, mut right, mut whole) = ([[0.0; 3]; 3], [0.0; 3], 0.0);
        for (run, inputs) in runs.iter().zip(inputs) {
            let [output, driven, held] = columns(run, inputs, lag_s);
            let held_index = if run.sign > 0.0 { 1 } else { 2 };
            for ((output, driven), held) in output.iter().zip(&driven).zip(&held) {
                let held = -run.sign * held;
                whole += output * output;
                normal[0][0] += driven * driven;
                normal[0][held_index] += driven * held;
                normal[held_index][held_index] += held * held;
                right[0] += driven * output;
                right[held_index] += held * output;
            }
        }
        // Eliminates both frictions, which do not meet: a 2 by 2 step each. One that never was is 0.
        let (mut own, mut common) = (normal[0][0], right[0]);
        let mut solved = right.map(|_| 0.0);
        for index in [1, 2] {
            if normal[index][index] > 0.0 {
                own -= normal[0][index] * normal[0][index] / normal[index][index];
                common -= normal[0][index] * right[index] / normal[index][index];
            }
        }
        // What of the duty's answer is not friction's: rounding is nine digits below.
        if !(own > 1e-9 * normal[0][0] && whole > 0.0) {
            return None;
        }
        solved[0] = common / own;
        for index in [1, 2] {
            if normal[index][index] > 0.0 {
                solved[index] = (right[index] - normal[0][index] * solved[0]) / normal[index][index];
            }
        }
        let explained: f64 = solved.iter().zip(&right).map(|(value, right)| value * right).sum();
        let [gain, up, down] = solved;
        Some(Self { gain, up, down, left: (whole - explained).max(0.0), whole })
    }
}

/// Position, the answer of a motor of gain 1 to the duty, and to a duty of 1; without what a place and a speed at the beginning
/// would add to each.
fn columns(run: &Cut<'_>, inputs: &[f64], lag_s: f64) -> [Vec<f64>; 3] {
    let turning = run.turning();
    let count = turning.len();
    let mut driven = Vec::with_capacity(count);
    let mut held = Vec::with_capacity(count);
    let mut rolled = Vec::with_capacity(count);
    let (mut speed, mut position, mut kept) = (0.0, 0.0, 1.0);
    let begin_s = turning[0].time_s;
    for (index, sample) in turning.iter().enumerate() {
        if index > 0 {
            let step_s = sample.time_s - turning[index - 1].time_s;
            let of_step = (-step_s / lag_s).exp();
            let input = inputs[index - 1];
            position += input * step_s + (speed - input) * lag_s * (1.0 - of_step);
            speed = input + (speed - input) * of_step;
            kept *= of_step;
        }
        let roll = lag_s * (1.0 - kept);
        driven.push(position);
        rolled.push(roll);
        held.push(sample.time_s - begin_s - roll);
    }
    centre(&mut rolled);
    let output = turning.iter().map(|sample| sample.output).collect();
    let mut columns = [output, driven, held];
    let own: f64 = rolled.iter().map(|roll| roll * roll).sum();
    for column in &mut columns {
        centre(column);
        if own > 0.0 {
            let share = column.iter().zip(&rolled).map(|(value, roll)| value * roll).sum::<f64>() / own;
            column.iter_mut().zip(&rolled).for_each(|(value, roll)| *value -= share * roll);
        }
    }
    columns
}

fn centre(values: &mut [f64]) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter_mut().for_each(|value| *value -= mean);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the recording is of, besides the model.
    #[derive(Clone, Copy)]
    struct World {
        friction: Friction,
        play: f64,
        count: f64,
    }

    const SMOOTH: World = World { friction: Friction { up: 0.12, down: 0.08 }, play: 0.0, count: 1e-9 };

    /// Four runs up and down of a motor stepped finely, seen each 2 ms, under duties that change as the board lets them.
    fn recording(model: Model, world: World) -> Vec<Run> {
        const STEP_S: f64 = 1e-4;
        let levels = [(true, 0.3), (false, 0.35), (true, 0.5), (false, 0.5)];
        let (mut position, mut output): (f64, f64) = (0.0, 0.0);
        let mut time_s = 0.0;
        let mut runs = Vec::new();
        for (up, level) in levels {
            let sign = if up { 1.0 } else { -1.0 };
            let friction = if up { world.friction.up } else { world.friction.down };
            let begin_s = time_s;
            let duty = |time_s: f64| {
                let since_s = time_s - begin_s;
                let change: f64 = if (since_s / 0.08) as i64 % 2 == 0 { 0.0 } else { -0.08 };
                sign * (level + change).min(20.0 * since_s.max(0.0))
            };
            let mut speed = 0.0;
            let mut samples = Vec::new();
            for step in 0..6000 {
                time_s = begin_s + f64::from(step) * STEP_S;
                if step % 20 == 0 {
                    let counted = (output / world.count).floor() * world.count;
                    samples.push(Sample { time_s, input: duty(time_s), output: counted });
                }
                let driven = (sign * duty(time_s - model.delay_s) - friction).max(0.0);
                speed += (model.gain * driven * sign - speed) / model.lag_s * STEP_S;
                position += speed * STEP_S;
                output = output.clamp(position - world.play / 2.0, position + world.play / 2.0);
            }
            time_s += 1.0;
            runs.push(Run { up, samples });
        }
        runs
    }

    #[test]
    fn known_motors_are_found() {
        for (gain, lag_s, delay_s) in [(9.0, 0.021, 0.004), (0.02, 0.1, 0.03), (40.0, 0.3, 0.002), (2.0, 0.015, 0.012)]
        {
            let model = Model { gain, lag_s, delay_s };
            let world = World { count: 1e-6 * gain, ..SMOOTH };
            let fit = Fit::of(&recording(model, world), world.count, 0.05).expect("it fits");
            let found = fit.model;
            // Two milliseconds between samples hide up to half of one of delay.
            assert!((found.gain / gain - 1.0).abs() < 0.02, "{model:?} {fit:?}");
            assert!((found.lag_s - lag_s).abs() < 0.04 * lag_s + 1e-3, "{model:?} {fit:?}");
            assert!((found.delay_s - delay_s).abs() < 1.5e-3, "{model:?} {fit:?}");
            assert!((fit.friction.up - 0.12).abs() < 0.01 && (fit.friction.down - 0.08).abs() < 0.01, "{fit:?}");
        }
    }

    /// A count of 1.8 degrees and a degree of play: the truth is among what is not excluded.
    #[test]
    fn a_coarse_sensor_leaves_more_open() {
        let model = Model { gain: 9.0, lag_s: 0.06, delay_s: 0.004 };
        let fit_of = |count: f64| {
            let world = World { count, play: 0.02, ..SMOOTH };
            Fit::of(&recording(model, world), count, 0.2).expect("it fits")
        };
        let spread = |fit: &Fit| {
            let lags = fit.plausible.iter().map(|model| model.lag_s);
            (lags.clone().fold(f64::INFINITY, f64::min), lags.fold(0.0, f64::max))
        };
        let (fine, coarse) = (fit_of(6e-4), fit_of(0.0314));
        let (low, high) = spread(&coarse);
        assert!(low <= 0.06 && high >= 0.06, "{coarse:?}");
        assert!(spread(&fine).1 - spread(&fine).0 < high - low, "{fine:?} {coarse:?}");
        assert!((coarse.model.gain / 9.0 - 1.0).abs() < 0.1, "{coarse:?}");
    }

    #[test]
    fn what_is_no_such_motor_is_said() {
        let good = recording(Model { gain: 9.0, lag_s: 0.02, delay_s: 0.004 }, SMOOTH);
        let with = |change: fn(&Sample) -> Sample| -> Vec<Run> {
            let changed = |run: &Run| Run { samples: run.samples.iter().map(change).collect(), ..run.clone() };
            good.iter().map(changed).collect()
        };
        let short = Run { samples: good[0].samples[..5].to_vec(), ..good[0].clone() };
        assert_eq!(Fit::of(&[short], 1e-9, 0.1), Err(FitError::TooShort { samples: 0 }));
        assert_eq!(Fit::of(&[], 1e-9, 0.1), Err(FitError::TooShort { samples: 0 }));
        let still = with(|sample| Sample { output: 1.0, ..*sample });
        assert_eq!(Fit::of(&still, 1e-9, 0.1), Err(FitError::TooShort { samples: 0 }));
        let flat = with(|sample| Sample { input: 0.3, ..*sample });
        assert_eq!(Fit::of(&flat, 1e-9, 0.1), Err(FitError::Flat));
        // More duty makes it slower.
        let against = with(|sample| Sample { input: -sample.input, ..*sample });
        assert_eq!(Fit::of(&against, 1e-9, 1.0), Err(FitError::Backwards));
        let other: Vec<Run> = good
            .iter()
            .map(|run| {
                let sign = if run.up { 1.0 } else { -1.0 };
                let place = |time_s: f64| sign * (time_s + 0.2 * (40.0 * time_s).sin());
                let samples = run.samples.iter().map(|at| Sample { output: place(at.time_s), ..*at }).collect();
                Run { samples, ..run.clone() }
            })
            .collect();
        assert!(matches!(Fit::of(&other, 1e-9, 0.1), Err(FitError::Poor { .. })));
        let broken = with(|sample| Sample { output: f64::NAN, ..*sample });
        assert!(Fit::of(&broken, 1e-9, 0.1).is_err());
    }
}
