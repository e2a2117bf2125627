//! How far two runs are apart.

use r4_maths::statistics::{QuantileRule, RootMeanSquare, quantile};

use crate::{Kind, Log, Signal, Value};

/// How a signal differs between two logs, seen from both: each sample of one is compared with what the other has at that
/// moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// Of the [`Signal`].
    pub name: String,
    /// How many samples each log has.
    pub samples: [usize; 2],
    /// Samples of each for which the other has nothing: it was not recorded then, or never.
    pub one_sided: [usize; 2],
    /// Samples of both that were compared.
    pub compared: usize,
    /// Largest difference of numbers, in the signal's unit; `None` for words, and where nothing was compared.
    pub max: Option<f64>,
    /// Root mean square of the differences of numbers.
    pub rms: Option<f64>,
    /// Compared samples that are not the same, to the last bit.
    pub unequal: usize,
}

impl Difference {
    /// Both logs have the same samples at the same moments, to the last bit.
    #[must_use]
    pub fn is_identical(&self) -> bool {
        self.one_sided == [0, 0] && self.unequal == 0
    }
}

/// A gap is no longer than so many of the signal's usual periods.
const GAP_PERIODS: f64 = 2.5;
/// Moments closer than this are one: half of what a board's clock counts, s.
const SAME_S: f64 = 0.5e-6;

/// Compares every signal that either log has. `shift_s` is added to the times of `b`.
///
/// Between samples a continuous signal of the other log is taken to go straight from one to the next, and any other to be
/// either; where its samples are farther apart than usual it has nothing. Events are compared in their order, whenever
/// they were.
#[must_use]
pub fn compare(a: &Log, b: &Log, shift_s: f64) -> Vec<Difference> {
    let (a, mut b) = (a.signals(), b.signals());
    if shift_s != 0.0 {
        b.iter_mut().flat_map(|signal| &mut signal.samples).for_each(|sample| sample.0 += shift_s);
    }
    let of = |signals: &[Signal], name: &str| signals.iter().find(|signal| signal.name == name).cloned();
    let mut all: Vec<Difference> =
        a.iter().map(|signal| difference(Some(signal), of(&b, &signal.name).as_ref(), &signal.name)).collect();
    let only_b = b.iter().filter(|signal| of(&a, &signal.name).is_none());
    all.extend(only_b.map(|signal| difference(None, Some(signal), &signal.name)));
    all
}

/// What comes of comparing samples.
#[derive(Default)]
struct Tally {
    compared: usize,
    unequal: usize,
    numbers: RootMeanSquare,
    max: f64,
}

impl Tally {
    /// Takes the difference of two numbers, if they are any, and whether they are the same.
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

/// Compares each sample of `signal` with what `other` has then; returns for how many that is nothing.
fn one_way(signal: &Signal, other: &Signal, tally: &mut Tally) -> usize {
    let longest_s = if other.kind == Kind::Changes { f64::INFINITY } else { GAP_PERIODS * usual_period_s(other) };
    let mut one_sided = 0;
    let mut after = 0;
    for (time_s, value) in &signal.samples {
        // The first at or after this moment.
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

/// The difference of two numbers.
fn apart(a: &Value, b: &Value) -> Option<f64> {
    a.number().zip(b.number()).map(|(a, b)| a - b)
}

/// The median time between samples.
fn usual_period_s(signal: &Signal) -> f64 {
    let periods: Vec<f64> = signal.samples.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    // One of the periods, not the mean of two: a signal that changes its rate halfway has one of both.
    quantile(&periods, 0.5, QuantileRule::NearestPosition).unwrap_or_default()
}
