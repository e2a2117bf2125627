//! Models that are not linear in their parameters.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt, TerminationReason};
use nalgebra::{DMatrix, DVector, Dyn, storage::Owned};

use super::{Fit, FitError, Scaled};

/// Fits by nonlinear least squares: finds the parameters with the least sum of squared `residuals`, from an initial
/// guess.
///
/// `residuals` returns one number for each observation, always the same number of them, of equal standard deviation
/// (divide each by its own). Derivatives are central differences, with steps of 6e-6 of a parameter's magnitude or that
/// of its guess: give a parameter that may be 0 a guess of its scale. The covariance follows from the Jacobian at the
/// minimum, as for a linear model with this slope.
///
/// # Errors
/// [`FitError`], all but [`FitError::Shape`] and [`FitError::Deviation`].
///
/// # Source
/// Moré, "The Levenberg-Marquardt Algorithm: Implementation and Theory", in *Numerical Analysis*, Springer 1978, by the crate
/// `levenberg-marquardt`; steps and covariance: Nocedal, Wright, *Numerical Optimization*, 2nd edition, Springer 2006, 8.1 and
/// 10.1.
///
/// ```
/// // Time constant and final speed of a motor's step response.
/// let time_s = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5f64];
/// let rad_s = time_s.map(|t| 20.0 * (1.0 - (-t / 0.15).exp()));
/// let residuals = |numbers: &[f64]| {
///     time_s.iter().zip(rad_s).map(|(t, speed)| speed - numbers[0] * (1.0 - (-t / numbers[1]).exp())).collect()
/// };
/// let fit = r4_maths::least_squares::nonlinear(&[10.0, 0.3], residuals).unwrap();
/// assert!((fit.parameters[0] - 20.0).abs() < 1e-6 && (fit.parameters[1] - 0.15).abs() < 1e-8);
/// ```
pub fn nonlinear(start: &[f64], residuals: impl Fn(&[f64]) -> Vec<f64>) -> Result<Fit, FitError> {
    let first = residuals(start);
    let (observed, parameters) = (first.len(), start.len());
    if parameters == 0 {
        return Err(FitError::NoParameters);
    }
    if observed <= parameters {
        return Err(FitError::TooFew { observed, parameters });
    }
    if let Some(row) = first.iter().position(|residual| !residual.is_finite()) {
        return Err(FitError::NotFinite { row });
    }
    let scales = start.iter().map(|guess| if *guess == 0.0 { 1.0 } else { guess.abs() }).collect();
    let problem = Problem { residuals: &residuals, at: DVector::from_column_slice(start), scales, observed };
    let (problem, report) = LevenbergMarquardt::new().minimize(problem);
    let not_converged = FitError::NotConverged { evaluations: report.number_of_evaluations };
    // Rounding ended the iteration before its tolerance did: there is no better point.
    let settled = report.termination.was_successful()
        || matches!(report.termination, TerminationReason::NoImprovementPossible(_));
    let (Some(residuals), Some(jacobian)) = (problem.residuals(), problem.jacobian()) else {
        return Err(not_converged);
    };
    if !settled {
        return Err(not_converged);
    }
    let scaled = Scaled::of(&jacobian)?;
    let degrees_of_freedom = observed - parameters;
    let residual_variance = residuals.norm_squared() / degrees_of_freedom as f64;
    Ok(Fit {
        covariance: scaled.inverse_gram() * residual_variance,
        influence: scaled.influence(&jacobian, &residuals),
        parameters: problem.at,
        residuals,
        residual_variance,
        degrees_of_freedom,
        condition: scaled.condition,
    })
}

struct Problem<'r, F> {
    residuals: &'r F,
    at: DVector<f64>,
    /// Scale of each parameter: the lower limit of its step.
    scales: Vec<f64>,
    observed: usize,
}

impl<F: Fn(&[f64]) -> Vec<f64>> Problem<'_, F> {
    /// Returns the residuals at a point; `None` where the model has no finite values.
    fn look(&self, at: &[f64]) -> Option<DVector<f64>> {
        let residuals = (self.residuals)(at);
        let is_usable = residuals.len() == self.observed && residuals.iter().all(|residual| residual.is_finite());
        is_usable.then(|| DVector::from_vec(residuals))
    }
}

impl<F: Fn(&[f64]) -> Vec<f64>> LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_, F> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, at: &DVector<f64>) {
        self.at.copy_from(at);
    }

    fn params(&self) -> DVector<f64> {
        self.at.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        // Larger than any data, so that the iteration goes back and takes a shorter step; the square is still finite.
        Some(self.look(self.at.as_slice()).unwrap_or_else(|| DVector::repeat(self.observed, 1e100)))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let mut jacobian = DMatrix::zeros(self.observed, self.at.len());
        let mut at = self.at.clone();
        for (column, scale) in self.scales.iter().enumerate() {
            let middle = self.at[column];
            // With the cube root the error of a central difference, which grows with the step's square, balances that
            // of rounding.
            let step = f64::EPSILON.cbrt() * middle.abs().max(*scale);
            at[column] = middle + step;
            let above = self.look(at.as_slice())?;
            let high = at[column];
            at[column] = middle - step;
            let below = self.look(at.as_slice())?;
            // The width of the rounded numbers, not twice the step.
            let width = high - at[column];
            at[column] = middle;
            jacobian.set_column(column, &((above - below) / width));
        }
        Some(jacobian)
    }
}
