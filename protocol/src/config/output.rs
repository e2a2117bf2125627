//! Outputs other than bridges: servos, brushless drives, steppers, relays, analog outputs.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{
    ConfigError, DAC_OUTPUTS, HomingConfig, MAX_EXACT, PCA9685_RULE, STEPPERS, STOP_BRAKE_MAX_MS, STOP_BRAKE_RULE,
    check, finite, finite_range, motor::HOMING_RULE, not_negative, pca9685_address, positive,
};
use crate::channel::{ChannelId, ChannelKind, Range};

/// PWM chip behind the servos, a PCA9685.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ServoChipConfig {
    /// I2C address of the chip, 7 bits.
    pub address: u8,
    /// Repetition rate of the pulses, Hz; 40 to 330.
    pub frequency_hz: f32,
    /// Measured frequency of this chip's oscillator, Hz; 25 MHz where it has not been calibrated.
    pub oscillator_hz: f32,
    /// True where pulses go on while the board is not armed, so that servos hold their position.
    pub hold_when_safe: bool,
}

/// RC servo, set by the width of pulses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ServoConfig {
    /// [`ChannelKind::Servo`] and its number.
    pub id: ChannelId,
    /// Output of the PWM chip, 0 to 15.
    pub output: u8,
    /// One end of the travel, with the shorter pulse.
    pub low: ServoPoint,
    /// Other end of the travel, with the longer pulse.
    pub high: ServoPoint,
    /// Fastest change of the commanded angle, rad/s.
    pub speed_max: f32,
}

/// Pulse width of a servo for an angle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ServoPoint {
    /// Pulse width at this point, s.
    pub pulse_s: f32,
    /// Angle at this pulse width, rad.
    pub angle_rad: f32,
}

/// DAC behind the brushless drives, an MCP4728.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DacChipConfig {
    /// I2C address of the chip, 7 bits.
    pub address: u8,
    /// Supply of the chip, which is its reference, V.
    pub full_scale_v: f32,
}

/// Brushless drive: a voltage sets the speed, lines set direction and brake.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BldcConfig {
    /// [`ChannelKind::Bldc`] and its number.
    pub id: ChannelId,
    /// Output of the DAC chip, 0 to 3.
    pub output: u8,
    /// Voltage at which the drive stands still, V. Not always 0: some throttles rest in the middle.
    pub neutral_v: f32,
    /// Voltage of full speed forwards, V.
    pub forward_v: f32,
    /// Reversal of the drive.
    pub reverse: Reverse,
    /// Line of the brake, if it is wired.
    pub brake: Option<DriveLine>,
    /// Fastest change of the speed, share of full speed per second.
    pub slew_per_s: f32,
    /// Time for which a controlled stop leaves the drive's supply on while it brakes, ms: see
    /// [`super::BoardConfig::stop_brake_ms`]. A time of 0 takes the supply away at once.
    pub stop_brake_ms: u16,
}

/// Reversal of a brushless drive.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Reverse {
    /// The drive cannot be reversed.
    None,
    /// A line reverses the drive, at the same voltages.
    Line {
        /// Line that is active for backwards.
        line: DriveLine,
        /// Time at neutral before the line changes, ms.
        rest_ms: u16,
    },
    /// A voltage on the other side of neutral reverses the drive.
    Voltage {
        /// Voltage of full speed backwards, V.
        full_v: f32,
    },
}

/// Line of the port expander to a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct DriveLine {
    /// Bit of the expander, 0 to 7 on port A, 8 to 15 on port B.
    pub bit: u8,
    /// True where a low output activates the line.
    pub active_low: bool,
}

/// Settings that all step/direction drivers share.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct StepperBankConfig {
    /// True where a low level enables the drivers.
    pub enable_active_low: bool,
    /// Time from enabling to the first pulse, µs.
    pub enable_setup_us: u32,
    /// Time for which the direction is steady before a pulse and after it, µs.
    pub direction_setup_us: u32,
    /// Highest pulse rate of one axis, Hz; at most 100 kHz.
    pub rate_max_hz: f32,
    /// True where the drivers stay enabled, and the motors hold, while the board is not armed.
    pub hold_when_safe: bool,
}

/// Step/direction driver with its motor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct StepperConfig {
    /// [`ChannelKind::Stepper`] and its number, which is the connector's.
    pub id: ChannelId,
    /// Pulses for one turn of the output shaft.
    pub steps_per_turn: u32,
    /// True where the direction line is high backwards.
    pub inverted: bool,
    /// Range of positions for set points, rad.
    pub position: Range,
    /// Highest speed of the shaft, rad/s.
    pub speed_max: f32,
    /// Acceleration of the shaft, rad/s².
    pub acceleration: f32,
    /// Jerk of the shaft, rad/s³; 0 for a trapezoid.
    pub jerk: f32,
    /// Highest speed at which it can start and stop without losing steps, rad/s.
    pub start_speed: f32,
    /// Homing switch; `None` where the zero is the position at power-on.
    pub homing: Option<HomingConfig>,
    /// Time in which a controlled stop may bring the stepper to rest by its ramp, ms: see
    /// [`super::BoardConfig::stop_brake_ms`]. A time of 0 ends its pulses at once.
    pub stop_brake_ms: u16,
}

/// Port expander with 16 lines, an MCP23017.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct ExpanderConfig {
    /// I2C address of the chip, 7 bits.
    pub address: u8,
}

/// Relay on the expander.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct RelayConfig {
    /// [`ChannelKind::Relay`] and its number.
    pub id: ChannelId,
    /// Bit of the expander, 0 to 7 on port A, 8 to 15 on port B.
    pub bit: u8,
    /// True where a low output closes the relay. An input, as after power-up, must leave it open either way.
    pub active_low: bool,
    /// Purpose of the relay.
    pub role: RelayRole,
}

/// Purpose of a relay.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum RelayRole {
    /// Any load of the user; open until commanded.
    General,
    /// Supply of the motors: closed while armed, opened first on a stop, not commanded by hosts.
    MotorPower,
}

/// Output of the processor's own DAC.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DacConfig {
    /// [`ChannelKind::Dac`] and its number, which is the connector's.
    pub id: ChannelId,
    /// Range of voltages for set points, V.
    pub range_v: Range,
    /// Voltage while the board is not armed, V.
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

    /// Returns the range of angles for set points, rad.
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
            // Without the line the drive would coast with its supply on.
            self.stop_brake_ms == 0 || self.brake.is_some(),
            "a brushless drive needs its brake line for a stop that brakes",
        )
    }

    /// Iterates over the lines of the expander that the drive uses.
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
        // Limits are checked in steps, because positions are counted as i32.
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
