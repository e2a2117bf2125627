//! What every body has in common.

use crate::scene::Scene;

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

/// Motion of a shaft's output at the beginning of a step.
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
    /// [`Body::shafts`].
    fn step(&mut self, scene: &Scene, time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64);

    /// Where its frame is.
    fn pose(&self) -> Pose;

    /// How its frame moves.
    fn twist(&self) -> Twist;

    /// Acceleration of its frame's origin over the last step, body frame, m/s²: what an accelerometer there feels without gravity.
    fn acceleration_m_s2(&self) -> [f64; 2];
}
