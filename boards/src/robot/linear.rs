//! `[[actuator]]`: a linear actuator on an OSMC bridge, with a potentiometer.

use r4_protocol::{
    channel::ChannelId,
    config::{
        BridgeConfig, BridgeLines, ControlConfig, FeedForward, Feedback, FollowConfig, MotorConfig, PidGains, PotPoint,
        ProfileLimits, SettleConfig, StallConfig,
    },
};
use serde::Deserialize;

use crate::number::{Interval, channel, finite, not_negative, optional_duty, positive};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LinearMotor {
    #[serde(deserialize_with = "channel")]
    pub(super) channel: ChannelId,
    #[serde(default)]
    inverted: bool,
    position_m: Interval,
    #[serde(deserialize_with = "positive")]
    speed_max_m_s: f32,
    #[serde(deserialize_with = "not_negative")]
    speed_filter_s: f32,
    #[serde(default, deserialize_with = "optional_duty")]
    pub(super) duty_max: Option<f32>,
    #[serde(deserialize_with = "positive")]
    duty_slew_per_s: f32,
    pub(super) potentiometer: Potentiometer,
    position_pid: PositionGains,
    speed_pid: SpeedGains,
    profile: Profile,
    feed_forward: StaticAndSpeed,
    settle: Settle,
    stall: Stall,
    follow: Follow,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Potentiometer {
    pub(super) input: u8,
    low: Point,
    high: Point,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Point {
    code_16bit: u16,
    #[serde(deserialize_with = "finite")]
    position_m: f32,
}

impl From<&Point> for PotPoint {
    fn from(point: &Point) -> Self {
        Self { code: point.code_16bit, position_m: point.position_m }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PositionGains {
    #[serde(deserialize_with = "not_negative")]
    kp_duty_per_m: f32,
    #[serde(deserialize_with = "not_negative")]
    ki_duty_per_m_s: f32,
    #[serde(deserialize_with = "not_negative")]
    kd_duty_s_per_m: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SpeedGains {
    #[serde(deserialize_with = "not_negative")]
    kp_duty_s_per_m: f32,
    #[serde(deserialize_with = "not_negative")]
    ki_duty_per_m: f32,
    #[serde(deserialize_with = "not_negative")]
    kd_duty_s2_per_m: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Profile {
    #[serde(deserialize_with = "positive")]
    speed_m_s: f32,
    #[serde(deserialize_with = "positive")]
    acceleration_m_s2: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StaticAndSpeed {
    #[serde(deserialize_with = "not_negative")]
    static_duty: f32,
    #[serde(deserialize_with = "not_negative")]
    duty_s_per_m: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Settle {
    #[serde(deserialize_with = "positive")]
    error_m: f32,
    #[serde(deserialize_with = "positive")]
    speed_m_s: f32,
    time_ms: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Follow {
    #[serde(deserialize_with = "positive")]
    error_m: f32,
    #[serde(deserialize_with = "positive")]
    time_ms: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stall {
    #[serde(deserialize_with = "positive")]
    duty: f32,
    #[serde(deserialize_with = "positive")]
    travel_m: f32,
    #[serde(deserialize_with = "positive")]
    time_ms: u16,
}

impl LinearMotor {
    pub(super) fn config(&self, lines: BridgeLines, duty_max: f32) -> MotorConfig {
        MotorConfig {
            id: self.channel,
            bridge: BridgeConfig::Osmc(lines),
            inverted: self.inverted,
            duty_max,
            duty_slew_per_s: self.duty_slew_per_s,
            control: Some(ControlConfig {
                feedback: Feedback::Potentiometer {
                    analog: self.potentiometer.input,
                    low: (&self.potentiometer.low).into(),
                    high: (&self.potentiometer.high).into(),
                },
                position: self.position_m.into(),
                speed_max: self.speed_max_m_s,
                position_pid: PidGains {
                    kp: self.position_pid.kp_duty_per_m,
                    ki: self.position_pid.ki_duty_per_m_s,
                    kd: self.position_pid.kd_duty_s_per_m,
                },
                speed_pid: PidGains {
                    kp: self.speed_pid.kp_duty_s_per_m,
                    ki: self.speed_pid.ki_duty_per_m,
                    kd: self.speed_pid.kd_duty_s2_per_m,
                },
                speed_filter_s: self.speed_filter_s,
                profile: ProfileLimits { speed: self.profile.speed_m_s, acceleration: self.profile.acceleration_m_s2 },
                feed_forward: FeedForward {
                    static_duty: self.feed_forward.static_duty,
                    duty_per_speed: self.feed_forward.duty_s_per_m,
                },
                settle: SettleConfig {
                    error: self.settle.error_m,
                    speed: self.settle.speed_m_s,
                    time_ms: self.settle.time_ms,
                },
                stall: StallConfig { duty: self.stall.duty, travel: self.stall.travel_m, time_ms: self.stall.time_ms },
                follow: FollowConfig { error: self.follow.error_m, time_ms: self.follow.time_ms },
                homing: None,
            }),
        }
    }
}
