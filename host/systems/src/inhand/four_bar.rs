//! The paper's method: fingers and object as a four-bar linkage with constant links, by Freudenstein's equation.
//!
//! `R1 cos(phi) - R2 cos(psi) + R3 - cos(phi - psi) = 0`, `R1 = a / d`, `R2 = a / b`, `R3 = (a² + b² - c² + d²) / (2 b d)`.
//!
//! # Repair
//! With both angles counted from the palm's axis, from the left joint to the right one, the first two terms need the
//! opposite sign. As printed, the equation holds for angles from the opposite ray, `pi - angle`, and so do the printed
//! `phi = theta_l + asin(w / b)` and `psi = theta_r - asin(w / d)`. This module converts the angles and leaves
//! everything else as printed.

use std::f64::consts::PI;

use super::bounded;

/// Palm and finger angles at one stop: the inputs of the method.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Distance between the fingers' joints, m.
    pub palm_m: f64,
    /// Angles of the left and right finger from the palm's axis, counterclockwise, rad.
    pub finger_rad: [f64; 2],
}

/// Lengths of a four-bar linkage, without that of the palm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linkage {
    /// Length from the left joint to its contact, m.
    pub b_m: f64,
    /// Distance between the contacts, m.
    pub c_m: f64,
    /// Length from the right joint to its contact, m.
    pub d_m: f64,
}

impl Linkage {
    fn ratios(&self, palm_m: f64) -> [f64; 3] {
        let Self { b_m, c_m, d_m } = *self;
        let third = (palm_m * palm_m + b_m * b_m - c_m * c_m + d_m * d_m) / (2.0 * b_m * d_m);
        [palm_m / d_m, palm_m / b_m, third]
    }

    /// Residual of Freudenstein's equation at a stop, dimensionless, with fingers of half-width `w_m`.
    #[must_use]
    pub fn residual(&self, w_m: f64, seen: &Observation) -> f64 {
        let [left_rad, right_rad] = seen.finger_rad.map(|angle_rad| PI - angle_rad);
        let phi = left_rad + (w_m / self.b_m).asin();
        let psi = right_rad - (w_m / self.d_m).asin();
        let [r1, r2, r3] = self.ratios(seen.palm_m);
        r1 * phi.cos() - r2 * psi.cos() + r3 - (phi - psi).cos()
    }

    /// Angle of the right finger for an angle of the left one, rad, by the half-angle form; of both solutions the one
    /// nearest to `near_rad`. NaN where the linkage does not close.
    #[must_use]
    pub fn right_rad(&self, w_m: f64, palm_m: f64, left_rad: f64, near_rad: f64) -> f64 {
        let phi = PI - left_rad + (w_m / self.b_m).asin();
        let [r1, r2, r3] = self.ratios(palm_m);
        let a = (1.0 + r1) * phi.cos() + r2 + r3;
        let b = -2.0 * phi.sin();
        let c = (r1 - 1.0) * phi.cos() - r2 + r3;
        let root = (b * b - 4.0 * a * c).sqrt();
        let right = |sign: f64| {
            let psi = 2.0 * (-b + sign * root).atan2(2.0 * a);
            let angle_rad = PI - (psi + (w_m / self.d_m).asin());
            // Unwrapped to within half a turn of `near_rad`.
            near_rad + (angle_rad - near_rad + PI).rem_euclid(2.0 * PI) - PI
        };
        let both = [right(1.0), right(-1.0)];
        if (both[0] - near_rad).abs() <= (both[1] - near_rad).abs() { both[0] } else { both[1] }
    }
}

/// Upper bounds of b and d, and of c, m. The lower bound of b and d is half the finger's width.
const REACH_M: f64 = 0.14;
const WIDEST_M: f64 = 0.12;
/// Initial guesses of c, m: the sum of squares has a second minimum near c = 0.
const SIZES_M: [f64; 3] = [0.010, 0.025, 0.045];

/// Fits constant b, c and d to all stops by least squares.
#[must_use]
pub fn fit(w_m: f64, seen: &[Observation]) -> Linkage {
    let linkage = |at: &[f64]| Linkage { b_m: at[0], c_m: at[1], d_m: at[2] };
    let residuals = |at: &[f64]| seen.iter().map(|stop| linkage(at).residual(w_m, stop)).collect::<Vec<_>>();
    let (low, high) = ([w_m + 1e-3, 1e-3, w_m + 1e-3], [REACH_M, WIDEST_M, REACH_M]);
    let fits = SIZES_M.map(|size_m| bounded::fit(&low, &high, &[0.07, size_m, 0.07], &residuals));
    let best = fits.iter().min_by(|one, other| one.1.total_cmp(&other.1));
    best.map_or(Linkage { b_m: f64::NAN, c_m: f64::NAN, d_m: f64::NAN }, |(at, _)| linkage(at))
}

#[cfg(test)]
mod tests {
    use super::*;

    const W_M: f64 = 0.008;

    /// Observation of fingers through two given contacts, by plane geometry.
    fn seen(palm_m: f64, contacts_m: [[f64; 2]; 2]) -> Observation {
        let angle = |side: usize| {
            let [x, y] = contacts_m[side];
            let x = x - [-0.5, 0.5][side] * palm_m;
            let inwards = (W_M / x.hypot(y)).asin();
            y.atan2(x) + [inwards, -inwards][side]
        };
        Observation { palm_m, finger_rad: [angle(0), angle(1)] }
    }

    #[test]
    fn the_repaired_equation_holds_and_its_half_angle_form_solves_it() {
        for (palm_m, contacts_m) in [(0.06, [[-0.012, 0.078], [0.014, 0.081]]), (0.08, [[-0.01, 0.07], [0.03, 0.09]])] {
            let seen = seen(palm_m, contacts_m);
            let length = |x: f64, y: f64| x.hypot(y);
            let [[lx, ly], [rx, ry]] = contacts_m;
            let linkage = Linkage {
                b_m: length(lx + 0.5 * palm_m, ly),
                c_m: length(rx - lx, ry - ly),
                d_m: length(rx - 0.5 * palm_m, ry),
            };
            assert!(linkage.residual(W_M, &seen).abs() < 1e-12);
            // As printed, with angles from the palm's axis, the equation does not hold.
            let turned = Observation { finger_rad: seen.finger_rad.map(|angle| PI - angle), ..seen };
            assert!(linkage.residual(W_M, &turned).abs() > 0.1);
            let [left_rad, right_rad] = seen.finger_rad;
            let found_rad = linkage.right_rad(W_M, palm_m, left_rad, right_rad + 0.05);
            assert!((found_rad - right_rad).abs() < 1e-12, "{found_rad} {right_rad}");
        }
    }

    #[test]
    fn a_linkage_is_found_from_both_motions() {
        let linkage = Linkage { b_m: 0.081, c_m: 0.026, d_m: 0.078 };
        let mut stops = Vec::new();
        let mut near_rad = 1.75;
        for number in -5..=5 {
            let part = f64::from(number) / 5.0;
            for (palm_m, left_rad) in [(0.062 + 0.015 * part, 1.45 - 0.1 * part), (0.062, 1.45 + 0.17 * part)] {
                near_rad = linkage.right_rad(W_M, palm_m, left_rad, near_rad);
                stops.push(Observation { palm_m, finger_rad: [left_rad, near_rad] });
            }
        }
        let found = fit(W_M, &stops);
        for (found_m, true_m) in [(found.b_m, 0.081), (found.c_m, 0.026), (found.d_m, 0.078)] {
            assert!((found_m - true_m).abs() < 1e-6, "{found:?}");
        }
    }
}
