//! Odometry of a robot with measured wheels: pose and covariance from the wheels' travel.
//!
//! # Source
//! Siegwart, Nourbakhsh, Scaramuzza, *Introduction to Autonomous Mobile Robots*, 2nd edition, MIT Press 2011, 5.2.4:
//! the travel of each side has a variance proportional to its length, which the Jacobians of the step propagate.

use r4_boards::SkidSteer;

/// Variance of a side's travel per metre, m²/m: our choice, 1 cm after 1 m.
pub const WHEEL_VARIANCE_M: f64 = 1e-4;

/// Pose of a robot relative to its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Place {
    /// Position along the initial heading, m.
    pub x_m: f64,
    /// Position to the left of the initial heading, m.
    pub y_m: f64,
    /// Heading, rad, counterclockwise, not wrapped.
    pub yaw_rad: f64,
}

/// Odometry of a skid-steer or differential robot.
#[derive(Clone, Debug)]
pub struct Odometry {
    wheel_radius_m: f64,
    track_m: f64,
    place: Place,
    /// Covariance of x, y and yaw: m², m rad, rad².
    covariance: [[f64; 3]; 3],
    /// Mean wheel angles of the left and the right side at the last call, rad; `None` before the first.
    last_rad: Option<[f64; 2]>,
}

impl Odometry {
    /// Starts at the origin, without uncertainty.
    #[must_use]
    pub fn new(robot: &SkidSteer) -> Self {
        Self {
            wheel_radius_m: robot.wheel_radius_m,
            track_m: robot.track_m,
            place: Place::default(),
            covariance: [[0.0; 3]; 3],
            last_rad: None,
        }
    }

    /// Estimated pose relative to the start.
    #[must_use]
    pub fn place(&self) -> Place {
        self.place
    }

    /// Covariance of x, y and yaw: m², m rad, rad². Slip that all wheels of a side share is contained by
    /// [`WHEEL_VARIANCE_M`] only.
    #[must_use]
    pub fn covariance(&self) -> [[f64; 3]; 3] {
        self.covariance
    }

    /// Starts to count from the present pose again, for wheels whose positions begin at 0 anew, as after a restart of the
    /// board. Motion between the last update and the next is not counted.
    pub fn count_anew(&mut self) {
        self.last_rad = None;
    }

    /// Updates the pose by the mean angles of the left and the right wheels, rad. The first call defines the start;
    /// angles that are not finite are ignored.
    pub fn look(&mut self, left_rad: f64, right_rad: f64) {
        if !(left_rad.is_finite() && right_rad.is_finite()) {
            return;
        }
        let Some([left_before, right_before]) = self.last_rad.replace([left_rad, right_rad]) else { return };
        let left_m = (left_rad - left_before) * self.wheel_radius_m;
        let right_m = (right_rad - right_before) * self.wheel_radius_m;
        let way_m = (left_m + right_m) / 2.0;
        let turned_rad = (right_m - left_m) / self.track_m;
        // Midpoint heading: second-order accurate for a constant turn rate within the step.
        let (sin, cos) = (self.place.yaw_rad + turned_rad / 2.0).sin_cos();
        self.place.x_m += way_m * cos;
        self.place.y_m += way_m * sin;
        self.place.yaw_rad += turned_rad;

        let by_place = [[1.0, 0.0, -way_m * sin], [0.0, 1.0, way_m * cos], [0.0, 0.0, 1.0]];
        let mut covariance = carried(&by_place, &self.covariance);
        // Jacobian of x, y and yaw by the travel of each side.
        let per_m = 1.0 / self.track_m;
        for (side_m, yaw) in [(left_m, -per_m), (right_m, per_m)] {
            let change = [cos / 2.0 - way_m * sin * yaw / 2.0, sin / 2.0 + way_m * cos * yaw / 2.0, yaw];
            let variance = WHEEL_VARIANCE_M * side_m.abs();
            for (row, one) in covariance.iter_mut().zip(change) {
                row.iter_mut().zip(change).for_each(|(entry, other)| *entry += variance * one * other);
            }
        }
        self.covariance = covariance;
    }
}

/// Propagated covariance `F C Fᵀ`.
fn carried(by: &[[f64; 3]; 3], covariance: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let times = |row: &[f64; 3], column: [f64; 3]| row.iter().zip(column).map(|(one, other)| one * other).sum::<f64>();
    let mut result = [[0.0; 3]; 3];
    for (row, entries) in result.iter_mut().enumerate() {
        let half = [0, 1, 2].map(|column| times(&by[row], covariance.map(|row| row[column])));
        for (column, entry) in entries.iter_mut().enumerate() {
            *entry = times(&half, by[column]);
        }
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use r4_boards::Drive;
    use std::f64::consts::PI;

    fn robot() -> SkidSteer {
        let Some(Drive::SkidSteer(robot)) = r4_boards::load("openscout").expect("built in").drive else { panic!() };
        robot
    }

    /// Rolls left and right wheels by these distances, m, in `looks` equal steps.
    fn rolled(robot: &SkidSteer, left_m: f64, right_m: f64, looks: u32) -> Odometry {
        let mut odometry = Odometry::new(robot);
        for look in 0..=looks {
            let share = f64::from(look) / f64::from(looks) / robot.wheel_radius_m;
            odometry.look(share * left_m, share * right_m);
        }
        odometry
    }

    #[test]
    fn wheels_that_roll_alike_go_straight_and_against_each_other_turn() {
        let robot = robot();
        let straight = rolled(&robot, 2.0, 2.0, 10).place();
        assert!((straight.x_m - 2.0).abs() < 1e-12 && straight.y_m == 0.0 && straight.yaw_rad == 0.0, "{straight:?}");
        let turned = rolled(&robot, -0.5, 0.5, 10).place();
        assert!((turned.yaw_rad - 1.0 / robot.track_m).abs() < 1e-12 && turned.x_m.abs() < 1e-12);
    }

    /// Half a circle of radius 1 m ends 2 m to the left of the start.
    #[test]
    fn a_half_circle_comes_back_beside_its_start() {
        let robot = robot();
        let half_m = robot.track_m / 2.0;
        let Place { x_m, y_m, yaw_rad } = rolled(&robot, PI * (1.0 - half_m), PI * (1.0 + half_m), 200).place();
        // The midpoint rule with 200 steps: an error of (pi / 200)² / 24 of the travel.
        assert!((yaw_rad - PI).abs() < 1e-9 && x_m.abs() < 1e-4 && (y_m - 2.0).abs() < 1e-4, "{x_m} {y_m}");
    }

    #[test]
    fn uncertainty_grows_with_the_way_and_most_across_it() {
        let robot = robot();
        let covariance = rolled(&robot, 4.0, 4.0, 400).covariance();
        // Expected variances: along the path that of a mean of two sides; of the yaw by their difference over the
        // track; across the path by the integral of the latter, s³/3.
        let (along, yaw) = (WHEEL_VARIANCE_M * 4.0 / 2.0, 2.0 * WHEEL_VARIANCE_M / robot.track_m.powi(2));
        assert!((covariance[0][0] / along - 1.0).abs() < 1e-9);
        assert!((covariance[2][2] / (yaw * 4.0) - 1.0).abs() < 1e-9);
        // To within the length of a step, 1/400 of the travel.
        assert!((covariance[1][1] / (yaw * 64.0 / 3.0) - 1.0).abs() < 5e-3, "{}", covariance[1][1]);
    }

    proptest! {
        #[test]
        fn covariances_are_symmetric_and_grow(ways in prop::collection::vec((-0.3..0.3f64, -0.3..0.3f64), 1..60)) {
            let mut odometry = Odometry::new(&robot());
            odometry.look(0.0, 0.0);
            let (mut left, mut right, mut before) = (0.0, 0.0, 0.0);
            for (left_rad, right_rad) in ways {
                (left, right) = (left + left_rad, right + right_rad);
                odometry.look(left, right);
                let covariance = odometry.covariance();
                prop_assert!(covariance[2][2] >= before);
                before = covariance[2][2];
                for (row, column) in [(0, 1), (0, 2), (1, 2)] {
                    let (one, other) = (covariance[row][column], covariance[column][row]);
                    prop_assert!((one - other).abs() <= 1e-12 * (1.0 + one.abs()));
                    prop_assert!(one * one <= covariance[row][row] * covariance[column][column] * (1.0 + 1e-9));
                }
            }
        }
    }

    #[test]
    fn a_count_that_starts_again_moves_nothing() {
        let robot = robot();
        let mut odometry = rolled(&robot, 1.0, 1.5, 10);
        let before = odometry.place();
        odometry.count_anew();
        odometry.look(0.0, 0.0);
        assert_eq!(odometry.place(), before);
        odometry.look(1.0, 1.0);
        let way_m = (odometry.place().x_m - before.x_m).hypot(odometry.place().y_m - before.y_m);
        assert!((way_m - robot.wheel_radius_m).abs() < 1e-12, "{way_m}");
    }

    #[test]
    fn a_look_that_is_no_number_is_left_out() {
        let robot = robot();
        let mut odometry = Odometry::new(&robot);
        odometry.look(0.0, 0.0);
        odometry.look(f64::NAN, 1.0);
        odometry.look(1.0, 1.0);
        assert!((odometry.place().x_m - robot.wheel_radius_m).abs() < 1e-15);
    }
}
