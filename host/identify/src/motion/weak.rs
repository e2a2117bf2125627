//! Weak form of an axis' equation of motion: the model's accelerations against the measured motion, without free-run
//! simulation.
//!
//! The error of a free-run simulation grows with whatever the model lacks, until a fit that begins far off follows
//! the wrong things. Here the motion is taken as measured, and the equation of motion `q'' = a(q, q', t)` is compared
//! over windows. Each window has a weight `w` that vanishes with its slope at both ends, so that no measurement is
//! differentiated:
//!
//! ```text
//! ∫ w'' q dt = ∫ w a dt        for a position
//! -∫ w' v dt = ∫ w a dt        for a speed
//! ```
//!
//! Noise on the motion biases such estimates a little: they are initial guesses, not results.
//!
//! # Source
//! M. Shinbrot, *On the analysis of linear and nonlinear systems*, Trans. ASME 79 (1957), 547-552 (modulating functions).

use std::{ops::Range, sync::Arc};

use nalgebra::{DMatrix, DVector};
use r4_maths::statistics::{QuantileRule, quantile};

use crate::{
    family::{self, Candidate, Model, Parameter, Simulated, Structure, Term},
    fit::{Effort, Fit, cost, fit, parameters},
    parallel,
};

use super::{
    Dynamics, Kind, Motion, MotionRun,
    effect::Effect,
    simulate::{Moved, accelerations, accelerations_each, is_placed, sensed},
    smooth::Smooth,
};

/// Half lengths of the windows, as multiples of the shortest.
const LENGTHS: [f64; 3] = [1.0, 2.5, 6.0];
/// Half length of the shortest window: the longer of this time, s, and this number of samples.
pub(super) const SHORTEST_S: f64 = 0.06;
const SHORTEST_SAMPLES: f64 = 8.0;
/// Standard errors beyond which a way back is a reversal, and a speed is not rest.
const CERTAIN: f64 = 4.0;
/// Number of windows per independent one: they overlap by half, and the longer ones repeat the shortest.
const OVERLAP: f64 = 3.0;
/// Iterations of the linear solution for the base parameters, which friction at rest makes nonlinear.
const LINES: usize = 2;
/// Number of the best starts that are fitted further.
const FURTHER: usize = 2;

/// A recording in the weak form.
#[derive(Clone, Debug)]
pub(super) struct Windows {
    /// Motion from each sample to the next.
    pub(super) moved: Vec<Moved>,
    /// Least travel distinguishable from noise, in the position's unit.
    least_travel: f64,
    pub(super) windows: Vec<Window>,
    /// Integral of the measurements in each window, in standard deviations that white noise on them gives it.
    measured: Vec<f64>,
}

#[derive(Clone, Debug)]
pub(super) struct Window {
    from: usize,
    /// Weights from each sample to the next, divided by that standard deviation.
    weights: Vec<f64>,
}

impl Window {
    pub(super) fn sum(&self, series: &[f64]) -> f64 {
        let (weights, values) = (&self.weights[..], &series[self.from..][..self.weights.len()]);
        // Four independent sums: a single one would wait for each addition.
        let mut sums = [0.0; 4];
        let whole = weights.len() - weights.len() % 4;
        for place in (0..whole).step_by(4) {
            for lane in 0..4 {
                sums[lane] += weights[place + lane] * values[place + lane];
            }
        }
        for place in whole..weights.len() {
            sums[0] += weights[place] * values[place];
        }
        (sums[0] + sums[1]) + (sums[2] + sums[3])
    }

    pub(super) fn ends_within(&self, series: &[f64]) -> bool {
        self.from + self.weights.len() <= series.len()
    }
}

/// Returns `(1 - x²)³` with its first and second derivative.
fn weight(x: f64) -> [f64; 3] {
    let inside = 1.0 - x * x;
    [inside.powi(3), -6.0 * x * inside.powi(2), inside * (30.0 * x * x - 6.0)]
}

impl Windows {
    fn of(run: &MotionRun, of_speed: bool) -> Option<Self> {
        let (time_s, measured) = (&run.all.time_s[..], &run.all.measured[..]);
        let smooth = Smooth::of(time_s, measured)?;
        let (moved, least_travel) = moved(time_s, &smooth, of_speed);
        let steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let period_s = quantile(&steps, 0.5, QuantileRule::NearestPosition).ok()?;
        let shortest_s = SHORTEST_S.max(SHORTEST_SAMPLES * period_s);
        let (first_s, last_s) = (*time_s.first()?, *time_s.last()?);
        let mut all = Self { moved, least_travel, windows: vec![], measured: vec![] };
        for half_s in LENGTHS.map(|length| length * shortest_s) {
            let mut begin_s = first_s;
            while last_s - begin_s >= 2.0 * half_s {
                let samples = inside(time_s, (begin_s, begin_s + 2.0 * half_s));
                if let Some(gap) = last_gap(time_s, begin_s, &samples, 0.5 * half_s) {
                    begin_s = time_s[gap];
                    continue;
                }
                all.push(time_s, measured, &smooth, of_speed, (begin_s + half_s, half_s), samples);
                begin_s += 0.5 * half_s;
            }
        }
        (!all.windows.is_empty()).then_some(all)
    }

    /// Returns the integral of a series (from each sample to the next) in each window.
    pub(super) fn sums<'w>(&'w self, series: &'w [f64]) -> impl Iterator<Item = f64> + 'w {
        self.windows.iter().map(|window| window.sum(series))
    }

    fn push(
        &mut self,
        time_s: &[f64],
        measured: &[f64],
        smooth: &Smooth,
        of_speed: bool,
        (at_s, half_s): (f64, f64),
        Range { start: from, end: to }: Range<usize>,
    ) {
        // The integrals of a line vanish, but its sums over uneven samples do not, so the line is subtracted.
        let slope = (smooth.value[to - 1] - smooth.value[from]) / (time_s[to - 1] - time_s[from]);
        let (mut sum, mut square) = (0.0, 0.0);
        for sample in from..to {
            let before_s = time_s[sample.saturating_sub(1).max(from)];
            let after_s = time_s[(sample + 1).min(to - 1)];
            // Trapezoidal rule for uneven samples.
            let share_s = 0.5 * (after_s - before_s);
            let [_, first, second] = weight((time_s[sample] - at_s) / half_s);
            let factor = share_s * if of_speed { -first / half_s } else { second / (half_s * half_s) };
            let line = smooth.value[from] + if of_speed { 0.0 } else { slope * (time_s[sample] - time_s[from]) };
            let value = if measured[sample].is_finite() { measured[sample] } else { smooth.value[sample] };
            sum += factor * (value - line);
            square += factor * factor;
        }
        let weights = (from..to - 1).map(|sample| {
            let middle_s = 0.5 * (time_s[sample] + time_s[sample + 1]);
            weight((middle_s - at_s) / half_s)[0] * (time_s[sample + 1] - time_s[sample]) / square.sqrt()
        });
        self.windows.push(Window { from, weights: weights.collect() });
        self.measured.push(sum / square.sqrt());
    }
}

/// Returns a recording as a centred sensor would have made it; `None` if the eccentric sensor went backwards.
fn centred(run: &MotionRun, amplitude_rad: f64, phase_rad: f64) -> Option<MotionRun> {
    /// At an amplitude of 1 the reading stands still once a turn, and beyond it goes backwards.
    const LARGEST_RAD: f64 = 0.9;
    if amplitude_rad.is_nan() || amplitude_rad.abs() > LARGEST_RAD {
        return None;
    }
    let angle_rad = |measured_rad: &f64| centred_rad(*measured_rad, amplitude_rad, phase_rad);
    Some(run.measuring(run.all.measured.iter().map(angle_rad).collect()))
}

/// Returns the angle, rad, at which a sensor with this eccentricity reads `measured_rad`: by Newton's method, to
/// rounding for amplitudes up to 0.9.
fn centred_rad(measured_rad: f64, amplitude_rad: f64, phase_rad: f64) -> f64 {
    let mut angle_rad = measured_rad;
    for _ in 0..8 {
        let (sin, cos) = (angle_rad + phase_rad).sin_cos();
        angle_rad -= (angle_rad + amplitude_rad * sin - measured_rad) / (1.0 + amplitude_rad * cos);
    }
    angle_rad
}

/// Returns the samples between two times.
fn inside(time_s: &[f64], (from_s, to_s): (f64, f64)) -> Range<usize> {
    time_s.partition_point(|&time_s| time_s < from_s)..time_s.partition_point(|&time_s| time_s <= to_s)
}

/// Returns the sample behind the last gap longer than `longest_s` that a window reaches into.
fn last_gap(time_s: &[f64], begin_s: f64, samples: &Range<usize>, longest_s: f64) -> Option<usize> {
    let begins_there = time_s.get(samples.start) == Some(&begin_s);
    let first = if begins_there { samples.start + 1 } else { samples.start.max(1) };
    (first..(samples.end + 1).min(time_s.len())).rfind(|&sample| time_s[sample] - time_s[sample - 1] > longest_s)
}

/// Returns the motion between samples with its reversals, and [`Windows::least_travel`].
fn moved(time_s: &[f64], smooth: &Smooth, of_speed: bool) -> (Vec<Moved>, f64) {
    let (position, speed, [position_noise, rest]) = if of_speed {
        let mut position = vec![0.0; time_s.len()];
        for sample in 1..time_s.len() {
            let mean = 0.5 * (smooth.value[sample - 1] + smooth.value[sample]);
            position[sample] = position[sample - 1] + mean * (time_s[sample] - time_s[sample - 1]);
        }
        let step_s = (time_s[time_s.len() - 1] - time_s[0]) / time_s.len() as f64;
        (position, &smooth.value, [smooth.noise[0] * step_s, smooth.noise[0]])
    } else {
        (smooth.value.clone(), &smooth.slope, smooth.noise)
    };
    let least_travel = CERTAIN * position_noise;
    let turned = turns(&position, least_travel);
    let moved = (1..time_s.len())
        .map(|sample| {
            let middle = |values: &[f64]| 0.5 * (values[sample - 1] + values[sample]);
            let Turn { direction, reversal, sample: turned_at } = turned[sample - 1];
            let speed = middle(speed);
            Moved {
                position: middle(&position),
                speed,
                rests: speed.abs() < CERTAIN * rest,
                direction,
                reversal,
                turned_s: turned_at.map_or(f64::NEG_INFINITY, |sample| time_s[sample]),
            }
        })
        .collect();
    (moved, least_travel)
}

/// Last reversal of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Turn {
    /// Direction of motion since the reversal; 0 before the first motion.
    direction: f64,
    /// Position of the reversal.
    reversal: f64,
    /// Sample of the reversal; `None` for the begin of the first motion.
    sample: Option<usize>,
}

/// Returns the last reversal at each sample; a way back shorter than `certain` does not count.
fn turns(position: &[f64], certain: f64) -> Vec<Turn> {
    let first = position.first().copied().unwrap_or(0.0);
    let mut turned = Vec::with_capacity(position.len());
    let mut turn = Turn { direction: 0.0, reversal: first, sample: None };
    let (mut direction, mut extreme) = (0.0, 0);
    for sample in 1..position.len() {
        let ahead = position[sample] - position[extreme];
        if ahead * direction > 0.0 {
            extreme = sample;
        } else if ahead.abs() > certain {
            // The axis reversed at the extreme, which is known only now; if it rested there, at its arrival.
            let held = (0..extreme).rev().take_while(|&at| (position[at] - position[extreme]).abs() < 0.5 * certain);
            let came = held.last().unwrap_or(extreme);
            let sample_turned = (direction != 0.0).then_some(came);
            direction = ahead.signum();
            turned.resize(sample_turned.unwrap_or(extreme), turn);
            turn = Turn { direction, reversal: position[extreme], sample: sample_turned };
            extreme = sample;
        }
    }
    turned.resize(position.len(), turn);
    turned
}

/// A recording with its windows.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) run: MotionRun,
    pub(super) windows: Arc<Windows>,
    /// Offset of its initial position from the recorded one, under the current model.
    began: f64,
}

/// Model of an axis whose output is the integrals over windows.
pub(super) struct Weak<'m> {
    motion: &'m Motion,
    began: Began,
}

/// Model that was fitted in the weak form.
pub(super) struct Rest<'m> {
    pub(super) weak: Weak<'m>,
    pub(super) fit: Fit,
    pub(super) seen: Vec<Seen>,
    /// Residual of each window of each recording.
    pub(super) left: Vec<Vec<f64>>,
}

/// Initial position of recordings in which it is not recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Began {
    /// The initial position is recorded or irrelevant.
    Anywhere,
    /// The initial position is known from the model to which terms are added.
    There,
    /// That model does not depend on the position, so it is searched for.
    Somewhere,
}

impl Model for Weak<'_> {
    type Run = Seen;

    fn base(&self) -> &[Parameter] {
        self.motion.base()
    }

    fn catalogue(&self) -> &[Candidate] {
        self.motion.catalogue()
    }

    fn initial(&self, _: &Seen) -> (Vec<f64>, Vec<f64>) {
        if self.began == Began::Anywhere { (vec![], vec![]) } else { (vec![0.0], vec![1.0]) }
    }

    fn predict(&self, structure: &Structure, initial: &[f64], seen: &Seen, predicted: &mut [f64]) {
        let accelerations = seen.accelerations(self.motion, structure, initial);
        for (predicted, sum) in predicted.iter_mut().zip(seen.windows.sums(&accelerations)) {
            *predicted = sum;
        }
    }

    fn predict_each(
        &self,
        known: &Simulated<'_>,
        others: &[(&Structure, &[f64])],
        seen: &Seen,
        told: &mut dyn FnMut(usize, &[f64]),
    ) {
        let true_stamps = |structure: &Structure| self.motion.with_true_stamps(structure.clone());
        let structures: Vec<Structure> = others.iter().map(|(structure, _)| true_stamps(structure)).collect();
        let offsets = others.iter().map(|(_, initial)| initial.first().copied().unwrap_or(0.0));
        let others: Vec<(&Structure, f64)> = structures.iter().zip(offsets).collect();
        let (known_structure, steps) = (true_stamps(known.structure), &seen.windows.moved[..]);
        let known = (&known_structure, known.initial.first().copied().unwrap_or(0.0));
        accelerations_each(self.motion, known, &others, &seen.run, steps, &mut |index, accelerations| {
            told(index, &seen.windows.sums(accelerations).collect::<Vec<_>>());
        });
    }

    fn measured<'r>(&self, seen: &'r Seen) -> &'r [f64] {
        &seen.windows.measured
    }

    fn noise(&self, seen: &Seen) -> f64 {
        seen.run.all.noise
    }
}

impl Motion {
    /// Returns true if the windows can see the motion of a structure that adds to `current`: only the model's forces cause it, and any effect
    /// between the motion and the recording is in `current` too, whose free run gives its contribution.
    fn is_seen(&self, structure: &Structure, current: &Fit) -> bool {
        let has = |structure: &Structure, index: usize| structure.of(index).is_some();
        self.stops.is_none() && !self.behind().any(|index| has(structure, index) && !has(&current.structure, index))
    }

    /// Returns true if the recorded output of a model is not the motion itself.
    pub(super) fn hides_motion(&self, structure: &Structure) -> bool {
        self.behind().any(|index| structure.of(index).is_some())
    }

    /// Indices of the effects between the motion and the recording.
    fn behind(&self) -> impl Iterator<Item = usize> + '_ {
        const BEHIND: [Effect; 6] = [
            Effect::Backlash,
            Effect::Compliance,
            Effect::SensorLag,
            Effect::SensorHold,
            Effect::EncoderScale,
            Effect::EncoderOffset,
        ];
        BEHIND.into_iter().filter_map(|effect| self.index(effect))
    }

    /// Returns the recordings that runs are parts of, without the contributions of `current` between the motion and the recording, and
    /// without a sensor's eccentricity as in `structure`.
    fn seen(&self, structure: &Structure, current: &Fit, runs: &[&MotionRun]) -> Option<Vec<Seen>> {
        let eccentricity = self.index(Effect::Eccentricity).and_then(|index| structure.of(index));
        let mut recordings: Vec<(&MotionRun, &Vec<f64>)> = Vec::new();
        for (run, initial) in runs.iter().zip(&current.initial) {
            if !recordings.iter().any(|(other, _)| Arc::ptr_eq(&other.all, &run.all)) {
                recordings.push((run, initial));
            }
        }
        let hides_motion = self.hides_motion(&current.structure);
        let seen = |(run, initial): &(&MotionRun, &Vec<f64>)| {
            let uncovered = hides_motion.then(|| self.uncovered(run, current, runs));
            let run = uncovered.as_ref().unwrap_or(run);
            let centred = match eccentricity {
                Some(&[amplitude_rad, phase_rad]) => Some(centred(run, amplitude_rad, phase_rad)?),
                _ => None,
            };
            let run = centred.as_ref().unwrap_or(run);
            let windows = self.windows(run)?.clone();
            let began = if self.of_speed { initial.first()? - windows.moved.get(run.from)?.position } else { 0.0 };
            let run = MotionRun { from: 0, to: run.all.time_s.len(), ..(*run).clone() };
            Some(Seen { run, windows, began })
        };
        recordings.iter().map(seen).collect()
    }

    /// Returns a recording without the contribution of a model's backlash, compliance, lag or hold in its free runs, which cover the recording
    /// or parts of it. To first order that is right even where a free run has diverged, because it depends on the velocity, not on the position.
    fn uncovered(&self, run: &MotionRun, current: &Fit, runs: &[&MotionRun]) -> MotionRun {
        let mut measured = run.all.measured.clone();
        for (part, initial) in runs.iter().zip(&current.initial).filter(|(part, _)| Arc::ptr_eq(&part.all, &run.all)) {
            let added = sensed(self, &current.structure, initial, part);
            for (value, added) in measured[part.from..part.to].iter_mut().zip(added) {
                *value -= if added.is_finite() { added } else { 0.0 };
            }
        }
        run.measuring(measured)
    }

    /// Of all of the recording that a run is a part of.
    fn windows<'r>(&self, run: &'r MotionRun) -> Option<&'r Arc<Windows>> {
        let windows = run.all.windows.get_or_init(|| Windows::of(run, self.of_speed).map(Arc::new));
        windows.as_ref()
    }

    /// Returns the least travel in a recording distinguishable from noise, in the position's unit; 0 if it is too
    /// short for windows.
    pub(super) fn least_travel(&self, run: &MotionRun) -> f64 {
        self.windows(run).map_or(0.0, |windows| windows.least_travel)
    }

    /// Returns the motion of a recording before a run that is a part of it; `None` if it has no windows.
    pub(super) fn moved_before<'r>(&self, run: &'r MotionRun) -> Option<&'r [Moved]> {
        self.windows(run)?.moved.get(..=run.from)
    }

    /// Returns the measured motion of recordings with its times; `None` if a model hides it.
    pub(super) fn moved(&self, current: &Fit, runs: &[&MotionRun]) -> Option<Vec<(Moved, f64)>> {
        let seen = self.shows_curves(current).then(|| self.seen(&current.structure, current, runs))??;
        let timed = |seen: Seen| -> Vec<(Moved, f64)> {
            let there = |moved: &Moved| Moved {
                position: moved.position + seen.began,
                reversal: moved.reversal + seen.began,
                ..*moved
            };
            seen.windows.moved.iter().map(there).zip(seen.run.all.time_s.iter().copied()).collect()
        };
        Some(seen.into_iter().flat_map(timed).collect())
    }

    /// Returns true if windows can place the knots of curves. A free run's estimate of the motion behind a gap or a lag is too rough for that.
    pub(super) fn shows_curves(&self, current: &Fit) -> bool {
        self.stops.is_none() && !self.hides_motion(&current.structure)
    }

    /// How many windows say as much as all that there are: of those that overlap, one.
    pub(super) fn independent_windows(&self, current: &Fit, runs: &[&MotionRun]) -> Option<f64> {
        let all: usize =
            self.seen(&current.structure, current, runs)?.iter().map(|seen| seen.windows.windows.len()).sum();
        Some((all as f64 / OVERLAP).max(2.0))
    }

    /// Returns a structure from which a fit with one more term can start. A damping that a fit drove to a limit is
    /// set to a visible value: from nearly 0, or from more than a sample shows, the gradient vanishes. Errors of the
    /// stamps that absorbed what was missing are set to 0.
    pub(super) fn movable(&self, structure: Structure) -> Structure {
        let mut structure = self.with_true_stamps(structure);
        let (base, longest_s) = (&mut structure.base, self.scales.duration_s);
        if self.kind == Kind::Axis {
            base[1] = base[1].max(base[0] / longest_s);
        } else if base[1] > longest_s {
            base[0] *= longest_s / base[1];
            base[1] = longest_s;
        } else {
            base[1] = base[1].max(self.scales.period_s);
        }
        structure
    }

    /// Returns the weak form for structures of the same terms that extend `current`, and the recordings; `None` if
    /// the motion is not visible.
    fn weak(&self, structure: &Structure, current: &Fit, runs: &[&MotionRun]) -> Option<(Weak<'_>, Vec<Seen>)> {
        let seen = self.is_seen(structure, current).then(|| self.seen(structure, current, runs))??;
        let began = if !self.of_speed || !is_placed(self, structure) {
            Began::Anywhere
        } else if is_placed(self, &current.structure) {
            Began::There
        } else {
            Began::Somewhere
        };
        Some((Weak { motion: self, began }, seen))
    }

    /// Returns the approximate cost in windows of a structure that extends `current`.
    pub(super) fn left_over_windows(&self, structure: Structure, current: &Fit, runs: &[&MotionRun]) -> Option<f64> {
        let (weak, seen) = self.shows_curves(current).then(|| self.weak(&structure, current, runs))??;
        Some(weak.best(vec![self.movable(structure)], &seen, Effort::SCREEN, 1).pop()?.cost)
    }

    /// Fits a model in windows, and returns it with the residual of each.
    pub(super) fn left_in_windows(&self, current: &Fit, runs: &[&MotionRun]) -> Option<Rest<'_>> {
        let (weak, seen) = self.weak(&current.structure, current, runs)?;
        let structure = self.movable(current.structure.clone());
        let fit = weak.best(vec![structure], &seen, Effort::SCREEN, 1).pop()?;
        let left = fit.residuals(&weak, &seen.iter().collect::<Vec<_>>());
        Some(Rest { weak, fit, seen, left })
    }

    /// Returns the best structure whose last term is an eccentricity, from the given ones and a pattern search around
    /// them, with its cost. Each has windows of its own, in which amplitude and phase are fixed.
    fn by_eccentricity(&self, starts: Vec<Structure>, current: &Fit, runs: &[&MotionRun]) -> Option<(Structure, f64)> {
        /// First steps of amplitude and phase, rad; halved when no neighbour is better.
        const FIRST_STEPS_RAD: [f64; 2] = [0.08, 0.4];
        const ROUNDS: usize = 10;
        let guess = |mut start: Structure| {
            let (weak, seen) = self.weak(&start, current, runs)?;
            let fixed = (start.terms.pop()?, start.added.pop()?);
            let mut fit = weak.best(vec![self.movable(start)], &seen, Effort::GLANCE, 1).pop()?;
            fit.structure.terms.push(fixed.0);
            fit.structure.added.push(fixed.1);
            Some((fit.structure, fit.cost))
        };
        let best =
            |all: Vec<Structure>| parallel::filter_map(all, guess).into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let mut found = best(starts)?;
        let mut steps_rad = FIRST_STEPS_RAD;
        for _ in 0..ROUNDS {
            let beside = [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]].map(|signs| {
                let mut other = found.0.clone();
                let numbers = other.added.iter_mut().next_back().into_iter().flatten();
                numbers.zip(signs).zip(steps_rad).for_each(|((number, sign), step_rad)| *number += sign * step_rad);
                other
            });
            if let Some(better) = best(beside.to_vec()).filter(|better| better.1 < found.1) {
                found = better;
            } else {
                steps_rad = steps_rad.map(|step_rad| 0.5 * step_rad);
            }
        }
        Some(found)
    }

    /// Returns the best of some structures of the same terms, fitted in windows, and its cost.
    pub(super) fn weakly(
        &self,
        starts: Vec<Structure>,
        current: &Fit,
        runs: &[&MotionRun],
        effort: Effort,
    ) -> Option<(Structure, f64)> {
        let eccentric = self.index(Effect::Eccentricity).map(Term::Known);
        if eccentric.is_some() && starts.first()?.terms.last() == eccentric.as_ref() {
            return self.by_eccentricity(starts, current, runs);
        }
        if matches!(starts.first()?.terms.last(), Some(Term::Curve(_))) && !self.shows_curves(current) {
            return None;
        }
        let (weak, seen) = self.weak(starts.first()?, current, runs)?;
        let is_coarse = |start: &Structure| {
            let last = parameters(&weak, &start.terms).pop();
            last.is_some_and(|parameter| matches!(parameter.range, family::Range::Coarse { .. }))
        };
        // A small number of starts are guesses already, to which terms may have been added that `current` lacks.
        let is_new = starts.len() > FURTHER;
        if is_new && starts.first().is_some_and(is_coarse) {
            return self.by_periods(&starts, &self.left_in_windows(current, runs)?);
        }
        let last = starts.first().and_then(|start| start.terms.last()).cloned();
        let waving = last.and_then(|term| Some((self.waving(&term)?, term))).filter(|_| is_new);
        let waves = match waving {
            Some((effect, term)) => self.by_waves(&term, effect, &self.left_in_windows(current, runs)?),
            None => vec![],
        };
        let starts = if waves.is_empty() { starts } else { waves };
        let starts = starts.into_iter().map(|start| self.movable(start)).collect();
        let glanced = weak.best(starts, &seen, Effort::GLANCE, FURTHER);
        let best = if effort.evaluations > Effort::GLANCE.evaluations {
            weak.best(glanced.into_iter().map(|fit| fit.structure).collect(), &seen, effort, 1).pop()?
        } else {
            glanced.into_iter().next()?
        };
        Some((best.structure, best.cost))
    }
}

impl Weak<'_> {
    /// Fits some structures and returns the best `count`, best first.
    fn best(&self, starts: Vec<Structure>, seen: &[Seen], effort: Effort, count: usize) -> Vec<Fit> {
        let seen: Vec<&Seen> = seen.iter().collect();
        let fitted = |structure| {
            let (structure, initial) = self.begun(self.with_base(structure, &seen), &seen, effort);
            fit(self, &seen, structure, initial, effort)
        };
        let mut fits: Vec<Fit> = starts.into_iter().map(fitted).filter(|fit| fit.cost.is_finite()).collect();
        fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        fits.truncate(count);
        fits
    }

    /// Returns the structure with the push per volt and the damping that fit the windows best, which depend on both
    /// linearly: a fit may not return from a base that was biased to compensate for a missing effect.
    fn with_base(&self, mut structure: Structure, seen: &[&Seen]) -> Structure {
        if self.motion.is_servo() || self.began != Began::Anywhere {
            return structure;
        }
        let predicted = |structure: &Structure| -> Vec<f64> {
            seen.iter()
                .flat_map(|seen| {
                    seen.windows.sums(&seen.accelerations(self.motion, structure, &[])).collect::<Vec<_>>()
                })
                .collect()
        };
        let measured = seen.iter().flat_map(|seen| seen.windows.measured.iter().copied());
        let measured = DVector::from_vec(measured.collect());
        let mut left = &measured - DVector::from_vec(predicted(&structure));
        for _ in 0..LINES {
            let Dynamics { k, b, .. } = self.motion.dynamics(&structure.base);
            let with = |k: f64, b: f64| self.motion.with_dynamics(structure.clone(), k, b);
            let slope = |structure: &Structure| &measured - &left - DVector::from_vec(predicted(structure));
            let columns = [with(2.0 * k, b), with(k, 2.0 * b)].map(|other| -slope(&other));
            let Ok(change) = DMatrix::from_columns(&columns).svd(true, true).solve(&left, 1e-9) else { break };
            let [k, b] = [k * (1.0 + change[0]), b * (1.0 + change[1])];
            if !(k > 0.0 && b.is_finite()) {
                break;
            }
            let other = with(k, b.max(1.0 / self.motion.scales.duration_s));
            let left_by_other = &measured - DVector::from_vec(predicted(&other));
            if left_by_other.norm_squared().is_nan() || left_by_other.norm_squared() >= left.norm_squared() {
                break;
            }
            (structure, left) = (other, left_by_other);
        }
        structure
    }

    /// Returns initial positions of the recordings; if they are searched for, the first is 0, and the fit to it gives
    /// the others.
    fn begun(&self, structure: Structure, seen: &[&Seen], effort: Effort) -> (Structure, Vec<Vec<f64>>) {
        let [first, others @ ..] = seen else { return (structure, vec![]) };
        match self.began {
            Began::Anywhere => return (structure, vec![vec![]; seen.len()]),
            Began::There => return (structure, seen.iter().map(|seen| vec![seen.began]).collect()),
            Began::Somewhere => {}
        }
        let structure = fit(self, &[first], structure, vec![vec![0.0]], effort).structure;
        let best = |seen: &&Seen| {
            let left = |place: f64| cost(self, &[seen], &structure, &[vec![place]]);
            let best = self.motion.places().map(|place| (left(place), place)).min_by(|a, b| a.0.total_cmp(&b.0));
            vec![best.map_or(0.0, |best| best.1)]
        };
        let initial = std::iter::once(vec![0.0]).chain(others.iter().map(best)).collect();
        (structure, initial)
    }
}

impl Seen {
    /// Returns the model's accelerations from each sample to the next; `initial` is empty, or the initial position.
    pub(super) fn accelerations(&self, motion: &Motion, structure: &Structure, initial: &[f64]) -> Vec<f64> {
        self.accelerations_until(f64::INFINITY, motion, structure, initial)
    }

    /// Returns the accelerations up to a time, s since the slots of a held value began.
    pub(super) fn accelerations_until(
        &self,
        until_s: f64,
        motion: &Motion,
        structure: &Structure,
        initial: &[f64],
    ) -> Vec<f64> {
        // Windows hardly depend on the stamps: noise on the motion would drive their error to the end of its range.
        let structure = &motion.with_true_stamps(structure.clone());
        let offset = initial.first().copied().unwrap_or(0.0);
        let all = &self.run.all;
        let steps = all.time_s.partition_point(|&time_s| all.slots_s + time_s <= until_s).min(self.windows.moved.len());
        accelerations(motion, structure, &self.run, (&self.windows.moved[..steps], offset))
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::data::{Quantity, Run, Signal};

    #[test]
    fn an_eccentric_sensor_is_read_back_at_every_angle_and_phase() {
        for amplitude_rad in [-0.9_f64, 0.05, 0.5, 0.9] {
            for place in 0..200_u32 * 60 {
                let (phase_rad, angle_rad) = (f64::from(place / 60) * TAU / 200.0, f64::from(place % 60) * TAU / 60.0);
                let measured_rad = angle_rad + amplitude_rad * (angle_rad + phase_rad).sin();
                let off_rad = centred_rad(measured_rad, amplitude_rad, phase_rad) - angle_rad;
                // Rounding of the angle, over the smallest slope of 0.1.
                assert!(off_rad.abs() < 1e-13, "{amplitude_rad} rad, {phase_rad} rad at {angle_rad} rad: {off_rad}");
            }
        }
    }

    #[test]
    fn a_turn_is_where_and_when_the_way_back_began() {
        // Forward, a rest at 3, back to -1, with steps of noise that are no reversals.
        let position = [0.0, 1.0, 2.0, 1.9, 3.0, 3.02, 2.98, 3.0, 2.0, 1.0, 1.05, 0.0, -1.0];
        let turned = turns(&position, 0.2);
        assert_eq!(turned[0], Turn { direction: 1.0, reversal: 0.0, sample: None });
        assert_eq!(turned[3], turned[0], "back by less than is certain");
        let back = Turn { direction: -1.0, reversal: 3.02, sample: Some(4) };
        assert!(turned[4..].iter().all(|turn| *turn == back), "{turned:?}");
    }

    #[test]
    fn no_window_reaches_over_a_gap() {
        // 200 Hz with two pauses, which may be very long; one is right behind the first sample.
        for gap_s in [0.2, 5.0, 1e9] {
            let paused_s = |n: u32| gap_s * f64::from(u8::from(n >= 1) + u8::from(n >= 401));
            let time_s: Vec<f64> = (0..801).map(|n| 0.005 * f64::from(n) + paused_s(n)).collect();
            let value = |n: u32| (0.05 * f64::from(n)).sin() + 1e-3 * f64::from(n * n % 7);
            let columns = [("input", Quantity::Number), ("output", Quantity::Angle)].map(|(name, quantity)| {
                let values = (0..801).map(value).collect();
                (name.to_owned(), Signal { quantity, values, column: name.to_owned() })
            });
            let run = Run { name: "paused".to_owned(), time_s, origin_s: None, signals: columns.into() };
            let run = MotionRun::new(&run, 12.0).expect("its columns");
            let windows = Windows::of(&run, false).expect("windows on both sides");
            let (before, after): (Vec<_>, Vec<_>) = windows.windows.iter().partition(|window| window.from < 401);
            let inside = |window: &&Window| window.from > 0 && window.from + window.weights.len() < 401;
            assert!(before.iter().all(inside), "{gap_s}");
            assert_eq!(before.len(), after.len(), "{gap_s}");
        }
    }

    #[test]
    fn windows_vanish_with_their_slope_and_bend_by_their_derivative() {
        for side in [-1.0, 1.0] {
            assert_eq!(weight(side), [0.0; 3]);
        }
        for x in [-0.7, 0.0, 0.3, 0.9] {
            let (step, [value, slope, bend]) = (1e-5, weight(x));
            let [before, after] = [-step, step].map(|off| weight(x + off));
            assert!(((after[0] - before[0]) / (2.0 * step) - slope).abs() < 1e-8, "{x}: {value}");
            assert!(((after[1] - before[1]) / (2.0 * step) - bend).abs() < 1e-8, "{x}");
        }
    }
}
