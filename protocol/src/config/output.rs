//! Outputs other than bridges: servos, brushless drives, steppers, relays, analog outputs.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{
    ConfigError, DAC_OUTPUTS, HomingConfig, MAX_EXACT, PCA9685_RULE, STEPPERS, STOP_BRAKE_MAX_MS, STOP_BRAKE_RULE,
    check, finite, finite_range, motor::HOMING_RULE, not_negative, pca9685_address, positive,
};
use crate::channel::{ChannelId, ChannelKind, Range};

/// The PCA9685 behind the servos.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ServoChipConfig {
    /// 7-bit I2C address.
    pub address: u8,
    /// Repetition of the pulses, Hz; 40 to 330.
    pub frequency_hz: f32,
    /// Measured frequency of this chip's oscillator, Hz; 25 MHz where it has not been calibrated.
    pub oscillator_hz: f32,
    /// Whether pulses go on while the board is not armed, so that servos hold where they are.
    pub hold_when_safe: bool,
}

/// An RC servo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ServoConfig {
    /// [`ChannelKind::Servo`] and its number.
    pub id: ChannelId,
    /// Output of the PWM chip.
    pub output: u8,
    /// One end of its travel.
    pub low: ServoPoint,
    /// The other end of its travel, with a longer pulse.
    pub high: ServoPoint,
    /// Fastest change of the angle that is asked of it, rad/s.
    pub speed_max: f32,
}

/// Which pulse a servo takes for which angle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ServoPoint {
    /// Pulse width, s.
    pub pulse_s: f32,
    /// Angle there, rad.
    pub angle_rad: f32,
}

/// The MCP4728 behind the brushless drives.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DacChipConfig {
    /// 7-bit I2C address.
    pub address: u8,
    /// Its supply, which is its reference, V.
    pub full_scale_v: f32,
}

/// A brushless drive: speed by voltage, direction and brake by lines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BldcConfig {
    /// [`ChannelKind::Bldc`] and its number.
    pub id: ChannelId,
    /// Output of the DAC chip.
    pub output: u8,
    /// Where the drive stands still, V. Not always 0: some throttles rest in the middle.
    pub neutral_v: f32,
    /// Full speed forwards, V.
    pub forward_v: f32,
    /// How it is sent backwards.
    pub reverse: Reverse,
    /// Its brake, if it is wired.
    pub brake: Option<DriveLine>,
    /// Fastest change of its speed, as share of full speed per second.
    pub slew_per_s: f32,
    /// How long a controlled stop leaves its supply on while it brakes, ms: see [`super::BoardConfig::stop_brake_ms`]. 0
    /// takes the supply away at once.
    pub stop_brake_ms: u16,
}

/// How a brushless drive is sent backwards.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Reverse {
    /// Not at all.
    None,
    /// By a line, at the same voltages.
    Line {
        /// Active backwards.
        line: DriveLine,
        /// Rest at neutral before the line changes, ms.
        rest_ms: u16,
    },
    /// By a voltage on the other side of neutral.
    Voltage {
        /// Full speed backwards, V.
        full_v: f32,
    },
}

/// A line of the port expander to a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct DriveLine {
    /// Bit of the expander, 0 to 7 on port A, 8 to 15 on port B.
    pub bit: u8,
    /// Whether a low output activates it.
    pub active_low: bool,
}

/// What the step/direction drivers have in common.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct StepperBankConfig {
    /// Whether a low level enables the drivers.
    pub enable_active_low: bool,
    /// From enabling to the first pulse, µs.
    pub enable_setup_us: u32,
    /// Direction steady before a pulse and after it, µs.
    pub direction_setup_us: u32,
    /// Most pulses per second of one axis, Hz; at most 100 kHz.
    pub rate_max_hz: f32,
    /// Whether the drivers stay enabled, and the motors hold, while the board is not armed.
    pub hold_when_safe: bool,
}

/// A step/direction driver with its motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct StepperConfig {
    /// [`ChannelKind::Stepper`] and its number, which is the connector's.
    pub id: ChannelId,
    /// Pulses for one turn of the output shaft.
    pub steps_per_turn: u32,
    /// Whether the direction line is high backwards.
    pub inverted: bool,
    /// Positions it may be sent to, rad.
    pub position: Range,
    /// Highest speed, rad/s.
    pub speed_max: f32,
    /// rad/s²
    pub acceleration: f32,
    /// rad/s³; 0 for a trapezoid.
    pub jerk: f32,
    /// Highest speed at which it can start and stop without losing steps, rad/s.
    pub start_speed: f32,
    /// How it finds its zero.
    pub homing: Option<HomingConfig>,
    /// How long a controlled stop may take to bring it to rest by its ramp, ms: see
    /// [`super::BoardConfig::stop_brake_ms`]. 0 ends its pulses at once.
    pub stop_brake_ms: u16,
}

/// An MCP23017.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct ExpanderConfig {
    /// 7-bit I2C address.
    pub address: u8,
}

/// A relay on the expander.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct RelayConfig {
    /// [`ChannelKind::Relay`] and its number.
    pub id: ChannelId,
    /// Bit of the expander, 0 to 7 on port A, 8 to 15 on port B.
    pub bit: u8,
    /// Whether a low output closes it. An input, as after power-up, must leave it open either way.
    pub active_low: bool,
    /// What it switches.
    pub role: RelayRole,
}

/// What a relay switches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum RelayRole {
    /// Whatever the user wired to it; open until commanded.
    General,
    /// The motors' supply: closed while armed, opened first on a stop, not commanded by hosts.
    MotorPower,
}

/// An output of the processor's own DAC.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DacConfig {
    /// [`ChannelKind::Dac`] and its number, which is the connector's.
    pub id: ChannelId,
    /// Voltages it may be set to, V.
    pub range_v: Range,
    /// While the board is not armed, V.
    pub safe_v: f32,
}

/// Full scale of the processor's DAC, V: the board's reference.
pub const DAC_FULL_SCALE_V: f32 = 3.3;

impl ServoChipConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(None, holds, rule);
        rule(pca9685_address(self.address), PCA9685_RULE)?;
        rule(Range::new(40.0, 330.0).contains(self.frequency_hz), "servo pulses repeat at 40 to 330 Hz")?;
        rule(
            Range::new(20e6, 30e6).contains(self.oscillator_hz),
            "the servo chip's oscillator is 25 MHz within some percent: 20 to 30 MHz",
        )
    }
}

impl ServoConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Servo, "a servo needs a servo channel name")?;
        // 2.5 ms at the highest frequency, 330 Hz, is 0.825 of the period: there is always a gap.
        let pulse = Range::new(500e-6, 2500e-6);
        rule(
            pulse.contains(self.low.pulse_s)
                && pulse.contains(self.high.pulse_s)
                && self.low.pulse_s < self.high.pulse_s,
            "servo pulses are 0.5 to 2.5 ms, the low point's shorter than the high point's",
        )?;
        let angles = [self.low.angle_rad, self.high.angle_rad];
        rule(
            angles.into_iter().all(finite) && positive((angles[0] - angles[1]).abs()),
            "a servo's two angles must differ",
        )?;
        rule(positive(self.speed_max), "speed_max must be positive")
    }

    /// Angles it can be sent to, rad.
    #[must_use]
    pub fn position(&self) -> Range {
        let (low, high) = (self.low.angle_rad, self.high.angle_rad);
        Range::new(low.min(high), low.max(high))
    }
}

impl BldcConfig {
    pub(super) fn validate(&self, full_scale_v: f32) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Bldc, "a brushless drive needs a bldc channel name")?;
        let full = Range::new(0.0, full_scale_v);
        let backwards_v = if let Reverse::Voltage { full_v } = self.reverse { full_v } else { self.neutral_v };
        rule(
            [self.neutral_v, self.forward_v, backwards_v].into_iter().all(|volts| full.contains(volts)),
            "voltages must lie between 0 and the DAC's full scale",
        )?;
        rule(self.forward_v != self.neutral_v, "forward_v must differ from neutral_v")?;
        if let Reverse::Voltage { full_v } = self.reverse {
            rule(
                (full_v - self.neutral_v) * (self.forward_v - self.neutral_v) < 0.0,
                "full speed backwards must be on the other side of neutral",
            )?;
        }
        rule(positive(self.slew_per_s), "slew_per_s must be positive")?;
        rule(self.stop_brake_ms <= STOP_BRAKE_MAX_MS, STOP_BRAKE_RULE)?;
        rule(
            self.stop_brake_ms == 0 || self.brake.is_some(),
            "a brushless drive needs its brake line for a stop that brakes",
        )
    }

    /// The expander's lines it uses.
    pub fn lines(&self) -> impl Iterator<Item = DriveLine> + use<> {
        let direction = if let Reverse::Line { line, .. } = self.reverse { Some(line) } else { None };
        direction.into_iter().chain(self.brake)
    }
}

impl StepperBankConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(None, holds, rule);
        rule(
            positive(self.rate_max_hz) && self.rate_max_hz <= 100e3,
            "rate_max_hz must be above 0 and at most 100000",
        )?;
        rule(
            self.enable_setup_us <= 1_000_000 && self.direction_setup_us <= 10_000,
            "enable_setup_us must be at most 1000000, direction_setup_us at most 10000",
        )
    }
}

impl StepperConfig {
    pub(super) fn validate(&self, rate_max_hz: f32) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Stepper, "a stepper needs a stepper channel name")?;
        rule(usize::from(self.id.index) < STEPPERS, "steppers are numbered 0 to 3")?;
        rule((1..=MAX_EXACT).contains(&self.steps_per_turn), "steps_per_turn must be 1 to 16777216")?;
        let steps_per_rad = self.steps_per_turn as f32 / core::f32::consts::TAU;
        rule(finite_range(self.position), "position must have a finite min below a finite max")?;
        let counts = |position: f32| (position * steps_per_rad).abs() <= 1e9;
        rule(counts(self.position.min) && counts(self.position.max), "position must be within 1e9 steps of 0")?;
        rule(
            positive(self.speed_max) && self.speed_max * steps_per_rad <= rate_max_hz,
            "speed_max must be positive, and no more than rate_max_hz pulses per second",
        )?;
        rule(
            positive(self.acceleration) && not_negative(self.jerk) && not_negative(self.start_speed),
            "acceleration must be positive, jerk and start_speed not negative",
        )?;
        rule(self.start_speed <= self.speed_max, "start_speed must be at most speed_max")?;
        rule(self.stop_brake_ms <= STOP_BRAKE_MAX_MS, STOP_BRAKE_RULE)?;
        rule(self.homing.is_none_or(|homing| homing.is_valid(self.position, self.speed_max)), HOMING_RULE)
    }
}

impl DacConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Dac, "an analog output needs a dac channel name")?;
        rule(usize::from(self.id.index) < DAC_OUTPUTS, "analog outputs are numbered 0 and 1")?;
        let full = Range::new(0.0, DAC_FULL_SCALE_V);
        rule(
            full.contains(self.range_v.min) && full.contains(self.range_v.max) && self.range_v.min < self.range_v.max,
            "range_v must lie between 0 and 3.3 V",
        )?;
        rule(full.contains(self.safe_v), "safe_v must lie between 0 and 3.3 V")
    }
}
