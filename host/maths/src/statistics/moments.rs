//! Moments: mean and variance.

use super::{StatisticsError, finite};

/// Returns the arithmetic mean.
///
/// # Errors
/// No value, or one that is not finite.
///
/// # Source
/// ISO 3534-1:2006, 1.15 (sample mean).
///
/// ```
/// assert_eq!(r4_maths::statistics::mean(&[1.0, 2.0, 6.0]), Ok(3.0));
/// ```
pub fn mean(values: &[f64]) -> Result<f64, StatisticsError> {
    finite(values, 1)?;
    Ok(values.iter().sum::<f64>() / values.len() as f64)
}

/// Returns the unbiased sample variance: squared deviations from the mean, divided by n - 1. Unit: that of the values,
/// squared.
///
/// # Errors
/// Fewer than two values, or one that is not finite.
///
/// # Source
/// Two passes with the correction of Chan, Golub, LeVeque, "Algorithms for Computing the Sample Variance", The American
/// Statistician 37, 1983, equation (1.7).
///
/// ```
/// assert_eq!(r4_maths::statistics::variance(&[1.0, 2.0, 6.0]), Ok(7.0));
/// ```
pub fn variance(values: &[f64]) -> Result<f64, StatisticsError> {
    finite(values, 2)?;
    Ok(squared_deviations(values) / (values.len() - 1) as f64)
}

/// Returns the square root of the unbiased [`variance`], in the values' unit.
///
/// # Errors
/// Those of [`variance`].
///
/// # Source
/// ISO 3534-1:2006, 1.17 (sample standard deviation).
///
/// ```
/// assert_eq!(r4_maths::statistics::standard_deviation(&[2.0, 4.0, 6.0]), Ok(2.0));
/// ```
pub fn standard_deviation(values: &[f64]) -> Result<f64, StatisticsError> {
    variance(values).map(f64::sqrt)
}

/// Returns the standard error of the mean of independent values: standard deviation over √n, in the values' unit.
///
/// # Errors
/// Those of [`variance`].
///
/// # Source
/// ISO 3534-1:2006, 1.24 (standard error).
///
/// ```
/// assert_eq!(r4_maths::statistics::standard_error(&[1.0, 3.0, 5.0, 7.0]), Ok((20.0f64 / 3.0 / 4.0).sqrt()));
/// ```
pub fn standard_error(values: &[f64]) -> Result<f64, StatisticsError> {
    Ok((variance(values)? / values.len() as f64).sqrt())
}

/// Returns the sum of the squared deviations from the mean, of at least one finite value.
pub(super) fn squared_deviations(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let (sum, squares) = values.iter().fold((0.0, 0.0), |(sum, squares), value| {
        let deviation = value - mean;
        (sum + deviation, squares + deviation * deviation)
    });
    // The deviations add up to the mean's rounding error, which this corrects. Rounding must not go below 0.
    (squares - sum * sum / values.len() as f64).max(0.0)
}
