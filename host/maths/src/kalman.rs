//! Kalman filter, linear and extended.

use nalgebra::{DMatrix, DVector};
use thiserror::Error;

/// Error of a step that was not carried out; the filter is unchanged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum KalmanError {
    /// A matrix or vector does not fit the state or the measurement.
    #[error("{what} is {rows} × {columns}, and {expected_rows} × {expected_columns} is needed")]
    Shape {
        /// Name of the matrix or vector.
        what: &'static str,
        /// Number of its rows.
        rows: usize,
        /// Number of its columns.
        columns: usize,
        /// Number of rows that fit.
        expected_rows: usize,
        /// Number of columns that fit.
        expected_columns: usize,
    },
    /// A number that is NaN or infinite.
    #[error("{what} has a number that is not finite")]
    NotFinite {
        /// Name of the matrix or vector.
        what: &'static str,
    },
    /// The covariance of the innovation is not positive definite.
    #[error("the innovation has no positive definite covariance: give the measurement some noise")]
    Singular,
}

/// State estimate and its covariance.
///
/// Units are the caller's: a covariance has those of two of the state's elements, multiplied.
///
/// ```
/// use nalgebra::{DMatrix, DVector};
/// use r4_maths::kalman::Kalman;
/// // Position (m) and speed (m/s) by measured positions.
/// let mut filter = Kalman::new(DVector::zeros(2), DMatrix::identity(2, 2) * 10.0).unwrap();
/// let step_s = 0.1;
/// let transition = DMatrix::from_row_slice(2, 2, &[1.0, step_s, 0.0, 1.0]);
/// let process = DMatrix::from_diagonal_element(2, 2, 1e-6);
/// let (position, noise) = (DMatrix::from_row_slice(1, 2, &[1.0, 0.0]), DMatrix::from_element(1, 1, 1e-4));
/// for step in 1..=50 {
///     filter.predict(&transition, &process).unwrap();
///     let measured_m = DVector::from_element(1, 0.5 * step_s * f64::from(step));
///     filter.update(&measured_m, &position, &noise).unwrap();
/// }
/// assert!((filter.state()[1] - 0.5).abs() < 0.01);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Kalman {
    state: DVector<f64>,
    covariance: DMatrix<f64>,
}

/// Comparison of a measurement with its prediction.
#[derive(Clone, Debug, PartialEq)]
pub struct Innovation {
    /// Residual: measured minus predicted.
    pub residual: DVector<f64>,
    /// Covariance of the residual.
    pub covariance: DMatrix<f64>,
    /// Normalised innovation squared: residualᵀ covariance⁻¹ residual, χ² distributed with as many degrees of freedom as the
    /// measurement has elements while the model is right. Gates outliers.
    pub normalised_squared: f64,
    /// Natural logarithm of the measurement's probability density.
    pub log_likelihood: f64,
}

impl Kalman {
    /// Makes a filter that starts at an estimate with this covariance.
    ///
    /// # Errors
    /// [`KalmanError::Shape`] and [`KalmanError::NotFinite`].
    ///
    /// # Source
    /// Kalman, "A New Approach to Linear Filtering and Prediction Problems", Journal of Basic Engineering 82, 1960.
    ///
    /// ```
    /// use nalgebra::{DMatrix, DVector};
    /// assert!(r4_maths::kalman::Kalman::new(DVector::zeros(2), DMatrix::identity(3, 3)).is_err());
    /// ```
    pub fn new(state: DVector<f64>, covariance: DMatrix<f64>) -> Result<Self, KalmanError> {
        vector("the state", &state, state.len())?;
        matrix("the state's covariance", &covariance, [state.len(); 2])?;
        Ok(Self { state, covariance })
    }

    /// Returns the state estimate.
    #[must_use]
    pub const fn state(&self) -> &DVector<f64> {
        &self.state
    }

    /// Returns the covariance of the estimate.
    #[must_use]
    pub const fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }

    /// Predicts by a linear model: state ← F state, covariance ← F covariance Fᵀ + `process`.
    ///
    /// For a model with inputs, add their effect and use [`Self::predict_extended`].
    ///
    /// # Errors
    /// [`KalmanError::Shape`] and [`KalmanError::NotFinite`].
    ///
    /// # Source
    /// Thrun, Burgard, Fox, *Probabilistic Robotics*, MIT Press 2005, 3.2.
    ///
    /// ```
    /// use nalgebra::{dmatrix, dvector};
    /// let mut filter = r4_maths::kalman::Kalman::new(dvector![1.0], dmatrix![4.0]).unwrap();
    /// filter.predict(&dmatrix![0.5], &dmatrix![0.25]).unwrap();
    /// assert_eq!((filter.state()[0], filter.covariance()[0]), (0.5, 1.25));
    /// ```
    pub fn predict(&mut self, transition: &DMatrix<f64>, process: &DMatrix<f64>) -> Result<(), KalmanError> {
        matrix("the transition", transition, [self.state.len(); 2])?;
        self.predict_extended(transition * &self.state, transition, process)
    }

    /// Predicts by any model, as an extended Kalman filter: `next` is the state after the model's step, `jacobian` the
    /// derivative of the step at the present state.
    ///
    /// # Errors
    /// [`KalmanError::Shape`] and [`KalmanError::NotFinite`].
    ///
    /// # Source
    /// Thrun, Burgard, Fox, *Probabilistic Robotics*, MIT Press 2005, 3.3.
    ///
    /// ```
    /// use nalgebra::{dmatrix, dvector};
    /// let mut filter = r4_maths::kalman::Kalman::new(dvector![0.2], dmatrix![0.01]).unwrap();
    /// let angle = filter.state()[0];
    /// filter.predict_extended(dvector![angle.sin()], &dmatrix![angle.cos()], &dmatrix![0.0]).unwrap();
    /// assert_eq!(filter.state()[0], 0.2f64.sin());
    /// ```
    pub fn predict_extended(
        &mut self,
        next: DVector<f64>,
        jacobian: &DMatrix<f64>,
        process: &DMatrix<f64>,
    ) -> Result<(), KalmanError> {
        let count = self.state.len();
        vector("the predicted state", &next, count)?;
        matrix("the transition", jacobian, [count; 2])?;
        matrix("the process noise", process, [count; 2])?;
        let covariance = symmetric(jacobian * &self.covariance * jacobian.transpose() + process);
        finite("the covariance", &covariance)?;
        (self.state, self.covariance) = (next, covariance);
        Ok(())
    }

    /// Corrects by a measurement of a linear combination of the state, `observation` × state, with covariance `noise`.
    ///
    /// # Errors
    /// [`KalmanError`].
    ///
    /// # Source
    /// Thrun, Burgard, Fox, *Probabilistic Robotics*, MIT Press 2005, 3.2.
    ///
    /// ```
    /// use nalgebra::{dmatrix, dvector};
    /// let mut filter = r4_maths::kalman::Kalman::new(dvector![1.0], dmatrix![1.0]).unwrap();
    /// let innovation = filter.update(&dvector![3.0], &dmatrix![1.0], &dmatrix![1.0]).unwrap();
    /// let found = dvector![filter.state()[0], filter.covariance()[0], innovation.normalised_squared];
    /// assert!((found - dvector![2.0, 0.5, 2.0]).amax() < 1e-12);
    /// ```
    pub fn update(
        &mut self,
        measured: &DVector<f64>,
        observation: &DMatrix<f64>,
        noise: &DMatrix<f64>,
    ) -> Result<Innovation, KalmanError> {
        vector("the measurement", measured, measured.len())?;
        matrix("the observation", observation, [measured.len(), self.state.len()])?;
        self.update_extended(measured - observation * &self.state, observation, noise)
    }

    /// Corrects by any measurement, as an extended Kalman filter: `residual` is measured minus predicted (wrap angles
    /// first), `jacobian` the derivative of the prediction by the state.
    ///
    /// Joseph's form keeps the covariance symmetric and positive.
    ///
    /// # Errors
    /// [`KalmanError`].
    ///
    /// # Source
    /// Thrun, Burgard, Fox, *Probabilistic Robotics*, MIT Press 2005, 3.3; Bucy, Joseph, *Filtering for Stochastic Processes with
    /// Applications to Guidance*, Wiley 1968.
    ///
    /// ```
    /// use nalgebra::{dmatrix, dvector};
    /// // A robot at x = 3 m, y = 4 m measures 5.2 m to a beacon at the origin.
    /// let mut filter = r4_maths::kalman::Kalman::new(dvector![3.0, 4.0], dmatrix![0.1, 0.0; 0.0, 0.1]).unwrap();
    /// filter.update_extended(dvector![5.2 - 5.0], &dmatrix![0.6, 0.8], &dmatrix![0.1]).unwrap();
    /// assert!((filter.state()[0] - 3.06).abs() < 1e-12 && (filter.state()[1] - 4.08).abs() < 1e-12);
    /// ```
    pub fn update_extended(
        &mut self,
        residual: DVector<f64>,
        jacobian: &DMatrix<f64>,
        noise: &DMatrix<f64>,
    ) -> Result<Innovation, KalmanError> {
        let (count, measured) = (self.state.len(), residual.len());
        vector("the residual", &residual, measured)?;
        matrix("the observation", jacobian, [measured, count])?;
        matrix("the measurement's noise", noise, [measured; 2])?;
        let covariance = symmetric(jacobian * &self.covariance * jacobian.transpose() + noise);
        // The factor serves the gain, the squared residual and the determinant; no inverse is formed.
        let decomposed = covariance.clone().cholesky().ok_or(KalmanError::Singular)?;
        let gain = decomposed.solve(&(jacobian * &self.covariance)).transpose();
        let normalised_squared = residual.dot(&decomposed.solve(&residual));
        let log_determinant = 2.0 * decomposed.l_dirty().diagonal().iter().map(|root| root.ln()).sum::<f64>();
        let constant = measured as f64 * std::f64::consts::TAU.ln();
        // Joseph's form: a sum of two products that are symmetric and positive whatever the rounding of the gain.
        let rest = DMatrix::identity(count, count) - &gain * jacobian;
        let after = symmetric(&rest * &self.covariance * rest.transpose() + &gain * noise * gain.transpose());
        let state = &self.state + &gain * &residual;
        vector("the state", &state, count)?;
        // Both are checked before either is stored, so that an error leaves the filter as it was.
        finite("the covariance", &after)?;
        (self.state, self.covariance) = (state, after);
        let log_likelihood = -0.5 * (normalised_squared + log_determinant + constant);
        Ok(Innovation { residual, covariance, normalised_squared, log_likelihood })
    }
}

/// Returns the mean of the matrix and its transpose, without the difference that rounding makes between both halves.
fn symmetric(matrix: DMatrix<f64>) -> DMatrix<f64> {
    (&matrix + matrix.transpose()) * 0.5
}

fn vector(what: &'static str, vector: &DVector<f64>, expected: usize) -> Result<(), KalmanError> {
    let rows = vector.len();
    if rows != expected {
        return Err(KalmanError::Shape { what, rows, columns: 1, expected_rows: expected, expected_columns: 1 });
    }
    if vector.iter().all(|value| value.is_finite()) { Ok(()) } else { Err(KalmanError::NotFinite { what }) }
}

fn matrix(what: &'static str, matrix: &DMatrix<f64>, expected: [usize; 2]) -> Result<(), KalmanError> {
    let ((rows, columns), [expected_rows, expected_columns]) = (matrix.shape(), expected);
    if [rows, columns] != expected {
        return Err(KalmanError::Shape { what, rows, columns, expected_rows, expected_columns });
    }
    finite(what, matrix)
}

fn finite(what: &'static str, matrix: &DMatrix<f64>) -> Result<(), KalmanError> {
    if matrix.iter().all(|value| value.is_finite()) { Ok(()) } else { Err(KalmanError::NotFinite { what }) }
}
