//! Our method: an object with two round edges that roll along the fingers.
//!
//! Each contact belongs to an arc of radius `r` about a centre that is fixed in the object. While the object turns by
//! `delta` and a finger by `theta`, the left arc's centre moves by `r (delta - theta)` along its finger and the right
//! one's by `-r (delta - theta)`. The vector `e` between the centres turns with the object:
//!
//! `right centre - left centre = R(delta) e`
//!
//! At each stop these are two equations for one unknown rotation, so that each stop has one residual; at the first,
//! where the rotation is 0 by definition, both remain. Five parameters are fitted to all stops: the positions of both
//! contacts along their fingers at the first stop, the two components of `e`, and `r`. With `r = 0` this is the paper's
//! four-bar linkage, with `e = 0` a disc.

use super::{bounded, four_bar::Observation};

/// Newton steps for the rotation at a stop: from that at the previous stop, three reach rounding errors.
const NEWTON_STEPS: usize = 4;
/// Bounds of the parameters, m: positions along the fingers, components of the vector between the centres, radius.
const PLACE_M: [f64; 2] = [0.03, 0.12];
const APART_M: f64 = 0.06;
const RADIUS_M: f64 = 0.03;
/// Initial guesses of the radius, m: sharp and round edges.
const RADII_M: [f64; 3] = [0.001, 0.006, 0.015];

/// An object between two fingers, as estimated at the first stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grasp {
    /// Distances from the joints to the contacts, left and right, m.
    pub contact_m: [f64; 2],
    /// Distance between the contacts, m.
    pub size_m: f64,
    /// Width of the object over both edges, m.
    pub across_m: f64,
    /// Radius of the object's edges, m.
    pub radius_m: f64,
    numbers: [f64; 5],
}

/// Closure error of the vector between the arcs' centres for a rotation of the object, m, and its derivative by the
/// rotation, m/rad.
fn closure(w_m: f64, numbers: &[f64], first: &Observation, seen: &Observation, turn_rad: f64) -> ([f64; 2], [f64; 2]) {
    let &[left_m, right_m, e_x, e_y, r] = numbers else { return ([f64::NAN; 2], [f64::NAN; 2]) };
    let [left_rad, right_rad] = seen.finger_rad;
    let left_m = left_m + r * (turn_rad - (left_rad - first.finger_rad[0]));
    let right_m = right_m - r * (turn_rad - (right_rad - first.finger_rad[1]));
    let ((sin_l, cos_l), (sin_r, cos_r), (sin, cos)) = (left_rad.sin_cos(), right_rad.sin_cos(), turn_rad.sin_cos());
    let off_m = w_m + r;
    let left = [-0.5 * seen.palm_m + left_m * cos_l + off_m * sin_l, left_m * sin_l - off_m * cos_l];
    let right = [0.5 * seen.palm_m + right_m * cos_r - off_m * sin_r, right_m * sin_r + off_m * cos_r];
    let turned = [cos * e_x - sin * e_y, sin * e_x + cos * e_y];
    let gap = [right[0] - left[0] - turned[0], right[1] - left[1] - turned[1]];
    (gap, [-r * (cos_r + cos_l) + turned[1], -r * (sin_r + sin_l) - turned[0]])
}

/// Rotation of the object at a stop, rad, by Newton's method from that at the previous stop.
fn turn_rad(w_m: f64, numbers: &[f64], first: &Observation, seen: &Observation, before_rad: f64) -> f64 {
    let mut turn_rad = before_rad;
    for _ in 0..NEWTON_STEPS {
        let (gap, slope) = closure(w_m, numbers, first, seen, turn_rad);
        let square = slope[0] * slope[0] + slope[1] * slope[1];
        turn_rad -= (gap[0] * slope[0] + gap[1] * slope[1]) / square.max(f64::MIN_POSITIVE);
    }
    turn_rad
}

fn residuals(w_m: f64, numbers: &[f64], seen: &[Observation]) -> Vec<f64> {
    let Some(first) = seen.first() else { return Vec::new() };
    let mut before_rad = 0.0;
    let rest = seen.iter().skip(1).map(|stop| {
        before_rad = turn_rad(w_m, numbers, first, stop, before_rad);
        let (gap, slope) = closure(w_m, numbers, first, stop, before_rad);
        (gap[0] * slope[1] - gap[1] * slope[0]) / slope[0].hypot(slope[1]).max(f64::MIN_POSITIVE)
    });
    closure(w_m, numbers, first, first, 0.0).0.into_iter().chain(rest).collect()
}

/// Fits the grasp to all stops by least squares; fingers have half-width `w_m`. With `rolls` false the edges are sharp.
/// `None` without stops.
#[must_use]
pub fn fit(w_m: f64, seen: &[Observation], rolls: bool) -> Option<Grasp> {
    let first = seen.first()?;
    let most_m = if rolls { RADIUS_M } else { 1e-7 };
    let (low, high) =
        ([PLACE_M[0], PLACE_M[0], -APART_M, -APART_M, 0.0], [PLACE_M[1], PLACE_M[1], APART_M, APART_M, most_m]);
    let fits = RADII_M.map(|radius_m| {
        let radius_m = radius_m.min(0.5 * most_m);
        let start = [0.075, 0.075, 0.0, 0.0, radius_m];
        let (apart, _) = closure(w_m, &start, first, first, 0.0);
        let start = [0.075, 0.075, apart[0], apart[1], radius_m];
        bounded::fit(&low, &high, &start, &|numbers| residuals(w_m, numbers, seen))
    });
    let (numbers, _) = fits.into_iter().min_by(|one, other| one.1.total_cmp(&other.1))?;
    let &[left_m, right_m, e_x, e_y, radius_m] = &numbers[..] else { return None };
    let [left_rad, right_rad] = first.finger_rad;
    // The contacts are one radius outside the centres, perpendicular to the fingers.
    let between =
        [e_x + radius_m * (right_rad.sin() + left_rad.sin()), e_y - radius_m * (right_rad.cos() + left_rad.cos())];
    Some(Grasp {
        contact_m: [left_m.hypot(w_m), right_m.hypot(w_m)],
        size_m: between[0].hypot(between[1]),
        across_m: e_x.hypot(e_y) + 2.0 * radius_m,
        radius_m,
        numbers: [left_m, right_m, e_x, e_y, radius_m],
    })
}

impl Grasp {
    /// Distances from the joints to the contacts at each stop, m.
    #[must_use]
    pub fn contacts_m(&self, w_m: f64, seen: &[Observation]) -> Vec<[f64; 2]> {
        let Some(first) = seen.first() else { return Vec::new() };
        let [left_m, right_m, .., r] = self.numbers;
        let mut before_rad = 0.0;
        let contact = |stop: &Observation| {
            before_rad = turn_rad(w_m, &self.numbers, first, stop, before_rad);
            let rolled_m = |side: usize| r * (before_rad - (stop.finger_rad[side] - first.finger_rad[side]));
            [(left_m + rolled_m(0)).hypot(w_m), (right_m - rolled_m(1)).hypot(w_m)]
        };
        seen.iter().map(contact).collect()
    }
}
