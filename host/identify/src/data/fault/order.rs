//! Detection of rows out of order.

use super::{Column, Fault};

/// Autocorrelation at one sample below which a series has no order. Positions have above 0.99; a speed that is
/// sampled once in its time constant has 0.37, and is explained by the input before it.
const ORDER: f64 = 0.5;
/// Smallest number of samples: with fewer, chance makes correlations of this magnitude.
const LEAST: usize = 100;
/// Share of the variance, explained by the input of the sample before, above which the output is quick rather than
/// shuffled.
const QUICK: f64 = 0.3;

/// Detects an output whose successive samples are uncorrelated, and which the input of the sample before does not
/// explain either.
pub(super) fn shuffled(output: &Column<'_>, inputs: &[Column<'_>]) -> Option<Fault> {
    let values: Vec<f64> = output.finite().collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let square: f64 = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
    let pairs: Vec<(f64, f64)> = output
        .series
        .iter()
        .flat_map(|series| series.values.windows(2).map(|pair| (pair[0] - mean, pair[1] - mean)))
        .filter(|pair| pair.0.is_finite() && pair.1.is_finite())
        .collect();
    if pairs.len() < LEAST || square.is_nan() || square <= 0.0 || !square.is_finite() {
        return None;
    }
    let correlation = pairs.iter().map(|(now, next)| now * next).sum::<f64>() / pairs.len() as f64 / square;
    // A quick system forgets within a sample, but its input explains it.
    let is_quick = inputs.iter().any(|input| explained_by_last(output, input) > QUICK);
    (correlation < ORDER && !is_quick).then(|| Fault::Shuffled { column: output.name.to_owned(), correlation })
}

/// Returns the share of the output's variance that a linear regression on the last sample's input explains.
fn explained_by_last(output: &Column<'_>, input: &Column<'_>) -> f64 {
    let both: Vec<(f64, f64)> = output
        .series
        .iter()
        .zip(&input.series)
        .flat_map(|(output, input)| input.values.iter().copied().zip(output.values.iter().copied().skip(1)))
        .filter(|(input, output)| input.is_finite() && output.is_finite())
        .collect();
    let count = both.len().max(1) as f64;
    let mean = both.iter().fold((0.0, 0.0), |mean, one| (mean.0 + one.0 / count, mean.1 + one.1 / count));
    let sums = both.iter().fold([0.0; 3], |[xx, yy, xy], (x, y)| {
        let (x, y) = (x - mean.0, y - mean.1);
        [xx + x * x, yy + y * y, xy + x * y]
    });
    if sums[0] > 0.0 && sums[1] > 0.0 { sums[2].powi(2) / (sums[0] * sums[1]) } else { 0.0 }
}
