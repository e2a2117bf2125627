//! Levenberg-Marquardt on the normal equations, for problems that sum them themselves.
//!
//! A model of many recordings has a few common parameters and, for each recording, some of its own. The rows of a
//! recording are zero in the columns of all others. A QR decomposition of the whole Jacobian costs the square of all
//! columns for each row, and needs all rows in memory. A problem that adds up `JᵀJ` one recording at a time needs
//! neither.
//!
//! The normal equations square the condition number. Columns are scaled to length one before, and a step only has to
//! reduce the cost: the loss is speed, in directions in which the data have less than a millionth of the information of
//! others.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Ridge on the diagonal of the scaled normal equations, about as large as their rounding, so that unobservable
/// directions have a step.
const RIDGE: f64 = 1e-13;
/// Tolerance of a step's length to the trust region's radius, as a share of it.
const ON_EDGE: f64 = 0.1;
/// Maximum number of damping values for one step.
const DAMPINGS: usize = 10;
/// Lowest accepted gain of a step, as a share of the predicted one.
const LEAST_RATIO: f64 = 1e-4;

/// Sum of squares to be minimised: half the sum of squares of residuals that depend on variables.
pub trait SumOfSquares {
    /// Returns the present values of the variables.
    fn variables(&self) -> &DVector<f64>;

    /// Sets the variables and returns the sum of squares there; `None` ends the search at this point.
    fn go(&mut self, variables: &DVector<f64>) -> Option<f64>;

    /// Returns `JᵀJ` and `Jᵀr` at the present values, of the Jacobian `J` and the residuals `r`; `None` ends the
    /// search.
    fn normal(&mut self) -> Option<(DMatrix<f64>, DVector<f64>)>;
}

/// Minimises a sum of squares from the present values, with `sum` there, until a step gains less than `tolerance` of
/// the sum or is shorter than `tolerance` of the variables, or the problem ends it. The first step is at most as long
/// as the vector of variables.
///
/// The problem ends at the last point that was tried, which may be worse than the best one: the problem has to remember
/// that.
///
/// # Source
/// Moré, "The Levenberg-Marquardt Algorithm: Implementation and Theory", in *Numerical Analysis*, Springer 1978, whose rules for the
/// radius and the damping these are; `JᵀJ` in place of the QR decomposition.
pub fn minimise(problem: &mut impl SumOfSquares, mut sum: f64, tolerance: f64) {
    let mut scales = DVector::zeros(problem.variables().len());
    let (mut radius, mut damping) = (f64::NAN, 0.0);
    while let Some((gram, gradient)) = problem.normal() {
        let at = problem.variables().clone();
        for (scale, square) in scales.iter_mut().zip(gram.diagonal().iter()) {
            *scale = square.sqrt().max(*scale);
        }
        // A variable without influence keeps its value.
        let scales_or_one = scales.map(|scale| if scale > 0.0 { scale } else { 1.0 });
        let mut is_first = radius.is_nan();
        if is_first {
            let length = at.component_mul(&scales_or_one).norm();
            radius = if length > 0.0 { length } else { 1.0 };
        }
        let Some(scaled) = Scaled::of(&gram, &gradient, &scales_or_one) else { return };
        loop {
            let Some(step) = scaled.step(radius, &mut damping) else { return };
            let length = step.norm();
            if is_first {
                (radius, is_first) = (radius.min(length), false);
            }
            let along = step.dot(&(&scaled.gram * &step));
            let predicted = (along + 2.0 * damping * length * length) / sum;
            let slope = -(along + damping * length * length) / sum;
            let next = &at + step.component_div(&scales_or_one);
            let Some(after) = problem.go(&next) else { return };
            let gained = if after < 100.0 * sum { 1.0 - after / sum } else { -1.0 };
            let ratio = if predicted > 0.0 { gained / predicted } else { 0.0 };
            if ratio <= 0.25 {
                let shrink = if gained >= 0.0 { 0.5 } else { 0.5 * slope / (slope + 0.5 * gained) };
                let shrink = if after >= 100.0 * sum || shrink < 0.1 { 0.1 } else { shrink };
                radius = shrink * radius.min(10.0 * length);
                damping /= shrink;
            } else if damping == 0.0 || ratio >= 0.75 {
                radius = 2.0 * length;
                damping *= 0.5;
            }
            let is_taken = ratio >= LEAST_RATIO;
            let is_flat = gained.abs() <= tolerance && predicted <= tolerance && ratio <= 2.0;
            let is_short = radius <= tolerance * next.component_mul(&scales_or_one).norm();
            if is_taken {
                sum = after;
            }
            if is_flat || is_short || radius.is_nan() {
                return;
            }
            if is_taken {
                break;
            }
        }
    }
}

/// Normal equations in variables that are multiplied by their scales.
struct Scaled {
    gram: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl Scaled {
    /// Scales the equations; `None` at a stationary point, and where a number is not finite.
    fn of(gram: &DMatrix<f64>, gradient: &DVector<f64>, scales: &DVector<f64>) -> Option<Self> {
        let gram = DMatrix::from_fn(gram.nrows(), gram.ncols(), |row, column| {
            gram[(row, column)] / (scales[row] * scales[column])
        });
        let gradient = gradient.component_div(scales);
        let is_usable = gradient.norm() > 0.0 && gradient.norm().is_finite() && gram.iter().all(|one| one.is_finite());
        is_usable.then_some(Self { gram, gradient })
    }

    fn damped(&self, damping: f64) -> Option<Cholesky<f64, Dyn>> {
        let mut damped = self.gram.clone();
        for place in 0..damped.nrows() {
            damped[(place, place)] += damping + RIDGE;
        }
        Cholesky::new(damped)
    }

    /// Returns the step to the minimum of the quadratic model within a radius, and changes the damping that keeps it
    /// there.
    fn step(&self, radius: f64, damping: &mut f64) -> Option<DVector<f64>> {
        // Returns the step, its excess length, and the relative change of the damping by Newton's rule on the length.
        let at = |cholesky: Cholesky<f64, Dyn>| {
            let step = -cholesky.solve(&self.gradient);
            let length = step.norm();
            let excess = length - radius;
            let mut slope = &step / length;
            cholesky.l_dirty().solve_lower_triangular_mut(&mut slope);
            (step, excess, excess / radius / slope.norm_squared())
        };
        let largest = self.gradient.norm() / radius;
        let mut least = 0.0;
        if let Some(cholesky) = self.damped(0.0) {
            let (step, excess, change) = at(cholesky);
            if excess <= ON_EDGE * radius {
                *damping = 0.0;
                return Some(step);
            }
            if change.is_finite() {
                least = change * radius / (radius + excess);
            }
        }
        let (mut lower, mut upper) = (least, largest.max(f64::MIN_POSITIVE));
        *damping = damping.max(lower).min(upper);
        if *damping == 0.0 {
            *damping = 1e-3 * upper;
        }
        let mut best = None;
        for _ in 0..DAMPINGS {
            let Some(cholesky) = self.damped(*damping) else {
                *damping *= 10.0;
                continue;
            };
            let (step, excess, change) = at(cholesky);
            let is_near = excess.abs() <= ON_EDGE * radius;
            best = Some(step);
            if is_near || !change.is_finite() {
                break;
            }
            if excess > 0.0 {
                lower = f64::max(lower, *damping);
            } else {
                upper = upper.min(*damping);
            }
            *damping = f64::max(lower, *damping + change);
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Residuals as a function, with derivatives by differences, as a problem of one recording.
    struct Residuals<F> {
        of: F,
        at: DVector<f64>,
        looks: usize,
    }

    impl<F: Fn(&[f64]) -> Vec<f64>> Residuals<F> {
        fn minimised(of: F, start: &[f64]) -> Self {
            let mut problem = Self { of, at: DVector::from_column_slice(start), looks: 500 };
            let sum = problem.sum();
            minimise(&mut problem, sum, 1e-12);
            problem
        }

        fn sum(&self) -> f64 {
            (self.of)(self.at.as_slice()).iter().map(|residual| residual * residual).sum()
        }
    }

    impl<F: Fn(&[f64]) -> Vec<f64>> SumOfSquares for Residuals<F> {
        fn variables(&self) -> &DVector<f64> {
            &self.at
        }

        fn go(&mut self, variables: &DVector<f64>) -> Option<f64> {
            self.looks = self.looks.checked_sub(1)?;
            self.at.copy_from(variables);
            Some(self.sum())
        }

        fn normal(&mut self) -> Option<(DMatrix<f64>, DVector<f64>)> {
            let here = DVector::from_vec((self.of)(self.at.as_slice()));
            let columns: Vec<DVector<f64>> = (0..self.at.len())
                .map(|column| {
                    let step = 1e-7 * self.at[column].abs().max(1.0);
                    let mut other = self.at.clone();
                    other[column] += step;
                    (DVector::from_vec((self.of)(other.as_slice())) - &here) / step
                })
                .collect();
            let jacobian = DMatrix::from_columns(&columns);
            Some((jacobian.tr_mul(&jacobian), jacobian.tr_mul(&here)))
        }
    }

    /// Known minima: More, Garbow and Hillstrom, "Testing Unconstrained Optimization Software", ACM Transactions on
    /// Mathematical Software 7 (1981), 17-41: problems 1, 3, 13 and 15, from their usual starts; their least sums.
    #[test]
    fn known_minima_are_found() {
        let rosenbrock = |x: &[f64]| vec![10.0 * (x[1] - x[0] * x[0]), 1.0 - x[0]];
        let done = Residuals::minimised(rosenbrock, &[-1.2, 1.0]);
        assert!(done.sum() < 1e-20, "Rosenbrock: {:?}, {} looks left", done.at, done.looks);

        let powell_scaled = |x: &[f64]| vec![1e4 * x[0] * x[1] - 1.0, (-x[0]).exp() + (-x[1]).exp() - 1.0001];
        let done = Residuals::minimised(powell_scaled, &[0.0, 1.0]);
        assert!(done.sum() < 1e-12, "Powell's badly scaled: {:?} leaves {}", done.at, done.sum());

        // The Jacobian is singular at the minimum.
        let powell = |x: &[f64]| {
            let far = 10.0_f64.sqrt() * (x[0] - x[3]).powi(2);
            vec![x[0] + 10.0 * x[1], 5.0_f64.sqrt() * (x[2] - x[3]), (x[1] - 2.0 * x[2]).powi(2), far]
        };
        let done = Residuals::minimised(powell, &[3.0, -1.0, 0.0, 1.0]);
        assert!(done.sum() < 1e-12, "Powell's singular: {:?} leaves {}", done.at, done.sum());

        let seen = [0.1957, 0.1947, 0.1735, 0.1600, 0.0844, 0.0627, 0.0456, 0.0342, 0.0323, 0.0235, 0.0246];
        let at = [4.0, 2.0, 1.0, 0.5, 0.25, 0.167, 0.125, 0.1, 0.0833, 0.0714, 0.0625];
        let kowalik = |x: &[f64]| {
            let model = |u: f64| x[0] * (u * u + u * x[1]) / (u * u + u * x[2] + x[3]);
            seen.iter().zip(at).map(|(seen, u)| seen - model(u)).collect()
        };
        let done = Residuals::minimised(kowalik, &[0.25, 0.39, 0.415, 0.39]);
        assert!((done.sum() - 3.07505e-4).abs() < 1e-9, "Kowalik and Osborne: {} at {:?}", done.sum(), done.at);
    }

    #[test]
    fn what_changes_nothing_keeps_its_place() {
        let line = |x: &[f64]| [1.0, 2.0, 3.0, 4.0].map(|t| x[0] * t + x[2] - (3.0 * t + 0.5)).to_vec();
        let done = Residuals::minimised(line, &[1.0, 7.0, 0.0]);
        assert!(done.sum() < 1e-20 && done.at[1] == 7.0, "{:?}", done.at);
        // Only the sum of two variables has an influence: any values of them are right, as long as the search ends and
        // they are finite.
        let sum = |x: &[f64]| [1.0, 2.0, 3.0].map(|t| (x[0] + x[1]) * t - 6.0 * t).to_vec();
        let done = Residuals::minimised(sum, &[1.0, 2.0]);
        assert!(done.sum() < 1e-16 && done.at.amax() < 10.0, "{:?}", done.at);
    }

    #[test]
    fn a_minimum_and_a_problem_that_ends_it_stay_where_they_are() {
        let line = |x: &[f64]| vec![x[0] - 2.0, 0.0];
        let done = Residuals::minimised(line, &[2.0]);
        assert_eq!((done.at[0], done.looks), (2.0, 500));
        let mut ended = Residuals { of: line, at: DVector::from_element(1, 5.0), looks: 0 };
        minimise(&mut ended, 9.0, 1e-6);
        assert_eq!(ended.at[0], 5.0);
    }
}
