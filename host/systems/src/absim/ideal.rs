//! The board's program on perfect actuators: wheels turn as commanded and do not slip.

use r4_boards::SkidSteer;
use r4_rig::{Follower, GroundDrive, Place, Velocity};

use super::boards::limits;

/// Limit of a leg's duration, s: 90 m of travel.
const MOST_S: f64 = 200.0;

/// A skid-steer robot on perfect actuators.
#[derive(Clone, Debug)]
pub struct IdealDrive {
    drive: SkidSteer,
    ground: GroundDrive,
}

impl IdealDrive {
    /// Period of the program, s: that of a board's telemetry.
    pub const PERIOD_S: f64 = super::boards::PERIOD_MS as f64 * 1e-3;

    /// Creates a robot of this geometry.
    #[must_use]
    pub fn new(drive: SkidSteer) -> Self {
        Self { ground: GroundDrive::new(r4_boards::Drive::SkidSteer(drive.clone())), drive }
    }

    /// Poses along a leg from rest to rest, one each period.
    #[must_use]
    pub fn leg(&self, from: Place, goal_m: [f64; 2]) -> Vec<Place> {
        let mut follower = Follower::new(limits(&self.drive), [goal_m]);
        let mut at = from;
        let mut places = vec![at];
        while let Some(asked) = follower.velocity(at, f64::INFINITY)
            && (places.len() as f64) < MOST_S / Self::PERIOD_S
        {
            let Velocity { forward_m_s, yaw_rad_s } = self.moved(asked);
            let yaw_rad = at.yaw_rad + yaw_rad_s * Self::PERIOD_S / 2.0;
            at.x_m += forward_m_s * yaw_rad.cos() * Self::PERIOD_S;
            at.y_m += forward_m_s * yaw_rad.sin() * Self::PERIOD_S;
            at.yaw_rad += yaw_rad_s * Self::PERIOD_S;
            places.push(at);
        }
        places
    }

    /// Velocity that follows from the wheels' set points for a requested one: the limits of the wheels act.
    fn moved(&self, asked: Velocity) -> Velocity {
        let setpoints = self.ground.setpoints(asked);
        let rim_m_s = |side: usize| {
            let count = self.drive.left.len();
            f64::from(setpoints[side * count].1.value) * self.drive.wheel_radius_m
        };
        let [left_m_s, right_m_s] = [rim_m_s(0), rim_m_s(1)];
        Velocity { forward_m_s: (left_m_s + right_m_s) / 2.0, yaw_rad_s: (right_m_s - left_m_s) / self.drive.track_m }
    }
}
