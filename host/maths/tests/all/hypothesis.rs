//! Comparison of two-sample tests with SciPy's and statsmodels'.

use r4_maths::statistics::{
    Alternative, StatisticsError, holm, mcnemar_exact, paired_power, paired_t, two_sample_power, welch_t,
    wilcoxon_signed_rank,
};
use serde::Deserialize;

use crate::oracle::{SUMS, cases, close};

#[derive(Clone, Copy, Deserialize)]
#[serde(remote = "Alternative")]
enum Side {
    TwoSided,
    Less,
    Greater,
}

#[derive(Deserialize)]
struct Welch {
    a: Vec<f64>,
    b: Vec<f64>,
    #[serde(with = "Side")]
    alternative: Alternative,
    t: f64,
    degrees_of_freedom: f64,
    p: f64,
}

/// Relative error of the cumulative distributions of statrs, also far out in a tail; 1e-12 was seen.
const CHANCES: f64 = 1e-10;

#[test]
fn welchs_test_is_scipys() {
    for case in cases::<Welch>("welch") {
        let found = welch_t(&case.a, &case.b, case.alternative).unwrap();
        // The difference of two similar means loses a few digits.
        close(found.t, case.t, 100.0 * SUMS);
        close(found.degrees_of_freedom, case.degrees_of_freedom, SUMS);
        close(found.p_value, case.p, CHANCES);
        close(found.difference / found.standard_error, found.t, SUMS);
    }
    let one = [1.0];
    assert_eq!(welch_t(&one, &[1.0, 2.0], Alternative::Less), Err(StatisticsError::TooFew { got: 1, need: 2 }));
    assert_eq!(welch_t(&[1.0; 3], &[2.0; 3], Alternative::Less), Err(StatisticsError::NoSpread));
}

#[derive(Deserialize)]
struct Pairs {
    a: Vec<f64>,
    b: Vec<f64>,
    #[serde(with = "Side")]
    alternative: Alternative,
    t: f64,
    p_t: f64,
    p_signed_rank: f64,
}

#[test]
fn tests_of_pairs_are_scipys() {
    let mut exact = [0; 2];
    for case in cases::<Pairs>("paired") {
        let found = paired_t(&case.a, &case.b, case.alternative).unwrap();
        close(found.t, case.t, 100.0 * SUMS);
        close(found.p_value, case.p_t, CHANCES);
        let found = wilcoxon_signed_rank(&case.a, &case.b, case.alternative).unwrap();
        close(found.p_value, case.p_signed_rank, CHANCES);
        exact[usize::from(found.exact)] += 1;
    }
    assert!(exact.iter().all(|count| *count > 0), "both ways are compared: {exact:?}");
    let same = [1.0, 2.0];
    assert_eq!(wilcoxon_signed_rank(&same, &same, Alternative::TwoSided), Err(StatisticsError::NoSpread));
    assert_eq!(paired_t(&same, &same, Alternative::TwoSided), Err(StatisticsError::NoSpread));
    assert_eq!(paired_t(&same, &[1.0], Alternative::TwoSided), Err(StatisticsError::Unpaired { first: 2, second: 1 }));
}

#[derive(Deserialize)]
struct Discordant {
    only_first: u64,
    only_second: u64,
    p: f64,
}

#[test]
fn mcnemars_test_is_that_of_statsmodels() {
    for Discordant { only_first, only_second, p } in cases::<Discordant>("mcnemar") {
        close(mcnemar_exact(only_first, only_second), p, CHANCES);
    }
}

#[derive(Deserialize)]
struct Power {
    effect: f64,
    counts: [usize; 2],
    level: f64,
    two_sample: f64,
    paired: f64,
}

/// Absolute error: Simpson's rule, and SciPy's noncentral t itself where the power is close to the level.
const POWERS: f64 = 1e-8;

#[test]
fn powers_are_those_of_statsmodels() {
    for case in cases::<Power>("powers") {
        let found = two_sample_power(case.effect, case.counts, case.level).unwrap();
        assert!((found - case.two_sample).abs() < POWERS, "{found}, {}", case.two_sample);
        let found = paired_power(case.effect, case.counts[0], case.level).unwrap();
        assert!((found - case.paired).abs() < POWERS, "{found}, {}", case.paired);
    }
    assert_eq!(two_sample_power(1.0, [1, 5], 0.05), Err(StatisticsError::TooFew { got: 1, need: 2 }));
    assert_eq!(paired_power(f64::NAN, 5, 0.05), Err(StatisticsError::NotANumber { index: 0 }));
    assert_eq!(paired_power(1.0, 5, 1.0), Err(StatisticsError::Probability(1.0)));
}

#[derive(Deserialize)]
struct Correction {
    p_values: Vec<f64>,
    holm: Vec<f64>,
}

#[test]
fn corrected_p_values_are_those_of_statsmodels() {
    for case in cases::<Correction>("corrections") {
        let found = holm(&case.p_values).unwrap();
        found.iter().zip(&case.holm).for_each(|(found, expected)| close(*found, *expected, SUMS));
    }
    assert_eq!(holm(&[0.1, 1.5]), Err(StatisticsError::Probability(1.5)));
    assert_eq!(holm(&[]), Ok(Vec::new()));
}
