//! Robot of the task: set points of its wheels for an action, at both fidelities.

use r4_boards::{Drive, SkidSteer};
use r4_protocol::ChannelId;
use r4_rig::{GroundDrive, Velocity};

use crate::{Action, Error};

/// Built-in robot of the task.
pub(crate) const ROBOT: &str = "openscout";
/// Number of wheels on each side.
pub(crate) const SIDE: usize = 2;

/// Wheels of a skid-steer robot with two on each side.
#[derive(Clone, Debug)]
pub(crate) struct Wheels {
    pub(crate) drive: SkidSteer,
    ground: GroundDrive,
    /// Channels of the left wheels, then of the right ones.
    pub(crate) channels: Vec<ChannelId>,
}

impl Wheels {
    pub(crate) fn new() -> Result<Self, Error> {
        let unfit = || Error::NoSkidSteer { robot: ROBOT.to_owned() };
        let robot = r4_boards::load(ROBOT).map_err(r4_rig::Error::from)?;
        let Some(Drive::SkidSteer(drive)) = robot.drive else { return Err(unfit()) };
        if drive.left.len() != SIDE || drive.right.len() != SIDE {
            return Err(unfit());
        }
        let channels: Vec<ChannelId> = drive.left.iter().chain(&drive.right).copied().collect();
        Ok(Self { ground: GroundDrive::new(Drive::SkidSteer(drive.clone())), drive, channels })
    }

    /// Set points of the wheels in the order of `channels`, rad/s. A turn whose outer wheels would exceed their limit is
    /// slower and keeps its curve.
    pub(crate) fn speeds_rad_s(&self, [forward, yaw]: Action) -> Vec<f64> {
        let velocity = Velocity {
            forward_m_s: forward * self.drive.speed_max_m_s,
            yaw_rad_s: yaw * self.drive.turn_rate_max_rad_s,
        };
        // The set points are in the same order: left wheels first.
        self.ground.setpoints(velocity).into_iter().map(|(_, setpoint)| f64::from(setpoint.value)).collect()
    }

    /// Requested speeds of the left and the right rims for an action, m/s.
    pub(crate) fn rims_m_s(&self, action: Action) -> [f64; 2] {
        let speeds = self.speeds_rad_s(action);
        [speeds[0] * self.drive.wheel_radius_m, speeds[SIDE] * self.drive.wheel_radius_m]
    }
}
