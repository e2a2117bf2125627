//! Units of a board's parameters, as text.

use r4_protocol::{ChannelId, ChannelKind, Parameter, ParameterInfo, ParameterKey};

/// Units of a board's parameters.
#[derive(Clone, Debug)]
pub struct ParameterUnits {
    /// Channels whose positions are in metres.
    linear: Vec<ChannelId>,
}

impl ParameterUnits {
    /// Determines the units from all parameters of the channels concerned: a channel with a potentiometer is linear.
    #[must_use]
    pub fn of(parameters: &[ParameterInfo]) -> Self {
        let with_potentiometer = parameters.iter().filter(|info| info.key.parameter == Parameter::PotLowCode);
        Self { linear: with_potentiometer.filter_map(|info| info.key.channel).collect() }
    }

    /// Returns the unit of the parameter `key`; empty for a count.
    #[must_use]
    pub fn unit(&self, key: ParameterKey) -> String {
        let is_linear =
            key.channel.is_some_and(|channel| channel.kind == ChannelKind::Actuator || self.linear.contains(&channel));
        let rotary = rotary(key);
        if is_linear { rotary.replace("rad", "m") } else { rotary.to_owned() }
    }
}

/// Returns the unit of the parameter `key` on a rotary channel.
fn rotary(key: ParameterKey) -> &'static str {
    match key.parameter {
        Parameter::LinkTimeoutMs
        | Parameter::SettleTimeMs
        | Parameter::StallTimeMs
        | Parameter::FollowTimeMs
        | Parameter::StopBrakeMs => "ms",
        Parameter::AirTemperatureC => "°C",
        Parameter::ServoOscillatorHz => "Hz",
        Parameter::DutyMax | Parameter::StaticDuty | Parameter::StallDuty | Parameter::DeadDuty => "duty",
        Parameter::DutySlew => "duty/s",
        Parameter::SpeedSlew | Parameter::Cascade => "1/s",
        Parameter::PositionMin
        | Parameter::PositionMax
        | Parameter::SettleError
        | Parameter::StallTravel
        | Parameter::FollowError
        | Parameter::HomePosition
        | Parameter::AngleLow
        | Parameter::AngleHigh
        | Parameter::ZeroAngle
        | Parameter::GapMax => "rad",
        Parameter::SpeedMax
        | Parameter::ProfileSpeed
        | Parameter::SettleSpeed
        | Parameter::HomeSpeedMax
        | Parameter::StartSpeed
        | Parameter::ApproachSpeed => "rad/s",
        Parameter::ProfileAcceleration | Parameter::Acceleration => "rad/s²",
        Parameter::Jerk => "rad/s³",
        Parameter::PositionKp | Parameter::SpeedKi => "duty/rad",
        Parameter::PositionKi => "duty/(rad s)",
        Parameter::PositionKd | Parameter::SpeedKp | Parameter::DutyPerSpeed => "duty s/rad",
        Parameter::SpeedKd | Parameter::DutyPerAcceleration => "duty s²/rad",
        Parameter::SpeedFilter | Parameter::PulseLow | Parameter::PulseHigh | Parameter::ThermalS => "s",
        Parameter::CanRate | Parameter::CanDataRate => "kbit/s",
        Parameter::CountsPerTurn | Parameter::MotorSideCounts | Parameter::StepsPerTurn | Parameter::CanNode => "",
        Parameter::PotLowCode | Parameter::PotHighCode => "code",
        Parameter::PotLowPosition | Parameter::PotHighPosition | Parameter::StopBelow => "m",
        Parameter::NeutralV
        | Parameter::ForwardV
        | Parameter::ReverseV
        | Parameter::SafeV
        | Parameter::OffsetV
        | Parameter::VoltsMin
        | Parameter::VoltsMax
        | Parameter::NominalV
        | Parameter::CurrentZeroV
        | Parameter::RegenerationV => "V",
        Parameter::ResistanceOhm => "ohm",
        Parameter::BackEmf => "V s/rad",
        Parameter::RatedA => "A",
        Parameter::ForceGain => "rad/(s N)",
        Parameter::ForceLimit | Parameter::ContactForce | Parameter::ForceError => "N",
        Parameter::CurrentVoltsPerA => "V/A",
        Parameter::VoltsPerCode => "V/code",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_actuator_moves_in_metres() {
        let key = |key: &str| -> ParameterKey { key.parse().expect("a key") };
        let pot = ParameterInfo { key: key("dhb1.pot_low_code"), active: 0.0, set: 0.0, built_in: 0.0 };
        let of = |text: &str| ParameterUnits::of(&[pot]).unit(key(text));
        assert_eq!(of("dhb0.position_kp"), "duty/rad");
        assert_eq!(of("dhb1.position_kp"), "duty/m");
        assert_eq!(of("osmc0.position_ki"), "duty/(rad s)");
        assert_eq!(of("actuator1.position_ki"), "duty/(m s)");
        assert_eq!(of("actuator1.profile_acceleration"), "m/s²");
        assert_eq!(of("board.link_timeout_ms"), "ms");
    }
}
