//! Statistics over the values of trials, each with a confidence interval.

use r4_maths::statistics::{
    Alternative, Bootstrap, Interval, QuantileRule, StatisticsError, mcnemar_exact, mean, quantile, standard_deviation,
    wilcoxon_signed_rank, wilson,
};

/// Confidence level of all intervals.
const CONFIDENCE: f64 = 0.95;
/// Seed of the bootstrap resamples: the same records always give the same row.
const RESAMPLES_SEED: u64 = 2023;

/// Statistic that makes one number of the values of trials.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Statistic {
    /// Arithmetic mean of the values.
    Mean,
    /// Quantile of this probability: 0.5 is the median.
    Quantile(f64),
    /// Sample standard deviation (divisor n - 1).
    Deviation,
    /// Share of trials whose value is 1; the values of the others are 0.
    Share,
}

/// A statistic with its confidence interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Statistic over all trials.
    pub value: f64,
    /// 95 % confidence interval.
    pub interval: Interval,
    /// Name of the statistic and of the interval's method.
    pub method: &'static str,
}

impl Statistic {
    /// Computes the statistic of `values`, one for each trial.
    ///
    /// # Errors
    /// [`StatisticsError::TooFew`] for fewer than two values, which have no interval; another [`StatisticsError`] for a
    /// value that is not finite.
    pub fn of(self, values: &[f64]) -> Result<Summary, StatisticsError> {
        if values.len() < 2 {
            return Err(StatisticsError::TooFew { got: values.len(), need: 2 });
        }
        match self {
            Self::Share => {
                let successes = values.iter().filter(|value| **value == 1.0).count() as u64;
                let interval = wilson(successes, values.len() as u64, CONFIDENCE)?;
                Ok(Summary { value: mean(values)?, interval, method: "share, Wilson 95 %" })
            }
            Self::Deviation => resampled(values, "standard deviation, bootstrap 95 %", standard_deviation),
            Self::Mean => resampled(values, "mean, bootstrap 95 %", mean),
            Self::Quantile(probability) => {
                let method = if probability == 0.5 { "median, bootstrap 95 %" } else { "quantile, bootstrap 95 %" };
                resampled(values, method, |values| quantile(values, probability, QuantileRule::Linear))
            }
        }
    }

    /// Two-sided p-value of "both arms are alike" for values of the same seeds in the same order: McNemar's exact test
    /// for shares, Wilcoxon's signed-rank test otherwise. `None` without a pair; 1 where all pairs are equal.
    #[must_use]
    // McNemar's test uses only the seeds in which exactly one of the arms succeeded.
    pub fn paired_p(self, first: &[f64], second: &[f64]) -> Option<f64> {
        if first.is_empty() || first.len() != second.len() {
            return None;
        }
        if self == Self::Share {
            let only = |mine: &[f64], other: &[f64]| {
                mine.iter().zip(other).filter(|(mine, other)| **mine == 1.0 && **other == 0.0).count() as u64
            };
            return Some(mcnemar_exact(only(first, second), only(second, first)));
        }
        match wilcoxon_signed_rank(first, second, Alternative::TwoSided) {
            Ok(test) => Some(test.p_value),
            Err(StatisticsError::NoSpread) => Some(1.0),
            Err(_) => None,
        }
    }
}

fn resampled(
    values: &[f64],
    method: &'static str,
    statistic: impl Fn(&[f64]) -> Result<f64, StatisticsError>,
) -> Result<Summary, StatisticsError> {
    let estimate = Bootstrap::new(RESAMPLES_SEED).percentile(values, |values| statistic(values).unwrap_or(f64::NAN))?;
    Ok(Summary { value: estimate.value, interval: estimate.interval, method })
}
