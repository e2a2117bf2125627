//! Linear and nonlinear least squares with standard errors.

mod linear;
mod nonlinear;
pub mod trust_region;

pub use linear::{linear, weighted};
use nalgebra::{DMatrix, DVector};
pub use nonlinear::nonlinear;
use thiserror::Error;

use crate::statistics::{Interval, StatisticsError, student_quantile, two_sided_p};

/// Reason why data or a model cannot be fitted.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FitError {
    /// Observations and rows of the design matrix, or deviations, differ in number.
    #[error("{rows} rows for {observed} observations: give as many of both")]
    Shape {
        /// Number of rows of the design matrix, or of standard deviations.
        rows: usize,
        /// Number of observations given.
        observed: usize,
    },
    /// The model has no parameters.
    #[error("the model has no parameters to fit")]
    NoParameters,
    /// There are not more observations than parameters, so that no residual remains to estimate standard errors from.
    #[error("{observed} observations for {parameters} parameters: more observations than parameters are needed")]
    TooFew {
        /// Number of observations given.
        observed: usize,
        /// Number of parameters to fit.
        parameters: usize,
    },
    /// A number in the data, or in the residuals of the initial guess, is NaN or infinite.
    #[error("row {row} has a number that is not finite: leave it out, or start elsewhere")]
    NotFinite {
        /// Row of the number, from 0.
        row: usize,
    },
    /// A standard deviation is not greater than 0.
    #[error("the standard deviation of row {row} is not greater than 0")]
    Deviation {
        /// Row of the standard deviation, from 0.
        row: usize,
    },
    /// Parameters are collinear: the data determine only combinations of them.
    #[error(
        "the data determine {rank} combinations of {parameters} parameters: fix some, or record what sets them apart"
    )]
    Collinear {
        /// Number of independent combinations.
        rank: usize,
        /// Number of parameters to fit.
        parameters: usize,
    },
    /// The iteration ended without a minimum.
    #[error("no minimum after {evaluations} evaluations: start nearer to it")]
    NotConverged {
        /// Number of evaluations of the residuals, without those of derivatives.
        evaluations: usize,
    },
}

/// Fitted parameters with their covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Estimates, in the order of the columns or of the initial guess.
    pub parameters: DVector<f64>,
    /// Covariance of the estimates: residual variance times (JᵀJ)⁻¹, unless [`Fit::autocorrelated`] replaced it.
    pub covariance: DMatrix<f64>,
    /// Influence of each observation, a row, on the errors of the estimates: (JᵀJ)⁻¹ Jᵢ rᵢ, weighted.
    pub influence: DMatrix<f64>,
    /// Observed minus predicted for linear fits, as the caller computed them for nonlinear ones; not weighted.
    pub residuals: DVector<f64>,
    /// Sum of the squared (weighted) residuals over the degrees of freedom.
    pub residual_variance: f64,
    /// Number of observations minus number of parameters.
    pub degrees_of_freedom: usize,
    /// Condition number of the design matrix or Jacobian with columns of length 1; relative errors of the data may grow by as
    /// much in the parameters.
    pub condition: f64,
}

impl Fit {
    /// Returns the standard error of each parameter, in its unit.
    ///
    /// ```
    /// use nalgebra::DMatrix;
    /// // A mean is the fit of a column of ones.
    /// let fit = r4_maths::least_squares::linear(&DMatrix::repeat(3, 1, 1.0), &[1.0, 2.0, 3.0]).unwrap();
    /// assert!((fit.standard_errors()[0] - 1.0 / 3.0f64.sqrt()).abs() < 1e-12);
    /// ```
    #[must_use]
    pub fn standard_errors(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.sqrt()).collect()
    }

    /// Returns the same fit with a covariance for residuals that are correlated over up to `lag` successive
    /// observations and of unequal variance: unmodelled effects in a time series are seldom white. [`newey_west_lag`]
    /// is the usual choice.
    ///
    /// The correction for few observations is n / (n - p), as in statsmodels.
    ///
    /// # Source
    /// Newey, West, *A Simple, Positive Semi-Definite, Heteroskedasticity and Autocorrelation Consistent Covariance Matrix*,
    /// Econometrica 55 (1987) 703-708.
    ///
    /// ```
    /// use nalgebra::DMatrix;
    /// // Each reading was taken twice: a mean of eight numbers with the information of four.
    /// let twice = [1.0, 1.0, 5.0, 5.0, 2.0, 2.0, 4.0, 4.0];
    /// let fit = r4_maths::least_squares::linear(&DMatrix::repeat(8, 1, 1.0), &twice).unwrap();
    /// let white = fit.standard_errors()[0];
    /// assert!(fit.autocorrelated(1).standard_errors()[0] > white);
    /// ```
    #[must_use]
    pub fn autocorrelated(mut self, lag: usize) -> Self {
        let observed = self.influence.nrows();
        let mut covariance = self.influence.tr_mul(&self.influence);
        for distance in 1..=lag.min(observed.saturating_sub(1)) {
            let rows = observed - distance;
            let product = self.influence.rows(0, rows).tr_mul(&self.influence.rows(distance, rows));
            // Bartlett's weights keep the matrix positive semi-definite.
            let weight = 1.0 - distance as f64 / (lag + 1) as f64;
            covariance += (&product + product.transpose()) * weight;
        }
        self.covariance = covariance * (observed as f64 / self.degrees_of_freedom as f64);
        self
    }

    /// Returns Student's t intervals of all parameters, each by itself; exact for linear fits with normal errors.
    ///
    /// # Errors
    /// A `level` outside 0 < level < 1.
    ///
    /// # Source
    /// Seber, Lee, *Linear Regression Analysis*, 2nd edition, Wiley 2003, 4.3.
    ///
    /// ```
    /// use nalgebra::DMatrix;
    /// let fit = r4_maths::least_squares::linear(&DMatrix::repeat(3, 1, 1.0), &[1.0, 2.0, 3.0]).unwrap();
    /// let mean = r4_maths::statistics::mean_interval(&[1.0, 2.0, 3.0], 0.95).unwrap();
    /// assert!((fit.intervals(0.95).unwrap()[0].high - mean.high).abs() < 1e-12);
    /// ```
    pub fn intervals(&self, level: f64) -> Result<Vec<Interval>, StatisticsError> {
        if !(level > 0.0 && level < 1.0) {
            return Err(StatisticsError::Probability(level));
        }
        let times = student_quantile(self.degrees_of_freedom as f64, f64::midpoint(1.0, level));
        let around = |(value, error): (&f64, f64)| Interval { low: value - times * error, high: value + times * error };
        Ok(self.parameters.iter().zip(self.standard_errors()).map(around).collect())
    }

    /// Returns the two-sided p-value of "this parameter is 0" for each parameter, by Student's t; NaN for a parameter
    /// that fits without any error.
    ///
    /// # Source
    /// As [`Fit::intervals`].
    ///
    /// ```
    /// use nalgebra::DMatrix;
    /// let fit = r4_maths::least_squares::linear(&DMatrix::repeat(4, 1, 1.0), &[1.0, 2.0, -1.0, -2.0]).unwrap();
    /// assert!((fit.p_values()[0] - 1.0).abs() < 1e-12);
    /// ```
    #[must_use]
    pub fn p_values(&self) -> Vec<f64> {
        let of = |(value, error): (&f64, f64)| two_sided_p(value / error, self.degrees_of_freedom as f64);
        self.parameters.iter().zip(self.standard_errors()).map(of).collect()
    }
}

/// Returns a lag for [`Fit::autocorrelated`] that grows slowly enough with the number of observations: the integer part
/// of 4 (n / 100)^(2/9).
///
/// # Source
/// Newey, West, *Automatic Lag Selection in Covariance Matrix Estimation*, Review of Economic Studies 61 (1994) 631-653.
///
/// ```
/// assert_eq!(r4_maths::least_squares::newey_west_lag(100), 4);
/// assert_eq!(r4_maths::least_squares::newey_west_lag(1000), 6);
/// ```
#[must_use]
pub fn newey_west_lag(observed: usize) -> usize {
    (4.0 * (observed as f64 / 100.0).powf(2.0 / 9.0)) as usize
}

/// Matrix with its columns scaled to length 1, decomposed: the condition of columns with different units has no
/// meaning.
struct Scaled {
    svd: nalgebra::SVD<f64, nalgebra::Dyn, nalgebra::Dyn>,
    lengths: DVector<f64>,
    condition: f64,
}

impl Scaled {
    fn of(matrix: &DMatrix<f64>) -> Result<Self, FitError> {
        let (rows, parameters) = matrix.shape();
        let lengths = DVector::from_iterator(parameters, matrix.column_iter().map(|column| column.norm()));
        let mut scaled = matrix.clone();
        for (mut column, length) in scaled.column_iter_mut().zip(&lengths) {
            if *length > 0.0 {
                column /= *length;
            }
        }
        let svd = scaled.svd(true, true);
        let greatest = svd.singular_values.max();
        // A singular value of 0 is at most this large after rounding (Golub, Van Loan, Matrix Computations, 4th
        // edition, 5.4.1).
        let rank = svd.rank(rows.max(parameters) as f64 * f64::EPSILON * greatest);
        if rank < parameters {
            return Err(FitError::Collinear { rank, parameters });
        }
        let condition = greatest / svd.singular_values.min();
        Ok(Self { svd, lengths, condition })
    }

    /// Returns the parameters with the least sum of squares.
    fn solve(&self, observed: &DVector<f64>) -> Option<DVector<f64>> {
        Some(self.svd.solve(observed, 0.0).ok()?.component_div(&self.lengths))
    }

    /// Returns the rows (JᵀJ)⁻¹ Jᵢ rᵢ of the scaled matrix J.
    fn influence(&self, matrix: &DMatrix<f64>, residuals: &DVector<f64>) -> DMatrix<f64> {
        let mut rows = matrix * self.inverse_gram();
        for (mut row, residual) in rows.row_iter_mut().zip(residuals) {
            row *= *residual;
        }
        rows
    }

    /// Returns the inverse (JᵀJ)⁻¹ of the scaled matrix J.
    fn inverse_gram(&self) -> DMatrix<f64> {
        let count = self.lengths.len();
        let Some(mut rows) = self.svd.v_t.clone() else { return DMatrix::zeros(count, count) };
        for (mut row, value) in rows.row_iter_mut().zip(&self.svd.singular_values) {
            row /= *value;
        }
        for (mut column, length) in rows.column_iter_mut().zip(&self.lengths) {
            column /= *length;
        }
        rows.tr_mul(&rows)
    }
}
