//! Root mean squares of values and of differences.

use super::{StatisticsError, finite, moments::squared_deviations, paired};

/// Root mean square (RMS) of values that arrive one after another.
///
/// ```
/// use r4_maths::statistics::RootMeanSquare;
/// let all: RootMeanSquare = [3.0, 4.0].into_iter().collect();
/// assert_eq!((all.count(), all.value()), (2, Some(12.5f64.sqrt())));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RootMeanSquare {
    squares: f64,
    count: usize,
}

impl RootMeanSquare {
    /// Adds a value; one that is not finite makes the result so.
    pub fn push(&mut self, value: f64) {
        self.squares += value * value;
        self.count += 1;
    }

    /// Returns the number of values added.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Returns the RMS, in the values' unit; `None` before the first value.
    #[must_use]
    pub fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.squares / self.count as f64).sqrt())
    }
}

impl Extend<f64> for RootMeanSquare {
    fn extend<I: IntoIterator<Item = f64>>(&mut self, values: I) {
        values.into_iter().for_each(|value| self.push(value));
    }
}

impl FromIterator<f64> for RootMeanSquare {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut all = Self::default();
        all.extend(values);
        all
    }
}

/// Returns the root mean square of values, in their unit.
///
/// # Errors
/// No value, or one that is not finite.
///
/// # Source
/// The definition; [`RootMeanSquare`] is the same for values that arrive one after another.
///
/// ```
/// assert_eq!(r4_maths::statistics::rms(&[1.0, -7.0]), Ok(5.0));
/// ```
pub fn rms(values: &[f64]) -> Result<f64, StatisticsError> {
    finite(values, 1)?;
    Ok(values.iter().copied().collect::<RootMeanSquare>().value().unwrap_or(f64::NAN))
}

/// Returns the root-mean-square error (RMSE) of a prediction, in the unit of the measured values.
///
/// # Errors
/// No pair, a different number of both, or a value that is not finite.
///
/// # Source
/// Ljung, *System Identification: Theory for the User*, 2nd edition, Prentice Hall 1999, 16.4 (model validation).
///
/// ```
/// assert_eq!(r4_maths::statistics::rmse(&[1.0, 2.0], &[2.0, 9.0]), Ok(5.0));
/// ```
pub fn rmse(measured: &[f64], predicted: &[f64]) -> Result<f64, StatisticsError> {
    paired(measured, predicted, 1)?;
    let errors = measured.iter().zip(predicted).map(|(measured, predicted)| measured - predicted);
    Ok(errors.collect::<RootMeanSquare>().value().unwrap_or(f64::NAN))
}

/// Returns the normalised root-mean-square error (NRMSE): [`rmse`] over the standard deviation (divisor n) of the
/// measured values.
///
/// 0 is a perfect prediction, 1 as good as the mean. `100 (1 - nrmse)` is the "fit" in percent of MATLAB's `compare`.
///
/// # Errors
/// Those of [`rmse`], and [`StatisticsError::NoSpread`] where the measured values are constant.
///
/// # Source
/// Ljung, *System Identification: Theory for the User*, 2nd edition, Prentice Hall 1999, 16.4 (model validation).
///
/// ```
/// use r4_maths::statistics::nrmse;
/// assert_eq!(nrmse(&[1.0, 3.0], &[2.0, 2.0]), Ok(1.0));
/// ```
pub fn nrmse(measured: &[f64], predicted: &[f64]) -> Result<f64, StatisticsError> {
    let error = rmse(measured, predicted)?;
    let deviation = (squared_deviations(measured) / measured.len() as f64).sqrt();
    if deviation > 0.0 { Ok(error / deviation) } else { Err(StatisticsError::NoSpread) }
}
