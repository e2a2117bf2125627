//! Order statistics: quantiles and the robust estimates made of them.

use super::{StatisticsError, numbers};

/// Ratio of a normal distribution's standard deviation to its median absolute deviation: 1 / Φ⁻¹(3/4).
pub const MAD_TO_DEVIATION: f64 = 1.482_602_218_505_602;

/// Definition of a quantile where no value splits the sample exactly.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum QuantileRule {
    /// Straight between the two values next to position `probability × (n - 1)`: type 7 of Hyndman and Fan, the default of
    /// NumPy and R.
    #[default]
    Linear,
    /// Smallest value that at least `probability` of the sample does not exceed: type 1 of Hyndman and Fan, NumPy's
    /// `inverted_cdf`. The result is always one of the values, so that a reported p99.9 was measured.
    NearestRank,
    /// Value at position `probability × (n - 1)`, rounded half away from zero. The result is always one of the values.
    NearestPosition,
}

/// Returns a quantile of unsorted values; 0 is the least, 1 the greatest. Infinite values are ordered like any other.
///
/// # Errors
/// No value, a NaN, or a `probability` outside 0..=1.
///
/// # Source
/// Hyndman, Fan, "Sample Quantiles in Statistical Packages", The American Statistician 50, 1996, definitions 7 and 1.
///
/// ```
/// use r4_maths::statistics::{QuantileRule, quantile};
/// let times_s = [0.4, 0.1, 0.2, 0.3];
/// assert_eq!(quantile(&times_s, 0.5, QuantileRule::Linear), Ok(0.25));
/// assert_eq!(quantile(&times_s, 0.5, QuantileRule::NearestRank), Ok(0.2));
/// ```
pub fn quantile(values: &[f64], probability: f64, rule: QuantileRule) -> Result<f64, StatisticsError> {
    numbers(values, 1)?;
    if !(0.0..=1.0).contains(&probability) {
        return Err(StatisticsError::Probability(probability));
    }
    let mut values = values.to_vec();
    let position = probability * (values.len() - 1) as f64;
    Ok(match rule {
        QuantileRule::NearestRank => {
            let rank = (probability * values.len() as f64).ceil() as usize;
            nth(&mut values, rank.saturating_sub(1)).0
        }
        QuantileRule::NearestPosition => nth(&mut values, position.round() as usize).0,
        QuantileRule::Linear => {
            let (left, rest) = nth(&mut values, position as usize);
            let share = position.fract();
            let right = rest.iter().copied().min_by(f64::total_cmp).unwrap_or(left);
            // Without the first condition two equal infinite values would give NaN.
            if left == right || share == 0.0 { left } else { left + share * (right - left) }
        }
    })
}

/// Returns the value of sorted data at the nearest rank, as [`QuantileRule::NearestRank`], without a copy; `None`
/// without data.
///
/// For several quantiles of one large sample: sort once. Unsorted data give some other of their values; a `probability`
/// beyond 0..=1 gives the least or greatest.
///
/// # Source
/// Hyndman, Fan 1996 (see [`quantile`]), definition 1.
///
/// ```
/// use r4_maths::statistics::nearest_rank;
/// let sorted: Vec<f64> = (1..=1000).map(f64::from).collect();
/// assert_eq!(nearest_rank(&sorted, 0.999), Some(999.0));
/// assert_eq!(nearest_rank(&[], 0.999), None);
/// ```
#[must_use]
pub fn nearest_rank(sorted: &[f64], probability: f64) -> Option<f64> {
    let rank = (probability * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1).min(sorted.len().checked_sub(1)?)).copied()
}

/// Returns the median: the middle value, or the mean of the middle two.
///
/// # Errors
/// No value, or a NaN.
///
/// # Source
/// ISO 3534-1:2006, 1.13 (sample median).
///
/// ```
/// use r4_maths::statistics::median;
/// assert_eq!(median(&[9.0, 1.0, 2.0]), Ok(2.0));
/// assert_eq!(median(&[1.0, f64::INFINITY, 2.0, 3.0]), Ok(2.5));
/// ```
pub fn median(values: &[f64]) -> Result<f64, StatisticsError> {
    numbers(values, 1)?;
    let mut values = values.to_vec();
    let half = values.len() / 2;
    let is_odd = values.len() % 2 == 1;
    let (right, ..) = nth(&mut values, half);
    if is_odd {
        return Ok(right);
    }
    // Selection has moved everything that is not greater to the left.
    let left = values[..half].iter().copied().max_by(f64::total_cmp).unwrap_or(right);
    Ok(if left == right { left } else { f64::midpoint(left, right) })
}

/// Returns the median absolute deviation (MAD) from the median, without a factor, in the values' unit.
///
/// Up to half of the values may be outliers without much effect. It is 0 if more than half of the values are equal.
///
/// # Errors
/// No value, a NaN, or a median that is infinite.
///
/// # Source
/// Hampel, "The Influence Curve and Its Role in Robust Estimation", Journal of the American Statistical Association 69, 1974.
///
/// ```
/// use r4_maths::statistics::median_absolute_deviation;
/// assert_eq!(median_absolute_deviation(&[1.0, 2.0, 3.0, 4.0, 100.0]), Ok(1.0));
/// ```
pub fn median_absolute_deviation(values: &[f64]) -> Result<f64, StatisticsError> {
    let middle = median(values)?;
    if middle.is_infinite() {
        let index = values.iter().position(|value| value.is_infinite()).unwrap_or(0);
        return Err(StatisticsError::Infinite { index });
    }
    median(&values.iter().map(|value| (value - middle).abs()).collect::<Vec<_>>())
}

/// Returns a robust estimate of the standard deviation: [`MAD_TO_DEVIATION`] times the [`median_absolute_deviation`].
///
/// For normal values it has 37 % of the efficiency of [`super::standard_deviation`], but outliers hardly change it.
///
/// # Errors
/// Those of [`median_absolute_deviation`].
///
/// # Source
/// Rousseeuw, Croux, "Alternatives to the Median Absolute Deviation", Journal of the American Statistical Association 88, 1993.
///
/// ```
/// let spread = r4_maths::statistics::robust_deviation(&[1.0, 2.0, 3.0, 4.0, 100.0]).unwrap();
/// assert!((spread - 1.4826).abs() < 1e-4);
/// ```
pub fn robust_deviation(values: &[f64]) -> Result<f64, StatisticsError> {
    median_absolute_deviation(values).map(|deviation| MAD_TO_DEVIATION * deviation)
}

/// Moves the value of a rank, from 0, to its place, and returns it and those that are not smaller.
fn nth(values: &mut [f64], rank: usize) -> (f64, &mut [f64]) {
    let (_, &mut value, greater) = values.select_nth_unstable_by(rank, f64::total_cmp);
    (value, greater)
}
