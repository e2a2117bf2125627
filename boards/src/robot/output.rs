//! Tables `[[bldc]]`, `[[servo]]`, `[[stepper]]`, `[[relay]]`, `[[dac]]`: outputs other than bridges.

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{
        BldcConfig, DacConfig, DriveLine, RelayConfig, RelayRole, Reverse, ServoChipConfig, ServoConfig, ServoPoint,
        StepperBankConfig, StepperConfig,
    },
};
use serde::Deserialize;

use super::{
    motor::Homing,
    read::{Place, Table},
};
use crate::{
    carrier::Carrier,
    error::BoardError,
    number::{Interval, channel, finite, not_negative, oscillator_hz, positive, stop_brake_ms},
};

/// Nominal oscillator frequency of a PCA9685, Hz (datasheet 7.3.5).
pub(super) const NOMINAL_OSCILLATOR_HZ: f32 = 25e6;

/// Brushless drive: a `reverse_v` reverses it by voltage, a `direction` by a line; without either it cannot be
/// reversed.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Bldc {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "not_negative")]
    neutral_v: f32,
    #[serde(deserialize_with = "not_negative")]
    forward_v: f32,
    reverse_v: Option<f32>,
    direction: Option<Direction>,
    brake: Option<Brake>,
    #[serde(deserialize_with = "positive")]
    slew_per_s: f32,
    #[serde(default, deserialize_with = "stop_brake_ms")]
    stop_brake_ms: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Direction {
    active_low: bool,
    rest_ms: u16,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Brake {
    active_low: bool,
}

impl Table for Bldc {
    type Config = BldcConfig;
    const KIND: ChannelKind = ChannelKind::Bldc;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<BldcConfig, BoardError> {
        let lines = place.connector(&place.carrier.bldc.connectors, self.channel)?;
        let reverse = match (self.reverse_v, &self.direction) {
            (None, None) => Reverse::None,
            (Some(full_v), None) => Reverse::Voltage { full_v },
            (None, &Some(Direction { active_low, rest_ms })) => {
                Reverse::Line { line: DriveLine { bit: lines.direction, active_low }, rest_ms }
            }
            (Some(_), Some(_)) => {
                // With both it would be ambiguous which of them means backwards.
                return Err(place.rule("reverse_v", "a drive reverses by voltage or by direction: leave one out"));
            }
        };
        let brake = self.brake.as_ref();
        Ok(BldcConfig {
            id: self.channel,
            output: lines.speed,
            neutral_v: self.neutral_v,
            forward_v: self.forward_v,
            reverse,
            brake: brake.map(|&Brake { active_low }| DriveLine { bit: lines.brake, active_low }),
            slew_per_s: self.slew_per_s,
            stop_brake_ms: self.stop_brake_ms,
        })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ServoChip {
    hold_when_safe: bool,
    #[serde(default = "nominal_oscillator_hz", deserialize_with = "oscillator_hz")]
    oscillator_hz: f32,
}

fn nominal_oscillator_hz() -> f32 {
    NOMINAL_OSCILLATOR_HZ
}

impl ServoChip {
    pub(super) fn config(&self, carrier: &Carrier) -> ServoChipConfig {
        ServoChipConfig {
            address: carrier.address(&carrier.servo.pwm),
            frequency_hz: carrier.servo.frequency_hz,
            oscillator_hz: self.oscillator_hz,
            hold_when_safe: self.hold_when_safe,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Servo {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    low: ServoEnd,
    high: ServoEnd,
    #[serde(deserialize_with = "positive")]
    speed_max_rad_s: f32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ServoEnd {
    #[serde(deserialize_with = "finite")]
    angle_rad: f32,
    pulse_s: Option<f64>,
}

impl ServoEnd {
    fn config(&self, field: &str, default_s: f64, place: &Place<'_, '_>) -> Result<ServoPoint, BoardError> {
        let Interval { min, max } = place.carrier.servo.pulse_hard_s;
        let pulse_s = self.pulse_s.unwrap_or(default_s);
        // 0.5 to 2.5 ms, our choice (r4-carrier.toml); 1 to 2 ms are the customary signal.
        if !(min..=max).contains(&pulse_s) {
            let field = format!("{field}.pulse_s");
            return Err(place.rule(&field, "must be inside servo.pulse_hard_s of the carrier"));
        }
        Ok(ServoPoint { pulse_s: pulse_s as f32, angle_rad: self.angle_rad })
    }
}

impl Table for Servo {
    type Config = ServoConfig;
    const KIND: ChannelKind = ChannelKind::Servo;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<ServoConfig, BoardError> {
        let default_s = place.carrier.servo.pulse_default_s;
        Ok(ServoConfig {
            id: self.channel,
            output: *place.connector(&place.carrier.servo.outputs, self.channel)?,
            low: self.low.config("low", default_s.min, place)?,
            high: self.high.config("high", default_s.max, place)?,
            speed_max: self.speed_max_rad_s,
        })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StepperBank {
    enable_active_low: bool,
    hold_when_safe: bool,
}

impl StepperBank {
    pub(super) fn config(&self, carrier: &Carrier) -> StepperBankConfig {
        let times = &carrier.stepper;
        StepperBankConfig {
            enable_active_low: self.enable_active_low,
            enable_setup_us: whole_us(times.enable_setup_s),
            direction_setup_us: whole_us(times.direction_setup_s),
            rate_max_hz: times.rate_max_hz,
            hold_when_safe: self.hold_when_safe,
        }
    }
}

/// Rounds up to whole µs, without the error that a 32-bit float adds to a whole number.
fn whole_us(time_s: f32) -> u32 {
    // 1 ms as an f32 is 1000.00005 µs, which `ceil` alone would make 1001.
    (f64::from(time_s) * 1e6 * (1.0 - f64::from(f32::EPSILON))).ceil() as u32
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Stepper {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "positive")]
    steps_per_turn: u32,
    #[serde(default)]
    inverted: bool,
    position_rad: Interval,
    #[serde(deserialize_with = "positive")]
    speed_max_rad_s: f32,
    #[serde(deserialize_with = "positive")]
    acceleration_rad_s2: f32,
    #[serde(default, deserialize_with = "not_negative")]
    jerk_rad_s3: f32,
    #[serde(deserialize_with = "not_negative")]
    start_speed_rad_s: f32,
    homing: Option<Homing>,
    #[serde(default, deserialize_with = "stop_brake_ms")]
    stop_brake_ms: u16,
}

impl Table for Stepper {
    type Config = StepperConfig;
    const KIND: ChannelKind = ChannelKind::Stepper;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, _: &mut Place<'_, '_>) -> Result<StepperConfig, BoardError> {
        Ok(StepperConfig {
            id: self.channel,
            steps_per_turn: self.steps_per_turn,
            inverted: self.inverted,
            position: self.position_rad.into(),
            speed_max: self.speed_max_rad_s,
            acceleration: self.acceleration_rad_s2,
            jerk: self.jerk_rad_s3,
            start_speed: self.start_speed_rad_s,
            homing: self.homing.map(Into::into),
            stop_brake_ms: self.stop_brake_ms,
        })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Relay {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    active_low: bool,
    #[serde(default)]
    role: Role,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Role {
    #[default]
    General,
    MotorPower,
}

impl Table for Relay {
    type Config = RelayConfig;
    const KIND: ChannelKind = ChannelKind::Relay;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<RelayConfig, BoardError> {
        let known = &place.carrier.relay;
        let bit = *place.connector(&known.outputs, self.channel)?;
        let role = match self.role {
            Role::General => RelayRole::General,
            Role::MotorPower if self.channel.index == known.motor_power => RelayRole::MotorPower,
            Role::MotorPower => {
                return Err(place.rule("channel", "the motors' supply is on the carrier's relay.motor_power"));
            }
        };
        Ok(RelayConfig { id: self.channel, bit, active_low: self.active_low, role })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Dac {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    range_v: Option<Interval>,
    #[serde(deserialize_with = "not_negative")]
    safe_v: f32,
}

impl Table for Dac {
    type Config = DacConfig;
    const KIND: ChannelKind = ChannelKind::Dac;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<DacConfig, BoardError> {
        let full_v = Interval { min: 0.0, max: place.carrier.dac.full_scale_v.into() };
        Ok(DacConfig { id: self.channel, range_v: self.range_v.unwrap_or(full_v).into(), safe_v: self.safe_v })
    }
}
