//! Choice of the sites to measure next.

use nalgebra::{DMatrix, DVector};

use super::{Process, ProcessError};
use crate::pose::Point;

/// Criterion for the value of a site.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Criterion {
    /// Greatest variance given the sites chosen before: entropy. Prefers the border of the region.
    Entropy,
    /// Greatest gain in mutual information between the chosen sites and the rest of the region.
    MutualInformation,
}

/// Chooses the sites to measure next, best first: indices of `candidates`, at most `count` and each once.
///
/// Candidates are places, m, that cover the region of interest; readings have the kernel's noise. Greedy choice is
/// within 1 - 1/e of the best for mutual information, as long as the candidates are dense compared with the kernel's
/// length. The time grows with the cube of the number of candidates.
///
/// # Errors
/// [`ProcessError::TooFew`] without candidates, [`ProcessError::NotFinite`] for a candidate that is not finite,
/// [`ProcessError::Singular`].
///
/// # Source
/// Krause, Singh, Guestrin, "Near-Optimal Sensor Placements in Gaussian Processes", Journal of Machine Learning Research 9, 2008.
pub fn next_sites(
    process: &Process,
    candidates: &[Point],
    count: usize,
    criterion: Criterion,
) -> Result<Vec<usize>, ProcessError> {
    if candidates.is_empty() {
        return Err(ProcessError::TooFew { what: "candidates for a site", least: 1 });
    }
    if let Some(index) = candidates.iter().position(|[x_m, y_m]| !(x_m.is_finite() && y_m.is_finite())) {
        return Err(ProcessError::NotFinite { index });
    }
    let noise = process.kernel().noise;
    // Covariance of readings at all candidates, given the samples so far; later also given the chosen sites.
    let mut given = process.place_covariance(candidates);
    (0..candidates.len()).for_each(|index| given[(index, index)] += noise * noise);
    // Precision of readings at the candidates that are not chosen.
    let singular = ProcessError::Singular { index: candidates.len() - 1, noise };
    let mut rest: DMatrix<f64> = given.clone().cholesky().ok_or(singular)?.inverse();
    let mut left: Vec<usize> = (0..candidates.len()).collect();
    let mut chosen = Vec::new();
    while chosen.len() < count && !left.is_empty() {
        let worth = |index: usize| match criterion {
            Criterion::Entropy => given[(index, index)],
            // The variance given all the others is the reciprocal of the precision.
            Criterion::MutualInformation => given[(index, index)] * rest[(index, index)],
        };
        // The first of equal ones: `max_by` alone would return the last.
        let best = (0..left.len()).rev().max_by(|a, b| worth(left[*a]).total_cmp(&worth(left[*b])));
        let Some(best) = best else { break };
        let site = left.remove(best);
        chosen.push(site);
        condition(&mut given, site);
        condition(&mut rest, site);
    }
    Ok(chosen)
}

/// Removes one variable: conditions a covariance on it, or marginalises a precision over it.
fn condition(matrix: &mut DMatrix<f64>, index: usize) {
    let column: DVector<f64> = matrix.column(index).into_owned();
    let scale = column[index].recip();
    if scale.is_finite() {
        matrix.ger(-scale, &column, &column, 1.0);
    }
}
