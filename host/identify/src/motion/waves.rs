//! Search for the number of waves of a push or a friction over position, by the residual of the weak form that each
//! explains.

use std::f64::consts::TAU;

use nalgebra::{DMatrix, DVector};

use crate::family::{Structure, Term};

use super::{
    Motion,
    effect::Effect,
    weak::{Rest, Seen},
};

/// Number of waves from which fits begin, no two nearer than the motion can resolve.
const OFFERED: usize = 2;
/// Largest number of waves that are tried, evenly spaced.
const MOST: f64 = 256.0;
/// Number of waves tried within the resolution of the motion, which is one period more over the whole travel.
const STEPS: f64 = 4.0;
/// Largest number of periods in a turn, and over the travel of a linear axis.
const MOST_PER_TURN: f64 = 16.0;
const MOST_PER_WAY: f64 = 16.0;
/// Smallest number of periods over the travel: fewer are a slope.
const FEWEST: f64 = 0.5;

/// Returns the smallest and largest number of periods per turn or metre.
pub(super) fn within(rotary: bool, distance: f64) -> [f64; 2] {
    if rotary {
        let fewest = FEWEST * TAU / distance;
        [fewest, MOST_PER_TURN.max(2.0 * fewest)]
    } else {
        [FEWEST / distance, MOST_PER_WAY / distance]
    }
}

/// Reduction of the sum of squares by a wave, with its amplitude and phase.
#[derive(Clone, Copy, Debug)]
struct Told {
    periods: f64,
    explained: f64,
    amplitude: f64,
    phase: f64,
}

impl Motion {
    /// Returns the effect of a term whose last parameter is its number of waves over position; `None` for others.
    pub(super) fn waving(&self, term: &Term) -> Option<Effect> {
        let Term::Known(index) = term else { return None };
        let effect = self.effects[*index];
        matches!(effect, Effect::Cogging | Effect::PositionFriction).then_some(effect)
    }

    /// Returns the model with one wave added: those waves that explain most of its residual.
    pub(super) fn by_waves(&self, term: &Term, effect: Effect, rest: &Rest<'_>) -> Vec<Structure> {
        let [fewest, most] = self.scales.periods_within;
        let per_unit = self.radians_per_period();
        let told_apart = TAU / per_unit / self.scales.distance;
        let step = (told_apart / STEPS).max((most - fewest) / MOST);
        let lacking = Lacking::new(self, rest, effect == Effect::PositionFriction);
        let count = ((most - fewest) / step).max(0.0) as u32;
        let mut told: Vec<Told> =
            (0..=count).map(|number| lacking.told(fewest + f64::from(number) * step, per_unit)).collect();
        // Best first: a later one that the motion cannot distinguish from it is dropped.
        told.sort_by(|a, b| b.explained.total_cmp(&a.explained));
        let mut best: Vec<Told> = Vec::new();
        for one in told {
            if best.len() < OFFERED && best.iter().all(|other| (other.periods - one.periods).abs() >= told_apart) {
                best.push(one);
            }
        }
        let with = |told: Told| {
            let mut structure = rest.fit.structure.clone();
            structure.terms.push(term.clone());
            structure.added.push(vec![told.amplitude, told.phase, told.periods]);
            self.movable(structure)
        };
        best.into_iter().filter(|told| told.amplitude > 0.0).map(with).collect()
    }
}

/// Windows of one recording, with the part of their residual that the rest of the model cannot explain.
struct Beyond<'r> {
    seen: &'r Seen,
    /// Orthonormal basis of the sensitivities to the model's parameters.
    basis: DMatrix<f64>,
    left: DVector<f64>,
}

impl Beyond<'_> {
    /// Returns the windows' integrals of a series without the part that the rest of the model can reproduce.
    fn alone(&self, series: &[f64]) -> DVector<f64> {
        let sums = DVector::from_iterator(self.left.len(), self.seen.windows.sums(series));
        &sums - &self.basis * (self.basis.transpose() * &sums)
    }
}

struct Lacking<'r> {
    recordings: Vec<Beyond<'r>>,
    /// True for a friction, which opposes the motion; half of its amplitude is its mean.
    friction: bool,
    /// True if recordings begin at unknown positions, so that each has a phase of its own.
    apart: bool,
}

impl<'r> Lacking<'r> {
    fn new(motion: &Motion, rest: &'r Rest<'_>, friction: bool) -> Self {
        let all: Vec<&Seen> = rest.seen.iter().collect();
        let recordings = rest.fit.slopes(&rest.weak, &all).into_iter().zip(&rest.left).zip(&rest.seen);
        let beyond = |((slopes, left), seen): ((DMatrix<f64>, &Vec<f64>), &'r Seen)| {
            let moving: Vec<_> =
                slopes.column_iter().filter(|column| column.norm() > 0.0).map(|column| column.normalize()).collect();
            let basis = if moving.is_empty() {
                DMatrix::zeros(slopes.nrows(), 0)
            } else {
                // Singular values below 1e-6 of the normalised sensitivities belong to collinear parameters.
                let svd = DMatrix::from_columns(&moving).svd(true, false);
                let kept = svd.singular_values.iter().filter(|&&value| value > 1e-6).count();
                svd.u.map_or_else(|| DMatrix::zeros(slopes.nrows(), 0), |u| u.columns(0, kept).into_owned())
            };
            let left = DVector::from_column_slice(left);
            let left = &left - &basis * (basis.transpose() * &left);
            Beyond { seen, basis, left }
        };
        Self { recordings: recordings.map(beyond).collect(), friction, apart: motion.of_speed }
    }

    fn told(&self, periods: f64, per_unit: f64) -> Told {
        let size = if self.friction { 3 } else { 2 };
        let mut all = Told { periods, explained: 0.0, amplitude: 0.0, phase: 0.0 };
        let mut products = (DMatrix::zeros(size, size), DVector::zeros(size));
        for recording in &self.recordings {
            let mut series = vec![Vec::with_capacity(recording.seen.windows.moved.len()); size];
            for moved in &recording.seen.windows.moved {
                let (sin, cos) = (periods * per_unit * moved.position).sin_cos();
                let along = match (self.friction, moved.rests) {
                    (false, _) => 1.0,
                    (true, true) => 0.0,
                    (true, false) => -moved.speed.signum(),
                };
                for (series, value) in series.iter_mut().zip([sin, cos, 1.0]) {
                    series.push(along * value);
                }
            }
            let alone: Vec<DVector<f64>> = series.iter().map(|series| recording.alone(series)).collect();
            for (row, one) in alone.iter().enumerate() {
                products.1[row] += one.dot(&recording.left);
                for (column, other) in alone.iter().enumerate() {
                    products.0[(row, column)] += one.dot(other);
                }
            }
            if self.apart {
                self.add(
                    &mut all,
                    std::mem::replace(&mut products, (DMatrix::zeros(size, size), DVector::zeros(size))),
                );
            }
        }
        if !self.apart {
            self.add(&mut all, products);
        }
        all
    }

    /// Adds the reduction of the sum of squares by least squares; amplitude and phase are those of the first
    /// recording.
    fn add(&self, all: &mut Told, (mut normal, right): (DMatrix<f64>, DVector<f64>)) {
        let smallest = 1e-9 * normal.diagonal().max();
        normal.set_diagonal(&normal.diagonal().add_scalar(smallest));
        let Some(solution) = normal.cholesky().map(|cholesky| cholesky.solve(&right)) else { return };
        let explained = solution.dot(&right);
        if !explained.is_finite() {
            return;
        }
        if all.explained == 0.0 {
            let (sin, cos) = (solution[0], solution[1]);
            all.amplitude = sin.hypot(cos) * if self.friction { 2.0 } else { 1.0 };
            all.phase = cos.atan2(sin);
        }
        all.explained += explained;
    }
}
