//! The [`Body`] trait, its frames and motions, and the kinds of bodies.

use std::ops::{Deref, DerefMut};

use crate::{
    berry::BerryPicker, cable_loop::CableLoop, deformable::Deformable, grip::TwoFingers, outline::Outline,
    scene::Scene, suction::SuctionPad, tail::BalanceTail, wheeled::Wheeled,
};

/// Position and heading on the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// World x of the origin, m.
    pub x_m: f64,
    /// World y of the origin, m.
    pub y_m: f64,
    /// Heading, rad, counterclockwise from the world's x axis; not wrapped.
    pub yaw_rad: f64,
}

impl Pose {
    /// Transforms a point from the body's frame to the world's, m.
    #[must_use]
    pub fn to_world(&self, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = libm::sincos(self.yaw_rad);
        [self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m]
    }

    /// The pose `after_s` seconds later at a constant velocity in the body's frame: by the mean heading, second order
    /// in the time.
    #[must_use]
    pub fn moved(&self, twist: Twist, after_s: f64) -> Self {
        let Twist { forward_m_s, left_m_s, yaw_rad_s } = twist;
        let (sin, cos) = libm::sincos(self.yaw_rad + 0.5 * yaw_rad_s * after_s);
        Self {
            x_m: self.x_m + (cos * forward_m_s - sin * left_m_s) * after_s,
            y_m: self.y_m + (sin * forward_m_s + cos * left_m_s) * after_s,
            yaw_rad: self.yaw_rad + yaw_rad_s * after_s,
        }
    }
}

/// Velocity in the body's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Velocity component forwards, m/s.
    pub forward_m_s: f64,
    /// Velocity component to the left, m/s.
    pub left_m_s: f64,
    /// Yaw rate, rad/s, counterclockwise.
    pub yaw_rad_s: f64,
}

impl Twist {
    /// Mean of two velocities.
    #[must_use]
    pub fn mean(self, other: Self) -> Self {
        Self {
            forward_m_s: f64::midpoint(self.forward_m_s, other.forward_m_s),
            left_m_s: f64::midpoint(self.left_m_s, other.left_m_s),
            yaw_rad_s: f64::midpoint(self.yaw_rad_s, other.yaw_rad_s),
        }
    }

    /// Velocity of a point of the body, body frame, m/s.
    #[must_use]
    pub fn at(&self, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
        [self.forward_m_s - self.yaw_rad_s * y_m, self.left_m_s + self.yaw_rad_s * x_m]
    }
}

/// Motion of a shaft's output at the beginning of a step. A relay is a shaft at 1 while its contact is closed and at 0
/// while it is open.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShaftMotion {
    /// Position of the output, rad or m.
    pub position: f64,
    /// Speed of the output, rad/s or m/s.
    pub speed: f64,
}

/// A mechanism that couples shafts by forces.
pub trait Body {
    /// Number of shafts, in the order in which their motions and loads are given.
    fn shafts(&self) -> usize;

    /// Advances the body from `time_s` by one step of `step_s`, s, at most [`crate::MAX_STEP_S`]. Takes the motion of
    /// the shafts and writes the load of each over the step, N m or N, positive towards positive positions. `shafts`
    /// and `loads` have one entry for each of [`Body::shafts`]. Boxes of the scene that the body pushes move with it.
    fn step(&mut self, scene: &mut Scene, time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64);

    /// Pose of the body's frame in the world.
    fn pose(&self) -> Pose;

    /// Moves the body to a pose, at rest.
    fn set_pose(&mut self, pose: Pose);

    /// Velocity of the body's frame, in that frame.
    fn twist(&self) -> Twist;

    /// Readings of an ideal inertial sensor at the origin of the body's frame, over the last step.
    fn inertial(&self) -> Inertial;

    /// Outline that collides with obstacles; `None` passes through them.
    fn outline(&self) -> Option<&Outline> {
        None
    }

    /// Names of the quantities that sensors on the body measure, each with its unit as a suffix (`pressure_0_pa`).
    /// Robot files connect analog inputs, switches and bus sensors to them.
    fn readings(&self) -> &'static [&'static str] {
        &[]
    }

    /// Value of one of [`Body::readings`] over the last step, by index; 0 past the last.
    fn reading(&self, number: usize) -> f64 {
        let _ = number;
        0.0
    }
}

/// Input of an inertial sensor: x forwards, y to the left, z upwards along the part that carries it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inertial {
    /// Acceleration minus gravity, m/s²: +9.8 on the upward axis at rest.
    pub specific_force_m_s2: [f64; 3],
    /// Angular rates about x, y and z, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Angular accelerations about x, y and z, rad/s².
    pub angular_acceleration_rad_s2: [f64; 3],
}

impl Inertial {
    /// Input of a level body at rest, which measures the reaction to gravity.
    pub const AT_REST: Self = Self {
        specific_force_m_s2: [0.0, 0.0, crate::GRAVITY_M_S2],
        rate_rad_s: [0.0; 3],
        angular_acceleration_rad_s2: [0.0; 3],
    };

    /// Input at another point of the same part, `place_m` from the first: `f + α × r + ω × (ω × r)`.
    #[must_use]
    pub fn at(&self, place_m: [f64; 3]) -> Self {
        let turning = cross(self.rate_rad_s, place_m);
        let added = [cross(self.angular_acceleration_rad_s2, place_m), cross(self.rate_rad_s, turning)];
        let specific_force_m_s2 =
            std::array::from_fn(|axis| self.specific_force_m_s2[axis] + added[0][axis] + added[1][axis]);
        Self { specific_force_m_s2, ..*self }
    }
}

fn cross([ax, ay, az]: [f64; 3], [bx, by, bz]: [f64; 3]) -> [f64; 3] {
    [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx]
}

/// A body of any kind, as robot files name it.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyBody {
    /// A chassis on wheels.
    Wheeled(Box<Wheeled>),
    /// A person with a tail on the back.
    BalanceTail(Box<BalanceTail>),
    /// A robot on wheels in a shell that narrows.
    Deformable(Box<Deformable>),
    /// Two fingers with an object between them.
    TwoFingers(Box<TwoFingers>),
    /// A gripper with a loop that closes round a vial.
    CableLoop(Box<CableLoop>),
    /// A gripper in front of a bush.
    BerryPicker(Box<BerryPicker>),
    /// A strip with suction cups and inflatable membranes.
    SuctionPad(Box<SuctionPad>),
}

impl Deref for AnyBody {
    type Target = dyn Body;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::Wheeled(body) => &**body,
            Self::Deformable(body) => &**body,
            Self::BalanceTail(body) => &**body,
            Self::TwoFingers(body) => &**body,
            Self::CableLoop(body) => &**body,
            Self::BerryPicker(body) => &**body,
            Self::SuctionPad(body) => &**body,
        }
    }
}

impl DerefMut for AnyBody {
    fn deref_mut(&mut self) -> &mut Self::Target {
        match self {
            Self::Wheeled(body) => &mut **body,
            Self::Deformable(body) => &mut **body,
            Self::BalanceTail(body) => &mut **body,
            Self::TwoFingers(body) => &mut **body,
            Self::CableLoop(body) => &mut **body,
            Self::BerryPicker(body) => &mut **body,
            Self::SuctionPad(body) => &mut **body,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sensor on a turntable at 2 rad/s and 3 rad/s², 0.5 m from the axis: centripetal `w² r`, tangential `a r`.
    #[test]
    fn a_sensor_away_from_the_axis_feels_the_turn() {
        let axis = Inertial {
            specific_force_m_s2: [0.0, 0.0, 9.8],
            rate_rad_s: [0.0, 0.0, 2.0],
            angular_acceleration_rad_s2: [0.0, 0.0, 3.0],
        };
        assert_eq!(axis.at([0.5, 0.0, 0.7]).specific_force_m_s2, [-2.0, 1.5, 9.8]);
        assert_eq!(axis.at([0.0, -0.5, 0.0]).specific_force_m_s2, [1.5, 2.0, 9.8]);
    }
}
