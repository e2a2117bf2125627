//! Interpretation of the four pull-off forces that the paper prints.
//!
//! `F = dp A` with the printed diameter gives the effective suction. Two readings explain a surface that changes the
//! force: it changes the suction, because the seal leaks, or the area that seals. Four numbers fit at most two
//! parameters, so a fit cannot separate the two readings. Geometry can: a rim of 18 mm cannot seal more than its own
//! area.

use std::f64::consts::PI;

/// Radius of a cup, m: printed, 18 mm across.
pub const RADIUS_M: f64 = 9e-3;

/// A printed pull-off force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PullOff {
    /// Surface under the cup.
    pub surface: &'static str,
    /// Force at pull-off, N: printed.
    pub force_n: f64,
}

/// Pull-off forces on four surfaces, as printed.
pub const PRINTED: [PullOff; 4] = [
    PullOff { surface: "moist", force_n: 2.96 },
    PullOff { surface: "under water", force_n: 2.65 },
    PullOff { surface: "dry", force_n: 1.79 },
    PullOff { surface: "oil", force_n: 0.95 },
];

/// Suction and area that a pull-off force implies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effective {
    /// Suction over the printed area, Pa.
    pub suction_pa: f64,
    /// Suction over full vacuum, 101.3 kPa; dimensionless.
    pub of_vacuum: f64,
    /// Force over that of the dry surface; dimensionless.
    pub of_dry: f64,
    /// Radius that would seal if the suction were that of the dry surface, m. Beyond [`RADIUS_M`] the area cannot be
    /// the reason.
    pub radius_by_area_m: f64,
}

/// Computes the effective suction of a force, N, over a cup of radius `radius_m`, and compares it with the dry
/// surface's force, N.
#[must_use]
pub fn effective(force_n: f64, dry_n: f64, radius_m: f64) -> Effective {
    let suction_pa = force_n / (PI * radius_m * radius_m);
    Effective {
        suction_pa,
        of_vacuum: suction_pa / 101_325.0,
        of_dry: force_n / dry_n,
        radius_by_area_m: radius_m * (force_n / dry_n).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 11.6, 10.4, 7.0 and 3.7 kPa over 254 mm²: 4 to 11 % of vacuum.
    #[test]
    fn the_printed_forces_are_a_tenth_of_vacuum() {
        let of = |place: usize| effective(PRINTED[place].force_n, PRINTED[2].force_n, RADIUS_M);
        for (place, expected_pa) in [11.6e3, 10.4e3, 7.0e3, 3.7e3].into_iter().enumerate() {
            // Half of the last digit that is printed above, 0.1 kPa.
            assert!((of(place).suction_pa - expected_pa).abs() <= 50.0, "{:?}", of(place));
            assert!((0.036..0.116).contains(&of(place).of_vacuum));
        }
        assert!((of(0).of_dry - 1.65).abs() < 0.005 && (of(3).of_dry - 0.53).abs() < 0.005);
        // By area alone a moist rim would have to seal 23 mm across, more than the cup has: the seal changes, not
        // the area.
        assert!(of(0).radius_by_area_m > 1.25 * RADIUS_M && of(1).radius_by_area_m > 1.2 * RADIUS_M);
        assert_eq!(of(2).radius_by_area_m, RADIUS_M);
    }
}
