//! Tables `[[osmc]]`, `[[actuator]]`, `[[dhb]]`: motors on bridges.
//!
//! A motor whose table has tables inside is controlled in closed loop: with an encoder or an angle sensor its fields
//! are in radians ([`rotary`]), with a potentiometer in metres ([`linear`]). A motor without them is [`Open`].

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{
        BridgeConfig, ControlConfig, CurrentSense, FeedForward, Feedback, FollowConfig, ForceConfig, ForceSensor,
        HomingConfig, MotorConfig, MotorSideConfig, PidGains, PotPoint, ProfileLimits, SettleConfig, StallConfig,
        WindingConfig,
    },
};
use serde::{Deserialize, Deserializer, de::Error};
use toml::{Spanned, de::DeValue};

use crate::number::{
    Interval, analog_number, angle_number, channel, finite, not_negative, optional_analog_number, optional_duty,
    optional_force_number, optional_supply_number, positive, stop_brake_ms,
};
use crate::tree::{Fault, Node};

/// Motor as it is in the file.
pub(super) enum Motor {
    Open(Open),
    Rotary(Box<rotary::Motor>),
    Linear(Box<linear::Motor>),
}

/// Motor that takes a duty in open loop only.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Open {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default)]
    inverted: bool,
    #[serde(default, deserialize_with = "optional_duty")]
    duty_max: Option<f32>,
    #[serde(deserialize_with = "positive")]
    duty_slew_per_s: f32,
    winding: Option<OpenWinding>,
    #[serde(default, deserialize_with = "stop_brake_ms")]
    stop_brake_ms: u16,
}

/// Current sensor on an analog input.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sense {
    #[serde(deserialize_with = "analog_number")]
    analog: u8,
    #[serde(default, deserialize_with = "finite")]
    zero_v: f32,
    #[serde(deserialize_with = "positive")]
    volts_per_a: f32,
}

impl From<Sense> for CurrentSense {
    fn from(Sense { analog, zero_v, volts_per_a }: Sense) -> Self {
        Self { analog, zero_v, volts_per_a }
    }
}

/// Makes the table of a motor's winding; only a motor whose speed is known has a back-EMF.
macro_rules! winding {
    ($Winding:ident $(, $back_emf:ident)?) => {
        #[derive(Clone, Copy, Deserialize)]
        #[serde(deny_unknown_fields)]
        struct $Winding {
            #[serde(default, deserialize_with = "optional_supply_number")]
            supply: Option<u8>,
            #[serde(deserialize_with = "positive")]
            nominal_v: f32,
            #[serde(default, deserialize_with = "not_negative")]
            dead_duty: f32,
            #[serde(deserialize_with = "positive")]
            resistance_ohm: f32,
            $(#[serde(deserialize_with = "not_negative")]
            $back_emf: f32,)?
            #[serde(deserialize_with = "positive")]
            rated_a: f32,
            #[serde(deserialize_with = "positive")]
            thermal_s: f32,
            current_sense: Option<Sense>,
        }

        impl From<$Winding> for WindingConfig {
            fn from(winding: $Winding) -> Self {
                let $Winding { supply, nominal_v, dead_duty, resistance_ohm, rated_a, thermal_s, current_sense, .. } = winding;
                Self {
                    supply,
                    nominal_v,
                    dead_duty,
                    resistance_ohm,
                    back_emf: 0.0 $(+ winding.$back_emf)?,
                    rated_a,
                    thermal_s,
                    current_sense: current_sense.map(Into::into),
                }
            }
        }
    };
}

winding!(OpenWinding);

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Encoder {
    pub(super) input: u8,
    #[serde(deserialize_with = "positive")]
    counts_per_turn: u32,
    #[serde(default)]
    inverted: bool,
    #[serde(default)]
    counts_per_index: u32,
}

/// Absolute angle sensor on the output shaft.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Angle {
    #[serde(deserialize_with = "angle_number")]
    sensor: u8,
    #[serde(default, deserialize_with = "finite")]
    zero_rad: f32,
    #[serde(default)]
    inverted: bool,
}

/// PWM output of an absolute angle sensor on the output shaft.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PulsedAngle {
    pub(super) range: u8,
    frames_hz: u16,
    #[serde(default, deserialize_with = "finite")]
    zero_rad: f32,
    #[serde(default)]
    inverted: bool,
}

/// Second encoder, on the motor's side of play.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MotorSide {
    pub(super) input: u8,
    #[serde(deserialize_with = "positive")]
    counts_per_turn: u32,
    #[serde(default)]
    inverted: bool,
    #[serde(deserialize_with = "positive")]
    gap_max_rad: f32,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Potentiometer {
    pub(super) input: u8,
    low: Point,
    high: Point,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Point {
    code_16bit: u16,
    #[serde(deserialize_with = "finite")]
    position_m: f32,
}

/// Force sensor of a motor: an analog input, or a load cell on the bus.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct ForceSensorFields {
    #[serde(default, deserialize_with = "optional_analog_number")]
    analog: Option<u8>,
    #[serde(default, deserialize_with = "finite")]
    zero_v: f32,
    #[serde(default, deserialize_with = "finite")]
    newtons_per_v: f32,
    #[serde(default, deserialize_with = "optional_force_number")]
    force: Option<u8>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "ForceSensorFields")]
struct ForceSensorTable(ForceSensor);

impl TryFrom<ForceSensorFields> for ForceSensorTable {
    type Error = &'static str;

    fn try_from(fields: ForceSensorFields) -> Result<Self, &'static str> {
        match fields {
            ForceSensorFields { analog: Some(analog), zero_v, newtons_per_v, force: None } => {
                Ok(Self(ForceSensor::Analog { analog, zero_v, newtons_per_v }))
            }
            ForceSensorFields { analog: None, zero_v: 0.0, newtons_per_v: 0.0, force: Some(force) } => {
                Ok(Self(ForceSensor::LoadCell { force }))
            }
            _ => Err("a force sensor is { analog, zero_v, newtons_per_v }, or { force }, as in { force = \"force0\" }"),
        }
    }
}

/// Homing of an axis by a switch.
#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Homing {
    pub(super) switch: u8,
    #[serde(deserialize_with = "finite")]
    position_rad: f32,
    #[serde(deserialize_with = "positive")]
    speed_max_rad_s: f32,
}

impl From<Encoder> for Feedback {
    fn from(Encoder { input, counts_per_turn, inverted, counts_per_index }: Encoder) -> Self {
        Self::Encoder { index: input, counts_per_turn, inverted, counts_per_index }
    }
}

impl From<Potentiometer> for Feedback {
    fn from(Potentiometer { input, low, high }: Potentiometer) -> Self {
        Self::Potentiometer { analog: input, low: low.into(), high: high.into() }
    }
}

impl From<Point> for PotPoint {
    fn from(Point { code_16bit, position_m }: Point) -> Self {
        Self { code: code_16bit, position_m }
    }
}

impl From<Homing> for HomingConfig {
    fn from(Homing { switch, position_rad, speed_max_rad_s }: Homing) -> Self {
        Self { switch, position: position_rad, speed_max: speed_max_rad_s }
    }
}

/// Homing of a linear motor: none, because its position is absolute.
pub(super) enum NoHoming {}

impl<'de> Deserialize<'de> for NoHoming {
    fn deserialize<D: Deserializer<'de>>(_: D) -> Result<Self, D::Error> {
        Err(D::Error::custom("a potentiometer needs no homing: leave it out"))
    }
}

impl From<NoHoming> for HomingConfig {
    fn from(none: NoHoming) -> Self {
        match none {}
    }
}

/// Returns the feedback of a motor that turns; `None` where the file gives none, which its reader refuses.
fn turning(motor: &rotary::Motor) -> Option<Feedback> {
    let angle = motor.angle.map(|Angle { sensor, zero_rad, inverted }| Feedback::Angle {
        angle: sensor,
        zero: zero_rad,
        inverted,
    });
    let pulses = motor.pulses.map(|PulsedAngle { range, frames_hz, zero_rad, inverted }| Feedback::Pulses {
        range,
        frames_hz,
        zero: zero_rad,
        inverted,
    });
    motor.encoder.map(Into::into).or(angle).or(pulses)
}

fn motor_side(motor: &rotary::Motor) -> Option<MotorSideConfig> {
    motor.motor_side.map(|MotorSide { input, counts_per_turn, inverted, gap_max_rad }| MotorSideConfig {
        index: input,
        counts_per_turn,
        inverted,
        gap_max: gap_max_rad,
    })
}

#[allow(clippy::unnecessary_wraps, reason = "as for a motor that turns")]
fn sliding(motor: &linear::Motor) -> Option<Feedback> {
    Some(motor.potentiometer.into())
}

fn no_motor_side(_: &linear::Motor) -> Option<MotorSideConfig> {
    None
}

/// Makes the table of a motor in closed loop. The fields are named after the unit of its position.
macro_rules! controlled {
    (
        $unit:ident, sensors: { $($sensor:ident: $Sensor:ty,)+ }, feedback: $feedback:path, motor_side: $motor_side:path,
        homing: $Homing:ident,
        position: $position:ident,
        speed_max: $speed_max:ident,
        position_pid: [$kp:ident, $ki:ident, $kd:ident],
        speed_pid: [$speed_kp:ident, $speed_ki:ident, $speed_kd:ident],
        profile: [$profile_speed:ident, $acceleration:ident, $jerk:ident],
        feed_forward: [$duty_per_speed:ident, $duty_per_acceleration:ident],
        settle: [$settle_error:ident, $settle_speed:ident],
        stall: $travel:ident,
        follow: $follow_error:ident,
        winding: $back_emf:ident,
        force: [$speed_per_n:ident, $approach_speed:ident],
    ) => {
        pub(super) mod $unit {
            use super::*;

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            pub(in super::super) struct Motor {
                #[serde(deserialize_with = "channel")]
                pub(super) channel: ChannelId,
                #[serde(default)]
                inverted: bool,
                $position: Interval,
                #[serde(deserialize_with = "positive")]
                $speed_max: f32,
                #[serde(deserialize_with = "not_negative")]
                speed_filter_s: f32,
                #[serde(default, deserialize_with = "optional_duty")]
                pub(super) duty_max: Option<f32>,
                #[serde(deserialize_with = "positive")]
                duty_slew_per_s: f32,
                #[serde(default, deserialize_with = "stop_brake_ms")]
                stop_brake_ms: u16,
                $(pub(in super::super) $sensor: $Sensor,)+
                position_pid: PositionGains,
                speed_pid: SpeedGains,
                #[serde(default, deserialize_with = "not_negative")]
                cascade_per_s: f32,
                profile: Profile,
                feed_forward: StaticAndSpeed,
                settle: Settle,
                stall: Stall,
                follow: Follow,
                winding: Winding,
                pub(in super::super) homing: Option<$Homing>,
                force: Option<Force>,
            }

            #[derive(Clone, Copy, Deserialize)]
            #[serde(deny_unknown_fields)]
            struct Force {
                sensor: ForceSensorTable,
                range_n: Interval,
                #[serde(deserialize_with = "positive")]
                limit_n: f32,
                #[serde(deserialize_with = "finite")]
                $speed_per_n: f32,
                #[serde(deserialize_with = "positive")]
                $approach_speed: f32,
                #[serde(deserialize_with = "positive")]
                contact_n: f32,
                #[serde(deserialize_with = "positive")]
                error_n: f32,
                #[serde(default, deserialize_with = "not_negative")]
                filter_s: f32,
                #[serde(default, deserialize_with = "not_negative")]
                drift_s: f32,
            }

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct PositionGains {
                #[serde(deserialize_with = "not_negative")]
                $kp: f32,
                #[serde(deserialize_with = "not_negative")]
                $ki: f32,
                #[serde(deserialize_with = "not_negative")]
                $kd: f32,
            }

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct SpeedGains {
                #[serde(deserialize_with = "not_negative")]
                $speed_kp: f32,
                #[serde(deserialize_with = "not_negative")]
                $speed_ki: f32,
                #[serde(deserialize_with = "not_negative")]
                $speed_kd: f32,
            }

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct Profile {
                #[serde(deserialize_with = "positive")]
                $profile_speed: f32,
                #[serde(deserialize_with = "positive")]
                $acceleration: f32,
                #[serde(default, deserialize_with = "not_negative")]
                $jerk: f32,
            }

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct StaticAndSpeed {
                #[serde(deserialize_with = "not_negative")]
                static_duty: f32,
                #[serde(deserialize_with = "not_negative")]
                $duty_per_speed: f32,
                #[serde(default, deserialize_with = "not_negative")]
                $duty_per_acceleration: f32,
            }

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct Settle {
                #[serde(deserialize_with = "positive")]
                $settle_error: f32,
                #[serde(deserialize_with = "positive")]
                $settle_speed: f32,
                time_ms: u16,
            }

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct Stall {
                #[serde(deserialize_with = "positive")]
                duty: f32,
                #[serde(deserialize_with = "positive")]
                $travel: f32,
                #[serde(deserialize_with = "positive")]
                time_ms: u16,
            }

            #[derive(Deserialize)]
            #[serde(deny_unknown_fields)]
            struct Follow {
                #[serde(deserialize_with = "positive")]
                $follow_error: f32,
                #[serde(deserialize_with = "positive")]
                time_ms: u16,
            }

            winding!(Winding, $back_emf);

            impl Motor {
                pub(super) fn config(self, bridge: BridgeConfig, duty_max: f32) -> MotorConfig {
                    let (feedback, motor_side) = ($feedback(&self), $motor_side(&self));
                    let (position, speed) = (self.position_pid, self.speed_pid);
                    let Self { profile, feed_forward, settle, stall, follow, .. } = self;
                    MotorConfig {
                        id: self.channel,
                        bridge,
                        inverted: self.inverted,
                        duty_max,
                        duty_slew_per_s: self.duty_slew_per_s,
                        control: feedback.map(|feedback| ControlConfig {
                            feedback,
                            position: self.$position.into(),
                            speed_max: self.$speed_max,
                            position_pid: PidGains { kp: position.$kp, ki: position.$ki, kd: position.$kd },
                            speed_pid: PidGains { kp: speed.$speed_kp, ki: speed.$speed_ki, kd: speed.$speed_kd },
                            cascade_per_s: self.cascade_per_s,
                            speed_filter_s: self.speed_filter_s,
                            profile: ProfileLimits {
                                speed: profile.$profile_speed,
                                acceleration: profile.$acceleration,
                                jerk: profile.$jerk,
                            },
                            feed_forward: FeedForward {
                                static_duty: feed_forward.static_duty,
                                duty_per_speed: feed_forward.$duty_per_speed,
                                duty_per_acceleration: feed_forward.$duty_per_acceleration,
                            },
                            settle: SettleConfig {
                                error: settle.$settle_error,
                                speed: settle.$settle_speed,
                                time_ms: settle.time_ms,
                            },
                            stall: StallConfig { duty: stall.duty, travel: stall.$travel, time_ms: stall.time_ms },
                            follow: FollowConfig { error: follow.$follow_error, time_ms: follow.time_ms },
                            homing: self.homing.map(Into::into),
                            motor_side,
                            force: self.force.map(|force| ForceConfig {
                                sensor: force.sensor.0,
                                range: force.range_n.into(),
                                limit_n: force.limit_n,
                                speed_per_n: force.$speed_per_n,
                                approach_speed: force.$approach_speed,
                                contact_n: force.contact_n,
                                error_n: force.error_n,
                                filter_s: force.filter_s,
                                drift_s: force.drift_s,
                            }),
                        }),
                        // A motor in closed loop needs a winding, for its overload protection; one in open loop may
                        // lack it.
                        winding: Some(self.winding.into()),
                        stop_brake_ms: self.stop_brake_ms,
                    }
                }
            }
        }
    };
}

controlled! {
    rotary,
    sensors: { encoder: Option<Encoder>, angle: Option<Angle>, pulses: Option<PulsedAngle>, motor_side: Option<MotorSide>, },
    feedback: turning,
    motor_side: motor_side,
    homing: Homing,
    position: position_rad,
    speed_max: speed_max_rad_s,
    position_pid: [kp_duty_per_rad, ki_duty_per_rad_s, kd_duty_s_per_rad],
    speed_pid: [kp_duty_s_per_rad, ki_duty_per_rad, kd_duty_s2_per_rad],
    profile: [speed_rad_s, acceleration_rad_s2, jerk_rad_s3],
    feed_forward: [duty_s_per_rad, duty_s2_per_rad],
    settle: [error_rad, speed_rad_s],
    stall: travel_rad,
    follow: error_rad,
    winding: back_emf_v_s_per_rad,
    force: [speed_rad_s_per_n, approach_speed_rad_s],
}

controlled! {
    linear, sensors: { potentiometer: Potentiometer, }, feedback: sliding, motor_side: no_motor_side, homing: NoHoming,
    position: position_m,
    speed_max: speed_max_m_s,
    position_pid: [kp_duty_per_m, ki_duty_per_m_s, kd_duty_s_per_m],
    speed_pid: [kp_duty_s_per_m, ki_duty_per_m, kd_duty_s2_per_m],
    profile: [speed_m_s, acceleration_m_s2, jerk_m_s3],
    feed_forward: [duty_s_per_m, duty_s2_per_m],
    settle: [error_m, speed_m_s],
    stall: travel_m,
    follow: error_m,
    winding: back_emf_v_s_per_m,
    force: [speed_m_s_per_n, approach_speed_m_s],
}

impl Motor {
    /// Reads the motor of one table in the array named after `kind`.
    pub(super) fn parse(kind: ChannelKind, value: Spanned<DeValue<'_>>) -> Result<Self, Fault> {
        let table = value.get_ref().as_table();
        let of_loop = |(name, value): (_, &Spanned<DeValue<'_>>)| name != "winding" && value.get_ref().is_table();
        let is_open =
            table.is_some_and(|table| !table.iter().map(|(name, value)| (name.get_ref().as_ref(), value)).any(of_loop));
        let has = |field: &str| table.is_some_and(|table| table.contains_key(field));
        let is_linear = has("potentiometer") || has("position_m");
        let deserializer = Node::from(value);
        match kind {
            ChannelKind::Actuator => Deserialize::deserialize(deserializer).map(Self::Linear),
            _ if is_open => Deserialize::deserialize(deserializer).map(Self::Open),
            ChannelKind::Dhb if is_linear => Deserialize::deserialize(deserializer).map(Self::Linear),
            _ => Deserialize::deserialize(deserializer).map(Self::Rotary),
        }
    }

    pub(super) fn channel(&self) -> ChannelId {
        match self {
            Self::Open(motor) => motor.channel,
            Self::Rotary(motor) => motor.channel,
            Self::Linear(motor) => motor.channel,
        }
    }

    pub(super) fn duty_max(&self) -> Option<f32> {
        match self {
            Self::Open(motor) => motor.duty_max,
            Self::Rotary(motor) => motor.duty_max,
            Self::Linear(motor) => motor.duty_max,
        }
    }

    pub(super) fn config(self, bridge: BridgeConfig, duty_max: f32) -> MotorConfig {
        match self {
            Self::Open(Open { channel, inverted, duty_slew_per_s, winding, stop_brake_ms, .. }) => MotorConfig {
                id: channel,
                bridge,
                inverted,
                duty_max,
                duty_slew_per_s,
                control: None,
                winding: winding.map(Into::into),
                stop_brake_ms,
            },
            Self::Rotary(motor) => motor.config(bridge, duty_max),
            Self::Linear(motor) => motor.config(bridge, duty_max),
        }
    }
}
