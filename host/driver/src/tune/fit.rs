//! Least-squares fit of a motor's model to recorded runs.

use super::Sample;

/// Motor as its loops see it: from the duty beyond friction to the speed, `gain e^(-delay s) / (lag s + 1)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Model {
    /// Steady-state speed per duty beyond friction, rad/s or m/s.
    pub gain: f64,
    /// Time constant of the speed, s.
    pub lag_s: f64,
    /// Dead time before the speed responds, s.
    pub delay_s: f64,
}

/// Duty that friction and a dead zone take from a turning motor, as a share of the supply voltage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Friction {
    /// Duty when turning in positive direction.
    pub up: f64,
    /// Duty when turning in negative direction.
    pub down: f64,
}

impl Friction {
    /// Returns the mean of both directions; their difference is a constant load.
    #[must_use]
    pub fn mean(&self) -> f64 {
        (self.up + self.down) / 2.0
    }
}

/// Recording of a motor driven in one direction, in which it turns from some sample on. The duty varies while it turns.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// True for the positive direction.
    pub up: bool,
    /// Samples of duty and position.
    pub samples: Vec<Sample>,
}

/// Fitted model with the quality of the fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Model with the smallest residual.
    pub model: Model,
    /// Friction fitted together with the model.
    pub friction: Friction,
    /// RMS residual relative to the RMS of the output, after position and speed at the start of each run are removed.
    pub residual: f64,
    /// RMS residual in the unit of the position.
    pub residual_rms: f64,
    /// Models that the recording does not exclude: those with the least and the most lag, delay, and gain over lag.
    pub plausible: Vec<Model>,
}

/// Reason why a recording has no model.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Too few samples with motion for a fit.
    #[error("{samples} samples of a turning motor are too few to fit it to: allow more --travel")]
    TooShort {
        /// Number of samples in the recording.
        samples: usize,
    },
    /// Duty or position is constant over the recording.
    #[error("duty or position does not change: nothing can be fitted")]
    Flat,
    /// The fitted gain is negative: more duty, less speed.
    #[error("the motor turns against its duty: check `inverted` of motor and encoder")]
    Backwards,
    /// The residual is too large a part of the motion.
    #[error(
        "no linear motor with friction describes the motion: {:.0} % of it are residual, allowed are {:.0} %",
        residual * 100.0, allowed * 100.0
    )]
    Poor {
        /// Relative residual as in [`Fit::residual`].
        residual: f64,
        /// Largest relative residual accepted.
        allowed: f64,
    },
}

/// Least number of samples for a fit of five numbers.
const LEAST_SAMPLES: usize = 40;
/// Travel in counts after which a run is used: the backlash is taken up by then.
const BEGIN_COUNTS: f64 = 3.0;
/// Least number of samples of a run; each run adds two unknowns, its initial position and speed.
const LEAST_RUN: usize = 8;
/// Grid of lags and delays, and the number of times it is refined around the best point.
const LAGS: usize = 20;
const DELAYS: usize = 12;
const ROUNDS: usize = 4;
/// Factor by which each refinement narrows the grid.
const CLOSER: f64 = 3.0;
/// Upper limits of the search for lag and delay, s.
const LONGEST_LAG_S: f64 = 3.0;
const LONGEST_DELAY_S: f64 = 0.08;
/// Number of neighbouring samples of a quantised position that count as one independent sample, since their errors are
/// alike. An assumption, not measured.
const ALIKE: f64 = 10.0;
/// 95 % quantile of the chi-squared distribution with two degrees of freedom (lag and delay).
const CHI_SQUARED: f64 = 5.99;

/// Grid point: lag and delay, with the linear parameters fitted for them and their residual.
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

    /// Gain over lag: the motor's gain as an integrator of the duty, at frequencies far above 1/lag.
    fn rise(&self) -> f64 {
        self.linear.gain / self.log_lag.exp()
    }
}

impl Fit {
    /// Fits the model with the smallest residual of the position in `runs`; `resolution` is one count of it. Position
    /// and speed at the start of each run are free, so backlash before a run and the motion left from an earlier one do
    /// not matter. The relative residual must not exceed `allowed`.
    ///
    /// # Errors
    /// [`FitError`] names the reason.
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
        // The standard deviation of a quantised position is at least count/√12, even where the residual happens to be
        // smaller.
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

/// Run from the end of its backlash on; earlier samples stay available for the delayed duty.
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

    /// Returns the duty in the middle of each interval between two samples of the turning motor, `delay_s` earlier;
    /// before the start of the run it is the first one.
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

/// Linear fit at a fixed lag: `output = gain (response to the duty) - sign friction (response to 1) + speed (1 -
/// e^(-t/lag)) lag + position`. Initial speed and position belong to each run, friction to the run's direction.
#[derive(Clone, Copy)]
struct Linear {
    gain: f64,
    /// Gain times the duty of friction, positive direction, then negative.
    up: f64,
    down: f64,
    /// Sum of squared residuals, and that of the output.
    left: f64,
    whole: f64,
}

impl Linear {
    /// Solves for gain and both frictions; `None` where they are not separately identifiable.
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
        // The two frictions have no common samples, so their 2 by 2 blocks are eliminated separately. One without
        // samples is 0.
        let (mut own, mut common) = (normal[0][0], right[0]);
        let mut solved = right.map(|_| 0.0);
        for index in [1, 2] {
            if normal[index][index] > 0.0 {
                own -= normal[0][index] * normal[0][index] / normal[index][index];
                common -= normal[0][index] * right[index] / normal[index][index];
            }
        }
        // The part of the response to the duty that is not collinear with friction; rounding is some nine digits below
        // it.
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

/// Returns the columns of the fit: position, response of a motor of gain 1 to the duty, and to a duty of 1. Initial
/// position and speed are projected out of each.
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

    /// Conditions of the recording besides the model.
    #[derive(Clone, Copy)]
    struct World {
        friction: Friction,
        play: f64,
        count: f64,
    }

    const SMOOTH: World = World { friction: Friction { up: 0.12, down: 0.08 }, play: 0.0, count: 1e-9 };

    /// Simulates four runs up and down with small steps, sampled every 2 ms, with duties that change at the board's
    /// rate limit.
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
            // With 2 ms between samples the delay is uncertain by up to half of that.
            assert!((found.gain / gain - 1.0).abs() < 0.02, "{model:?} {fit:?}");
            assert!((found.lag_s - lag_s).abs() < 0.04 * lag_s + 1e-3, "{model:?} {fit:?}");
            assert!((found.delay_s - delay_s).abs() < 1.5e-3, "{model:?} {fit:?}");
            assert!((fit.friction.up - 0.12).abs() < 0.01 && (fit.friction.down - 0.08).abs() < 0.01, "{fit:?}");
        }
    }

    /// With a count of 1.8 degrees and about one degree of backlash, the true lag is among the plausible models.
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
        // A negated duty makes the fitted gain negative.
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
