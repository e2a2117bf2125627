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
