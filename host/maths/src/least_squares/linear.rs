//! Models that are linear in their parameters.

use nalgebra::{DMatrix, DVector};

use super::{Fit, FitError, Scaled};

/// Fits by ordinary least squares: the parameters of `observed ≈ design × parameters`.
///
/// | name | shape | unit |
/// | --- | --- | --- |
/// | `design` | observations × parameters | that of an observation over that of the column's parameter |
/// | `observed` | observations | the same for all |
///
/// Columns may be of any scale; they are decomposed (SVD) with length 1. The standard errors of the parameters assume
/// independent residuals of equal variance.
///
/// # Errors
/// [`FitError`], all but [`FitError::Deviation`].
///
/// # Source
/// Golub, Van Loan, *Matrix Computations*, 4th edition, Johns Hopkins 2013, 5.5; covariance: Seber, Lee, *Linear Regression
/// Analysis*, 2nd edition, Wiley 2003, 3.2.
///
/// ```
/// use nalgebra::DMatrix;
/// // Speed over voltage, with an offset for friction.
/// let volts = [2.0, 4.0, 6.0, 8.0];
/// let rad_s = [9.9, 30.2, 49.8, 70.1];
/// let design = DMatrix::from_fn(4, 2, |row, column| if column == 0 { volts[row] } else { 1.0 });
/// let fit = r4_maths::least_squares::linear(&design, &rad_s).unwrap();
/// assert!((fit.parameters[0] - 10.01).abs() < 1e-9 && (fit.parameters[1] + 10.05).abs() < 1e-9);
/// ```
pub fn linear(design: &DMatrix<f64>, observed: &[f64]) -> Result<Fit, FitError> {
    fit(design, observed, None)
}

/// Fits by weighted least squares: as [`linear`], for observations of different standard deviations.
///
/// Only the ratios of the standard deviations matter: their common factor is estimated from the residuals, in
/// [`Fit::residual_variance`].
///
/// # Errors
/// [`FitError`].
///
/// # Source
/// Seber, Lee, *Linear Regression Analysis*, 2nd edition, Wiley 2003, 3.10.
///
/// ```
/// use nalgebra::DMatrix;
/// let ones = DMatrix::repeat(3, 1, 1.0);
/// // The third sensor has nearly no weight.
/// let fit = r4_maths::least_squares::weighted(&ones, &[1.0, 3.0, 99.0], &[0.1, 0.1, 1e6]).unwrap();
/// assert!((fit.parameters[0] - 2.0).abs() < 1e-6);
/// ```
pub fn weighted(design: &DMatrix<f64>, observed: &[f64], deviations: &[f64]) -> Result<Fit, FitError> {
    if deviations.len() != observed.len() {
        return Err(FitError::Shape { rows: deviations.len(), observed: observed.len() });
    }
    if let Some(row) = deviations.iter().position(|deviation| !(*deviation > 0.0 && deviation.is_finite())) {
        return Err(FitError::Deviation { row });
    }
    fit(design, observed, Some(deviations))
}

fn fit(design: &DMatrix<f64>, observed: &[f64], deviations: Option<&[f64]>) -> Result<Fit, FitError> {
    let (rows, parameters) = design.shape();
    if rows != observed.len() {
        return Err(FitError::Shape { rows, observed: observed.len() });
    }
    if parameters == 0 {
        return Err(FitError::NoParameters);
    }
    if rows <= parameters {
        return Err(FitError::TooFew { observed: rows, parameters });
    }
    let is_finite = |row: &usize| observed[*row].is_finite() && design.row(*row).iter().all(|value| value.is_finite());
    if let Some(row) = (0..rows).find(|row| !is_finite(row)) {
        return Err(FitError::NotFinite { row });
    }
    let observed = DVector::from_column_slice(observed);
    let weights = deviations.map(|deviations| DVector::from_iterator(rows, deviations.iter().map(|it| 1.0 / it)));
    let (mut left, mut right) = (design.clone(), observed.clone());
    if let Some(weights) = &weights {
        left.column_iter_mut().for_each(|mut column| column.component_mul_assign(weights));
        right.component_mul_assign(weights);
    }
    let scaled = Scaled::of(&left)?;
    let collinear = FitError::Collinear { rank: 0, parameters };
    let mut estimates = scaled.solve(&right).ok_or(collinear)?;
    // One step of iterative refinement: it gains a digit or two for ill-conditioned designs.
    estimates += scaled.solve(&(&right - &left * &estimates)).ok_or(collinear)?;
    let residuals = observed - design * &estimates;
    let weighted = weights.map_or_else(|| residuals.clone(), |weights| residuals.component_mul(&weights));
    let degrees_of_freedom = rows - parameters;
    let residual_variance = weighted.norm_squared() / degrees_of_freedom as f64;
    Ok(Fit {
        parameters: estimates,
        covariance: scaled.inverse_gram() * residual_variance,
        influence: scaled.influence(&left, &weighted),
        residuals,
        residual_variance,
        degrees_of_freedom,
        condition: scaled.condition,
    })
}
