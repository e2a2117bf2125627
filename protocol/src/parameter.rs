//! Parameters: the numbers of a board's configuration that a host may change and save.
//!
//! [`crate::config::BoardConfig::parameter`] reads one, [`crate::config::BoardConfig::set_parameter`] changes it.

use core::{fmt, str::FromStr};

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{channel::ChannelId, config::ConfigError};

/// Number of a board's configuration. postcard sends the variant's position: append, never reorder or remove.
///
/// The unit is that of its field in [`crate::config`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
pub enum Parameter {
    /// Link time-out of the board, ms: [`crate::config::BoardConfig::link_timeout_ms`].
    LinkTimeoutMs,
    /// Temperature of the air in front of the range sensors, °C: [`crate::config::BoardConfig::air_temperature_c`].
    AirTemperatureC,
    /// Measured oscillator frequency of the servos' PWM chip, Hz: [`crate::config::ServoChipConfig::oscillator_hz`].
    ServoOscillatorHz,
    /// Highest duty of a motor, share of the supply.
    DutyMax,
    /// Fastest change of a motor's duty, 1/s.
    DutySlew,
    /// Lowest position of a motor with feedback or of a stepper, rad or m.
    PositionMin,
    /// Highest position of a motor with feedback or of a stepper, rad or m.
    PositionMax,
    /// Highest speed of a motor with feedback, a servo or a stepper, rad/s or m/s.
    SpeedMax,
    /// Proportional gain of a motor's position loop, duty/rad or duty/m.
    PositionKp,
    /// Integral gain of a motor's position loop, duty/(rad s) or duty/(m s).
    PositionKi,
    /// Derivative gain of a motor's position loop, duty s/rad or duty s/m.
    PositionKd,
    /// Proportional gain of a motor's speed loop, duty s/rad or duty s/m.
    SpeedKp,
    /// Integral gain of a motor's speed loop, duty/rad or duty/m.
    SpeedKi,
    /// Derivative gain of a motor's speed loop, duty s²/rad or duty s²/m.
    SpeedKd,
    /// Time constant of the low-pass on a motor's measured speed, s.
    SpeedFilter,
    /// Speed limit of a motor's profile, rad/s or m/s.
    ProfileSpeed,
    /// Acceleration limit of a motor's profile, rad/s² or m/s².
    ProfileAcceleration,
    /// Feed-forward of a motor against static friction, share of the supply.
    StaticDuty,
    /// Feed-forward of a motor for its speed, duty s/rad or duty s/m.
    DutyPerSpeed,
    /// Settling: largest position error of a motor that rests at its position, rad or m.
    SettleError,
    /// Settling: largest speed of a motor that rests at its position, rad/s or m/s.
    SettleSpeed,
    /// Settling: time for which a motor must stay within both, ms.
    SettleTimeMs,
    /// Stall detection of a motor: lowest duty at which it counts, share of the supply.
    StallDuty,
    /// Stall detection of a motor: travel below which it counts as stalled, rad or m.
    StallTravel,
    /// Stall detection of a motor: time in which it must make that travel, ms.
    StallTimeMs,
    /// Following of a motor: largest distance from its path, rad or m.
    FollowError,
    /// Following of a motor: time for which it may be further away, ms.
    FollowTimeMs,
    /// Encoder counts in one turn of the output shaft, of a motor's encoder or of an encoder channel.
    CountsPerTurn,
    /// Potentiometer of a motor: 16-bit code of the first calibration point.
    PotLowCode,
    /// Potentiometer of a motor: position of the first calibration point, m.
    PotLowPosition,
    /// Potentiometer of a motor: 16-bit code of the second calibration point.
    PotHighCode,
    /// Potentiometer of a motor: position of the second calibration point, m.
    PotHighPosition,
    /// Homing of a motor or stepper: position at which the switch opens again, rad.
    HomePosition,
    /// Homing of a motor or stepper: highest speed at which it seeks the switch, rad/s.
    HomeSpeedMax,
    /// Pulse width of a servo at the first end of its travel, s.
    PulseLow,
    /// Angle of a servo at the first end of its travel, rad.
    AngleLow,
    /// Pulse width of a servo at the second end of its travel, s.
    PulseHigh,
    /// Angle of a servo at the second end of its travel, rad.
    AngleHigh,
    /// Voltage at which a brushless drive stands still, V.
    NeutralV,
    /// Voltage of a brushless drive at full speed forwards, V.
    ForwardV,
    /// Voltage of a brushless drive at full speed backwards, V; only where a voltage reverses it.
    ReverseV,
    /// Fastest change of a brushless drive's speed, share of full speed per second.
    SpeedSlew,
    /// Pulses of a stepper for one turn of the output shaft.
    StepsPerTurn,
    /// Acceleration of a stepper, rad/s².
    Acceleration,
    /// Jerk limit of a motor's profile or of a stepper, rad/s³ or m/s³; 0 for none.
    Jerk,
    /// Highest speed at which a stepper can start and stop, rad/s.
    StartSpeed,
    /// Voltage of an analog output while the board is not armed, V.
    SafeV,
    /// Distance of a range sensor below which the board trips, m; only where one is configured.
    StopBelow,
    /// Volts for one step of the 16-bit code, of an analog input or a supply.
    VoltsPerCode,
    /// Voltage of an analog input at code 0, V.
    OffsetV,
    /// Lowest voltage of an analog output, of what is plausible at an analog input, or of a supply in range, V.
    VoltsMin,
    /// Highest voltage of an analog output, of what is plausible at an analog input, or of a supply in range, V.
    VoltsMax,
    /// Winding of a motor: supply voltage at which its gains were tuned, V.
    NominalV,
    /// Winding of a motor: duty below which no current flows.
    DeadDuty,
    /// Winding of a motor: resistance including the bridge, ohm.
    ResistanceOhm,
    /// Winding of a motor: back-EMF constant at the output, V s/rad or V s/m.
    BackEmf,
    /// Winding of a motor: current that it withstands continuously, A.
    RatedA,
    /// Winding of a motor: thermal time constant, s.
    ThermalS,
    /// Current sensor of a motor: voltage at 0 A, V.
    CurrentZeroV,
    /// Current sensor of a motor: sensitivity, V/A.
    CurrentVoltsPerA,
    /// Supply voltage above which its motors feed less energy back, V; only where one is configured.
    RegenerationV,
    /// Time for which a controlled stop brakes a motor, a brushless drive or a stepper, ms.
    StopBrakeMs,
    /// Bit rate of the board's CAN bus, kbit/s: [`crate::config::CanConfig::kbit_per_s`].
    CanRate,
    /// Node number of the board on its CAN bus: [`crate::config::CanConfig::node`].
    CanNode,
    /// Bit rate of the data phase on the board's CAN bus, kbit/s: [`crate::config::CanConfig::data_kbit_per_s`].
    CanDataRate,
    /// Feed-forward of a motor for its acceleration, duty s²/rad or duty s²/m.
    DutyPerAcceleration,
    /// Cascade gain of a motor with feedback: speed for the distance from its path, 1/s: [`crate::config::ControlConfig::cascade_per_s`].
    Cascade,
    /// Angle sensor of a motor: angle that is position 0, rad.
    ZeroAngle,
    /// Encoder on the motor's side: counts in one turn of the output shaft: [`crate::config::MotorSideConfig::counts_per_turn`].
    MotorSideCounts,
    /// Encoder on the motor's side: largest difference from the sensor of the output shaft, rad: [`crate::config::MotorSideConfig::gap_max`].
    GapMax,
    /// Force control of a motor: speed per newton of error, rad/(s N) or m/(s N): [`crate::config::ForceConfig::speed_per_n`].
    ForceGain,
    /// Force control of a motor: force at which the board trips, N: [`crate::config::ForceConfig::limit_n`].
    ForceLimit,
    /// Force control of a motor: highest speed, rad/s or m/s: [`crate::config::ForceConfig::approach_speed`].
    ApproachSpeed,
    /// Force control of a motor: force that counts as contact, N: [`crate::config::ForceConfig::contact_n`].
    ContactForce,
    /// Force control of a motor: error within which a force counts as reached, N: [`crate::config::ForceConfig::error_n`].
    ForceError,
}

impl Parameter {
    const NAMES: [(Self, &'static str); 75] = [
        (Self::LinkTimeoutMs, "link_timeout_ms"),
        (Self::AirTemperatureC, "air_temperature_c"),
        (Self::ServoOscillatorHz, "servo_oscillator_hz"),
        (Self::DutyMax, "duty_max"),
        (Self::DutySlew, "duty_slew"),
        (Self::PositionMin, "position_min"),
        (Self::PositionMax, "position_max"),
        (Self::SpeedMax, "speed_max"),
        (Self::PositionKp, "position_kp"),
        (Self::PositionKi, "position_ki"),
        (Self::PositionKd, "position_kd"),
        (Self::SpeedKp, "speed_kp"),
        (Self::SpeedKi, "speed_ki"),
        (Self::SpeedKd, "speed_kd"),
        (Self::SpeedFilter, "speed_filter"),
        (Self::ProfileSpeed, "profile_speed"),
        (Self::ProfileAcceleration, "profile_acceleration"),
        (Self::StaticDuty, "static_duty"),
        (Self::DutyPerSpeed, "duty_per_speed"),
        (Self::SettleError, "settle_error"),
        (Self::SettleSpeed, "settle_speed"),
        (Self::SettleTimeMs, "settle_time_ms"),
        (Self::StallDuty, "stall_duty"),
        (Self::StallTravel, "stall_travel"),
        (Self::StallTimeMs, "stall_time_ms"),
        (Self::FollowError, "follow_error"),
        (Self::FollowTimeMs, "follow_time_ms"),
        (Self::CountsPerTurn, "counts_per_turn"),
        (Self::PotLowCode, "pot_low_code"),
        (Self::PotLowPosition, "pot_low_position"),
        (Self::PotHighCode, "pot_high_code"),
        (Self::PotHighPosition, "pot_high_position"),
        (Self::HomePosition, "home_position"),
        (Self::HomeSpeedMax, "home_speed_max"),
        (Self::PulseLow, "pulse_low"),
        (Self::AngleLow, "angle_low"),
        (Self::PulseHigh, "pulse_high"),
        (Self::AngleHigh, "angle_high"),
        (Self::NeutralV, "neutral_v"),
        (Self::ForwardV, "forward_v"),
        (Self::ReverseV, "reverse_v"),
        (Self::SpeedSlew, "speed_slew"),
        (Self::StepsPerTurn, "steps_per_turn"),
        (Self::Acceleration, "acceleration"),
        (Self::Jerk, "jerk"),
        (Self::StartSpeed, "start_speed"),
        (Self::SafeV, "safe_v"),
        (Self::StopBelow, "stop_below"),
        (Self::VoltsPerCode, "volts_per_code"),
        (Self::OffsetV, "offset_v"),
        (Self::VoltsMin, "volts_min"),
        (Self::VoltsMax, "volts_max"),
        (Self::NominalV, "nominal_v"),
        (Self::DeadDuty, "dead_duty"),
        (Self::ResistanceOhm, "resistance_ohm"),
        (Self::BackEmf, "back_emf"),
        (Self::RatedA, "rated_a"),
        (Self::ThermalS, "thermal_s"),
        (Self::CurrentZeroV, "current_zero_v"),
        (Self::CurrentVoltsPerA, "current_volts_per_a"),
        (Self::RegenerationV, "regeneration_v"),
        (Self::StopBrakeMs, "stop_brake_ms"),
        (Self::CanRate, "can_rate"),
        (Self::CanNode, "can_node"),
        (Self::CanDataRate, "can_data_rate"),
        (Self::DutyPerAcceleration, "duty_per_acceleration"),
        (Self::Cascade, "cascade"),
        (Self::ZeroAngle, "zero_angle"),
        (Self::MotorSideCounts, "motor_side_counts"),
        (Self::GapMax, "gap_max"),
        (Self::ForceGain, "force_gain"),
        (Self::ForceLimit, "force_limit"),
        (Self::ApproachSpeed, "approach_speed"),
        (Self::ContactForce, "contact_force"),
        (Self::ForceError, "force_error"),
    ];

    /// Iterates over all parameters, in the order of the variants.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::NAMES.into_iter().map(|(parameter, _)| parameter)
    }

    /// Returns the name used on command lines and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        // The table is in the order of the variants, which a test checks.
        Self::NAMES[self as usize].1
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Error of text that names no parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAParameter;

impl fmt::Display for NotAParameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a parameter: write a channel or board, a dot and a name, as in osmc0.position_kp")
    }
}

impl core::error::Error for NotAParameter {}

impl FromStr for Parameter {
    type Err = NotAParameter;

    fn from_str(text: &str) -> Result<Self, NotAParameter> {
        Self::NAMES.into_iter().find(|(_, name)| *name == text).map(|(parameter, _)| parameter).ok_or(NotAParameter)
    }
}

/// Name of one parameter of one channel or of the board, written `osmc0.position_kp`, `board.link_timeout_ms` …
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
pub struct ParameterKey {
    /// Channel of the parameter; `None` for the board.
    pub channel: Option<ChannelId>,
    /// Parameter of this channel.
    pub parameter: Parameter,
}

/// Name in the place of the channel in parameters of the board.
const BOARD: &str = "board";

impl fmt::Display for ParameterKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.channel {
            Some(channel) => write!(f, "{channel}.{}", self.parameter),
            None => write!(f, "{BOARD}.{}", self.parameter),
        }
    }
}

impl FromStr for ParameterKey {
    type Err = NotAParameter;

    fn from_str(text: &str) -> Result<Self, NotAParameter> {
        let (channel, parameter) = text.split_once('.').ok_or(NotAParameter)?;
        let channel = if channel == BOARD { None } else { Some(channel.parse().map_err(|_| NotAParameter)?) };
        Ok(Self { channel, parameter: parameter.parse()? })
    }
}

/// Reason why a parameter was not set. Nothing was changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetError {
    /// The configuration has no such parameter.
    Unknown(ParameterKey),
    /// The field cannot hold the value, or the configuration would break a rule.
    Invalid(ConfigError),
}

impl fmt::Display for SetError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown(key) => write!(f, "the configuration has no parameter {key}"),
            Self::Invalid(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for SetError {}

#[cfg(test)]
mod tests {
    use core::fmt::Write;

    use heapless::String;
    use postcard_schema::schema::DataModelType;

    use super::*;
    use crate::channel::ChannelKind;

    #[test]
    fn every_variant_has_its_name_in_snake_case() {
        let DataModelType::Enum(variants) = Parameter::SCHEMA.ty else { panic!("an enum") };
        assert_eq!(variants.len(), Parameter::NAMES.len());
        for (variant, (parameter, name)) in variants.iter().zip(Parameter::NAMES) {
            let mut snake = String::<32>::new();
            for (at, letter) in variant.name.char_indices() {
                if letter.is_uppercase() && at > 0 {
                    snake.push('_').expect("fits");
                }
                snake.push(letter.to_ascii_lowercase()).expect("fits");
            }
            assert_eq!(name, snake);
            assert_eq!(parameter.name(), name, "the table is in the order of the variants");
            assert_eq!(name.parse(), Ok(parameter));
        }
    }

    #[test]
    fn keys_come_back() {
        for parameter in Parameter::all() {
            for channel in [None, Some(ChannelId::new(ChannelKind::DeadMan, 255))] {
                let key = ParameterKey { channel, parameter };
                let mut text = String::<64>::new();
                write!(text, "{key}").expect("fits");
                assert_eq!(text.parse(), Ok(key), "{text}");
            }
        }
        let key =
            ParameterKey { channel: Some(ChannelId::new(ChannelKind::Osmc, 0)), parameter: Parameter::PositionKp };
        assert_eq!("osmc0.position_kp".parse(), Ok(key));
        let key = ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs };
        assert_eq!("board.link_timeout_ms".parse(), Ok(key));
        for bad in [
            "",
            ".",
            "osmc0",
            "osmc0.",
            "osmc0.kp",
            "osmc0.position_kp.x",
            "osmc.position_kp",
            "position_kp",
            ".position_kp",
            "board0.link_timeout_ms",
            "osmc0.Position_kp",
            "osmc0 .position_kp",
        ] {
            assert_eq!(bad.parse::<ParameterKey>(), Err(NotAParameter), "{bad}");
        }
        let mut advice = String::<128>::new();
        write!(advice, "{NotAParameter}").expect("fits");
        assert!(advice.contains("osmc0.position_kp"), "{advice}");
    }
}
