//! Hypothesis tests for two samples, and for pairs.

use statrs::distribution::{Binomial, ContinuousCDF, DiscreteCDF, StudentsT};

use super::{StatisticsError, finite, interval::normal_probability, mean, paired, variance};

/// Alternative hypothesis, as seen from the first sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Alternative {
    /// The samples differ, in either direction.
    #[default]
    TwoSided,
    /// The first sample is smaller.
    Less,
    /// The first sample is greater.
    Greater,
}

/// Result of a t-test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TTest {
    /// Mean of the first sample minus that of the second, in the values' unit.
    pub difference: f64,
    /// Standard error of the difference, in the values' unit.
    pub standard_error: f64,
    /// Student's t: difference over standard error.
    pub t: f64,
    /// Degrees of freedom; a fraction with [`welch_t`].
    pub degrees_of_freedom: f64,
    /// Probability of such a t, or one farther out, if the means are equal.
    pub p_value: f64,
}

/// Performs Welch's t-test: have two independent samples the same mean? The variances need not be equal.
///
/// # Errors
/// Fewer than two values of either, one that is not finite, or [`StatisticsError::NoSpread`] where both are constant.
///
/// # Source
/// Welch, "The Generalization of 'Student's' Problem when Several Different Population Variances are Involved", Biometrika
/// 34, 1947; degrees of freedom by Satterthwaite, Biometrics Bulletin 2, 1946.
///
/// ```
/// use r4_maths::statistics::{Alternative, welch_t};
/// let found = welch_t(&[5.1, 4.9, 5.3, 5.0], &[4.1, 4.6, 3.8, 4.4, 4.0], Alternative::TwoSided).unwrap();
/// assert!((found.difference - 0.895).abs() < 1e-9 && found.p_value < 0.01);
/// ```
pub fn welch_t(first: &[f64], second: &[f64], alternative: Alternative) -> Result<TTest, StatisticsError> {
    let difference = mean(first)? - mean(second)?;
    let squared = |values: &[f64]| Ok((variance(values)? / values.len() as f64, (values.len() - 1) as f64));
    let ((a, free_a), (b, free_b)) = (squared(first)?, squared(second)?);
    // NaN (0 / 0) where the squares of tiny variances underflow: `t_test` then reports no spread.
    let degrees_of_freedom = (a + b).powi(2) / (a * a / free_a + b * b / free_b);
    t_test(difference, (a + b).sqrt(), degrees_of_freedom, alternative)
}

/// Performs a paired t-test: do pairs, such as of two controllers on the same seeds, differ in the mean?
///
/// # Errors
/// Fewer than two pairs, a different number of both, a value that is not finite, or [`StatisticsError::NoSpread`] where all
/// pairs differ by the same.
///
/// # Source
/// Student, "The Probable Error of a Mean", Biometrika 6, 1908.
///
/// ```
/// use r4_maths::statistics::{Alternative, paired_t};
/// let (ours, theirs) = ([1.0, 2.0, 3.0, 4.0], [1.4, 2.6, 3.5, 4.3]);
/// let found = paired_t(&ours, &theirs, Alternative::Less).unwrap();
/// assert_eq!(found.degrees_of_freedom, 3.0);
/// assert!(found.t < -6.9 && found.p_value < 0.005);
/// ```
pub fn paired_t(first: &[f64], second: &[f64], alternative: Alternative) -> Result<TTest, StatisticsError> {
    paired(first, second, 2)?;
    let differences: Vec<f64> = first.iter().zip(second).map(|(first, second)| first - second).collect();
    let count = differences.len() as f64;
    t_test(mean(&differences)?, (variance(&differences)? / count).sqrt(), count - 1.0, alternative)
}

fn t_test(
    difference: f64,
    standard_error: f64,
    degrees_of_freedom: f64,
    alternative: Alternative,
) -> Result<TTest, StatisticsError> {
    let student = StudentsT::new(0.0, 1.0, degrees_of_freedom)
        .ok()
        .filter(|_| standard_error > 0.0 && standard_error.is_finite());
    let student = student.ok_or(StatisticsError::NoSpread)?;
    let t = difference / standard_error;
    let p_value = match alternative {
        Alternative::TwoSided => (2.0 * student.cdf(-t.abs())).min(1.0),
        Alternative::Less => student.cdf(t),
        Alternative::Greater => student.cdf(-t),
    };
    Ok(TTest { difference, standard_error, t, degrees_of_freedom, p_value })
}

/// Result of a Wilcoxon signed-rank test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wilcoxon {
    /// Sum of the ranks of positive differences.
    pub rank_sum_positive: f64,
    /// Sum of the ranks of negative differences.
    pub rank_sum_negative: f64,
    /// Number of pairs that differ; equal ones have no information.
    pub pairs: usize,
    /// True when the p-value counts all signs; false when it follows from the normal approximation.
    pub exact: bool,
    /// Probability of such rank sums, or ones farther out, if differences are as often above as below 0.
    pub p_value: f64,
}

/// Maximum number of pairs whose signs are counted instead of approximated, as in SciPy.
const MOST_EXACT: usize = 50;

/// Performs a Wilcoxon signed-rank test: do pairs differ? The distribution need not be normal.
///
/// Equal pairs are left out, and tied differences share their ranks. Up to 50 pairs the p-value is exact, with ties too
/// (the distribution of the given ranks under random signs); beyond that it is normal with tie correction and without
/// continuity correction.
///
/// # Errors
/// No pair, a different number of both, a value that is not finite, or [`StatisticsError::NoSpread`] where no pair differs.
///
/// # Source
/// Wilcoxon, "Individual Comparisons by Ranking Methods", Biometrics Bulletin 1, 1945; Pratt, Gibbons, *Concepts of
/// Nonparametric Theory*, Springer 1981, chapter 3.
///
/// ```
/// use r4_maths::statistics::{Alternative, wilcoxon_signed_rank};
/// let (before, after) = ([5.0, 6.0, 7.0, 8.0, 9.0], [4.0, 4.0, 4.0, 4.0, 4.0]);
/// let found = wilcoxon_signed_rank(&before, &after, Alternative::Greater).unwrap();
/// // All five signs are positive: one of 32 equally likely cases.
/// assert_eq!((found.rank_sum_positive, found.p_value), (15.0, 1.0 / 32.0));
/// ```
pub fn wilcoxon_signed_rank(
    first: &[f64],
    second: &[f64],
    alternative: Alternative,
) -> Result<Wilcoxon, StatisticsError> {
    paired(first, second, 1)?;
    let mut differences: Vec<f64> = first.iter().zip(second).map(|(first, second)| first - second).collect();
    differences.retain(|difference| *difference != 0.0);
    finite(&differences, 0)?;
    let pairs = differences.len();
    if pairs == 0 {
        return Err(StatisticsError::NoSpread);
    }
    differences.sort_by(|a, b| a.abs().total_cmp(&b.abs()));
    // Twice the ranks: halves of shared ranks become whole numbers.
    let mut doubled = Vec::with_capacity(pairs);
    let mut tied = 0.0;
    for alike in differences.chunk_by(|a, b| a.abs() == b.abs()) {
        let (before, count) = (doubled.len(), alike.len());
        doubled.extend(std::iter::repeat_n(2 * before + count + 1, count));
        tied += (count as f64).powi(3) - count as f64;
    }
    let sum: usize = doubled.iter().sum();
    let positive: usize =
        doubled.iter().zip(&differences).filter(|(_, difference)| **difference > 0.0).map(|(rank, _)| rank).sum();
    let exact = pairs <= MOST_EXACT;
    let at_most: Box<dyn Fn(usize) -> f64> = if exact {
        let chances = rank_sums(&doubled);
        Box::new(move |rank_sum| chances[..=rank_sum].iter().sum())
    } else {
        let count = pairs as f64;
        let deviation = (count * (count + 1.0) * (2.0 * count + 1.0) / 24.0 - tied / 48.0).sqrt();
        Box::new(move |rank_sum| normal_probability((rank_sum as f64 - 0.5 * sum as f64) / 2.0 / deviation))
    };
    let p_value = match alternative {
        Alternative::TwoSided => 2.0 * at_most(positive.min(sum - positive)),
        Alternative::Less => at_most(positive),
        Alternative::Greater => at_most(sum - positive),
    };
    Ok(Wilcoxon {
        rank_sum_positive: 0.5 * positive as f64,
        rank_sum_negative: 0.5 * (sum - positive) as f64,
        pairs,
        exact,
        p_value: p_value.min(1.0),
    })
}

/// Returns the probability of each sum of the ranks that random signs leave positive.
fn rank_sums(ranks: &[usize]) -> Vec<f64> {
    let mut chances = vec![0.0; ranks.iter().sum::<usize>() + 1];
    chances[0] = 1.0;
    let mut greatest = 0;
    for rank in ranks {
        greatest += rank;
        for sum in (0..=greatest).rev() {
            let with = if sum >= *rank { chances[sum - rank] } else { 0.0 };
            chances[sum] = f64::midpoint(chances[sum], with);
        }
    }
    chances
}

/// Performs an exact McNemar test: do two programs succeed equally often on the same cases? Returns the two-sided
/// p-value.
///
/// Only cases in which exactly one of them succeeded count: `only_first` and `only_second`. Without any the p-value is
/// 1.
///
/// # Source
/// McNemar, "Note on the Sampling Error of the Difference Between Correlated Proportions or Percentages", Psychometrika 12,
/// 1947; exact by the binomial distribution: Agresti, *Categorical Data Analysis*, 3rd edition, Wiley 2013, 11.1.
///
/// ```
/// use r4_maths::statistics::mcnemar_exact;
/// // 2 × (1 + 5) / 2^5: of five seeds that differ, one speaks for the first program and four for the second.
/// assert!((mcnemar_exact(1, 4) - 0.375).abs() < 1e-12);
/// assert_eq!(mcnemar_exact(0, 0), 1.0);
/// ```
#[must_use]
pub fn mcnemar_exact(only_first: u64, only_second: u64) -> f64 {
    let fewer = only_first.min(only_second);
    let chance = Binomial::new(0.5, only_first + only_second).map_or(1.0, |binomial| binomial.cdf(fewer));
    (2.0 * chance).min(1.0)
}
