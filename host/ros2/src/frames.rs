//! Conversion of telemetry frames to ROS messages, shared by the node and the bag of a log.

use r4_boards::{Drive, SkidSteer};
use r4_protocol::{ChannelInfo, ChannelKind, Sample};
use r4_rig::{GroundDrive, NewestMotors, Odometry, Velocity, inertial_reading, recorded_sides_rad, sides_rad_s};

use crate::{Report, convert, message, time::Stamp};

/// Telemetry period of motors and encoders that the node subscribes to, ms.
pub const MOTION_EVERY_MS: u16 = 20;

/// Converter of a board's telemetry frames, with the robot's odometry.
#[derive(Clone, Debug)]
pub struct Frames {
    channels: Vec<ChannelInfo>,
    odometry: Option<Counted>,
    has_transform: bool,
}

/// Odometry of a skid-steer robot, with the time of its last frame.
#[derive(Clone, Debug)]
struct Counted {
    robot: SkidSteer,
    odometry: Odometry,
    motors: NewestMotors,
    /// Time of the last frame with a motor, µs on the board's clock; `None` before the first and after a restart.
    last_us: Option<u64>,
}

impl Frames {
    /// Creates a converter for a board with these channels. Only a skid-steer robot has odometry; `has_transform` adds its transform for
    /// `/tf`.
    #[must_use]
    pub fn new(channels: &[ChannelInfo], drive: Option<&GroundDrive>, has_transform: bool) -> Self {
        let odometry = match drive.map(GroundDrive::drive) {
            Some(Drive::SkidSteer(robot)) => {
                let (odometry, motors) = (Odometry::new(robot), NewestMotors::default());
                Some(Counted { robot: robot.clone(), odometry, motors, last_us: None })
            }
            Some(Drive::Ackermann(_)) | None => None,
        };
        Self { channels: channels.to_vec(), odometry, has_transform }
    }

    /// Returns the geometry of a skid-steer robot; `None` for other robots.
    #[must_use]
    pub fn robot(&self) -> Option<&SkidSteer> {
        self.odometry.as_ref().map(|counted| &counted.robot)
    }

    /// Handles a restart of the board: its wheels count from 0 again, and odometry continues at its last pose.
    pub fn restarted(&mut self) {
        if let Some(counted) = &mut self.odometry {
            counted.odometry.count_anew();
            counted.motors.clear();
            counted.last_us = None;
        }
    }

    /// Passes the messages of a frame to `give`. Its samples were taken at `stamp`, when the board's clock showed `device_us`.
    pub fn convert(&mut self, stamp: Stamp, device_us: u64, samples: &[Sample], mut give: impl FnMut(Report)) {
        let counted = self.odometry.as_mut();
        if let Some(message) = counted.and_then(|counted| counted.look(stamp, device_us, &self.channels, samples)) {
            if self.has_transform {
                give(Report::Transform(convert::transform(&message)));
            }
            give(Report::Odometry(message));
        }
        if let Some(joints) = convert::joint_states(stamp.to_time(), &self.channels, samples) {
            give(Report::Joints(joints));
        }
        for sample in samples {
            let Some(info) = self.channels.iter().find(|info| info.id == sample.channel()) else { continue };
            // A sensor measures at its own rate: its reading is `age_ms` older than the frame.
            let measured = |age_ms: u16| stamp.plus_us(-1000 * i64::from(age_ms)).to_time();
            match *sample {
                Sample::Sensor { channel, age_ms, .. } if channel.kind == ChannelKind::Imu => {
                    if let Some(reading) = inertial_reading(channel, std::slice::from_ref(sample)) {
                        give(Report::Imu(channel, convert::imu(measured(age_ms), channel, &reading)));
                    }
                }
                Sample::Reading { channel, age_ms, .. } | Sample::Sensor { channel, age_ms, .. } => {
                    if let Some(range) = convert::range(measured(age_ms), info, sample) {
                        give(Report::Range(channel, range));
                    }
                }
                Sample::Scalar { channel, value } if channel.kind == ChannelKind::Supply => {
                    give(Report::Battery(channel, convert::battery(stamp.to_time(), channel, value)));
                }
                _ => {}
            }
        }
    }
}

impl Counted {
    /// Returns the odometry after a frame; `None` for a frame without motors, and before all wheels were seen.
    fn look(
        &mut self,
        stamp: Stamp,
        device_us: u64,
        channels: &[ChannelInfo],
        samples: &[Sample],
    ) -> Option<message::Odometry> {
        let motors = self.motors.take(samples)?;
        let [left_rad, right_rad] = recorded_sides_rad(channels, &self.robot, &motors)?;
        let velocity = Velocity::of_sides(&self.robot, sides_rad_s(&self.robot, &motors)?);
        self.odometry.look(left_rad, right_rad);
        let before_us = self.last_us.replace(device_us);
        let since_us = before_us.and_then(|before_us| device_us.checked_sub(before_us)).filter(|us| *us > 0);
        // The first frame has no predecessor: the nominal period takes its place in the covariance of the velocity.
        let period_s = since_us.map_or(f64::from(MOTION_EVERY_MS) * 1e-3, |us| us as f64 * 1e-6);
        Some(convert::odometry(stamp.to_time(), &self.robot, &self.odometry, velocity, period_s))
    }
}
