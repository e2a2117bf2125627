//! Comparison of two runs, signal by signal.

use r4_maths::statistics::{QuantileRule, RootMeanSquare, quantile};

use crate::{Kind, Log, Signal, Value};

/// Difference of one signal between two logs, from both sides: each sample of one is compared with the value of the
/// other at that time.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Name of the [`Signal`].
    pub name: String,
    /// Number of samples in each log.
    pub samples: [usize; 2],
    /// Samples of each log for which the other has no value at that time.
    pub one_sided: [usize; 2],
    /// Number of comparisons, of the samples of both logs.
    pub compared: usize,
    /// Largest absolute difference of numbers, in the signal's unit; `None` for text, and if nothing was compared.
    pub max: Option<f64>,
    /// Root mean square of the differences of numbers; `None` where `max` is.
    pub rms: Option<f64>,
    /// Number of compared samples that are not bit-identical.
    pub unequal: usize,
}

impl Difference {
    /// Returns whether both logs have the same samples at the same times, to the last bit.
    #[must_use]
    pub fn is_identical(&self) -> bool {
        self.one_sided == [0, 0] && self.unequal == 0
    }
}

/// Longest time between two samples that still counts as continuous, in median periods of the signal.
const GAP_PERIODS: f64 = 2.5;
/// Times closer than this are equal, s: half of what a board's clock counts.
const SAME_S: f64 = 0.5e-6;

/// Compares every signal that either log has. `shift_s` is added to the times of `b`.
///
/// Between two samples, a continuous signal of the other log is interpolated linearly, and any other signal may have
/// either value; where its samples are farther apart than usual it has none. Events are compared in their order,
/// whatever their times.
#[must_use]
pub fn compare(a: &Log, b: &Log, shift_s: f64) -> Vec<Difference> {
    let (a, mut b) = (a.signals(), b.signals());
    if shift_s != 0.0 {
        b.iter_mut().flat_map(|signal| &mut signal.samples).for_each(|sample| sample.0 += shift_s);
    }
    let of = |signals: &[Signal], name: &str| signals.iter().find(|signal| signal.name == name).cloned();
    let mut all: Vec<Difference> =
        a.iter().map(|signal| difference(Some(signal), of(&b, &signal.name).as_ref(), &signal.name)).collect();
    // Signals of both are in the order of `a`, those of `b` alone follow.
    let only_b = b.iter().filter(|signal| of(&a, &signal.name).is_none());
    all.extend(only_b.map(|signal| difference(None, Some(signal), &signal.name)));
    all
}

/// Counters of a comparison.
#[derive(Default)]
struct Tally {
    compared: usize,
    unequal: usize,
    numbers: RootMeanSquare,
    max: f64,
}

impl Tally {
    /// Counts one comparison: the difference of the numbers, if they are numbers, and whether the values are
    /// identical.
    fn take(&mut self, difference: Option<f64>, equal: bool) {
        self.compared += 1;
        self.unequal += usize::from(!equal);
        if let Some(difference) = difference {
            self.numbers.push(difference);
            self.max = self.max.max(difference.abs());
        }
    }
}

fn difference(a: Option<&Signal>, b: Option<&Signal>, name: &str) -> Difference {
    let samples = [a, b].map(|signal| signal.map_or(0, |signal| signal.samples.len()));
    let mut tally = Tally::default();
    let one_sided = match (a, b) {
        (Some(a), Some(b)) if a.kind == Kind::Event => {
            for ((_, a), (_, b)) in a.samples.iter().zip(&b.samples) {
                tally.take(apart(a, b), a == b);
            }
            [samples[0].saturating_sub(samples[1]), samples[1].saturating_sub(samples[0])]
        }
        (Some(a), Some(b)) => [one_way(a, b, &mut tally), one_way(b, a, &mut tally)],
        _ => samples,
    };
    let rms = tally.numbers.value();
    Difference {
        name: name.to_owned(),
        samples,
        one_sided,
        compared: tally.compared,
        max: rms.map(|_| tally.max),
        rms,
        unequal: tally.unequal,
    }
}

/// Compares each sample of `signal` with the value of `other` at that time. Returns the number of samples for which
/// `other` has none.
fn one_way(signal: &Signal, other: &Signal, tally: &mut Tally) -> usize {
    let longest_s = if other.kind == Kind::Changes { f64::INFINITY } else { GAP_PERIODS * usual_period_s(other) };
    let mut one_sided = 0;
    let mut after = 0;
    for (time_s, value) in &signal.samples {
        // Index of the other's first sample at or after this time.
        while other.samples.get(after).is_some_and(|sample| sample.0 < time_s - SAME_S) {
            after += 1;
        }
        let (next, before) = (other.samples.get(after), after.checked_sub(1).and_then(|at| other.samples.get(at)));
        match (before, next) {
            (_, Some((at_s, same))) if (at_s - time_s).abs() <= SAME_S => tally.take(apart(value, same), value == same),
            (Some((_, held)), _) if other.kind == Kind::Changes => tally.take(apart(value, held), value == held),
            (Some((from_s, from)), Some((to_s, to))) if to_s - from_s <= longest_s => match other.kind {
                Kind::Continuous => {
                    let share = (time_s - from_s) / (to_s - from_s);
                    let numbers = value.number().zip(from.number().zip(to.number()));
                    let difference = numbers.map(|(value, (from, to))| value - (from + share * (to - from)));
                    tally.take(difference, difference == Some(0.0));
                }
                // The time of the step between the two samples is unknown, so either value is right.
                Kind::Held | Kind::Changes | Kind::Event => {
                    let nearer = [from, to].map(|neighbour| apart(value, neighbour));
                    let nearest = nearer.into_iter().flatten().min_by(|a, b| a.abs().total_cmp(&b.abs()));
                    tally.take(nearest, value == from || value == to);
                }
            },
            _ => one_sided += 1,
        }
    }
    one_sided
}

/// Returns the difference of two numbers; `None` if either is text.
fn apart(a: &Value, b: &Value) -> Option<f64> {
    a.number().zip(b.number()).map(|(a, b)| a - b)
}

/// Returns the median time between samples, s; 0 for a single one.
fn usual_period_s(signal: &Signal) -> f64 {
    let periods: Vec<f64> = signal.samples.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    // A measured period rather than the mean of two: a signal that changes its rate halfway has no period in between.
    quantile(&periods, 0.5, QuantileRule::NearestPosition).unwrap_or_default()
}
