//! What the node publishes.

use r4_driver::Clock as _;
use r4_protocol::{ChannelId, ChannelKind, Sample, Telemetry};
use r4_rig::{Error, inertial_reading, sides_rad, sides_rad_s};

use super::Serving;
use crate::{
    convert,
    diagnose::{self, Health},
    message::{BatteryState, Clock, DiagnosticArray, Imu, JointState, Odometry, Range, TFMessage, Text, TwistStamped},
};

/// Something for ROS.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "each is handed on at once, none is kept: a box would be an allocation for each odometry"
)]
pub enum Report {
    /// `odom`
    Odometry(Odometry),
    /// `/tf`
    Transform(TFMessage),
    /// `joint_states`
    Joints(JointState),
    /// `imu/data`, of this channel.
    Imu(ChannelId, Imu),
    /// `rangeN` or `distanceN`, of this channel.
    Range(ChannelId, Range),
    /// `battery_state`, of this channel.
    Battery(ChannelId, BatteryState),
    /// `/diagnostics`
    Diagnostics(DiagnosticArray),
    /// `~/state`, latched.
    State(Text),
    /// `/clock`, of a simulated board.
    Clock(Clock),
    /// `~/cmd_vel_out`: a velocity that the board has taken, with the stamp of its command.
    Commanded(TwistStamped),
}

/// Period of motors' and encoders' samples, ms.
const MOTION_EVERY_MS: u16 = 20;
/// Period of inertial samples, ms: as often as the sensors of the built-in robots measure.
const INERTIAL_EVERY_MS: u16 = 10;
/// Period of distances, ms: a little less than the time between two pings, 60 ms.
const RANGE_EVERY_MS: u16 = 50;
/// Period of supplies, ms.
const SUPPLY_EVERY_MS: u16 = 200;

/// How often a channel is published, ms; `None` for one that is not.
fn period_ms(kind: ChannelKind) -> Option<u16> {
    match kind {
        ChannelKind::Osmc | ChannelKind::Actuator | ChannelKind::Dhb | ChannelKind::Stepper | ChannelKind::Encoder => {
            Some(MOTION_EVERY_MS)
        }
        ChannelKind::Imu => Some(INERTIAL_EVERY_MS),
        ChannelKind::Range | ChannelKind::Distance => Some(RANGE_EVERY_MS),
        ChannelKind::Supply => Some(SUPPLY_EVERY_MS),
        _ => None,
    }
}

impl<R: FnMut(Report) -> bool> Serving<'_, R> {
    pub(super) async fn subscribe(&self) -> Result<(), Error> {
        let board = self.session.board;
        for info in board.channels() {
            if let Some(period_ms) = period_ms(info.id.kind) {
                board.subscribe(info.id, period_ms).await?;
            }
        }
        Ok(())
    }

    pub(super) fn publish(&mut self, report: Report) {
        if !(self.report)(report) {
            self.unpublished += 1;
        }
    }

    pub(super) fn publish_state(&mut self) {
        let (state, causes) = self.safety;
        self.publish(Report::State(Text { data: diagnose::state(state, causes) }));
    }

    pub(super) fn tick(&mut self) {
        if self.session.target().is_virtual() {
            self.publish(Report::Clock(Clock { clock: self.now().to_time() }));
        }
        self.look_at_safety();
    }

    pub(super) fn diagnose(&mut self) {
        let board = self.session.board;
        let (state, causes) = self.safety;
        let health = Health {
            robot: board.info().robot.to_string(),
            board: self.session.target().to_string(),
            firmware: board.info().firmware.to_string(),
            state,
            causes,
            is_estop_engaged: self.is_estop_engaged,
            timeout_s: f64::from(board.info().link_timeout_ms) * 1e-3,
            taken: self.taken,
            refused: self.refused,
            refusal: self.refusal.clone(),
            unpublished: self.unpublished,
            bad_frames: board.bad_frames(),
            hot: board.hot_windings(),
        };
        let stamp = self.now().to_time();
        self.publish(Report::Diagnostics(health.diagnostics(stamp)));
    }

    pub(super) fn frame(&mut self, frame: &Telemetry) {
        let board = self.session.board;
        let samples = &frame.samples[..];
        let stamp = self.door.clock.at(board.host_us(frame.device_us), self.session.clock.now_us());
        if let Some((robot, odometry)) = &mut self.odometry
            && let Some([left_rad, right_rad]) = sides_rad(board, robot, samples)
            && let Some(sides_rad_s) = sides_rad_s(robot, samples)
        {
            odometry.look(left_rad, right_rad);
            let velocity = r4_rig::Velocity::of_sides(robot, sides_rad_s);
            let period_s = f64::from(MOTION_EVERY_MS) * 1e-3;
            let message = convert::odometry(stamp.to_time(), robot, odometry, velocity, period_s);
            if self.door.has_transform {
                self.publish(Report::Transform(convert::transform(&message)));
            }
            self.publish(Report::Odometry(message));
        }
        if let Some(joints) = convert::joint_states(stamp.to_time(), board.channels(), samples) {
            self.publish(Report::Joints(joints));
        }
        for sample in samples {
            let Ok(info) = board.channel(sample.channel()) else { continue };
            // Sensors measure at a time of their own.
            let measured = |age_ms: u16| stamp.plus_us(-1000 * i64::from(age_ms)).to_time();
            match *sample {
                Sample::Sensor { channel, age_ms, .. } if channel.kind == ChannelKind::Imu => {
                    if let Some(reading) = inertial_reading(channel, std::slice::from_ref(sample)) {
                        self.publish(Report::Imu(channel, convert::imu(measured(age_ms), channel, &reading)));
                    }
                }
                Sample::Reading { channel, age_ms, .. } | Sample::Sensor { channel, age_ms, .. } => {
                    if let Some(range) = convert::range(measured(age_ms), info, sample) {
                        self.publish(Report::Range(channel, range));
                    }
                }
                Sample::Scalar { channel, value } if channel.kind == ChannelKind::Supply => {
                    self.publish(Report::Battery(channel, convert::battery(stamp.to_time(), channel, value)));
                }
                _ => {}
            }
        }
    }
}
