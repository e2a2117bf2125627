//! Paths of motors: written for hosts, followed by the control loop.

use r4_protocol::{
    Mode, PathPoint, Refusal,
    config::{MAX_MOTORS, MotorConfig},
};

use super::statuses::{MotorStatus, Status};
use crate::{
    channel::resolution,
    path::{Leg, Limits, Path},
};

/// Paths, one for each motor.
pub(super) struct Paths([Path; MAX_MOTORS]);

impl Paths {
    pub(super) fn new() -> Self {
        Self(Default::default())
    }

    /// Ends the path of `motor`.
    pub(super) fn clear(&mut self, motor: usize) {
        self.0[motor].clear();
    }

    /// Ends all paths.
    pub(super) fn clear_all(&mut self) {
        self.0.iter_mut().for_each(Path::clear);
    }

    /// Segment of the path of `motor` at `now_us`.
    pub(super) fn leg(&mut self, motor: usize, now_us: u64) -> Leg {
        self.0[motor].leg(now_us)
    }

    /// Checks that the path of `motor`, which is `config` and has `status`, can take `points` at `now_us`.
    pub(super) fn check(
        &self,
        motor: usize,
        config: &MotorConfig,
        status: Status,
        points: &[PathPoint],
        now_us: u64,
    ) -> Result<(), Refusal> {
        let MotorConfig { id: channel, control, .. } = *config;
        let (Some(control), Status::Motor(MotorStatus { position, .. })) = (control, status) else {
            return Err(Refusal::WrongMode { channel, mode: Mode::Follow });
        };
        let position = position as f32 * resolution(control.feedback);
        self.0[motor].check(points, &Limits { channel, position, speed_max: control.speed_max, now_us })
    }

    /// Adds `points`, which were checked, to the path of `motor`.
    pub(super) fn splice(&mut self, motor: usize, points: &[PathPoint], now_us: u64) {
        self.0[motor].splice(points, now_us);
    }
}

/// Point of a path for a single set point.
pub(crate) const fn at(at_us: u64, position: f32) -> PathPoint {
    PathPoint { at_us, position, speed: None, feed_forward: 0.0 }
}
