//! Parameters: the numbers of a board's configuration that a host may change and have kept.

use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::channel::ChannelId;

/// One number of the configuration. postcard sends the variant's position: append, never reorder or remove.
///
/// Units are those of the field it stands for in [`crate::config`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
pub enum Parameter {
    /// Of the board: [`crate::config::BoardConfig::link_timeout_ms`].
    LinkTimeoutMs,
    /// Of the board: [`crate::config::BoardConfig::air_temperature_c`].
    AirTemperatureC,
    /// Of the board: [`crate::config::ServoChipConfig::oscillator_hz`].
    ServoOscillatorHz,
    /// Of a motor.
    DutyMax,
    /// Of a motor, 1/s.
    DutySlew,
    /// Of a motor with feedback or a stepper.
    PositionMin,
    /// Of a motor with feedback or a stepper.
    PositionMax,
    /// Of a motor with feedback, a servo or a stepper.
    SpeedMax,
    /// Of a motor's position loop.
    PositionKp,
    /// Of a motor's position loop.
    PositionKi,
    /// Of a motor's position loop.
    PositionKd,
    /// Of a motor's speed loop.
    SpeedKp,
    /// Of a motor's speed loop.
    SpeedKi,
    /// Of a motor's speed loop.
    SpeedKd,
    /// Of a motor with feedback, s.
    SpeedFilter,
    /// Of a motor's path.
    ProfileSpeed,
    /// Of a motor's path.
    ProfileAcceleration,
    /// Of a motor's feed-forward.
    StaticDuty,
    /// Of a motor's feed-forward.
    DutyPerSpeed,
    /// Of a motor with feedback.
    SettleError,
    /// Of a motor with feedback.
    SettleSpeed,
    /// Of a motor with feedback.
    SettleTimeMs,
    /// Of a motor with feedback.
    StallDuty,
    /// Of a motor with feedback.
    StallTravel,
    /// Of a motor with feedback.
    StallTimeMs,
    /// Of a motor with feedback.
    FollowError,
    /// Of a motor with feedback.
    FollowTimeMs,
    /// Of a motor with an encoder, or of an encoder.
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
    /// Of a stepper.
    StepsPerTurn,
    /// Of a stepper, rad/s².
    Acceleration,
    /// Of a stepper, rad/s³.
    Jerk,
    /// Of a stepper, rad/s.
    StartSpeed,
    /// Of an analog output, V.
    SafeV,
    /// Of a range sensor that has a limit, m.
    StopBelow,
    /// Of an analog input or a supply.
    VoltsPerCode,
    /// Of an analog input, V.
    OffsetV,
    /// Lowest voltage of an analog output, of what is plausible at an analog input, or of a supply in range, V.
    VoltsMin,
    /// Highest voltage of an analog output, of what is plausible at an analog input, or of a supply in range, V.
    VoltsMax,
}

/// Which parameter of which channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, Schema)]
pub struct ParameterKey {
    /// `None` for the board.
    pub channel: Option<ChannelId>,
    /// Which of its numbers.
    pub parameter: Parameter,
}

impl fmt::Display for ParameterKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.channel {
            Some(channel) => write!(f, "{channel}.{:?}", self.parameter),
            None => write!(f, "{:?}", self.parameter),
        }
    }
}
