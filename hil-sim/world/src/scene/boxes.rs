//! Boxes on the floor that a body pushes: rigid rectangles with Coulomb friction.
//!
//! Friction of the whole base is a limit surface, an ellipsoid of the largest force `mu m g` and the largest moment
//! `mu m g d`, with `d` the mean distance of the base from its centre. A box at rest stays up to the static friction;
//! one that slides is decelerated by the kinetic friction, opposite to its velocity on that surface. It does not tilt.
//!
//! # Source
//! Goyal, Ruina, Papadopoulos, "Planar sliding with dry friction", Wear 143 (1991) 307-330; the ellipsoid: Howe, Cutkosky, "Practical
//! force-motion models for sliding manipulation", Int. J. Robotics Research 15 (1996) 557-572.

use super::{Point, SceneError, length, minus};
use crate::{GRAVITY_M_S2, Pose};

/// Speed below which a box is at rest, m/s: friction of 0.01 removes it in a twentieth of the longest step.
const REST_M_S: f64 = 1e-6;

/// Size, mass and friction of a box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoxSpec {
    /// Side lengths along its own x and y, m.
    pub size_m: [f64; 2],
    /// Mass of the box, kg.
    pub mass_kg: f64,
    /// Static friction coefficient on the floor.
    pub friction: f64,
    /// Kinetic friction as a share of the static one, 0 to 1.
    pub kinetic_share: f64,
}

/// A box on the floor with its state.
#[derive(Clone, Debug, PartialEq)]
pub struct MovableBox {
    spec: BoxSpec,
    pose: Pose,
    /// Velocity of its centre, world frame, m/s.
    velocity_m_s: Point,
    rate_rad_s: f64,
    /// Mean distance of the base from its centre, m.
    lever_m: f64,
    inertia_kg_m2: f64,
    /// Force and moment about the centre applied by bodies since the last step, N and N m.
    pushed: [f64; 3],
}

impl MovableBox {
    /// A box at rest, its centre and x axis at `pose`.
    ///
    /// # Errors
    /// [`SceneError::Box`] for parameters out of range.
    pub fn new(spec: BoxSpec, pose: Pose) -> Result<Self, SceneError> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let BoxSpec { size_m: [along_m, across_m], mass_kg, friction, kinetic_share } = spec;
        let is_placed = [pose.x_m, pose.y_m, pose.yaw_rad].into_iter().all(f64::is_finite);
        if ![along_m, across_m, mass_kg].into_iter().all(positive)
            || !(0.0..f64::INFINITY).contains(&friction)
            || !(0.0..=1.0).contains(&kinetic_share)
            || !is_placed
        {
            return Err(SceneError::Box);
        }
        let diagonal_m = libm::hypot(along_m, across_m);
        let side = |one_m: f64, other_m: f64| one_m * one_m / other_m * libm::log((other_m + diagonal_m) / one_m);
        // mean distance from the corner of a quarter of the rectangle
        let lever_m = 0.5 * (diagonal_m / 3.0 + (side(along_m, across_m) + side(across_m, along_m)) / 6.0);
        let inertia_kg_m2 = mass_kg * diagonal_m * diagonal_m / 12.0;
        Ok(Self { spec, pose, velocity_m_s: [0.0; 2], rate_rad_s: 0.0, lever_m, inertia_kg_m2, pushed: [0.0; 3] })
    }

    /// Size, mass and friction of the box.
    #[must_use]
    pub const fn spec(&self) -> &BoxSpec {
        &self.spec
    }

    /// Pose of its centre and x axis, world frame.
    #[must_use]
    pub const fn pose(&self) -> Pose {
        self.pose
    }

    /// Corners of the box, counterclockwise, world frame, m.
    #[must_use]
    pub fn corners_m(&self) -> [Point; 4] {
        let [x, y] = self.spec.size_m.map(|side_m| 0.5 * side_m);
        [[x, -y], [x, y], [-x, y], [-x, -y]].map(|corner| self.pose.to_world(corner))
    }

    /// Upper bound of the speed of its points, m/s.
    pub(crate) fn fastest_m_s(&self) -> f64 {
        length(self.velocity_m_s) + self.rate_rad_s.abs() * 0.5 * length(self.spec.size_m)
    }

    /// Velocity of one of its points, world frame, m/s.
    pub(crate) fn velocity_at(&self, point: Point) -> Point {
        let arm = minus(point, [self.pose.x_m, self.pose.y_m]);
        [self.velocity_m_s[0] - self.rate_rad_s * arm[1], self.velocity_m_s[1] + self.rate_rad_s * arm[0]]
    }

    /// Adds a force at a point, world frame, N and m, for the next step.
    pub(crate) fn push(&mut self, force_n: Point, at_m: Point) {
        let arm = minus(at_m, [self.pose.x_m, self.pose.y_m]);
        self.pushed[0] += force_n[0];
        self.pushed[1] += force_n[1];
        self.pushed[2] += super::cross(arm, force_n);
    }

    /// Advances by `step_s`, s, under friction and the forces since the last step.
    pub(crate) fn step(&mut self, step_s: f64) {
        let [x_n, y_n, moment_nm] = std::mem::take(&mut self.pushed);
        let BoxSpec { mass_kg, friction, kinetic_share, .. } = self.spec;
        let holds_n = friction * mass_kg * GRAVITY_M_S2;
        let sliding_m_s =
            |[x, y]: Point, rate: f64| libm::sqrt(x * x + y * y + self.lever_m * self.lever_m * rate * rate);
        if sliding_m_s(self.velocity_m_s, self.rate_rad_s) < REST_M_S {
            (self.velocity_m_s, self.rate_rad_s) = ([0.0; 2], 0.0);
            if libm::hypot(libm::hypot(x_n, y_n), moment_nm / self.lever_m) <= holds_n {
                return;
            }
        }
        let velocity_m_s = [x_n, y_n].map(|force_n| force_n / mass_kg * step_s);
        let velocity_m_s = [self.velocity_m_s[0] + velocity_m_s[0], self.velocity_m_s[1] + velocity_m_s[1]];
        let rate_rad_s = self.rate_rad_s + moment_nm / self.inertia_kg_m2 * step_s;
        let impulse = kinetic_share * holds_n * step_s / sliding_m_s(velocity_m_s, rate_rad_s).max(f64::MIN_POSITIVE);
        // friction stops a motion and never reverses it
        let keeps = (1.0 - impulse / mass_kg).max(0.0);
        let keeps_turning = (1.0 - impulse * self.lever_m * self.lever_m / self.inertia_kg_m2).max(0.0);
        self.velocity_m_s = velocity_m_s.map(|speed| speed * keeps);
        self.rate_rad_s = rate_rad_s * keeps_turning;
        self.pose.x_m += self.velocity_m_s[0] * step_s;
        self.pose.y_m += self.velocity_m_s[1] * step_s;
        self.pose.yaw_rad += self.rate_rad_s * step_s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_STEP_S;

    const CARDBOARD: BoxSpec = BoxSpec { size_m: [0.165, 0.22], mass_kg: 0.25, friction: 0.4, kinetic_share: 0.8 };

    fn at_rest(spec: BoxSpec) -> MovableBox {
        MovableBox::new(spec, Pose::default()).unwrap()
    }

    #[test]
    fn a_box_moves_from_static_friction_on_and_is_held_by_kinetic() {
        let holds_n = 0.4 * 0.25 * GRAVITY_M_S2;
        let after = |share: f64| {
            let mut one = at_rest(CARDBOARD);
            for _ in 0..400 {
                one.push([share * holds_n, 0.0], [-0.0825, 0.0]);
                one.step(MAX_STEP_S);
            }
            one
        };
        assert_eq!(after(0.999).pose(), Pose::default());
        // 100 ms at (1.001 - 0.8) mu g from static friction on; semi-implicit steps are ahead by half a step: 0.25 %
        let expected_m = 0.5 * (1.001 - 0.8) * 0.4 * GRAVITY_M_S2 * 0.01;
        let moved_m = after(1.001).pose().x_m;
        assert!((moved_m / expected_m - 1.0).abs() < 3e-3, "{moved_m}, {expected_m}");
    }

    #[test]
    fn a_sliding_box_stops_after_its_braking_distance_and_angle() {
        let mut one = at_rest(CARDBOARD);
        one.velocity_m_s = [0.6, 0.8];
        while one.velocity_m_s != [0.0; 2] {
            one.step(MAX_STEP_S);
        }
        // v² / (2 mu g), to half a step at 1 m/s
        let way_m = libm::hypot(one.pose.x_m, one.pose.y_m);
        assert!((way_m - 1.0 / (2.0 * 0.32 * GRAVITY_M_S2)).abs() < 2e-4, "{way_m}");
        let mut one = at_rest(CARDBOARD);
        one.rate_rad_s = 5.0;
        while one.rate_rad_s != 0.0 {
            one.step(MAX_STEP_S);
        }
        // J w² / (2 mu m g d); d as the mean over 400 x 400 points of the base, without the closed form
        let mean_m: f64 = (0..160_000)
            .map(|cell| {
                let place = |number: i32, side_m: f64| (f64::from(number) + 0.5) / 400.0 * side_m - 0.5 * side_m;
                libm::hypot(place(cell / 400, 0.165), place(cell % 400, 0.22))
            })
            .sum::<f64>()
            / 160_000.0;
        let moment_nm = 0.32 * 0.25 * GRAVITY_M_S2 * mean_m;
        let expected_rad = one.inertia_kg_m2 * 25.0 / (2.0 * moment_nm);
        assert!((one.pose.yaw_rad / expected_rad - 1.0).abs() < 5e-3, "{} {expected_rad}", one.pose.yaw_rad);
    }

    #[test]
    fn a_push_beside_the_centre_turns_it_and_needs_less_force() {
        let holds_n = 0.4 * 0.25 * GRAVITY_M_S2;
        let turned_rad = |share: f64| {
            let mut one = at_rest(CARDBOARD);
            one.push([share * holds_n, 0.0], [-0.0825, -0.11]);
            one.step(MAX_STEP_S);
            one.pose.yaw_rad
        };
        // on the ellipsoid: 1 / sqrt(1 + (r/d)²) of the force at the centre, r = 0.11, d = 0.0742
        let share = 1.0 / libm::hypot(1.0, 0.11 / at_rest(CARDBOARD).lever_m);
        assert_eq!(turned_rad(0.999 * share), 0.0);
        assert!(turned_rad(1.001 * share) > 0.0, "counterclockwise: pushed forwards on the right");
    }

    #[test]
    fn what_is_no_box_is_refused() {
        for wrong in [
            BoxSpec { size_m: [0.0, 0.2], ..CARDBOARD },
            BoxSpec { mass_kg: -1.0, ..CARDBOARD },
            BoxSpec { friction: f64::NAN, ..CARDBOARD },
            BoxSpec { kinetic_share: 1.1, ..CARDBOARD },
        ] {
            assert_eq!(MovableBox::new(wrong, Pose::default()), Err(SceneError::Box), "{wrong:?}");
        }
        assert!(MovableBox::new(CARDBOARD, Pose { x_m: f64::INFINITY, ..Pose::default() }).is_err());
    }
}
