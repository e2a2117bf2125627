//! Parameters: the numbers of a board's configuration that a host may change and have kept.
//!
//! [`crate::config::BoardConfig::parameter`] reads one, [`crate::config::BoardConfig::set_parameter`] changes it.

use core::{fmt, str::FromStr};

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{channel::ChannelId, config::ConfigError};

/// One number of the configuration. postcard sends the variant's position: append, never reorder or remove.
///
/// Units are those of the field it stands for in [`crate::config`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
pub enum Parameter {
    /// Of the board, ms: [`crate::config::BoardConfig::link_timeout_ms`].
    LinkTimeoutMs,
    /// Of the board, °C: [`crate::config::BoardConfig::air_temperature_c`].
    AirTemperatureC,
    /// Of the board, Hz: [`crate::config::ServoChipConfig::oscillator_hz`].
    ServoOscillatorHz,
    /// Of a motor, share of the supply.
    DutyMax,
    /// Of a motor, 1/s.
    DutySlew,
    /// Of a motor with feedback or a stepper, rad or m.
    PositionMin,
    /// Of a motor with feedback or a stepper, rad or m.
    PositionMax,
    /// Of a motor with feedback, a servo or a stepper, rad/s or m/s.
    SpeedMax,
    /// Of a motor's position loop, duty/rad or duty/m.
    PositionKp,
    /// Of a motor's position loop, duty/(rad s) or duty/(m s).
    PositionKi,
    /// Of a motor's position loop, duty s/rad or duty s/m.
    PositionKd,
    /// Of a motor's speed loop, duty s/rad or duty s/m.
    SpeedKp,
    /// Of a motor's speed loop, duty/rad or duty/m.
    SpeedKi,
    /// Of a motor's speed loop, duty s²/rad or duty s²/m.
    SpeedKd,
    /// Of a motor with feedback, s.
    SpeedFilter,
    /// Of a motor's path, rad/s or m/s.
    ProfileSpeed,
    /// Of a motor's path, rad/s² or m/s².
    ProfileAcceleration,
    /// Of a motor's feed-forward, share of the supply.
    StaticDuty,
    /// Of a motor's feed-forward, duty s/rad or duty s/m.
    DutyPerSpeed,
    /// Of a motor with feedback, rad or m.
    SettleError,
    /// Of a motor with feedback, rad/s or m/s.
    SettleSpeed,
    /// Of a motor with feedback, ms.
    SettleTimeMs,
    /// Of a motor with feedback, share of the supply.
    StallDuty,
    /// Of a motor with feedback, rad or m.
    StallTravel,
    /// Of a motor with feedback, ms.
    StallTimeMs,
    /// Of a motor with feedback, rad or m.
    FollowError,
    /// Of a motor with feedback, ms.
    FollowTimeMs,
    /// Of a motor with an encoder, or of an encoder, counts in a turn.
    CountsPerTurn,
    /// Of a motor with a potentiometer: 16-bit code of the first calibration point.
    PotLowCode,
    /// Of a motor with a potentiometer, m.
    PotLowPosition,
    /// Of a motor with a potentiometer: 16-bit code of the second calibration point.
    PotHighCode,
    /// Of a motor with a potentiometer, m.
    PotHighPosition,
    /// Of a motor or stepper with a homing switch, rad.
    HomePosition,
    /// Of a motor or stepper with a homing switch, rad/s.
    HomeSpeedMax,
    /// Of a servo, s.
    PulseLow,
    /// Of a servo, rad.
    AngleLow,
    /// Of a servo, s.
    PulseHigh,
    /// Of a servo, rad.
    AngleHigh,
    /// Of a brushless drive, V.
    NeutralV,
    /// Of a brushless drive, V.
    ForwardV,
    /// Of a brushless drive that is sent backwards by a voltage, V.
    ReverseV,
    /// Of a brushless drive, share of full speed per second.
    SpeedSlew,
    /// Of a stepper, steps in a turn.
    StepsPerTurn,
    /// Of a stepper, rad/s².
    Acceleration,
    /// Of a motor's path or of a stepper, rad/s³ or m/s³.
    Jerk,
    /// Of a stepper, rad/s.
    StartSpeed,
    /// Of an analog output, V.
    SafeV,
    /// Of a range sensor that has a limit, m.
    StopBelow,
    /// Of an analog input or a supply, V in a step of its 16-bit code.
    VoltsPerCode,
    /// Of an analog input, V.
    OffsetV,
    /// Lowest voltage of an analog output, of what is plausible at an analog input, or of a supply in range, V.
    VoltsMin,
    /// Highest voltage of an analog output, of what is plausible at an analog input, or of a supply in range, V.
    VoltsMax,
    /// Of a motor with a winding: supply voltage that its gains were tuned at, V.
    NominalV,
    /// Of a motor with a winding: duty below which no current flows.
    DeadDuty,
    /// Of a motor with a winding, ohm.
    ResistanceOhm,
    /// Of a motor with a winding: back-EMF constant at the output, V s/rad or V s/m.
    BackEmf,
    /// Of a motor with a winding: current it withstands continuously, A.
    RatedA,
    /// Of a motor with a winding: thermal time constant, s.
    ThermalS,
    /// Of a motor with a current sensor: its voltage at 0 A, V.
    CurrentZeroV,
    /// Of a motor with a current sensor, V/A.
    CurrentVoltsPerA,
    /// Of a supply that limits regeneration: above this motors feed less back, V.
    RegenerationV,
    /// Of a motor, a brushless drive or a stepper, ms: how long a controlled stop brakes it.
    StopBrakeMs,
    /// Of the board, kbit/s: [`crate::config::CanConfig::kbit_per_s`].
    CanRate,
    /// Of the board: [`crate::config::CanConfig::node`].
    CanNode,
    /// Of the board, kbit/s: [`crate::config::CanConfig::data_kbit_per_s`].
    CanDataRate,
    /// Of a motor's feed-forward, duty s²/rad or duty s²/m.
    DutyPerAcceleration,
    /// Of a motor with feedback, 1/s: [`crate::config::ControlConfig::cascade_per_s`].
    Cascade,
    /// Of a motor with an angle sensor, rad: the angle that is position 0.
    ZeroAngle,
    /// Of a motor with an encoder on the motor's side: [`crate::config::MotorSideConfig::counts_per_turn`].
    MotorSideCounts,
    /// Of a motor with an encoder on the motor's side, rad: [`crate::config::MotorSideConfig::gap_max`].
    GapMax,
    /// Of a motor with force control, rad/(s N) or m/(s N): [`crate::config::ForceConfig::speed_per_n`].
    ForceGain,
    /// Of a motor with force control, N: [`crate::config::ForceConfig::limit_n`].
    ForceLimit,
    /// Of a motor with force control, rad/s or m/s: [`crate::config::ForceConfig::approach_speed`].
    ApproachSpeed,
    /// Of a motor with force control, N: [`crate::config::ForceConfig::contact_n`].
    ContactForce,
    /// Of a motor with force control, N: [`crate::config::ForceConfig::error_n`].
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

    /// Every parameter, in the order of the variants.
    pub fn all() -> impl Iterator<Item = Self> {
        Self::NAMES.into_iter().map(|(parameter, _)| parameter)
    }

    /// The name used on command lines and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize].1
    }
}

impl fmt::Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The text names no parameter.
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

/// Which parameter of which channel, written `osmc0.position_kp`, `board.link_timeout_ms` …
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
pub struct ParameterKey {
    /// `None` for the board.
    pub channel: Option<ChannelId>,
    /// Which of its numbers.
    pub parameter: Parameter,
}

/// What stands for the channel in the parameters that belong to none.
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

/// Why a parameter was not set. Nothing was changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetError {
    /// The configuration has no such number.
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
