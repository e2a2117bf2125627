//! Properties that must hold for any numbers.

use nalgebra::DMatrix;
use proptest::{collection::vec, prelude::*};
use r4_maths::{
    least_squares::linear,
    statistics::{
        Alternative, Bootstrap, QuantileRule, StatisticsError, mcnemar_exact, median, median_absolute_deviation,
        quantile, variance, welch_t, wilcoxon_signed_rank, wilson,
    },
};

const RULES: [QuantileRule; 3] = [QuantileRule::Linear, QuantileRule::NearestRank, QuantileRule::NearestPosition];

fn values() -> impl Strategy<Value = Vec<f64>> {
    vec(-1e6..1e6f64, 2..40)
}

proptest! {
    #[test]
    fn a_quantile_grows_with_its_probability_and_stays_within(
        values in values(), a in 0.0..=1.0f64, b in 0.0..=1.0f64, infinite in any::<bool>(),
    ) {
        let mut values = values;
        if infinite {
            values.push(f64::INFINITY);
        }
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let greatest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        for rule in RULES {
            let of = |probability| quantile(&values, probability, rule).unwrap();
            prop_assert_eq!((of(0.0), of(1.0)), (least, greatest));
            let (low, high) = (of(a.min(b)), of(a.max(b)));
            prop_assert!(least <= low && low <= high && high <= greatest, "{:?}: {} {}", rule, low, high);
            if rule != QuantileRule::Linear {
                prop_assert!(values.contains(&low));
            }
        }
    }

    #[test]
    fn the_median_is_the_linear_quantile_of_a_half_in_any_order(values in values()) {
        let middle = median(&values).unwrap();
        let mut turned = values.clone();
        turned.reverse();
        prop_assert_eq!(median(&turned), Ok(middle));
        let half = quantile(&values, 0.5, QuantileRule::Linear).unwrap();
        prop_assert!((middle - half).abs() <= 4.0 * f64::EPSILON * 1e6, "{} {}", middle, half);
    }

    #[test]
    fn fewer_than_half_outliers_leave_the_spread_bounded(values in vec(-1.0..1.0f64, 5..20), far in 1e3..1e9f64) {
        let mut with = values.clone();
        with.extend(std::iter::repeat_n(far, values.len() - 2));
        prop_assert!(median_absolute_deviation(&with).unwrap() <= 2.0);
    }

    #[test]
    fn nan_is_refused_wherever_it_is(values in values(), at in any::<prop::sample::Index>()) {
        let mut values = values;
        let index = at.index(values.len());
        values[index] = f64::NAN;
        let refused = Err(StatisticsError::NotANumber { index });
        prop_assert_eq!(median(&values), refused);
        prop_assert_eq!(variance(&values), refused);
        prop_assert_eq!(quantile(&values, 0.5, QuantileRule::NearestRank), refused);
    }

    #[test]
    fn a_wilson_interval_holds_the_share_and_shrinks(successes in 0..500u64, failures in 0..500u64, level in 0.01..0.999f64) {
        let trials = (successes + failures).max(1);
        let share = successes as f64 / trials as f64;
        let found = wilson(successes, trials, level).unwrap();
        prop_assert!(found.contains(share) && found.low >= 0.0 && found.high <= 1.0, "{:?}", found);
        prop_assert!(wilson(4 * successes, 4 * trials, level).unwrap().width() < found.width());
        let other = wilson(trials - successes, trials, level).unwrap();
        prop_assert!((found.low - (1.0 - other.high)).abs() < 1e-12);
    }

    #[test]
    fn swapping_the_samples_swaps_the_sides(a in values(), b in values()) {
        let (one, other) = (welch_t(&a, &b, Alternative::Less), welch_t(&b, &a, Alternative::Greater));
        prop_assert_eq!(one.unwrap().p_value, other.unwrap().p_value);
        let pairs = a.len().min(b.len());
        let (a, b) = (&a[..pairs], &b[..pairs]);
        let rank = |a, b, side| wilcoxon_signed_rank(a, b, side).unwrap();
        let (less, greater) = (rank(a, b, Alternative::Less), rank(b, a, Alternative::Greater));
        prop_assert_eq!(less.p_value, greater.p_value);
        prop_assert!((0.0..=1.0).contains(&less.p_value));
        // Counted over all signs: "at most" and "at least" both contain the rank sum itself.
        prop_assert!(less.p_value + rank(a, b, Alternative::Greater).p_value > 1.0);
    }

    #[test]
    fn mcnemars_p_falls_as_cases_gather_on_one_side(few in 0..30u64, more in 0..30u64) {
        let p = mcnemar_exact(few, few + more);
        prop_assert_eq!(p, mcnemar_exact(few + more, few));
        prop_assert!(mcnemar_exact(few, few + more + 1) <= p * (1.0 + 1e-12));
    }

    #[test]
    fn a_bootstrap_is_repeatable_and_stays_within_the_sample(values in values(), seed in any::<u64>()) {
        let bootstrap = Bootstrap { resamples: 50, confidence: 0.9, seed };
        let of = |values: &[f64]| median(values).unwrap();
        let found = bootstrap.percentile(&values, of).unwrap();
        prop_assert_eq!(found, bootstrap.percentile(&values, of).unwrap());
        for end in [found.interval.low, found.interval.high] {
            prop_assert!(values.iter().any(|value| *value <= end) && values.iter().any(|value| *value >= end));
        }
        let blocks = bootstrap.block(&values, values.len(), |values| values.iter().sum()).unwrap();
        // Rotations have all values: their sum is that of the sample, but for rounding.
        prop_assert!(blocks.standard_error <= 1e-15 * 40.0 * 40e6, "{:?}", blocks);
    }

    #[test]
    fn residuals_of_a_fit_are_orthogonal_to_its_columns(
        cells in vec(-10.0..10.0f64, 30), observed in vec(-10.0..10.0f64, 10),
    ) {
        let design = DMatrix::from_vec(10, 3, cells);
        let Ok(fit) = linear(&design, &observed) else { return Ok(()) };
        let gradient = design.tr_mul(&fit.residuals);
        // Rounding errors of ten products of at most 10 × 20, and as much again of the parameters.
        prop_assert!(gradient.amax() < 1e-10, "{}", gradient);
    }
}
