//! What every body has in common, and the kinds there are.

use std::ops::{Deref, DerefMut};

use crate::{
    berry::BerryPicker, cable_loop::CableLoop, deformable::Deformable, grip::TwoFingers, outline::Outline,
    scene::Scene, suction::SuctionPad, tail::BalanceTail, wheeled::Wheeled,
};

/// Position and heading on the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// m, world frame.
    pub x_m: f64,
    /// m, world frame.
    pub y_m: f64,
    /// rad, counterclockwise from the world's x axis; not wrapped.
    pub yaw_rad: f64,
}

impl Pose {
    /// A point given in the body's frame, m, in the world's.
    #[must_use]
    pub fn to_world(&self, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = libm::sincos(self.yaw_rad);
        [self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m]
    }

    /// The pose `after_s` later, s, with this velocity in the body's frame: by the mean heading, second order in the time.
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
    /// Forwards, m/s.
    pub forward_m_s: f64,
    /// To the left, m/s.
    pub left_m_s: f64,
    /// Counterclockwise, rad/s.
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

/// Motion of a shaft's output at the beginning of a step. A relay is a shaft at 1 while its contact is closed and at 0 while it is open.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ShaftMotion {
    /// rad or m.
    pub position: f64,
    /// rad/s or m/s.
    pub speed: f64,
}

/// Something that couples shafts by forces.
pub trait Body {
    /// Number of shafts, in the order in which their motions and loads are given.
    fn shafts(&self) -> usize;

    /// One step of `step_s`, s, at most [`crate::MAX_STEP_S`], from `time_s` on in `scene`: from the motion of the shafts to the load
    /// of each over the step, N m or N, positive towards positive positions. `shafts` and `loads` have one entry for each of
    /// [`Body::shafts`]. Boxes of the scene that it pushes move with it.
    fn step(&mut self, scene: &mut Scene, time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64);

    /// Where its frame is.
    fn pose(&self) -> Pose;

    /// Puts it somewhere, at rest.
    fn set_pose(&mut self, pose: Pose);

    /// How its frame moves.
    fn twist(&self) -> Twist;

    /// What an inertial sensor feels at the origin of its frame, over the last step.
    fn inertial(&self) -> Inertial;

    /// What bumps into things; `None` passes through them.
    fn outline(&self) -> Option<&Outline> {
        None
    }

    /// Names of the quantities that sensors on the body measure, each with its unit as a suffix (`pressure_0_pa`): robots' files
    /// connect analog inputs, switches and sensors on the bus to them.
    fn readings(&self) -> &'static [&'static str] {
        &[]
    }

    /// One of [`Body::readings`], by its number, over the last step; 0 beyond their number.
    fn reading(&self, number: usize) -> f64 {
        let _ = number;
        0.0
    }
}

/// What an inertial sensor feels: x forwards, y to the left, z upwards along the part that carries it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inertial {
    /// Acceleration less that of free fall, m/s²: upwards 9.8 at rest.
    pub specific_force_m_s2: [f64; 3],
    /// rad/s
    pub rate_rad_s: [f64; 3],
    /// rad/s²
    pub angular_acceleration_rad_s2: [f64; 3],
}

impl Inertial {
    /// Of a level body that does not move: it feels what holds it against gravity.
    pub const AT_REST: Self = Self {
        specific_force_m_s2: [0.0, 0.0, crate::GRAVITY_M_S2],
        rate_rad_s: [0.0; 3],
        angular_acceleration_rad_s2: [0.0; 3],
    };

    /// The same at another point of the part, m from the first: `f + α × r + ω × (ω × r)`.
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

/// A body of any kind, as a robot's file names it.
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
    /// A gripper before a bush.
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

    /// On a turntable of 2 rad/s that speeds up by 3 rad/s², 0.5 m from the axis: centripetal `w² r`, tangential `a r`.
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
