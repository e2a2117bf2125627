//! Units of parameters, for people.

use r4_protocol::{ChannelKind, Parameter, ParameterKey};

/// The unit of `key`'s number; nothing for a count.
pub(super) fn unit(key: ParameterKey) -> String {
    let rotary = match key.parameter {
        Parameter::LinkTimeoutMs | Parameter::SettleTimeMs | Parameter::StallTimeMs | Parameter::FollowTimeMs => "ms",
        Parameter::AirTemperatureC => "°C",
        Parameter::ServoOscillatorHz => "Hz",
        Parameter::DutyMax | Parameter::StaticDuty | Parameter::StallDuty => "duty",
        Parameter::DutySlew => "duty/s",
        Parameter::SpeedSlew => "1/s",
        Parameter::PositionMin
        | Parameter::PositionMax
        | Parameter::SettleError
        | Parameter::StallTravel
        | Parameter::FollowError
        | Parameter::HomePosition
        | Parameter::AngleLow
        | Parameter::AngleHigh => "rad",
        Parameter::SpeedMax
        | Parameter::ProfileSpeed
        | Parameter::SettleSpeed
        | Parameter::HomeSpeedMax
        | Parameter::StartSpeed => "rad/s",
        Parameter::ProfileAcceleration | Parameter::Acceleration => "rad/s²",
        Parameter::Jerk => "rad/s³",
        Parameter::PositionKp | Parameter::SpeedKi => "duty/rad",
        Parameter::PositionKi => "duty/(rad s)",
        Parameter::PositionKd | Parameter::SpeedKp | Parameter::DutyPerSpeed => "duty s/rad",
        Parameter::SpeedKd => "duty s²/rad",
        Parameter::SpeedFilter | Parameter::PulseLow | Parameter::PulseHigh => "s",
        Parameter::CountsPerTurn | Parameter::StepsPerTurn => "",
        Parameter::PotLowCode | Parameter::PotHighCode => "code",
        Parameter::PotLowPosition | Parameter::PotHighPosition | Parameter::StopBelow => "m",
        Parameter::NeutralV
        | Parameter::ForwardV
        | Parameter::ReverseV
        | Parameter::SafeV
        | Parameter::OffsetV
        | Parameter::VoltsMin
        | Parameter::VoltsMax => "V",
        Parameter::VoltsPerCode => "V/code",
    };
    let is_linear = key.channel.is_some_and(|channel| channel.kind == ChannelKind::Actuator);
    if is_linear { rotary.replace("rad", "m") } else { rotary.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_actuator_moves_in_metres() {
        let of = |key: &str| unit(key.parse().expect("a key"));
        assert_eq!(of("osmc0.position_ki"), "duty/(rad s)");
        assert_eq!(of("actuator1.position_ki"), "duty/(m s)");
        assert_eq!(of("actuator1.profile_acceleration"), "m/s²");
        assert_eq!(of("board.link_timeout_ms"), "ms");
    }
}
