//! What residuals say for a model: how many samples are independent of each other, and what a model's numbers cost.

use crate::{family::Family, fit::Fit};

/// A difference in price (see [`price`]) from which on a rival is told apart: a ratio of likelihoods of 150, "very strong" in R. E.
/// Kass and A. E. Raftery, *Bayes Factors*, Journal of the American Statistical Association 90 (1995), 773-795.
pub(crate) const TOLD_APART: f64 = 10.0;

/// How many independent samples say as much as those that a model was fitted to.
pub(crate) fn independent<F: Family>(family: &F, runs: &[&F::Run], fit: &Fit) -> f64 {
    let residuals = fit.residuals(family, runs);
    let samples = residuals.iter().flatten().filter(|residual| residual.is_finite()).count() as f64;
    samples / correlated(&residuals)
}

/// What a model costs, of which less is better, but for a constant: twice Schwarz's criterion for its numbers, with only as many
/// samples as are `independent`. What is left of a long free run is so correlated that any few corners would explain some of
/// it.
pub(crate) fn price(independent: f64, cost: f64, numbers: usize) -> f64 {
    independent * cost.ln() + 2.0 * numbers as f64 * independent.max(2.0).ln()
}

/// How many samples say as much as one independent one: the integrated autocorrelation, up to where it first vanishes.
pub(crate) fn correlated(residuals: &[Vec<f64>]) -> f64 {
    let mut sum = 1.0;
    let variance = product(residuals, 0);
    if variance <= 0.0 {
        return 1.0;
    }
    let longest = residuals.iter().map(Vec::len).max().unwrap_or(0) / 2;
    let mut lag = 1;
    while lag < longest {
        let correlation = product(residuals, lag) / variance;
        if correlation < 0.05 {
            break;
        }
        // Far lags by strides: the sum stays right where the correlation is smooth.
        let stride = (lag / 10).max(1);
        sum += 2.0 * correlation * stride as f64;
        lag += stride;
    }
    sum
}

/// Mean product of residuals a lag apart.
pub(crate) fn product(residuals: &[Vec<f64>], lag: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for run in residuals {
        for (a, b) in run.iter().zip(run.iter().skip(lag)) {
            if a.is_finite() && b.is_finite() {
                sum += a * b;
                count += 1.0;
            }
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
