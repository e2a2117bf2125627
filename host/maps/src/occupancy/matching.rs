//! Scan matching: the pose at which a scan agrees best with a map.

use nalgebra::{Matrix3, Vector3};

use super::{Occupancy, OccupancyError};
use crate::{
    grid::Grid,
    pose::{Point, Pose, wrapped},
};

/// Region about a guess in which a pose is sought, and the weights of a scan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Search {
    /// Greatest displacement in x and in y, m.
    pub reach_m: f64,
    /// Greatest rotation to either side, rad.
    pub turn_rad: f64,
    /// Standard deviation of a scan's points about the map's walls, m: the sensor's noise and half a cell.
    pub deviation_m: f64,
    /// Share of the points that count as independent for the covariance, above 0 to 1: neighbouring rays have
    /// correlated errors.
    pub independent: f64,
}

/// Pose of a scan, with its quality.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Matched {
    /// Best pose, to a sixteenth of a cell.
    pub pose: Pose,
    /// Covariance of x, y and yaw (m, m, rad): wide along a corridor, which a scan does not determine.
    pub covariance: Matrix3<f64>,
    /// Mean log-likelihood of a point: 0 at best, -4.5 where no point is within three standard deviations of a wall.
    pub score: f64,
}

/// Largest negative log-likelihood of a point. Points farther than three standard deviations from every wall count
/// alike: they belong to objects that are not on the map.
const FARTHEST: f64 = 4.5;

/// Finds the pose of a scan, given as points in the sensor's frame (m), near `guess`.
///
/// The search tries every pose of the window in steps of a cell and of the angle that moves the farthest point by a
/// cell, then those about the best in quarters and sixteenths of that. Each call makes a distance map, which takes
/// longer than the search on large maps.
///
/// # Errors
/// [`OccupancyError::Model`] names a parameter that is out of range, or the number of points when there is none;
/// [`OccupancyError::Reading`] for a point that is not finite.
///
/// # Source
/// Olson, "Real-Time Correlative Scan Matching", ICRA 2009 (search and covariance); likelihood field: Thrun, Burgard, Fox,
/// *Probabilistic Robotics*, MIT Press 2005, 6.4.
pub fn match_scan(map: &Occupancy, points: &[Point], guess: Pose, search: Search) -> Result<Matched, OccupancyError> {
    let Search { reach_m, turn_rad, deviation_m, independent } = search;
    // NaN fails the check below, with the same message.
    let share = if independent <= 1.0 { independent } else { f64::NAN };
    let all = [("reach_m", reach_m), ("turn_rad", turn_rad), ("deviation_m", deviation_m), ("independent", share)];
    let numbers = all.into_iter().chain([("points of the scan", points.len() as f64)]);
    for (what, value) in numbers {
        if !(value > 0.0 && value.is_finite()) {
            return Err(OccupancyError::Model {
                what,
                value,
                needed: "a finite number above 0, for a share at most 1",
            });
        }
    }
    let farthest_m = points.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max);
    if !guess.is_finite() || points.iter().any(|[x, y]| !(x + y).is_finite()) {
        return Err(OccupancyError::Reading { range_m: farthest_m, bearing_rad: guess.yaw_rad });
    }
    let likelihood = map.clearance_m().map(|clear_m| -(0.5 * (clear_m / deviation_m).powi(2)).min(FARTHEST));
    let cell_m = map.frame().cell_m();
    let step = [cell_m, cell_m, cell_m / farthest_m.max(cell_m)];
    let sides = [reach_m, reach_m, turn_rad].into_iter().zip(step).map(|(reach, step)| (reach / step).ceil() as i32);
    let sides: Vec<i32> = sides.collect();
    // Coarse over the whole window, then finer about the best, so that a narrow maximum costs few poses.
    let coarse = around(&likelihood, points, guess, step, [sides[0], sides[1], sides[2]]);
    let centre = best(&coarse, guess);
    let fine = around(&likelihood, points, centre.0, step.map(|step| step / 4.0), [4; 3]);
    let centre = best(&fine, centre.0);
    let finest = around(&likelihood, points, centre.0, step.map(|step| step / 16.0), [4; 3]);
    let (pose, score) = best(&finest, centre.0);
    // Relative to the best score: likelihoods of hundreds of points would underflow.
    let weight = |score: f64| (independent * points.len() as f64 * (score - score_of(&coarse))).exp();
    let (mut total, mut mean, mut square) = (0.0, Vector3::zeros(), Matrix3::zeros());
    for (pose, score) in &coarse {
        let off = Vector3::new(pose.x_m - guess.x_m, pose.y_m - guess.y_m, wrapped(pose.yaw_rad - guess.yaw_rad));
        let weight = weight(*score);
        total += weight;
        mean += off * weight;
        square += off * off.transpose() * weight;
    }
    mean /= total;
    // The steps of the search quantise the pose: a twelfth of their square is the variance of that.
    let quantised = Matrix3::from_diagonal(&Vector3::from(step.map(|step| step * step / 12.0)));
    Ok(Matched { pose, covariance: square / total - mean * mean.transpose() + quantised, score })
}

/// Returns the poses about one, with their scores.
fn around(likelihood: &Grid<f64>, points: &[Point], at: Pose, step: [f64; 3], sides: [i32; 3]) -> Vec<(Pose, f64)> {
    let mut tried = Vec::new();
    for turn in -sides[2]..=sides[2] {
        let yaw_rad = wrapped(at.yaw_rad + f64::from(turn) * step[2]);
        for x in -sides[0]..=sides[0] {
            for y in -sides[1]..=sides[1] {
                let pose = Pose::new(at.x_m + f64::from(x) * step[0], at.y_m + f64::from(y) * step[1], yaw_rad);
                let of = |point: &Point| likelihood.interpolated(pose.outer(*point)).unwrap_or(-FARTHEST);
                tried.push((pose, points.iter().map(of).sum::<f64>() / points.len() as f64));
            }
        }
    }
    tried
}

fn best(tried: &[(Pose, f64)], otherwise: Pose) -> (Pose, f64) {
    let best = tried.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
    best.unwrap_or((otherwise, -FARTHEST))
}

fn score_of(tried: &[(Pose, f64)]) -> f64 {
    best(tried, Pose::default()).1
}
