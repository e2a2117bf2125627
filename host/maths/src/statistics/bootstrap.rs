//! Bootstrap confidence intervals of any statistic.

use rand_pcg::{Pcg64Mcg, rand_core::Rng};

use super::{
    Interval, QuantileRule, StatisticsError, confidence, finite,
    interval::{normal_probability, normal_quantile},
    quantile, standard_deviation,
};

/// Settings of a bootstrap.
///
/// The same seed, sample and statistic give the same resamples and the same interval, bit by bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bootstrap {
    /// Number of resamples, at least 2. An end of a 95 % interval of 10 000 has a standard error of 2 % of the
    /// distribution's standard deviation, of 1000 one of 7 %.
    pub resamples: usize,
    /// Confidence level of the interval, such as 0.95.
    pub confidence: f64,
    /// Seed of the random numbers.
    pub seed: u64,
}

/// Statistic with its bootstrap interval, in the statistic's unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Statistic of the sample itself.
    pub value: f64,
    /// Standard deviation of the resampled statistic.
    pub standard_error: f64,
    /// Confidence interval of the statistic.
    pub interval: Interval,
}

impl Bootstrap {
    /// Makes settings with 10 000 resamples and 95 % confidence.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Self { resamples: 10_000, confidence: 0.95, seed }
    }

    /// Returns the percentile interval of a statistic of independent items: numbers, pairs, whole runs.
    ///
    /// Right where the resampled statistic is unbiased and symmetric; otherwise [`Self::bca`] covers better.
    ///
    /// # Errors
    /// Fewer than two items or resamples, a confidence outside 0 < confidence < 1, or a statistic that is not finite.
    ///
    /// # Source
    /// Efron, Tibshirani, *An Introduction to the Bootstrap*, Chapman & Hall 1993, 13.3.
    ///
    /// ```
    /// use r4_maths::statistics::{Bootstrap, median};
    /// let times_s = [1.1, 0.9, 1.0, 1.4, 1.2, 0.8, 1.0, 1.3];
    /// let median_s = |times: &[f64]| median(times).unwrap_or(f64::NAN);
    /// let found = Bootstrap::new(1).percentile(&times_s, median_s).unwrap();
    /// assert_eq!(found.value, 1.05);
    /// assert!(found.interval.low >= 0.8 && found.interval.high <= 1.4);
    /// ```
    pub fn percentile<T: Clone>(
        &self,
        sample: &[T],
        statistic: impl Fn(&[T]) -> f64,
    ) -> Result<Estimate, StatisticsError> {
        self.estimate(sample, 1, statistic)
    }

    /// Returns the bias-corrected and accelerated (BCa) interval of a statistic of independent items.
    ///
    /// Second-order accurate; calls the statistic once more for each item. Too narrow for fewer than about 10 items,
    /// like every bootstrap.
    ///
    /// # Errors
    /// Those of [`Self::percentile`], and [`StatisticsError::NoSpread`] where all resamples have the same statistic, or all
    /// are on one side of the sample's.
    ///
    /// # Source
    /// Efron, "Better Bootstrap Confidence Intervals", Journal of the American Statistical Association 82, 1987; Efron,
    /// Tibshirani 1993, 14.3.
    ///
    /// ```
    /// use r4_maths::statistics::{Bootstrap, mean};
    /// let errors_m = [0.1, 0.2, 0.1, 0.3, 0.2, 0.1, 1.4, 0.2, 0.1, 0.4];
    /// let found = Bootstrap::new(1).bca(&errors_m, |errors| mean(errors).unwrap_or(f64::NAN)).unwrap();
    /// // The sample is skewed: its interval reaches farther up than down.
    /// assert!(found.interval.high - found.value > found.value - found.interval.low);
    /// ```
    pub fn bca<T: Clone>(&self, sample: &[T], statistic: impl Fn(&[T]) -> f64) -> Result<Estimate, StatisticsError> {
        let (value, distribution) = self.distribution(sample, 1, &statistic)?;
        let mut others = sample[1..].to_vec();
        let mut jackknife = Vec::with_capacity(sample.len());
        jackknife.push(statistic(&others));
        // The item at `place` returns and the next one is left out, so that one copy serves for all.
        for (place, item) in sample[..sample.len() - 1].iter().enumerate() {
            others[place].clone_from(item);
            jackknife.push(statistic(&others));
        }
        Ok(Estimate {
            value,
            standard_error: standard_deviation(&distribution)?,
            interval: bca_interval(&distribution, value, &jackknife, self.confidence)?,
        })
    }

    /// Returns the percentile interval of a statistic of a time series with correlated samples.
    ///
    /// Resamples consist of blocks of `block` consecutive samples, which begin anywhere and wrap round from the end to
    /// the start. Blocks should be several correlation times long; the cube root of the number of samples is a common
    /// choice when nothing is known.
    ///
    /// # Errors
    /// Those of [`Self::percentile`], and [`StatisticsError::Block`] for empty blocks or ones longer than the series.
    ///
    /// # Source
    /// Politis, Romano, "A Circular Block-Resampling Procedure for Stationary Data", in *Exploring the Limits of Bootstrap*,
    /// Wiley 1992.
    ///
    /// ```
    /// use r4_maths::statistics::{Bootstrap, mean};
    /// let error_m: Vec<f64> = (0..200).map(|n| (0.05 * f64::from(n)).sin()).collect();
    /// let of_mean = |values: &[f64]| mean(values).unwrap_or(f64::NAN);
    /// let alone = Bootstrap::new(1).percentile(&error_m, of_mean).unwrap();
    /// let in_blocks = Bootstrap::new(1).block(&error_m, 20, of_mean).unwrap();
    /// // Correlated neighbours have less information than as many independent samples.
    /// assert!(in_blocks.interval.width() > 2.0 * alone.interval.width());
    /// ```
    pub fn block<T: Clone>(
        &self,
        series: &[T],
        block: usize,
        statistic: impl Fn(&[T]) -> f64,
    ) -> Result<Estimate, StatisticsError> {
        if block == 0 || block > series.len() {
            return Err(StatisticsError::Block { block, length: series.len() });
        }
        self.estimate(series, block, statistic)
    }

    fn estimate<T: Clone>(
        &self,
        sample: &[T],
        block: usize,
        statistic: impl Fn(&[T]) -> f64,
    ) -> Result<Estimate, StatisticsError> {
        let (value, distribution) = self.distribution(sample, block, &statistic)?;
        Ok(Estimate {
            value,
            standard_error: standard_deviation(&distribution)?,
            interval: percentile_interval(&distribution, self.confidence)?,
        })
    }

    /// Returns the sample's statistic, and that of each resample.
    fn distribution<T: Clone>(
        &self,
        sample: &[T],
        block: usize,
        statistic: impl Fn(&[T]) -> f64,
    ) -> Result<(f64, Vec<f64>), StatisticsError> {
        confidence(self.confidence)?;
        for got in [sample.len(), self.resamples] {
            if got < 2 {
                return Err(StatisticsError::TooFew { got, need: 2 });
            }
        }
        let mut random = Pcg64Mcg::new(u128::from(self.seed) ^ SEQUENCE);
        let mut resample = sample.to_vec();
        let mut distribution = Vec::with_capacity(self.resamples);
        for number in 0..self.resamples {
            // Blocks of one item are the ordinary bootstrap of independent items.
            for items in resample.chunks_mut(block) {
                let first = below(&mut random, sample.len());
                for (place, item) in items.iter_mut().enumerate() {
                    item.clone_from(&sample[(first + place) % sample.len()]);
                }
            }
            let value = statistic(&resample);
            if !value.is_finite() {
                return Err(StatisticsError::Resample { resample: number });
            }
            distribution.push(value);
        }
        Ok((statistic(sample), distribution))
    }
}

/// Stream of the generator, any odd number: it makes neighbouring seeds start far apart.
const SEQUENCE: u128 = 0x9e37_79b9_7f4a_7c15_f39c_c060_5ced_c835;

/// Returns a uniform number below `end`, which is not 0: the high half of a product (Lemire, "Fast Random Integer
/// Generation in an Interval", ACM TOMACS 29, 2019), without its rejection, whose absence favours no number by more
/// than `end` / 2^64.
fn below(random: &mut Pcg64Mcg, end: usize) -> usize {
    ((u128::from(random.next_u64()) * end as u128) >> 64) as usize
}

/// Returns the percentile interval of a statistic that the caller has resampled.
///
/// # Errors
/// Fewer than two values, one that is not finite, or a `level` outside 0 < level < 1.
///
/// # Source
/// Efron, Tibshirani, *An Introduction to the Bootstrap*, Chapman & Hall 1993, 13.3; quantiles by [`QuantileRule::Linear`].
///
/// ```
/// let resampled: Vec<f64> = (0..=100).map(f64::from).collect();
/// let interval = r4_maths::statistics::percentile_interval(&resampled, 0.9).unwrap();
/// assert!((interval.low - 5.0).abs() < 1e-12 && (interval.high - 95.0).abs() < 1e-12);
/// ```
pub fn percentile_interval(distribution: &[f64], level: f64) -> Result<Interval, StatisticsError> {
    confidence(level)?;
    finite(distribution, 2)?;
    ends(distribution, [f64::midpoint(0.0, 1.0 - level), f64::midpoint(1.0, level)])
}

/// Returns the BCa interval of a statistic that the caller has resampled: `value` is that of the sample, `jackknife`
/// that of the sample without each of its items.
///
/// # Errors
/// Fewer than two values of either, one that is not finite, a `level` outside 0 < level < 1, or
/// [`StatisticsError::NoSpread`] where the whole distribution is on one side of `value`.
///
/// # Source
/// Efron, Tibshirani, *An Introduction to the Bootstrap*, Chapman & Hall 1993, equations 14.10, 14.14 and 14.15; resamples
/// equal to `value` count half on each side.
///
/// ```
/// let resampled: Vec<f64> = (0..=100).map(f64::from).collect();
/// // Unbiased and with a symmetric jackknife it is the percentile interval.
/// let interval = r4_maths::statistics::bca_interval(&resampled, 50.0, &[49.0, 50.0, 51.0], 0.9).unwrap();
/// assert!((interval.low - 5.0).abs() < 1e-9 && (interval.high - 95.0).abs() < 1e-9);
/// ```
pub fn bca_interval(
    distribution: &[f64],
    value: f64,
    jackknife: &[f64],
    level: f64,
) -> Result<Interval, StatisticsError> {
    confidence(level)?;
    finite(distribution, 2)?;
    finite(jackknife, 2)?;
    finite(&[value], 1)?;
    let count = |is: fn(&f64, &f64) -> bool| distribution.iter().filter(|other| is(other, &value)).count() as f64;
    // Resamples equal to the value count half, or a discrete statistic would look biased.
    let below = (count(f64::lt) + count(f64::le)) / (2.0 * distribution.len() as f64);
    let bias = normal_quantile(below);
    // All resamples on one side: the quantile of 0 or 1 is infinite.
    if !bias.is_finite() {
        return Err(StatisticsError::NoSpread);
    }
    let middle = jackknife.iter().sum::<f64>() / jackknife.len() as f64;
    let power = |exponent| jackknife.iter().map(|other| (middle - other).powi(exponent)).sum::<f64>();
    let squares = power(2);
    // A statistic that no item changes has no skew.
    let acceleration = if squares > 0.0 { power(3) / (6.0 * squares.powf(1.5)) } else { 0.0 };
    let adjusted = |probability| {
        let shifted = bias + normal_quantile(probability);
        normal_probability(bias + shifted / (1.0 - acceleration * shifted))
    };
    ends(distribution, [adjusted(f64::midpoint(0.0, 1.0 - level)), adjusted(f64::midpoint(1.0, level))])
}

fn ends(distribution: &[f64], probabilities: [f64; 2]) -> Result<Interval, StatisticsError> {
    let [low, high] = probabilities.map(|probability| quantile(distribution, probability, QuantileRule::Linear));
    Ok(Interval { low: low?, high: high? })
}
