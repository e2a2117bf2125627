//! Descriptive statistics, confidence intervals and hypothesis tests.
//!
//! Every function refuses NaN by [`StatisticsError::NotANumber`]. Order statistics accept infinite values, which are what a
//! failed run usually counts as; sums and tests refuse them too.

mod bootstrap;
mod hypothesis;
mod interval;
mod moments;
mod multiple;
mod order;
mod power;
mod residuals;

use thiserror::Error;

pub use bootstrap::{Bootstrap, Estimate, bca_interval, percentile_interval};
pub use hypothesis::{Alternative, TTest, Wilcoxon, mcnemar_exact, paired_t, welch_t, wilcoxon_signed_rank};
pub use interval::{Interval, mean_interval, wilson};
#[cfg(feature = "matrices")]
pub(crate) use interval::{student_quantile, two_sided_p};
pub use moments::{mean, standard_deviation, standard_error, variance};
pub use multiple::holm;
pub use order::{
    MAD_TO_DEVIATION, QuantileRule, median, median_absolute_deviation, nearest_rank, quantile, robust_deviation,
};
pub use power::{paired_power, two_sample_power};
pub use residuals::{RootMeanSquare, nrmse, rms, rmse};

/// Error of input for which a statistic is not defined.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum StatisticsError {
    /// Fewer values than the statistic is defined for.
    #[error("{got} values, and at least {need} are needed: record more")]
    TooFew {
        /// Number of values given.
        got: usize,
        /// Number of values needed.
        need: usize,
    },
    /// A value is NaN.
    #[error("value {index} is not a number: leave it out or replace it first")]
    NotANumber {
        /// Position of the value, from 0.
        index: usize,
    },
    /// A value is infinite where only finite ones have a meaning.
    #[error("value {index} is infinite: leave it out, or use the median")]
    Infinite {
        /// Position of the value, from 0.
        index: usize,
    },
    /// Two series that belong together have different lengths.
    #[error("{first} values beside {second}: pairs need as many of both")]
    Unpaired {
        /// Length of the first series.
        first: usize,
        /// Length of the second series.
        second: usize,
    },
    /// A probability or confidence level is outside its range.
    #[error("{0} is not a probability that can be used here: give one between 0 and 1")]
    Probability(f64),
    /// There are more successes than trials.
    #[error("{successes} successes in {trials} trials: swap them?")]
    Share {
        /// Number of successes given.
        successes: u64,
        /// Number of trials given.
        trials: u64,
    },
    /// All values are equal, and the statistic divides by their spread.
    #[error("all values are equal, so that their spread, which the statistic divides by, is 0")]
    NoSpread,
    /// The resampled statistic of a bootstrap is NaN or infinite.
    #[error("the statistic of resample {resample} is not finite: use one that every resample has")]
    Resample {
        /// Number of the resample, from 0.
        resample: usize,
    },
    /// A bootstrap block that is empty or longer than the series.
    #[error("blocks of {block} values of a series of {length}: choose 1 to {length}")]
    Block {
        /// Length of the blocks.
        block: usize,
        /// Length of the series.
        length: usize,
    },
}

/// Checks that there are enough values, and no NaN.
fn numbers(values: &[f64], need: usize) -> Result<(), StatisticsError> {
    if values.len() < need {
        return Err(StatisticsError::TooFew { got: values.len(), need });
    }
    values.iter().position(|value| value.is_nan()).map_or(Ok(()), |index| Err(StatisticsError::NotANumber { index }))
}

/// Checks that there are enough values, all of them finite.
fn finite(values: &[f64], need: usize) -> Result<(), StatisticsError> {
    numbers(values, need)?;
    values.iter().position(|value| value.is_infinite()).map_or(Ok(()), |index| Err(StatisticsError::Infinite { index }))
}

fn paired(first: &[f64], second: &[f64], need: usize) -> Result<(), StatisticsError> {
    if first.len() != second.len() {
        return Err(StatisticsError::Unpaired { first: first.len(), second: second.len() });
    }
    finite(first, need)?;
    finite(second, need)
}

/// Checks that the confidence level is in 0 < confidence < 1.
fn confidence(confidence: f64) -> Result<(), StatisticsError> {
    if confidence > 0.0 && confidence < 1.0 { Ok(()) } else { Err(StatisticsError::Probability(confidence)) }
}
