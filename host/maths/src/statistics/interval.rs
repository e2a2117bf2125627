//! Confidence intervals with a closed form.

use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use super::{StatisticsError, confidence, mean, standard_error};

/// Interval between two ends, in the unit of its quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Interval {
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end of the interval.
    pub high: f64,
}

impl Interval {
    /// Returns whether a value lies in the interval, ends included.
    ///
    /// ```
    /// let interval = r4_maths::statistics::Interval { low: 1.0, high: 2.0 };
    /// assert!(interval.contains(2.0) && !interval.contains(f64::NAN));
    /// ```
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }

    /// Returns the distance between the ends.
    #[must_use]
    pub fn width(&self) -> f64 {
        self.high - self.low
    }
}

/// Returns the Wilson score interval of a share, such as of seeds that succeeded; 0.95 as `level` for 95 % confidence.
///
/// It stays within 0..=1 and has a width at 0 and at all successes, where the normal approximation has none. Without a
/// trial it is all of 0..=1.
///
/// # Errors
/// More successes than trials, or a `level` outside 0 < level < 1.
///
/// # Source
/// Wilson, "Probable Inference, the Law of Succession, and Statistical Inference", Journal of the American Statistical
/// Association 22, 1927; recommended by Brown, Cai, DasGupta, "Interval Estimation for a Binomial Proportion", Statistical
/// Science 16, 2001. Without continuity correction.
///
/// ```
/// let interval = r4_maths::statistics::wilson(9, 10, 0.95).unwrap();
/// assert!((interval.low - 0.596).abs() < 0.001 && (interval.high - 0.982).abs() < 0.001);
/// ```
pub fn wilson(successes: u64, trials: u64, level: f64) -> Result<Interval, StatisticsError> {
    confidence(level)?;
    if successes > trials {
        return Err(StatisticsError::Share { successes, trials });
    }
    if trials == 0 {
        return Ok(Interval { low: 0.0, high: 1.0 });
    }
    let z = normal_quantile(f64::midpoint(1.0, level));
    let (count, share) = (trials as f64, successes as f64 / trials as f64);
    let shrink = 1.0 + z * z / count;
    let middle = (share + z * z / (2.0 * count)) / shrink;
    let half = z / shrink * (share * (1.0 - share) / count + z * z / (4.0 * count * count)).sqrt();
    // Exact at the ends, where rounding would leave 1e-17 instead of 0 and less than 1.
    let low = if successes == 0 { 0.0 } else { (middle - half).max(0.0) };
    let high = if successes == trials { 1.0 } else { (middle + half).min(1.0) };
    Ok(Interval { low, high })
}

/// Returns Student's t interval of the mean of independent, about normal values, in their unit.
///
/// # Errors
/// Fewer than two values, one that is not finite, or a `level` outside 0 < level < 1.
///
/// # Source
/// Student, "The Probable Error of a Mean", Biometrika 6, 1908.
///
/// ```
/// let interval = r4_maths::statistics::mean_interval(&[1.0, 2.0, 3.0], 0.95).unwrap();
/// // 4.3027 is the 97.5 % quantile of Student's t with 2 degrees of freedom.
/// assert!((interval.high - (2.0 + 4.3027 / 3.0f64.sqrt())).abs() < 1e-4);
/// ```
pub fn mean_interval(values: &[f64], level: f64) -> Result<Interval, StatisticsError> {
    confidence(level)?;
    let error = standard_error(values)?;
    let middle = mean(values)?;
    let half = student_quantile((values.len() - 1) as f64, f64::midpoint(1.0, level)) * error;
    Ok(Interval { low: middle - half, high: middle + half })
}

/// Returns the standard normal value below which this probability lies.
pub(super) fn normal_quantile(probability: f64) -> f64 {
    Normal::standard().inverse_cdf(probability)
}

/// Returns the probability below a standard normal value.
pub(super) fn normal_probability(value: f64) -> f64 {
    Normal::standard().cdf(value)
}

/// Returns the value of Student's t below which this probability lies; NaN without a degree of freedom.
pub(crate) fn student_quantile(degrees_of_freedom: f64, probability: f64) -> f64 {
    StudentsT::new(0.0, 1.0, degrees_of_freedom).map_or(f64::NAN, |student| student.inverse_cdf(probability))
}

/// Returns the probability of a Student's t at least as far from 0; NaN for a NaN or without a degree of freedom.
#[cfg(feature = "matrices")]
pub(crate) fn two_sided_p(t: f64, degrees_of_freedom: f64) -> f64 {
    if t.is_nan() {
        return f64::NAN;
    }
    StudentsT::new(0.0, 1.0, degrees_of_freedom).map_or(f64::NAN, |student| (2.0 * student.cdf(-t.abs())).min(1.0))
}
