//! Correction of p-values for several tests of one study.

use super::{StatisticsError, numbers};

/// Returns p-values corrected by Holm's method, in the order given: with them all tests together reject a true
/// hypothesis with at most the level's probability.
///
/// # Errors
/// A value that is NaN, or not a probability.
///
/// # Source
/// Holm, "A Simple Sequentially Rejective Multiple Test Procedure", Scandinavian Journal of Statistics 6, 1979.
///
/// ```
/// let corrected = r4_maths::statistics::holm(&[0.04, 0.01, 0.03]).unwrap();
/// assert!((corrected[1] - 0.03).abs() < 1e-12 && corrected[0] == corrected[2]);
/// ```
pub fn holm(p_values: &[f64]) -> Result<Vec<f64>, StatisticsError> {
    numbers(p_values, 0)?;
    if let Some(bad) = p_values.iter().find(|p| !(0.0..=1.0).contains(*p)) {
        return Err(StatisticsError::Probability(*bad));
    }
    let mut places: Vec<usize> = (0..p_values.len()).collect();
    places.sort_by(|a, b| p_values[*a].total_cmp(&p_values[*b]));
    let mut corrected = vec![0.0; p_values.len()];
    let mut least: f64 = 0.0;
    for (rank, place) in places.into_iter().enumerate() {
        // A hypothesis is rejected only after all with smaller p-values.
        least = least.max(((p_values.len() - rank) as f64 * p_values[place]).min(1.0));
        corrected[place] = least;
    }
    Ok(corrected)
}
