//! Messages that the node publishes.

use r4_driver::Clock as _;
use r4_protocol::{ChannelId, ChannelKind, Telemetry};
use r4_rig::Error;

use super::Serving;
use crate::{
    diagnose::{self, Health, NodeHealth},
    frames::MOTION_EVERY_MS,
    message::{BatteryState, Clock, DiagnosticArray, Imu, JointState, Odometry, Range, TFMessage, Text, TwistStamped},
    names::{self, Topic},
};

/// Message for ROS, or a notice for the node's lifecycle.
#[derive(Clone, Debug, PartialEq)]
#[expect(
    clippy::large_enum_variant,
    reason = "each is handed on at once, none is kept: a box would be an allocation for each odometry"
)]
pub enum Report {
    /// Message on `odom`: pose and velocity by the wheels.
    Odometry(Odometry),
    /// Message on `/tf`: transform from `odom` to `base_link`.
    Transform(TFMessage),
    /// Message on `joint_states`: motors, steppers and encoders.
    Joints(JointState),
    /// Message on `imu/data` for the first IMU, with its channel.
    Imu(ChannelId, Imu),
    /// Message on `rangeN` or `distanceN`, with its channel.
    Range(ChannelId, Range),
    /// Message on `battery_state` for the first supply, with its channel.
    Battery(ChannelId, BatteryState),
    /// Message on `/diagnostics`: state of the board and of commands.
    Diagnostics(DiagnosticArray),
    /// Message on `~/state`, which is latched.
    State(Text),
    /// Message on `/clock` for a simulated board.
    Clock(Clock),
    /// Message on `~/cmd_vel_out`: velocity that the board has accepted, with the stamp of its command.
    Commanded(TwistStamped),
    /// Notice for the lifecycle that a managed node is no longer active without a requested transition.
    Deactivated,
}

impl Report {
    /// Returns the topic of the message; `None` for a channel without a topic and for [`Report::Deactivated`].
    #[must_use]
    pub fn topic(&self) -> Option<Topic> {
        Some(match self {
            Self::Odometry(_) => names::ODOMETRY,
            Self::Transform(_) => names::TRANSFORM,
            Self::Joints(_) => names::JOINTS,
            Self::Imu(channel, _) | Self::Range(channel, _) | Self::Battery(channel, _) => names::topic(*channel)?,
            Self::Diagnostics(_) => names::DIAGNOSTICS,
            Self::State(_) => names::STATE,
            Self::Clock(_) => names::CLOCK,
            Self::Commanded(_) => names::COMMANDED,
            Self::Deactivated => return None,
        })
    }
}

/// Period of inertial samples, ms: the period at which the sensors of the built-in robots measure.
const INERTIAL_EVERY_MS: u16 = 10;
/// Period of distances, ms: below the 60 ms between two pings, so that none is missed.
const RANGE_EVERY_MS: u16 = 50;
/// Period of supply voltages, ms.
const SUPPLY_EVERY_MS: u16 = 200;

/// Returns the telemetry period of a channel, ms; `None` for a channel that is not published.
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
            // A second publisher of `/clock` would confuse nodes on simulated time, so a real board has none.
            self.publish(Report::Clock(Clock { clock: self.now().to_time() }));
        }
        self.look_at_safety();
        self.feed();
    }

    pub(super) fn diagnose(&mut self) {
        let board = self.session.board;
        let (state, causes) = self.safety;
        let node = NodeHealth {
            is_estop_engaged: self.is_estop_engaged,
            timeout_s: f64::from(board.info().link_timeout_ms) * 1e-3,
            taken: self.taken,
            refused: self.refused,
            refusal: self.refusal.clone(),
            unpublished: self.unpublished,
            bad_frames: board.bad_frames(),
        };
        let health = Health {
            robot: board.info().robot.to_string(),
            board: self.session.target().to_string(),
            firmware: board.info().firmware.to_string(),
            state,
            causes,
            hot: board.hot_windings(),
            node: Some(node),
        };
        let stamp = self.now().to_time();
        self.publish(Report::Diagnostics(health.diagnostics(stamp)));
    }

    pub(super) fn frame(&mut self, frame: &Telemetry) {
        let board = self.session.board;
        self.note_positions(&frame.samples);
        let stamp = self.door.clock.at(board.host_us(frame.device_us), self.session.clock.now_us());
        let Self { frames, report, unpublished, .. } = self;
        // The stamp is the time of the measurement, mapped from the board's clock, and not that of its arrival.
        frames.convert(stamp, frame.device_us, &frame.samples, |message| {
            if !report(message) {
                *unpublished += 1;
            }
        });
    }
}
