//! Analysis of residuals: whiteness, and the quantities they depend on.

use rand_pcg::{
    Pcg64Mcg,
    rand_core::{Rng, SeedableRng},
};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::{
    evidence::product,
    family::{Driver, Family},
    fit::Fit,
    report::{Cause, ResidualReport, Unexplained},
};

/// Share of the variance of a sensor's rounding below which an effect's contribution to the output is of no use,
/// however significant. With nothing hidden, a board (tuning seed 60650000) has a residual of 1.41 times that
/// variance, which is not white, and an eccentricity of half a count explains 0.03 of it. With half of this share the
/// search continues there, six times as long, and accepts nothing either.
const RESOLVED: f64 = 0.5;
/// Number of lags in the test of whiteness.
const LAGS: usize = 20;
/// Autocorrelation below which a residual counts as white, however significant it is.
const TRIFLE: f64 = 0.05;
const BINS: usize = 16;
/// Number of circular shifts of the residual against a driver that estimate what chance alone would show.
const TURNS: usize = 200;
/// Smallest share of the variance that is reported as a dependence.
const LEAST_SHARE: f64 = 0.01;

/// Residuals of runs under a model, and the series they may depend on.
pub(crate) struct Left {
    residuals: Vec<Vec<f64>>,
    /// Residuals as a push (see [`Family::push`]), or as they are if the model has none.
    pushes: Vec<Vec<f64>>,
    unit: &'static str,
    drivers: Vec<Vec<Driver>>,
}

/// Computes the residuals of a fitted model in each run, and the series they may depend on.
pub(crate) fn left<F: Family>(family: &F, fit: &Fit, runs: &[&F::Run]) -> Left {
    let residuals = fit.residuals(family, runs);
    let mut unit = family.unit();
    let pushes = runs
        .iter()
        .zip(&residuals)
        .map(|(run, residual)| match family.push(&fit.structure, run, residual) {
            Some((push, its)) => {
                unit = its;
                push
            }
            None => residual.clone(),
        })
        .collect();
    let drivers =
        runs.iter().zip(&fit.initial).map(|(run, initial)| family.drivers(&fit.structure, initial, run)).collect();
    Left { residuals, pushes, unit, drivers }
}

impl Left {
    /// Tests the residuals for whiteness and for dependences. `seed` samples the circular shifts.
    pub(crate) fn report(&self, seed: u64) -> ResidualReport {
        let count = self.drivers.first().map_or(0, Vec::len);
        let mut unexplained: Vec<Unexplained> = (0..count)
            .filter_map(|driver| {
                let (share, p_value) = self.dependence(driver, seed)?;
                // Bonferroni correction for the number of drivers.
                let p_value = (p_value * count as f64).min(1.0);
                let name = self.drivers[0][driver].over.name();
                (p_value < 0.05 && share > LEAST_SHARE).then(|| Unexplained {
                    depends_on: name.to_owned(),
                    share,
                    p_value,
                })
            })
            .collect();
        unexplained.sort_by(|a, b| b.share.total_cmp(&a.share));
        let mut seen: Vec<String> = Vec::new();
        // A position may occur with and without a period: the stronger dependence is reported.
        unexplained.retain(|entry| {
            let new = !seen.contains(&entry.depends_on);
            seen.push(entry.depends_on.clone());
            new
        });
        ResidualReport { white: is_white(&self.residuals), unexplained }
    }

    /// Returns the share of the variance that bins over a driver explain beyond what chance explains, and its
    /// p-value; `None` with too few samples for bins.
    fn dependence(&self, driver: usize, seed: u64) -> Option<(f64, f64)> {
        let bins = self.bins(driver)?;
        let residual: Vec<f64> = self.pushes.iter().flatten().copied().collect();
        let at: Vec<f64> = self.drivers.iter().flat_map(|drivers| drivers[driver].values.iter().copied()).collect();
        let places: Vec<Option<usize>> = at.iter().map(|&x| place(&bins, x)).collect();
        let share = |turn: usize| {
            let mut sums = vec![(0.0, 0.0); bins.len()];
            let (mut square, mut mean, mut count) = (0.0, 0.0, 0.0);
            // A circular shift keeps the autocorrelation of the residual, which a random permutation would destroy.
            for (index, bin) in places.iter().enumerate() {
                let value = residual[(index + turn) % residual.len()];
                if let (Some(bin), true) = (bin, value.is_finite()) {
                    sums[*bin].0 += value;
                    sums[*bin].1 += 1.0;
                    square += value * value;
                    mean += value;
                    count += 1.0;
                }
            }
            let total = square - mean * mean / f64::max(count, 1.0);
            let between: f64 = sums.iter().filter(|sum| sum.1 > 0.0).map(|sum| sum.0 * sum.0 / sum.1).sum::<f64>()
                - mean * mean / f64::max(count, 1.0);
            if total > 0.0 { between / total } else { 0.0 }
        };
        let observed = share(0);
        // A generator per driver, so that results do not depend on their order.
        let mut rng = Pcg64Mcg::seed_from_u64(seed ^ driver as u64);
        let mut chance: Vec<f64> =
            (0..TURNS).map(|_| share((rng.next_u64() % residual.len().max(1) as u64) as usize)).collect();
        chance.sort_by(f64::total_cmp);
        let as_much = chance.iter().filter(|share| **share >= observed).count();
        let usual = chance[TURNS / 2];
        // A p-value below one in [`TURNS`] is extrapolated with an exponential tail from the median to the 90 %
        // quantile.
        let p_value = if as_much > 0 {
            as_much as f64 / TURNS as f64
        } else {
            let spread = (chance[TURNS * 9 / 10] - usual).max(f64::MIN_POSITIVE) / 5.0_f64.ln();
            0.5 * (-(observed - usual) / spread).exp()
        };
        Some((observed - usual, p_value))
    }

    /// Returns the upper ends of at most [`BINS`] bins with equally many samples; `None` with too few samples.
    fn bins(&self, driver: usize) -> Option<Vec<f64>> {
        let period = self.drivers.first()?.get(driver)?.period;
        let mut values: Vec<f64> = self
            .drivers
            .iter()
            .flat_map(|drivers| drivers[driver].values.iter())
            .filter(|value| value.is_finite())
            .map(|value| period.map_or(*value, |period| value.rem_euclid(period)))
            .collect();
        values.sort_by(f64::total_cmp);
        // Fewer than ten samples per bin say nothing.
        if values.len() < 10 * BINS {
            return None;
        }
        let mut ends: Vec<f64> = (1..=BINS).map(|bin| values[bin * values.len() / BINS - 1]).collect();
        // A value that repeats often may fill several bins.
        ends.dedup();
        (ends.len() > 1).then_some(ends)
    }

    /// Returns the means of the residuals over bins of each driver, before and after effects were added.
    pub(crate) fn causes(before: &Self, after: &Self) -> Vec<Cause> {
        let count = before.drivers.first().map_or(0, Vec::len);
        let mut causes: Vec<(f64, Cause)> = Vec::new();
        for driver in 0..count {
            let Some(ends) = before.bins(driver) else { continue };
            let (share, _) = before.dependence(driver, 0).unwrap_or_default();
            let period = before.drivers[0][driver].period;
            let mut sums = vec![[0.0; 5]; ends.len()];
            for (index, drivers) in before.drivers.iter().enumerate() {
                for (sample, &x) in drivers[driver].values.iter().enumerate() {
                    let x = period.map_or(x, |period| x.rem_euclid(period));
                    let (first, last) = (before.pushes[index][sample], after.pushes[index][sample]);
                    if let (Some(bin), true) = (place(&ends, x), first.is_finite() && last.is_finite()) {
                        for (sum, value) in sums[bin].iter_mut().zip([1.0, x, first, first * first, last]) {
                            *sum += value;
                        }
                    }
                }
            }
            // The standard error of a mean needs at least two samples.
            sums.retain(|sum| sum[0] > 1.0);
            let mean = |column: usize| sums.iter().map(|sum| sum[column] / sum[0]).collect::<Vec<f64>>();
            let error = sums
                .iter()
                .map(|[count, _, sum, square, _]| {
                    2.0 * ((square / count - (sum / count).powi(2)).max(0.0) / count).sqrt()
                })
                .collect();
            let mut depends_on = before.drivers[0][driver].over.name().to_owned();
            if period.is_some() {
                depends_on += " within a turn";
            }
            causes.push((
                share,
                Cause {
                    depends_on,
                    at_unit: before.drivers[0][driver].unit.to_owned(),
                    unit: before.unit.to_owned(),
                    at: mean(1),
                    before: mean(2),
                    after: mean(4),
                    error,
                },
            ));
        }
        causes.sort_by(|a, b| b.0.total_cmp(&a.0));
        causes.into_iter().map(|(_, cause)| cause).collect()
    }
}

/// Returns the largest absolute autocorrelation of the first [`LAGS`] lags: about the share of the variance that is
/// not noise.
pub(crate) fn largest_correlation(residuals: &[Vec<f64>]) -> f64 {
    let variance = product(residuals, 0);
    let correlation = |lag| (product(residuals, lag) / variance).abs();
    if variance > 0.0 { (1..=LAGS).map(correlation).fold(0.0, f64::max) } else { 0.0 }
}

/// Returns whether residuals are about as large as the rounding of the sensor: no useful effect can be in them.
pub(crate) fn is_rounding<F: Family>(family: &F, residuals: &[Vec<f64>], runs: &[&F::Run]) -> bool {
    let known = residuals.iter().flatten().filter(|residual| residual.is_finite());
    let left: f64 = known.clone().map(|residual| residual * residual).sum();
    left <= (1.0 + RESOLVED) * rounding_variance(family, runs) * known.count() as f64
}

/// Returns whether a fall of the mean square error from `before` to `after` is large enough beside the sensor's
/// rounding.
pub(crate) fn is_resolved<F: Family>(family: &F, runs: &[&F::Run], [before, after]: [f64; 2]) -> bool {
    before - after >= RESOLVED * rounding_variance(family, runs)
}

/// Returns the variance of the sensors' rounding, averaged over all samples.
fn rounding_variance<F: Family>(family: &F, runs: &[&F::Run]) -> f64 {
    let (sum, samples) = runs.iter().fold((0.0, 0), |(sum, samples), run| {
        let count = family.measured(run).len();
        (sum + count as f64 * family.rounding(run).powi(2), samples + count)
    });
    sum / f64::max(samples as f64, 1.0)
}

/// Tests for whiteness with the statistic of Ljung and Box at the 0.1 % level. Correlations below [`TRIFLE`] count as
/// none.
pub(crate) fn is_white(residuals: &[Vec<f64>]) -> bool {
    let samples: usize = residuals.iter().flatten().filter(|value| value.is_finite()).count();
    let variance = product(residuals, 0);
    if variance <= 0.0 || samples <= 2 * LAGS {
        return true;
    }
    if largest_correlation(residuals) < TRIFLE {
        return true;
    }
    let correlations = (1..=LAGS).map(|lag| product(residuals, lag) / variance);
    let n = samples as f64;
    let q: f64 = (1..=LAGS).zip(correlations).map(|(lag, correlation)| correlation.powi(2) / (n - lag as f64)).sum();
    ChiSquared::new(LAGS as f64).is_ok_and(|chi| chi.sf(n * (n + 2.0) * q) > 0.001)
}

fn place(ends: &[f64], x: f64) -> Option<usize> {
    let bin = ends.partition_point(|&end| end < x);
    (bin < ends.len()).then_some(bin)
}
