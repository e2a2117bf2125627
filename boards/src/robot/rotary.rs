//! `[[osmc]]`: a rotary motor on an OSMC bridge, with an encoder on its output shaft.

use r4_protocol::{
    channel::ChannelId,
    config::{
        BridgeConfig, BridgeLines, ControlConfig, FeedForward, Feedback, FollowConfig, MotorConfig, PidGains,
        ProfileLimits, SettleConfig, StallConfig,
    },
};
use serde::Deserialize;

use crate::number::{Interval, channel, not_negative, optional_duty, positive};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RotaryMotor {
    #[serde(deserialize_with = "channel")]
    pub(super) channel: ChannelId,
    #[serde(default)]
    inverted: bool,
    position_rad: Interval,
    #[serde(deserialize_with = "positive")]
    speed_max_rad_s: f32,
    #[serde(deserialize_with = "not_negative")]
    speed_filter_s: f32,
    #[serde(default, deserialize_with = "optional_duty")]
    pub(super) duty_max: Option<f32>,
    #[serde(deserialize_with = "positive")]
    duty_slew_per_s: f32,
    pub(super) encoder: Encoder,
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
pub(super) struct Encoder {
    pub(super) input: u8,
    #[serde(deserialize_with = "positive")]
    counts_per_turn: u32,
    #[serde(default)]
    inverted: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PositionGains {
    #[serde(deserialize_with = "not_negative")]
    kp_duty_per_rad: f32,
    #[serde(deserialize_with = "not_negative")]
    ki_duty_per_rad_s: f32,
    #[serde(deserialize_with = "not_negative")]
    kd_duty_s_per_rad: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SpeedGains {
    #[serde(deserialize_with = "not_negative")]
    kp_duty_s_per_rad: f32,
    #[serde(deserialize_with = "not_negative")]
    ki_duty_per_rad: f32,
    #[serde(deserialize_with = "not_negative")]
    kd_duty_s2_per_rad: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Profile {
    #[serde(deserialize_with = "positive")]
    speed_rad_s: f32,
    #[serde(deserialize_with = "positive")]
    acceleration_rad_s2: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StaticAndSpeed {
    #[serde(deserialize_with = "not_negative")]
    static_duty: f32,
    #[serde(deserialize_with = "not_negative")]
    duty_s_per_rad: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Settle {
    #[serde(deserialize_with = "positive")]
    error_rad: f32,
    #[serde(deserialize_with = "positive")]
    speed_rad_s: f32,
    time_ms: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Follow {
    #[serde(deserialize_with = "positive")]
    error_rad: f32,
    #[serde(deserialize_with = "positive")]
    time_ms: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stall {
    #[serde(deserialize_with = "positive")]
    duty: f32,
    #[serde(deserialize_with = "positive")]
    travel_rad: f32,
    #[serde(deserialize_with = "positive")]
    time_ms: u16,
}

impl RotaryMotor {
    pub(super) fn config(&self, lines: BridgeLines, duty_max: f32) -> MotorConfig {
        MotorConfig {
            id: self.channel,
            bridge: BridgeConfig::Osmc(lines),
            inverted: self.inverted,
            duty_max,
            duty_slew_per_s: self.duty_slew_per_s,
            control: Some(ControlConfig {
                feedback: Feedback::Encoder {
                    index: self.encoder.input,
                    counts_per_turn: self.encoder.counts_per_turn,
                    inverted: self.encoder.inverted,
                },
                position: self.position_rad.into(),
                speed_max: self.speed_max_rad_s,
                position_pid: PidGains {
                    kp: self.position_pid.kp_duty_per_rad,
                    ki: self.position_pid.ki_duty_per_rad_s,
                    kd: self.position_pid.kd_duty_s_per_rad,
                },
                speed_pid: PidGains {
                    kp: self.speed_pid.kp_duty_s_per_rad,
                    ki: self.speed_pid.ki_duty_per_rad,
                    kd: self.speed_pid.kd_duty_s2_per_rad,
                },
                speed_filter_s: self.speed_filter_s,
                profile: ProfileLimits {
                    speed: self.profile.speed_rad_s,
                    acceleration: self.profile.acceleration_rad_s2,
                },
                feed_forward: FeedForward {
                    static_duty: self.feed_forward.static_duty,
                    duty_per_speed: self.feed_forward.duty_s_per_rad,
                },
                settle: SettleConfig {
                    error: self.settle.error_rad,
                    speed: self.settle.speed_rad_s,
                    time_ms: self.settle.time_ms,
                },
                stall: StallConfig {
                    duty: self.stall.duty,
                    travel: self.stall.travel_rad,
                    time_ms: self.stall.time_ms,
                },
                follow: FollowConfig { error: self.follow.error_rad, time_ms: self.follow.time_ms },
                homing: None,
            }),
        }
    }
}
