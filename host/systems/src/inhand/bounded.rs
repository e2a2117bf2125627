//! Nonlinear least squares with bounds on the parameters.

use nalgebra::{DMatrix, DVector};
use r4_maths::least_squares::trust_region::{SumOfSquares, minimise};

/// Relative step or gain below which the search ends: a millionth of a millimetre here.
const TOLERANCE: f64 = 1e-12;
/// Largest number of Jacobian evaluations; fits that the data determine take fewer than thirty.
const JACOBIANS: usize = 200;

struct Problem<'r> {
    residuals: &'r dyn Fn(&[f64]) -> Vec<f64>,
    low: &'r [f64],
    high: &'r [f64],
    variables: DVector<f64>,
    best: (f64, DVector<f64>),
    left: usize,
}

/// Maps unbounded variables to parameters inside their bounds: `low + (high - low) (1 + sin v) / 2`.
fn inside(low: &[f64], high: &[f64], variables: &DVector<f64>) -> Vec<f64> {
    let bounds = low.iter().zip(high);
    bounds.zip(variables).map(|((low, high), variable)| low + 0.5 * (high - low) * (1.0 + variable.sin())).collect()
}

impl Problem<'_> {
    fn look(&self, variables: &DVector<f64>) -> DVector<f64> {
        DVector::from_vec((self.residuals)(&inside(self.low, self.high, variables)))
    }
}

impl SumOfSquares for Problem<'_> {
    fn variables(&self) -> &DVector<f64> {
        &self.variables
    }

    fn go(&mut self, variables: &DVector<f64>) -> Option<f64> {
        let sum = self.look(variables).norm_squared();
        let sum = if sum.is_finite() { sum } else { f64::MAX.sqrt() };
        self.variables.copy_from(variables);
        if sum < self.best.0 {
            self.best = (sum, variables.clone());
        }
        Some(sum)
    }

    fn normal(&mut self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        self.left = self.left.checked_sub(1)?;
        let residuals = self.look(&self.variables);
        let mut jacobian = DMatrix::zeros(residuals.len(), self.variables.len());
        // Central difference: the cube root of the rounding unit balances truncation against rounding; variables are of
        // order 1.
        let step = f64::EPSILON.cbrt();
        let mut at = self.variables.clone();
        for column in 0..at.len() {
            let middle = at[column];
            at[column] = middle + step;
            let above = self.look(&at);
            at[column] = middle - step;
            let below = self.look(&at);
            at[column] = middle;
            jacobian.set_column(column, &((above - below) / (2.0 * step)));
        }
        let gradient = jacobian.tr_mul(&residuals);
        let gram = jacobian.tr_mul(&jacobian);
        gram.iter().chain(gradient.iter()).all(|number| number.is_finite()).then_some((gram, gradient))
    }
}

/// Minimises the sum of squared `residuals` inside `low..=high`, by descent from `start`. Returns the parameters and
/// that sum.
pub(super) fn fit(low: &[f64], high: &[f64], start: &[f64], residuals: &dyn Fn(&[f64]) -> Vec<f64>) -> (Vec<f64>, f64) {
    let variable = |(place, value): (usize, &f64)| {
        let share: f64 = 2.0 * (value - low[place]) / (high[place] - low[place]) - 1.0;
        // At a bound the mapping has slope 0, and the search would not leave it.
        share.clamp(-0.99, 0.99).asin()
    };
    let variables = DVector::from_iterator(start.len(), start.iter().enumerate().map(variable));
    let mut problem =
        Problem { residuals, low, high, best: (f64::INFINITY, variables.clone()), variables, left: JACOBIANS };
    let sum = problem.go(&problem.variables.clone()).unwrap_or(f64::MAX.sqrt());
    minimise(&mut problem, sum, TOLERANCE);
    let (sum, variables) = problem.best;
    (inside(low, high, &variables), sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_minimum_beyond_a_bound_is_at_it() {
        let (found, sum) = fit(&[0.0, 0.0], &[1.0, 5.0], &[0.5, 1.0], &|at| vec![at[0] - 2.0, at[1] - 3.0, 0.0]);
        assert!(
            (found[0] - 1.0).abs() < 1e-6 && (found[1] - 3.0).abs() < 1e-6 && (sum - 1.0).abs() < 1e-6,
            "{found:?}"
        );
    }
}
