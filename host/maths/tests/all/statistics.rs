//! Tests of one sample, its intervals and its bootstrap.

use r4_maths::statistics::{
    Bootstrap, Interval, QuantileRule, StatisticsError, bca_interval, mean, mean_interval, median,
    median_absolute_deviation, nearest_rank, nrmse, percentile_interval, quantile, rms, rmse, robust_deviation,
    standard_deviation, standard_error, variance, wilson,
};
use serde::Deserialize;

use crate::oracle::{SUMS, cases, close};

#[derive(Deserialize)]
struct Sample {
    values: Vec<f64>,
    mean: f64,
    variance: f64,
    standard_error: f64,
    median: f64,
    mad: f64,
    robust_deviation: f64,
    rms: f64,
    mean_interval: [f64; 2],
    quantiles: Vec<Quantile>,
}

#[derive(Deserialize)]
struct Quantile {
    probability: f64,
    linear: f64,
    nearest_rank: f64,
}

#[test]
fn moments_and_order_statistics_are_those_of_numpy() {
    for sample in cases::<Sample>("one_sample") {
        let values = &sample.values;
        close(mean(values).unwrap(), sample.mean, SUMS);
        close(variance(values).unwrap(), sample.variance, SUMS);
        close(standard_deviation(values).unwrap(), sample.variance.sqrt(), SUMS);
        close(standard_error(values).unwrap(), sample.standard_error, SUMS);
        close(rms(values).unwrap(), sample.rms, SUMS);
        // Selected, not computed: only the mean of two, or a difference, may be wrong by a few last bits.
        assert_eq!(median(values), Ok(sample.median));
        close(median_absolute_deviation(values).unwrap(), sample.mad, 4.0 * f64::EPSILON);
        close(robust_deviation(values).unwrap(), sample.robust_deviation, 8.0 * f64::EPSILON);
        let mut sorted = values.clone();
        sorted.sort_by(f64::total_cmp);
        for Quantile { probability, linear, nearest_rank: ranked } in sample.quantiles {
            let found = quantile(values, probability, QuantileRule::Linear).unwrap();
            // Interpolation between two values: rounding errors of their difference, relative to the greatest value.
            let scale = values.iter().fold(0.0f64, |scale, value| scale.max(value.abs()));
            assert!((found - linear).abs() <= 4.0 * f64::EPSILON * scale, "{probability}: {found} {linear}");
            assert_eq!(quantile(values, probability, QuantileRule::NearestRank), Ok(ranked), "{probability}");
            assert_eq!(nearest_rank(&sorted, probability), Some(ranked), "{probability}");
        }
    }
}

/// Relative error of the quantiles of Student's t and the normal distribution by statrs; 1e-11 was seen.
const QUANTILES: f64 = 1e-10;

#[test]
fn the_interval_of_a_mean_is_that_of_scipy() {
    for sample in cases::<Sample>("one_sample") {
        let found = mean_interval(&sample.values, 0.9).unwrap();
        // The half width has the error of the quantile, the middle that of the mean.
        let [low, high] = sample.mean_interval;
        let within = QUANTILES * (high - low) + SUMS * sample.mean.abs();
        assert!((found.low - low).abs() <= within && (found.high - high).abs() <= within, "{found:?} {low} {high}");
    }
}

#[derive(Deserialize)]
struct Share {
    successes: u64,
    trials: u64,
    level: f64,
    low: f64,
    high: f64,
}

#[test]
fn wilson_intervals_are_those_of_statsmodels() {
    for Share { successes, trials, level, low, high } in cases::<Share>("wilson") {
        let found = wilson(successes, trials, level).unwrap();
        let close = |found: f64, expected: f64| (found - expected).abs() < QUANTILES;
        assert!(close(found.low, low) && close(found.high, high), "{successes} of {trials}: {found:?} {low} {high}");
    }
    assert_eq!(wilson(0, 0, 0.95), Ok(Interval { low: 0.0, high: 1.0 }));
    assert_eq!(wilson(3, 2, 0.95), Err(StatisticsError::Share { successes: 3, trials: 2 }));
    assert_eq!(wilson(1, 2, 1.0), Err(StatisticsError::Probability(1.0)));
}

#[derive(Deserialize)]
struct Errors {
    measured: Vec<f64>,
    predicted: Vec<f64>,
    rmse: f64,
    nrmse: f64,
}

#[test]
fn errors_of_predictions_are_those_of_numpy() {
    for Errors { measured, predicted, rmse: error, nrmse: normalised } in cases::<Errors>("errors") {
        close(rmse(&measured, &predicted).unwrap(), error, SUMS);
        close(nrmse(&measured, &predicted).unwrap(), normalised, SUMS);
    }
    assert_eq!(nrmse(&[2.0, 2.0], &[1.0, 3.0]), Err(StatisticsError::NoSpread));
    assert_eq!(rmse(&[2.0], &[1.0, 3.0]), Err(StatisticsError::Unpaired { first: 1, second: 2 }));
    assert_eq!(rmse(&[2.0, f64::INFINITY], &[1.0, 3.0]), Err(StatisticsError::Infinite { index: 1 }));
}

#[derive(Deserialize)]
struct Resampled {
    values: Vec<f64>,
    statistic: String,
    level: f64,
    jackknife: Vec<f64>,
    distribution: Vec<f64>,
    percentile: [f64; 2],
    bca: [f64; 2],
    /// Ends by the percentile and the BCa method, of 20 000 resamples.
    many: [Ends; 2],
    standard_error: f64,
}

/// Mean and standard deviation of each end over 20 seeds.
#[derive(Deserialize)]
struct Ends {
    ends: [f64; 2],
    spread: [f64; 2],
}

#[test]
fn intervals_of_a_given_distribution_are_those_of_scipy() {
    for case in cases::<Resampled>("bootstrap") {
        let value = statistic(&case.statistic)(&case.values);
        let found = percentile_interval(&case.distribution, case.level).unwrap();
        let bca = bca_interval(&case.distribution, value, &case.jackknife, case.level).unwrap();
        for (found, [low, high]) in [(found, case.percentile), (bca, case.bca)] {
            // Neighbours of 199 values differ by less than the range of the distribution, by which the probability's
            // error is scaled.
            let within = QUANTILES * 199.0 * (high - low);
            assert!((found.low - low).abs() <= within && (found.high - high).abs() <= within, "{found:?} {low} {high}");
        }
    }
}

#[test]
fn own_resamples_give_the_intervals_that_scipys_give() {
    for case in cases::<Resampled>("bootstrap") {
        let bootstrap = Bootstrap { resamples: 20_000, confidence: case.level, seed: 11 };
        let statistic = statistic(&case.statistic);
        let percentile = bootstrap.percentile(&case.values, statistic).unwrap();
        let bca = bootstrap.bca(&case.values, statistic).unwrap();
        assert_eq!(percentile.value, statistic(&case.values));
        // The standard deviation of 20 000 normal samples is known to 0.5 %; that of heavy tails less well.
        close(percentile.standard_error, case.standard_error, 0.05);
        for (found, Ends { ends, spread }) in [percentile.interval, bca.interval].into_iter().zip(case.many) {
            for ((end, expected), spread) in [found.low, found.high].into_iter().zip(ends).zip(spread) {
                // The spread itself is known to 16 %. Where the distribution has equal values it can be 0, so a floor
                // for rounding is added.
                let within = 5.0 * spread + 1e-3 * case.standard_error;
                assert!((end - expected).abs() < within, "{} at {}: {end} {expected}", case.statistic, case.level);
            }
        }
    }
}

fn statistic(name: &str) -> fn(&[f64]) -> f64 {
    match name {
        "mean" => |values| mean(values).expect("has values"),
        "median" => |values| median(values).expect("has values"),
        "deviation" => |values| standard_deviation(values).expect("has values"),
        other => panic!("{other}"),
    }
}

#[test]
fn a_bootstrap_refuses_what_it_cannot_resample() {
    let of = |values: &[f64]| mean(values).unwrap();
    let bootstrap = Bootstrap::new(1);
    assert_eq!(bootstrap.bca(&[1.0], of), Err(StatisticsError::TooFew { got: 1, need: 2 }));
    assert_eq!(bootstrap.block(&[1.0, 2.0], 3, of), Err(StatisticsError::Block { block: 3, length: 2 }));
    assert_eq!(bootstrap.block(&[1.0, 2.0], 0, of), Err(StatisticsError::Block { block: 0, length: 2 }));
    let none = Bootstrap { resamples: 1, ..bootstrap };
    assert_eq!(none.percentile(&[1.0, 2.0], of), Err(StatisticsError::TooFew { got: 1, need: 2 }));
    let all = Bootstrap { confidence: 1.0, ..bootstrap };
    assert_eq!(all.percentile(&[1.0, 2.0], of), Err(StatisticsError::Probability(1.0)));
    assert_eq!(bootstrap.percentile(&[1.0, 2.0], |_| f64::NAN), Err(StatisticsError::Resample { resample: 0 }));
}

/// Uses a first-order autoregressive series: each sample is 0.9 of the previous one and a new number.
#[test]
fn block_intervals_cover_the_mean_of_a_correlated_series() {
    use rand_pcg::{Pcg64Mcg, rand_core::Rng};
    let of = |values: &[f64]| mean(values).unwrap();
    let mut covered = [0; 2];
    for seed in 0..200u64 {
        let mut random = Pcg64Mcg::new(u128::from(seed) * 2 + 1);
        let mut value = 0.0;
        let series: Vec<f64> = (0..600)
            .map(|_| {
                let uniform = (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
                value = 0.9 * value + uniform - 0.5;
                value
            })
            .collect();
        let bootstrap = Bootstrap { resamples: 400, confidence: 0.95, seed };
        let found = [bootstrap.percentile(&series, of), bootstrap.block(&series, 60, of)];
        for (covered, found) in covered.iter_mut().zip(found) {
            *covered += i32::from(found.unwrap().interval.contains(0.0));
        }
    }
    // The correlation leaves 600 samples with the information of 600 (1 - 0.9) / (1 + 0.9) = 32: intervals of single
    // samples are 4.4 times too narrow and cover P(|z| < 0.45) = 35 %. Ten blocks cover 95 % but for their own bias; of
    // 200 series ± 3 % (one sigma: 1.5 %).
    assert!(covered[0] < 100 && covered[1] > 170, "{covered:?} of 200");
}
