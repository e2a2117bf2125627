//! Nonlinear least squares between free-run simulations and measurements, by the method of Levenberg and Marquardt.
//!
//! The base model's parameters, those of every term, and the unknown initial state of each run are fitted together. A
//! change of variable keeps every parameter in its [`Range`].

mod profile;
#[cfg(test)]
mod tests;

use nalgebra::{DMatrix, DVector, Dyn, SymmetricEigen};
use r4_maths::{
    least_squares::trust_region::{SumOfSquares, minimise},
    statistics::{QuantileRule, quantile},
};

pub(crate) use profile::RISE;

use crate::family::{Family, Model, Parameter, Range, Simulated, Structure, Term};

/// Step of the changed variable for numerical differences: well above the effect of a stick or a stop that occurs in
/// another step, and far below the curvature (the variables are of order one).
const DIFFERENCE: f64 = 3e-5;
/// Number of distances that are tried on both sides of a parameter in which the prediction is a staircase, and the
/// first distance in steps; each further one is half as far.
const BESIDE: i32 = 8;
const FARTHEST: f64 = 5.0;
/// Step for differences of an initial state alone, in standard deviations of its guess.
const SETTLING: f64 = 1e-3;
/// Largest number of steps for an initial state, and the relative gain of the last one.
const SETTLING_STEPS: usize = 6;
const SETTLED: f64 = 1e-3;
/// Prior standard deviation of the difference between neighbouring knots of a curve, in noticeable changes.
const JUMP: f64 = 3.0;
/// Residual, in robust standard deviations, beyond which it counts linearly (Huber).
const HUBER: f64 = 4.0;
/// Number of stretches of the recordings that count as independent of each other.
const CLUSTERS: usize = 40;

impl Range {
    /// Returns the unbounded variable for a value.
    fn variable(self, value: f64) -> f64 {
        match self {
            Self::Positive | Self::Coarse { .. } => value.max(f64::MIN_POSITIVE).ln(),
            // Inverse of ln(1 + e^z).
            Self::NotNegative { scale } => {
                let share = (value / scale).max(1e-9);
                if share > 30.0 { share } else { share.exp_m1().ln() }
            }
            Self::Between(lower, upper) => {
                let share = ((value - lower) / (upper - lower)).clamp(1e-6, 1.0 - 1e-6);
                (share / (1.0 - share)).ln()
            }
            Self::Reflected(lower, upper) => (value - lower) / (upper - lower),
            Self::Any { scale } => value / scale,
        }
    }

    /// Returns the value for a variable; it is in range for every finite one.
    fn value(self, variable: f64) -> f64 {
        match self {
            Self::Positive | Self::Coarse { .. } => variable.clamp(-80.0, 80.0).exp(),
            Self::NotNegative { scale } => {
                scale * if variable > 30.0 { variable } else { variable.max(-40.0).exp().ln_1p() }
            }
            Self::Between(lower, upper) => lower + (upper - lower) / (1.0 + (-variable.clamp(-40.0, 40.0)).exp()),
            Self::Reflected(lower, upper) => {
                // A way to the other end and back is 2.
                let way = variable.rem_euclid(2.0);
                lower + (upper - lower) * way.min(2.0 - way)
            }
            Self::Any { scale } => scale * variable,
        }
    }

    /// Returns the step of the variable for numerical differences.
    fn difference(self) -> f64 {
        if let Self::Coarse { step } = self { step } else { DIFFERENCE }
    }

    /// Returns a small step of the value that stays in range.
    fn small(self, value: f64) -> f64 {
        match self {
            Self::Positive => value * 1e-4,
            Self::Coarse { step } => value * step,
            Self::NotNegative { scale } => 1e-4 * value.max(scale),
            Self::Between(lower, upper) | Self::Reflected(lower, upper) => {
                let step = 1e-4 * (upper - lower);
                if value + step < upper { step } else { -step }
            }
            Self::Any { scale } => 1e-4 * value.abs().max(scale),
        }
    }
}

/// Returns the parameters of a structure in order: the base model's, then those of each term. A curve has one per
/// knot.
#[must_use]
pub fn parameters<F: Model>(family: &F, terms: &[Term]) -> Vec<Parameter> {
    let mut all = family.base().to_vec();
    for term in terms {
        match term {
            Term::Known(candidate) => all.extend_from_slice(&family.catalogue()[*candidate].parameters),
            Term::Curve(curve) => all.extend(curve.at.iter().map(|_| Parameter {
                name: "value",
                unit: curve.unit,
                range: Range::Any { scale: curve.scale },
                absent: Some(0.0),
            })),
        }
    }
    all
}

fn flat(structure: &Structure) -> impl Iterator<Item = f64> {
    structure.base.iter().chain(structure.added.iter().flatten()).copied()
}

fn set_flat(structure: &mut Structure, values: &[f64]) {
    let places = structure.base.iter_mut().chain(structure.added.iter_mut().flatten());
    for (place, &value) in places.zip(values) {
        *place = value;
    }
}

/// A model fitted to runs.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Structure with the fitted values.
    pub structure: Structure,
    /// Initial state of each run.
    pub initial: Vec<Vec<f64>>,
    /// Sum of the squared, weighted residuals.
    pub cost: f64,
    /// Weights of the samples, run by run; below 1 for outliers.
    weights: Vec<Vec<f64>>,
}

/// Effort of a fit.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// Largest number of simulations of all data, not counting those for differences.
    pub evaluations: usize,
    /// Relative gain of the cost at which the fit ends.
    pub tolerance: f64,
    /// True to repeat the fit with outliers weighted down.
    pub robust: bool,
}

impl Effort {
    /// Effort for parameters that are reported.
    pub const FULL: Self = Self { evaluations: 40, tolerance: 1e-7, robust: true };
    /// Effort for a comparison of the most promising effects.
    pub const COMPARE: Self = Self { evaluations: 24, tolerance: 1e-6, robust: false };
    /// Effort for a selection of these among all.
    pub const SCREEN: Self = Self { evaluations: 10, tolerance: 1e-4, robust: false };
    /// Effort for a selection among initial guesses.
    pub const GLANCE: Self = Self { evaluations: 4, tolerance: 1e-3, robust: false };
}

/// Fits a structure, starting from its values.
#[must_use]
pub fn fit<F: Model>(
    family: &F,
    runs: &[&F::Run],
    structure: Structure,
    initial: Vec<Vec<f64>>,
    effort: Effort,
) -> Fit {
    let mut first = Problem::new(family, runs, structure, initial, even(family, runs)).solved(effort);
    // Costly, so only in thorough fits.
    if effort.evaluations > Effort::SCREEN.evaluations {
        first = first.beside(effort);
    }
    if !effort.robust {
        return first.into_fit();
    }
    let weights = first.huber();
    // Without outliers a second fit would repeat the first.
    if weights.iter().flatten().all(|&weight| weight == 1.0) {
        return first.into_fit();
    }
    let Problem { structure, initial, .. } = first;
    Problem::new(family, runs, structure, initial, weights).solved(effort).into_fit()
}

/// Fits all parameters of a structure but the last, which keeps its value.
pub(crate) fn fit_but_last<F: Model>(
    family: &F,
    runs: &[&F::Run],
    structure: Structure,
    initial: Vec<Vec<f64>>,
    effort: Effort,
) -> Fit {
    let mut problem = Problem::new(family, runs, structure, initial, even(family, runs));
    problem.held = problem.parameters.len().checked_sub(1);
    problem.solved(effort).into_fit()
}

/// Returns weights of 1 for all samples.
fn even<F: Model>(family: &F, runs: &[&F::Run]) -> Vec<Vec<f64>> {
    runs.iter().map(|run| vec![1.0; family.measured(run).len()]).collect()
}

/// Returns the sum of squared residuals of a structure with its values.
#[must_use]
pub fn cost<F: Model>(family: &F, runs: &[&F::Run], structure: &Structure, initial: &[Vec<f64>]) -> f64 {
    let squares = runs.iter().zip(initial).map(|(run, initial)| {
        residuals(family, structure, initial, run).iter().filter(|r| !r.is_nan()).map(|r| r * r).sum::<f64>()
    });
    squares.sum()
}

/// Returns the initial states that the family guesses.
#[must_use]
pub fn guessed<F: Model>(family: &F, runs: &[&F::Run]) -> Vec<Vec<f64>> {
    runs.iter().map(|run| family.initial(run).0).collect()
}

/// Fits the initial state of a run under a given model to its first `samples`; the family's guess counts as a
/// measurement with its standard deviation.
#[must_use]
pub fn settle<F: Family>(family: &F, structure: &Structure, run: &F::Run, samples: usize) -> Vec<f64> {
    let (guess, deviations) = family.initial(run);
    if guess.is_empty() {
        return guess;
    }
    let samples = samples.min(family.measured(run).len());
    let part = family.part(run, 0, samples);
    let measured = family.measured(&part);
    let mut predicted = vec![0.0; samples];
    let mut tried = predicted.clone();
    let mut beginnings = family.beginnings(structure, run);
    // The best of several guesses by its cost alone: a fit of each would take as many times as long.
    if beginnings.len() > 1 {
        let left = |state: &Vec<f64>| cost(family, &[&part], structure, std::slice::from_ref(state));
        let costs: Vec<f64> = beginnings.iter().map(left).collect();
        let least = (0..costs.len()).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).unwrap_or(0);
        beginnings.swap(0, least);
    }
    let mut state = beginnings.into_iter().next().unwrap_or_else(|| guess.clone());
    family.predict(structure, &state, &part, &mut predicted);
    for _ in 0..SETTLING_STEPS {
        // The residual itself scales the cost, so that the guess weighs little against good data.
        let noise = deviation(measured, &predicted).max(f64::MIN_POSITIVE);
        let cost = |state: &[f64], predicted: &[f64]| {
            let errors = measured.iter().zip(predicted).map(|(measured, predicted)| (measured - predicted) / noise);
            let known: f64 = errors.filter(|error| !error.is_nan()).map(|error| error * error).sum();
            let off = state.iter().zip(&guess).zip(&deviations);
            known + off.map(|((state, guess), deviation)| ((state - guess) / deviation).powi(2)).sum::<f64>()
        };
        let mut jacobian = DMatrix::zeros(samples + state.len(), state.len());
        let mut residual = DVector::zeros(samples + state.len());
        for row in 0..samples {
            if (measured[row] - predicted[row]).is_finite() {
                residual[row] = (measured[row] - predicted[row]) / noise;
            }
        }
        let moved: Vec<Vec<f64>> = (0..state.len())
            .map(|column| {
                let mut other = state.clone();
                other[column] += SETTLING * deviations[column];
                other
            })
            .collect();
        let others: Vec<(&Structure, &[f64])> = moved.iter().map(|initial| (structure, &initial[..])).collect();
        let known = Simulated { structure, initial: &state, predicted: &predicted };
        family.predict_each(&known, &others, &part, &mut |column, moved| {
            for row in 0..samples {
                let slope = (moved[row] - predicted[row]) / (SETTLING * deviations[column]) / noise;
                if measured[row].is_finite() && slope.is_finite() {
                    jacobian[(row, column)] = slope;
                }
            }
        });
        for column in 0..state.len() {
            jacobian[(samples + column, column)] = 1.0 / deviations[column];
            residual[samples + column] = (guess[column] - state[column]) / deviations[column];
        }
        let Ok(step) = jacobian.svd(true, true).solve(&residual, 1e-12) else { break };
        let before = cost(&state, &predicted);
        // Static friction, stops or reversals may make a whole step worse.
        let better = [1.0, 0.3, 0.1].into_iter().find_map(|share| {
            let other: Vec<f64> = state.iter().zip(step.iter()).map(|(state, step)| state + share * step).collect();
            family.predict(structure, &other, &part, &mut tried);
            let after = cost(&other, &tried);
            (after < before || !before.is_finite()).then_some((other, before - after))
        });
        let Some((other, gain)) = better else { break };
        state = other;
        std::mem::swap(&mut predicted, &mut tried);
        if gain < SETTLED * before {
            break;
        }
    }
    if state.iter().all(|value| value.is_finite()) { state } else { guess }
}

/// Returns the standard deviation of the residuals from their median magnitude, which outliers hardly affect.
fn deviation(measured: &[f64], predicted: &[f64]) -> f64 {
    let residuals = measured.iter().zip(predicted).map(|(measured, predicted)| (measured - predicted).abs());
    robust_deviation(residuals.collect())
}

/// Returns 1.4826 times the median of the magnitudes: the standard deviation of a normal distribution.
pub(crate) fn robust_deviation(mut magnitudes: Vec<f64>) -> f64 {
    magnitudes.retain(|magnitude| magnitude.is_finite());
    // Around zero, not around the median: a bias of the residuals counts.
    1.4826 * quantile(&magnitudes, 0.5, QuantileRule::NearestPosition).unwrap_or(0.0)
}

/// Returns the standard deviation of white noise on a smooth series, from its second differences. For a series that
/// is constant most of the time, it is that of rounding to its smallest change.
pub(crate) fn white_noise(values: &[f64]) -> f64 {
    let differences = values.windows(3).map(|three| (three[0] - 2.0 * three[1] + three[2]).abs());
    let noise = robust_deviation(differences.collect()) / 6.0_f64.sqrt();
    if noise > 0.0 { noise } else { rounding(values) }
}

/// Returns the standard deviation of rounding to a sensor's resolution, taken as the smallest change; 0 without
/// changes.
pub(crate) fn rounding(values: &[f64]) -> f64 {
    let changes = values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|change| *change > 0.0);
    let smallest = changes.fold(f64::INFINITY, f64::min);
    // Standard deviation of a uniform distribution of this width.
    if smallest.is_finite() { smallest / 12.0_f64.sqrt() } else { 0.0 }
}

/// Prior that ties two neighbouring knots of a curve: the factor that makes their difference a residual. It is
/// negligible where data determine a knot; elsewhere the knot follows its neighbours.
struct Neighbours {
    /// Indexes of the knots among the parameters.
    corners: [usize; 2],
    factor: f64,
}

/// Returns the ties between the knots of all curves, scaled by the noise of the data.
fn neighbours(structure: &Structure, noise: f64) -> Vec<Neighbours> {
    let mut from = structure.base.len();
    let mut all = Vec::new();
    for (term, values) in structure.terms.iter().zip(&structure.added) {
        if let Term::Curve(curve) = term {
            let factor = noise / (JUMP * curve.scale);
            let pairs = (1..values.len()).map(|corner| [from + corner - 1, from + corner]);
            let closing = curve.period.map(|_| [from + values.len() - 1, from]);
            all.extend(pairs.chain(closing).map(|corners| Neighbours { corners, factor }));
        }
        from += values.len();
    }
    all
}

struct Problem<'p, F: Model> {
    family: &'p F,
    runs: &'p [&'p F::Run],
    parameters: Vec<Parameter>,
    structure: Structure,
    initial: Vec<Vec<f64>>,
    /// Factor from the variable of an initial state to its value.
    scales: Vec<Vec<f64>>,
    weights: Vec<Vec<f64>>,
    /// Rows of each run in the residuals.
    rows: Vec<std::ops::Range<usize>>,
    neighbours: Vec<Neighbours>,
    /// Index of a parameter that is held at its value.
    held: Option<usize>,
    variables: DVector<f64>,
    predicted: Vec<f64>,
    /// Sum of the squared, weighted residuals.
    cost: f64,
    /// Residual of a prediction that is not finite.
    absurd: f64,
    /// Number of evaluations that remain.
    left: usize,
    /// Lowest cost so far, with its variables.
    best: (f64, DVector<f64>),
}

impl<'p, F: Model> Problem<'p, F> {
    fn new(
        family: &'p F,
        runs: &'p [&'p F::Run],
        structure: Structure,
        initial: Vec<Vec<f64>>,
        weights: Vec<Vec<f64>>,
    ) -> Self {
        let parameters = parameters(family, &structure.terms);
        let mut rows = Vec::new();
        let mut count = 0;
        for run in runs {
            let len = family.measured(run).len();
            rows.push(count..count + len);
            count += len;
        }
        let scales: Vec<Vec<f64>> = runs.iter().map(|run| family.initial(run).1).collect();
        // Variables: the parameters of the structure, then the initial states of all runs.
        let globals = parameters.iter().zip(flat(&structure)).map(|(parameter, value)| parameter.range.variable(value));
        let locals = initial.iter().flatten().zip(scales.iter().flatten()).map(|(value, scale)| value / scale);
        let variables = DVector::from_vec(globals.chain(locals).collect());
        let largest = runs.iter().flat_map(|run| family.measured(run)).filter(|value| value.is_finite());
        // A finite residual lets the solver step back from a simulation that failed.
        let absurd = 1e3 * largest.fold(1.0, |largest: f64, value| largest.max(value.abs()));
        let noise = runs.iter().map(|run| family.noise(run)).sum::<f64>() / runs.len().max(1) as f64;
        let mut problem = Self {
            family,
            runs,
            parameters,
            neighbours: neighbours(&structure, noise),
            structure,
            initial,
            scales,
            weights,
            rows,
            held: None,
            best: (f64::INFINITY, variables.clone()),
            variables,
            predicted: vec![0.0; count],
            cost: f64::INFINITY,
            absurd,
            left: usize::MAX,
        };
        let variables = problem.variables.clone();
        problem.set_variables(&variables);
        problem
    }

    fn solved(mut self, effort: Effort) -> Self {
        self.left = effort.evaluations;
        self.best = (self.cost, self.variables.clone());
        let cost = self.cost;
        minimise(&mut self, cost, effort.tolerance);
        self.left = usize::MAX;
        // The solver ends at its last trial, which may not be the best.
        let best = self.best.1.clone();
        self.set_variables(&best);
        self
    }

    /// Continues from the best of several values beside each parameter in which the prediction is a staircase: the
    /// gradient does not lead over its steps.
    fn beside(mut self, effort: Effort) -> Self {
        for column in 0..self.parameters.len() {
            let Range::Coarse { step } = self.parameters[column].range else { continue };
            let from = self.variables.clone();
            let mut best = (self.cost, from.clone());
            self.held = Some(column);
            for level in 0..BESIDE {
                let off = FARTHEST * step * 0.5_f64.powi(level);
                let from = best.1.clone();
                for off in [-off, off] {
                    let mut variables = from.clone();
                    variables[column] += off;
                    self.set_variables(&variables);
                    self = self.solved(Effort::SCREEN);
                    if self.cost < best.0 {
                        best = (self.cost, self.variables.clone());
                    }
                }
            }
            self.held = None;
            self.set_variables(&best.1);
            if best.1 != from {
                self = self.solved(effort);
            }
        }
        self
    }

    fn set_variables(&mut self, variables: &DVector<f64>) {
        self.variables.copy_from(variables);
        let values = self.values_of(variables);
        set_flat(&mut self.structure, &values);
        let mut rest = variables.iter().skip(values.len());
        for (initial, scales) in self.initial.iter_mut().zip(&self.scales) {
            for ((place, scale), variable) in initial.iter_mut().zip(scales).zip(&mut rest) {
                *place = scale * variable;
            }
        }
        let mut predicted = std::mem::take(&mut self.predicted);
        self.predict_all(&self.structure, &self.initial, &mut predicted);
        self.predicted = predicted;
        self.cost = self.weighted().norm_squared();
        if self.cost < self.best.0 {
            self.best = (self.cost, variables.clone());
        }
        self.left = self.left.saturating_sub(1);
    }

    fn into_fit(self) -> Fit {
        Fit { structure: self.structure, initial: self.initial, cost: self.cost, weights: self.weights }
    }

    fn predict_all(&self, structure: &Structure, initial: &[Vec<f64>], predicted: &mut [f64]) {
        for ((run, rows), initial) in self.runs.iter().zip(&self.rows).zip(initial) {
            self.family.predict(structure, initial, run, &mut predicted[rows.clone()]);
        }
    }

    fn values_of(&self, variables: &DVector<f64>) -> Vec<f64> {
        self.parameters.iter().zip(variables.iter()).map(|(parameter, &z)| parameter.range.value(z)).collect()
    }

    fn residual(&self, row: usize, run: usize, measured: f64, predicted: f64) -> f64 {
        if !measured.is_finite() {
            return 0.0;
        }
        let residual = if predicted.is_finite() { predicted - measured } else { self.absurd };
        residual * self.weights[run][row]
    }

    fn weighted(&self) -> DVector<f64> {
        let mut residuals = DVector::zeros(self.predicted.len() + self.neighbours.len());
        for (index, (run, rows)) in self.runs.iter().zip(&self.rows).enumerate() {
            for (row, &measured) in self.family.measured(run).iter().enumerate() {
                let predicted = self.predicted[rows.start + row];
                residuals[rows.start + row] = self.residual(row, index, measured, predicted);
            }
        }
        if !self.neighbours.is_empty() {
            let values: Vec<f64> = flat(&self.structure).collect();
            for (place, Neighbours { corners: [one, other], factor }) in self.neighbours.iter().enumerate() {
                residuals[self.predicted.len() + place] = factor * (values[*other] - values[*one]);
            }
        }
        residuals
    }

    /// Returns the square roots of Huber's weights.
    fn huber(&self) -> Vec<Vec<f64>> {
        let residuals = self.weighted();
        let scale = robust_deviation(residuals.iter().map(|residual| residual.abs()).collect());
        let weight = |residual: f64| {
            let share = residual.abs() / (HUBER * scale);
            if scale > 0.0 && share > 1.0 { share.recip().sqrt() } else { 1.0 }
        };
        self.rows.iter().map(|rows| rows.clone().map(|row| weight(residuals[row])).collect()).collect()
    }
}

impl<F: Model> SumOfSquares for Problem<'_, F> {
    fn variables(&self) -> &DVector<f64> {
        &self.variables
    }

    fn go(&mut self, variables: &DVector<f64>) -> Option<f64> {
        self.set_variables(variables);
        (self.left > 0).then_some(self.cost)
    }

    fn normal(&mut self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        (self.left > 0).then(|| self.summed())
    }
}

impl<F: Model> Problem<'_, F> {
    /// Iterates over the rows of the Jacobian of each run: columns of the parameters, then of the run's own initial
    /// state, which affects no other run.
    fn slopes(&self) -> impl Iterator<Item = DMatrix<f64>> + '_ {
        let globals = self.parameters.len();
        let steps: Vec<f64> = self.parameters.iter().map(|parameter| parameter.range.difference()).collect();
        let moved = |column: usize| {
            let mut structure = self.structure.clone();
            let mut variables = self.variables.clone();
            variables[column] += steps[column];
            set_flat(&mut structure, &self.values_of(&variables));
            structure
        };
        // The column of a held parameter stays zero, so that the solver takes no step along it.
        let free: Vec<usize> = (0..globals).filter(|&column| self.held != Some(column)).collect();
        let structures: Vec<Structure> = free.iter().map(|&column| moved(column)).collect();
        self.scales.iter().enumerate().map(move |(index, scales)| {
            let initials: Vec<Vec<f64>> = (0..scales.len())
                .map(|component| {
                    let mut initial = self.initial[index].clone();
                    initial[component] += DIFFERENCE * scales[component];
                    initial
                })
                .collect();
            let others = structures.iter().zip(std::iter::repeat(&self.initial[index]));
            let others: Vec<(&Structure, &[f64])> = others
                .chain(std::iter::repeat(&self.structure).zip(&initials))
                .map(|(structure, initial)| (structure, &initial[..]))
                .collect();
            let mut slopes = DMatrix::zeros(self.rows[index].len(), globals + scales.len());
            self.predict_each(index, &others, |other, row, difference| {
                let column = free.get(other).copied().unwrap_or(globals + other.saturating_sub(free.len()));
                let slope = difference / steps.get(column).unwrap_or(&DIFFERENCE);
                if slope.is_finite() {
                    slopes[(row, column)] = slope * self.weights[index][row];
                }
            });
            slopes
        })
    }

    /// Iterates over the rows of the Jacobian that tie two knots of a curve.
    fn ties(&self) -> impl Iterator<Item = [(usize, f64); 2]> + '_ {
        self.neighbours.iter().map(|Neighbours { corners: [one, other], factor }| {
            [(*one, -1.0), (*other, 1.0)].map(|(column, sign)| match self.parameters[column].range {
                Range::Any { scale } if self.held != Some(column) => (column, sign * factor * scale),
                _ => (column, 0.0),
            })
        })
    }

    /// Returns `JᵀJ` and `Jᵀr` of Jacobian and residuals.
    fn summed(&self) -> (DMatrix<f64>, DVector<f64>) {
        let (globals, all) = (self.parameters.len(), self.variables.len());
        let residuals = self.weighted();
        let (mut gram, mut gradient) = (DMatrix::zeros(all, all), DVector::zeros(all));
        let mut local = globals;
        for (rows, slopes) in self.rows.iter().zip(self.slopes()) {
            let own = slopes.ncols() - globals;
            let (of_run, down) = (slopes.tr_mul(&slopes), slopes.tr_mul(&residuals.rows(rows.start, rows.len())));
            // Columns of the parameters, and of the run's own initial state.
            for (from, to, len) in [(0, 0, globals), (globals, local, own)] {
                let mut sum = gradient.rows_mut(to, len);
                sum += down.rows(from, len);
                for (from_column, to_column, columns) in [(0, 0, globals), (globals, local, own)] {
                    let mut sum = gram.view_mut((to, to_column), (len, columns));
                    sum += of_run.view((from, from_column), (len, columns));
                }
            }
            local += own;
        }
        for (tie, residual) in self.ties().zip(residuals.iter().skip(self.predicted.len())) {
            for (row, slope) in tie {
                gradient[row] += slope * residual;
                for (column, other) in tie {
                    gram[(row, column)] += slope * other;
                }
            }
        }
        (gram, gradient)
    }

    /// Returns the whole Jacobian, with the rows of all runs and ties.
    fn assembled(&self) -> DMatrix<f64> {
        let globals = self.parameters.len();
        let mut jacobian = DMatrix::zeros(self.predicted.len() + self.neighbours.len(), self.variables.len());
        let mut local = globals;
        for (rows, slopes) in self.rows.iter().zip(self.slopes()) {
            let own = slopes.ncols() - globals;
            jacobian.view_mut((rows.start, 0), (rows.len(), globals)).copy_from(&slopes.columns(0, globals));
            jacobian.view_mut((rows.start, local), (rows.len(), own)).copy_from(&slopes.columns(globals, own));
            local += own;
        }
        for (place, tie) in self.ties().enumerate() {
            for (column, slope) in tie {
                jacobian[(self.predicted.len() + place, column)] = slope;
            }
        }
        jacobian
    }

    /// Passes to `differs` how other simulations of a run deviate from the current one: their index, the run's row,
    /// and the difference. Rows without a measurement are skipped.
    fn predict_each(&self, run: usize, others: &[(&Structure, &[f64])], mut differs: impl FnMut(usize, usize, f64)) {
        let rows = &self.rows[run];
        let predicted = &self.predicted[rows.clone()];
        let known = Simulated { structure: &self.structure, initial: &self.initial[run], predicted };
        let measured = self.family.measured(self.runs[run]);
        self.family.predict_each(&known, others, self.runs[run], &mut |other, moved| {
            for (row, ((moved, predicted), measured)) in moved.iter().zip(predicted).zip(measured).enumerate() {
                if measured.is_finite() {
                    differs(other, row, moved - predicted);
                }
            }
        });
    }
}

/// Uncertainty of a parameter from the curvature at the best fit.
struct Spread {
    /// Standard error, in the parameter's unit.
    deviation: f64,
    /// Variance of a residual that gives this standard error if all residuals are independent.
    variance: f64,
    /// Change of all parameters, then of the variables of the initial states, per change of this parameter, with the
    /// others at their optimum.
    along: Vec<f64>,
}

impl Fit {
    /// Returns the same parameters for other runs, with initial states fitted to these.
    #[must_use]
    pub fn over<F: Family>(&self, family: &F, runs: &[&F::Run]) -> Self {
        let structure = self.structure.clone();
        let samples = |run| family.measured(run).len();
        let initial: Vec<_> = runs.iter().map(|run| settle(family, &structure, run, samples(run))).collect();
        Self::at(family, runs, structure, initial)
    }

    /// Returns a model with its values, without a fit.
    pub(crate) fn at<F: Model>(family: &F, runs: &[&F::Run], structure: Structure, initial: Vec<Vec<f64>>) -> Self {
        let cost = cost(family, runs, &structure, &initial);
        Self { structure, initial, cost, weights: even(family, runs) }
    }

    /// Returns measured minus predicted output, run by run; NaN without a measurement.
    #[must_use]
    pub fn residuals<F: Model>(&self, family: &F, runs: &[&F::Run]) -> Vec<Vec<f64>> {
        runs.iter().zip(&self.initial).map(|(run, initial)| residuals(family, &self.structure, initial, run)).collect()
    }

    /// Returns the sensitivities of each run's prediction to the variables of the structure's parameters, then to
    /// those of its initial state: a row per sample.
    pub(crate) fn slopes<F: Model>(&self, family: &F, runs: &[&F::Run]) -> Vec<DMatrix<f64>> {
        Problem::new(family, runs, self.structure.clone(), self.initial.clone(), self.weights.clone())
            .slopes()
            .collect()
    }

    /// Returns the standard errors of the structure's parameters, in the order of [`parameters()`]; `None` for a
    /// parameter that the data do not determine.
    ///
    /// Residuals of real data are correlated over time: the spread of the score between stretches of the recording
    /// gives the standard error (White's sandwich estimator, clustered). The usual one for independent noise is its
    /// lower bound.
    #[must_use]
    pub fn deviations<F: Model>(&self, family: &F, runs: &[&F::Run]) -> Vec<Option<f64>> {
        self.spreads(family, runs).into_iter().map(|spread| spread.map(|spread| spread.deviation)).collect()
    }

    fn spreads<F: Model>(&self, family: &F, runs: &[&F::Run]) -> Vec<Option<Spread>> {
        self.curvature(family, runs).map_or(vec![], |curvature| curvature.spreads())
    }

    /// Returns the standard error of each parameter in a unit that depends on other parameters, as a force per unit of
    /// inertia does, over that with the unit fixed; 1 for an undetermined parameter. The error is that of the
    /// linearised product with [`Family::units`].
    #[must_use]
    pub fn unit_errors<F: Family>(&self, family: &F, runs: &[&F::Run]) -> Vec<f64> {
        let values: Vec<f64> = flat(&self.structure).collect();
        let fixed = family.units(&self.structure);
        let steps = parameters(family, &self.structure.terms).into_iter().zip(&values);
        let moved: Vec<(f64, Vec<f64>)> = steps
            .enumerate()
            .map(|(place, (parameter, &value))| {
                let step = parameter.range.small(value);
                let mut other = values.clone();
                other[place] += step;
                let mut structure = self.structure.clone();
                set_flat(&mut structure, &other);
                (step, family.units(&structure))
            })
            .collect();
        let is_fixed = |place: usize| moved.iter().all(|(_, units)| units[place] == fixed[place]);
        if (0..values.len()).all(is_fixed) {
            return vec![1.0; values.len()];
        }
        let Some(curvature) = self.curvature(family, runs) else { return vec![] };
        let ratio = |place: usize| {
            let mut along = vec![0.0; values.len()];
            along[place] = 1.0;
            let alone = curvature.variance_along(&along);
            for (slope, (step, units)) in along.iter_mut().zip(&moved) {
                *slope += values[place] * (units[place] / fixed[place] - 1.0) / step;
            }
            let ratio = (curvature.variance_along(&along) / alone).sqrt();
            if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 }
        };
        (0..values.len()).map(|place| if is_fixed(place) { 1.0 } else { ratio(place) }).collect()
    }

    /// Returns the curvature of the cost; `None` without parameters.
    fn curvature<F: Model>(&self, family: &F, runs: &[&F::Run]) -> Option<Curvature> {
        let problem = Problem::new(family, runs, self.structure.clone(), self.initial.clone(), self.weights.clone());
        if problem.variables.is_empty() {
            return None;
        }
        let mut jacobian = problem.assembled();
        let globals = problem.parameters.len();
        let values: Vec<f64> = flat(&self.structure).collect();
        // Derivatives with respect to the values: at the end of a range the change of variable is flat.
        let steps: Vec<f64> =
            problem.parameters.iter().zip(&values).map(|(parameter, &value)| parameter.range.small(value)).collect();
        let moved = |column: usize| {
            let mut other = values.clone();
            other[column] += steps[column];
            let mut structure = self.structure.clone();
            set_flat(&mut structure, &other);
            structure
        };
        let structures: Vec<Structure> = (0..globals).map(moved).collect();
        for index in 0..runs.len() {
            let others: Vec<(&Structure, &[f64])> =
                structures.iter().map(|structure| (structure, &self.initial[index][..])).collect();
            problem.predict_each(index, &others, |column, row, slope| {
                let slope = slope / steps[column] * self.weights[index][row];
                let at = problem.rows[index].start + row;
                jacobian[(at, column)] = if slope.is_finite() { slope } else { 0.0 };
            });
        }
        for (place, Neighbours { corners: [one, other], factor }) in problem.neighbours.iter().enumerate() {
            let at = problem.predicted.len() + place;
            (jacobian[(at, *one)], jacobian[(at, *other)]) = (-factor, *factor);
        }
        // Columns are scaled to length one, so that small eigenvalues mean collinear parameters.
        let lengths: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
        for (mut column, &length) in jacobian.column_iter_mut().zip(&lengths) {
            if length > 0.0 {
                column /= length;
            }
        }
        let residuals = problem.weighted();
        let samples = residuals.iter().filter(|residual| **residual != 0.0).count();
        let columns = jacobian.ncols();
        let variance = self.cost / samples.saturating_sub(columns).max(1) as f64;
        let eigen = (jacobian.transpose() * &jacobian).symmetric_eigen();
        let inverse_values = eigen.eigenvalues.map(|value| if is_known(value) { 1.0 / value } else { 0.0 });
        let inverse = &eigen.eigenvectors * DMatrix::from_diagonal(&inverse_values) * eigen.eigenvectors.transpose();
        let clusters = (CLUSTERS / runs.len()).max(1);
        let mut spread = DMatrix::<f64>::zeros(columns, columns);
        let mut count = 0.0;
        for rows in &problem.rows {
            let length = rows.len().div_ceil(clusters).max(1);
            for from in rows.clone().step_by(length) {
                let len = length.min(rows.end - from);
                let score = jacobian.rows(from, len).transpose() * residuals.rows(from, len);
                spread += &score * score.transpose();
                count += 1.0;
            }
        }
        // The last factor corrects for the finite number of clusters.
        let sandwich = &inverse * spread * &inverse * (count / (count - 1.0_f64).max(1.0));
        Some(Curvature { globals, lengths, variance, inverse, sandwich, eigen })
    }
}

/// Returns whether an eigenvalue of normal equations, whose columns have length one, is more than rounding.
fn is_known(eigenvalue: f64) -> bool {
    eigenvalue > 1e-10
}

/// Curvature of the cost at the best fit, over parameters and initial states; columns of the Jacobian have length one.
struct Curvature {
    /// Number of the structure's parameters.
    globals: usize,
    /// Lengths of the columns before they were scaled.
    lengths: Vec<f64>,
    /// Variance of a residual.
    variance: f64,
    /// Inverse of the normal equations.
    inverse: DMatrix<f64>,
    /// Covariance by the spread of the score between stretches of the recordings.
    sandwich: DMatrix<f64>,
    eigen: SymmetricEigen<f64, Dyn>,
}

impl Curvature {
    /// Returns the variance of a linear combination of the structure's parameters.
    fn variance_along(&self, along: &[f64]) -> f64 {
        let mut scaled = DVector::zeros(self.lengths.len());
        for ((place, along), &length) in scaled.iter_mut().zip(along).zip(&self.lengths) {
            *place = if length > 0.0 { along / length } else { 0.0 };
        }
        let by = |matrix: &DMatrix<f64>| scaled.dot(&(matrix * &scaled));
        (self.variance * by(&self.inverse)).max(by(&self.sandwich))
    }

    /// Returns the uncertainty of each of the structure's parameters.
    fn spreads(&self) -> Vec<Option<Spread>> {
        let Self { globals, lengths, variance, inverse, sandwich, eigen } = self;
        let columns = lengths.len();
        (0..*globals)
            .map(|row| {
                let lost: f64 = (0..columns)
                    .filter(|&column| !is_known(eigen.eigenvalues[column]))
                    .map(|column| eigen.eigenvectors[(row, column)].powi(2))
                    .sum();
                // The parameter lies partly in directions that the data do not determine.
                if lengths[row] == 0.0 || lost > 1e-3 {
                    return None;
                }
                let square = (variance * inverse[(row, row)]).max(sandwich[(row, row)]);
                // Change of the other parameters per change of this one, at their optimum.
                let per_own = |column: usize| match lengths[column] {
                    length if length > 0.0 => inverse[(column, row)] / inverse[(row, row)] * lengths[row] / length,
                    _ => 0.0,
                };
                Some(Spread {
                    deviation: square.sqrt() / lengths[row],
                    variance: square / inverse[(row, row)],
                    along: (0..columns).map(per_own).collect(),
                })
            })
            .collect()
    }
}

/// Returns measured minus predicted output of one run; NaN without a measurement.
#[must_use]
pub fn residuals<F: Model>(family: &F, structure: &Structure, initial: &[f64], run: &F::Run) -> Vec<f64> {
    let measured = family.measured(run);
    let mut predicted = vec![0.0; measured.len()];
    family.predict(structure, initial, run, &mut predicted);
    measured.iter().zip(&predicted).map(|(measured, predicted)| measured - predicted).collect()
}
