//! Evidence for a model in its residuals: effective number of independent samples, and an information criterion.

use crate::{family::Family, fit::Fit};

/// Least difference of [`price`] at which the data distinguish two models: a likelihood ratio of 150, "very strong" in R. E. Kass and
/// A. E. Raftery, *Bayes Factors*, Journal of the American Statistical Association 90 (1995), 773-795.
pub(crate) const TOLD_APART: f64 = 10.0;

/// Effective number of independent samples in a fit's residuals.
pub(crate) fn independent<F: Family>(family: &F, runs: &[&F::Run], fit: &Fit) -> f64 {
    let residuals = fit.residuals(family, runs);
    let samples = residuals.iter().flatten().filter(|residual| residual.is_finite()).count() as f64;
    samples / correlated(&residuals)
}

/// Bayesian information criterion (BIC, Schwarz) with twice its complexity penalty, but for a constant; lower is better. `independent` is the
/// effective number of samples, because residuals of a long free-run simulation are correlated; `cost` is the sum of their squares.
pub(crate) fn price(independent: f64, cost: f64, numbers: usize) -> f64 {
    independent * cost.ln() + 2.0 * numbers as f64 * independent.max(2.0).ln()
}

/// Integrated autocorrelation of residuals up to its first zero: the number of samples that count as one independent sample.
fn correlated(residuals: &[Vec<f64>]) -> f64 {
    let mut sum = 1.0;
    let variance = product(residuals, 0);
    if variance <= 0.0 {
        return 1.0;
    }
    let longest = residuals.iter().map(Vec::len).max().unwrap_or(0) / 2;
    let mut lag = 1;
    while lag < longest {
        let correlation = product(residuals, lag) / variance;
        // A correlation below 0.05 counts as the first zero.
        if correlation < 0.05 {
            break;
        }
        // Long lags are summed in strides, which is accurate where the correlation is smooth.
        let stride = (lag / 10).max(1);
        sum += 2.0 * correlation * stride as f64;
        lag += stride;
    }
    sum
}

/// Autocovariance of residuals at a lag in samples, over pairs of which both are finite; 0 without such pairs.
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
