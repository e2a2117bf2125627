//! Numbers of a configuration, by the parameters that name them.

use super::{
    AnalogConfig, BldcConfig, BoardConfig, ConfigError, ControlConfig, CurrentSense, DacConfig, EncoderConfig,
    FeedForward, Feedback, FollowConfig, ForceConfig, HomingConfig, MAX_EXACT, MotorConfig, MotorSideConfig, PidGains,
    Place, PotPoint, ProfileLimits, RangeConfig, Reverse, ServoChipConfig, ServoConfig, ServoPoint, SettleConfig,
    StallConfig, StepperConfig, SupplyConfig, WindingConfig,
};
use crate::{
    channel::Range,
    parameter::{Parameter, ParameterKey, SetError},
};

impl BoardConfig {
    /// Iterates over every number of this configuration: the board's first, then those of each channel in the order of
    /// [`BoardConfig::channels`].
    pub fn parameters(&self) -> impl Iterator<Item = ParameterKey> {
        core::iter::once((None, None))
            .chain(self.channels().map(|(id, place)| (Some(id), Some(place))))
            .flat_map(|(channel, place)| {
                Parameter::all().map(move |parameter| (place, ParameterKey { channel, parameter }))
            })
            // Asking for each parameter of each channel needs no second list of what a channel has.
            .filter(|(place, key)| read::number(self, *place, key.parameter).is_some())
            .map(|(_, key)| key)
    }

    /// Returns the number of parameter `key`, or `None` when the configuration does not have it. Exact in a valid
    /// configuration.
    #[must_use]
    pub fn parameter(&self, key: ParameterKey) -> Option<f32> {
        read::number(self, self.place_of(key)?, key.parameter).map(Number::get)
    }

    /// Sets one number. A value for a whole number is not rounded.
    ///
    /// # Errors
    /// [`SetError`] when the configuration does not have the number, its field cannot hold `value`, or the
    /// configuration would not be valid with it. Nothing is changed then.
    pub fn set_parameter(&mut self, key: ParameterKey, value: f32) -> Result<(), SetError> {
        self.set_parameters([(key, value)])
    }

    /// Sets several numbers, all or none: only the configuration with all of them must be valid. Needs room for a copy
    /// of the configuration, some 2.5 kB of stack.
    ///
    /// # Errors
    /// As [`BoardConfig::set_parameter`].
    pub fn set_parameters(&mut self, values: impl IntoIterator<Item = (ParameterKey, f32)>) -> Result<(), SetError> {
        // Rules hold between numbers, so only a complete copy can be checked.
        let mut changed = self.clone();
        for (key, value) in values {
            let place = self.place_of(key).ok_or(SetError::Unknown(key))?;
            write::number(&mut changed, place, key.parameter)
                .ok_or(SetError::Unknown(key))?
                .set(value)
                .map_err(|rule| SetError::Invalid(ConfigError::new(key.channel, rule)))?;
        }
        changed.validate().map_err(SetError::Invalid)?;
        *self = changed;
        Ok(())
    }

    /// Returns the place of `key`'s number, `Some(None)` for the board itself; `None` for a channel that it does not
    /// have.
    fn place_of(&self, key: ParameterKey) -> Option<Option<Place>> {
        key.channel.map_or(Some(None), |channel| self.place(channel).map(Some))
    }
}

/// Field of a configuration that is a parameter.
trait Number {
    fn get(&self) -> f32;

    /// Sets the field.
    ///
    /// # Errors
    /// The rule that `value` breaks; the field is then not changed.
    fn set(&mut self, value: f32) -> Result<(), &'static str>;
}

impl Number for f32 {
    fn get(&self) -> f32 {
        *self
    }

    fn set(&mut self, value: f32) -> Result<(), &'static str> {
        *self = value;
        Ok(())
    }
}

impl Number for u16 {
    fn get(&self) -> f32 {
        f32::from(*self)
    }

    fn set(&mut self, value: f32) -> Result<(), &'static str> {
        // `as` clamps to the type's range and turns NaN into 0: in either case the result differs from `value`.
        if f32::from(value as Self) != value {
            return Err("this parameter must be a whole number from 0 to 65535");
        }
        *self = value as Self;
        Ok(())
    }
}

impl Number for u32 {
    fn get(&self) -> f32 {
        *self as f32
    }

    fn set(&mut self, value: f32) -> Result<(), &'static str> {
        // Above `MAX_EXACT` not every whole number is an f32: the host would read back another value.
        let whole = value as Self;
        if whole > MAX_EXACT || whole as f32 != value {
            return Err("this parameter must be a whole number from 0 to 16777216");
        }
        *self = whole;
        Ok(())
    }
}

/// Makes a module whose `number` lends the field of a parameter of the channel at a place, `None` being the board.
///
/// The macro is used twice, for reading and for writing, so that each parameter is written down once: a pattern lends
/// the fields as the configuration was lent.
macro_rules! lend {
    ($module:ident, $get:ident $(, $mut:ident)?) => {
        mod $module {
            use super::*;
            use Parameter as P;

            type Lent<'a> = Option<&'a $($mut)? dyn Number>;

            pub(super) fn number(config: &$($mut)? BoardConfig, place: Option<Place>, parameter: Parameter) -> Lent<'_> {
                match place {
                    None => board(config, parameter),
                    Some(Place::Motor(index)) => motor(config.motors.$get(index)?, parameter),
                    Some(Place::Bldc(index)) => bldc(config.bldcs.$get(index)?, parameter),
                    Some(Place::Servo(index)) => servo(config.servos.$get(index)?, parameter),
                    Some(Place::Stepper(index)) => stepper(config.steppers.$get(index)?, parameter),
                    Some(Place::Dac(index)) => dac(config.dacs.$get(index)?, parameter),
                    Some(Place::Encoder(index)) => encoder(config.encoders.$get(index)?, parameter),
                    Some(Place::Range(index)) => range(config.ranges.$get(index)?, parameter),
                    Some(Place::Analog(index)) => analog(config.analogs.$get(index)?, parameter),
                    Some(Place::Supply(index)) => supply(config.supplies.$get(index)?, parameter),
                    Some(Place::Relay(_) | Place::Switch(_) | Place::DeadMan(_) | Place::Sensor(_)) => None,
                }
            }

            fn board(config: &$($mut)? BoardConfig, parameter: Parameter) -> Lent<'_> {
                let BoardConfig { link_timeout_ms, air_temperature_c, servo_pwm, can, .. } = config;
                Some(match (parameter, servo_pwm) {
                    (P::LinkTimeoutMs, _) => link_timeout_ms,
                    (P::AirTemperatureC, _) => air_temperature_c,
                    (P::CanRate, _) => &$($mut)? can.kbit_per_s,
                    (P::CanNode, _) => &$($mut)? can.node,
                    (P::CanDataRate, _) => &$($mut)? can.data_kbit_per_s,
                    (P::ServoOscillatorHz, Some(ServoChipConfig { oscillator_hz, .. })) => oscillator_hz,
                    _ => return None,
                })
            }

            fn motor(config: &$($mut)? MotorConfig, parameter: Parameter) -> Lent<'_> {
                let MotorConfig {
                    id: _,
                    bridge: _,
                    inverted: _,
                    duty_max,
                    duty_slew_per_s,
                    control: loops,
                    winding: electrical,
                    stop_brake_ms,
                } = config;
                Some(match (parameter, loops) {
                    (P::DutyMax, _) => duty_max,
                    (P::DutySlew, _) => duty_slew_per_s,
                    (
                        P::NominalV
                        | P::DeadDuty
                        | P::ResistanceOhm
                        | P::BackEmf
                        | P::RatedA
                        | P::ThermalS
                        | P::CurrentZeroV
                        | P::CurrentVoltsPerA,
                        _,
                    ) => return winding(electrical, parameter),
                    (P::StopBrakeMs, _) => stop_brake_ms,
                    (_, Some(loops)) => return control(loops, parameter),
                    _ => return None,
                })
            }

            fn winding(config: &$($mut)? Option<WindingConfig>, parameter: Parameter) -> Lent<'_> {
                let Some(WindingConfig {
                    supply: _,
                    nominal_v,
                    dead_duty,
                    resistance_ohm,
                    back_emf,
                    rated_a,
                    thermal_s,
                    current_sense,
                }) = config
                else {
                    return None;
                };
                Some(match (parameter, current_sense) {
                    (P::NominalV, _) => nominal_v,
                    (P::DeadDuty, _) => dead_duty,
                    (P::ResistanceOhm, _) => resistance_ohm,
                    (P::BackEmf, _) => back_emf,
                    (P::RatedA, _) => rated_a,
                    (P::ThermalS, _) => thermal_s,
                    (P::CurrentZeroV, Some(CurrentSense { zero_v, .. })) => zero_v,
                    (P::CurrentVoltsPerA, Some(CurrentSense { volts_per_a, .. })) => volts_per_a,
                    _ => return None,
                })
            }

            fn control(config: &$($mut)? ControlConfig, parameter: Parameter) -> Lent<'_> {
                let ControlConfig {
                    feedback: sensor,
                    position: Range { min: position_min, max: position_max },
                    speed_max,
                    position_pid: PidGains { kp: position_kp, ki: position_ki, kd: position_kd },
                    speed_pid: PidGains { kp: speed_kp, ki: speed_ki, kd: speed_kd },
                    speed_filter_s,
                    profile: ProfileLimits { speed: profile_speed, acceleration: profile_acceleration, jerk: profile_jerk },
                    cascade_per_s,
                    feed_forward: FeedForward { static_duty, duty_per_speed, duty_per_acceleration },
                    settle: SettleConfig { error: settle_error, speed: settle_speed, time_ms: settle_time_ms },
                    stall: StallConfig { duty: stall_duty, travel: stall_travel, time_ms: stall_time_ms },
                    follow: FollowConfig { error: follow_error, time_ms: follow_time_ms },
                    homing: home,
                    motor_side: side,
                    force,
                } = config;
                Some(match parameter {
                    P::PositionMin => position_min,
                    P::PositionMax => position_max,
                    P::SpeedMax => speed_max,
                    P::PositionKp => position_kp,
                    P::PositionKi => position_ki,
                    P::PositionKd => position_kd,
                    P::SpeedKp => speed_kp,
                    P::SpeedKi => speed_ki,
                    P::SpeedKd => speed_kd,
                    P::SpeedFilter => speed_filter_s,
                    P::ProfileSpeed => profile_speed,
                    P::ProfileAcceleration => profile_acceleration,
                    P::Jerk => profile_jerk,
                    P::StaticDuty => static_duty,
                    P::DutyPerSpeed => duty_per_speed,
                    P::DutyPerAcceleration => duty_per_acceleration,
                    P::Cascade => cascade_per_s,
                    P::SettleError => settle_error,
                    P::SettleSpeed => settle_speed,
                    P::SettleTimeMs => settle_time_ms,
                    P::StallDuty => stall_duty,
                    P::StallTravel => stall_travel,
                    P::StallTimeMs => stall_time_ms,
                    P::FollowError => follow_error,
                    P::FollowTimeMs => follow_time_ms,
                    P::HomePosition | P::HomeSpeedMax => return homing(home, parameter),
                    P::MotorSideCounts | P::GapMax => return motor_side(side, parameter),
                    P::ForceGain | P::ForceLimit | P::ApproachSpeed | P::ContactForce | P::ForceError => {
                        return of_force(force, parameter);
                    }
                    _ => return feedback(sensor, parameter),
                })
            }

            fn feedback(config: &$($mut)? Feedback, parameter: Parameter) -> Lent<'_> {
                match config {
                    Feedback::Encoder { index: _, counts_per_turn, inverted: _, counts_per_index: _ } => match parameter {
                        P::CountsPerTurn => Some(counts_per_turn),
                        _ => None,
                    },
                    Feedback::Potentiometer {
                        analog: _,
                        low: PotPoint { code: low_code, position_m: low_position },
                        high: PotPoint { code: high_code, position_m: high_position },
                    } => Some(match parameter {
                        P::PotLowCode => low_code,
                        P::PotLowPosition => low_position,
                        P::PotHighCode => high_code,
                        P::PotHighPosition => high_position,
                        _ => return None,
                    }),
                    Feedback::Angle { angle: _, zero, inverted: _ }
                    | Feedback::Pulses { range: _, frames_hz: _, zero, inverted: _ } => match parameter {
                        P::ZeroAngle => Some(zero),
                        _ => None,
                    },
                }
            }

            fn motor_side(config: &$($mut)? Option<MotorSideConfig>, parameter: Parameter) -> Lent<'_> {
                match (parameter, config) {
                    (P::MotorSideCounts, Some(MotorSideConfig { counts_per_turn, .. })) => Some(counts_per_turn),
                    (P::GapMax, Some(MotorSideConfig { gap_max, .. })) => Some(gap_max),
                    _ => None,
                }
            }

            fn of_force(config: &$($mut)? Option<ForceConfig>, parameter: Parameter) -> Lent<'_> {
                let ForceConfig { limit_n, speed_per_n, approach_speed, contact_n, error_n, .. } = match config {
                    Some(force) => force,
                    None => return None,
                };
                Some(match parameter {
                    P::ForceGain => speed_per_n,
                    P::ForceLimit => limit_n,
                    P::ApproachSpeed => approach_speed,
                    P::ContactForce => contact_n,
                    P::ForceError => error_n,
                    _ => return None,
                })
            }

            fn homing(config: &$($mut)? Option<HomingConfig>, parameter: Parameter) -> Lent<'_> {
                match (parameter, config) {
                    (P::HomePosition, Some(HomingConfig { position, .. })) => Some(position),
                    (P::HomeSpeedMax, Some(HomingConfig { speed_max, .. })) => Some(speed_max),
                    _ => None,
                }
            }

            fn bldc(config: &$($mut)? BldcConfig, parameter: Parameter) -> Lent<'_> {
                let BldcConfig { id: _, output: _, neutral_v, forward_v, reverse, brake: _, slew_per_s, stop_brake_ms } =
                    config;
                Some(match (parameter, reverse) {
                    (P::NeutralV, _) => neutral_v,
                    (P::ForwardV, _) => forward_v,
                    (P::ReverseV, Reverse::Voltage { full_v }) => full_v,
                    (P::SpeedSlew, _) => slew_per_s,
                    (P::StopBrakeMs, _) => stop_brake_ms,
                    _ => return None,
                })
            }

            fn servo(config: &$($mut)? ServoConfig, parameter: Parameter) -> Lent<'_> {
                let ServoConfig {
                    id: _,
                    output: _,
                    low: ServoPoint { pulse_s: low_pulse, angle_rad: low_angle },
                    high: ServoPoint { pulse_s: high_pulse, angle_rad: high_angle },
                    speed_max,
                } = config;
                Some(match parameter {
                    P::PulseLow => low_pulse,
                    P::AngleLow => low_angle,
                    P::PulseHigh => high_pulse,
                    P::AngleHigh => high_angle,
                    P::SpeedMax => speed_max,
                    _ => return None,
                })
            }

            fn stepper(config: &$($mut)? StepperConfig, parameter: Parameter) -> Lent<'_> {
                let StepperConfig {
                    id: _,
                    steps_per_turn,
                    inverted: _,
                    position: Range { min, max },
                    speed_max,
                    acceleration,
                    jerk,
                    start_speed,
                    homing: home,
                    stop_brake_ms,
                } = config;
                Some(match parameter {
                    P::StepsPerTurn => steps_per_turn,
                    P::PositionMin => min,
                    P::PositionMax => max,
                    P::SpeedMax => speed_max,
                    P::Acceleration => acceleration,
                    P::Jerk => jerk,
                    P::StartSpeed => start_speed,
                    P::StopBrakeMs => stop_brake_ms,
                    _ => return homing(home, parameter),
                })
            }

            fn dac(config: &$($mut)? DacConfig, parameter: Parameter) -> Lent<'_> {
                let DacConfig { id: _, range_v: Range { min, max }, safe_v } = config;
                Some(match parameter {
                    P::VoltsMin => min,
                    P::VoltsMax => max,
                    P::SafeV => safe_v,
                    _ => return None,
                })
            }

            fn encoder(config: &$($mut)? EncoderConfig, parameter: Parameter) -> Lent<'_> {
                let EncoderConfig { id: _, counts_per_turn, inverted: _ } = config;
                match parameter {
                    P::CountsPerTurn => Some(counts_per_turn),
                    _ => None,
                }
            }

            fn range(config: &$($mut)? RangeConfig, parameter: Parameter) -> Lent<'_> {
                match (parameter, config) {
                    (P::StopBelow, RangeConfig { stop_below_m: Some(stop), .. }) => Some(stop),
                    _ => None,
                }
            }

            fn analog(config: &$($mut)? AnalogConfig, parameter: Parameter) -> Lent<'_> {
                let AnalogConfig { id: _, volts_per_code, offset_v, plausible_v: Range { min, max } } = config;
                Some(match parameter {
                    P::VoltsPerCode => volts_per_code,
                    P::OffsetV => offset_v,
                    P::VoltsMin => min,
                    P::VoltsMax => max,
                    _ => return None,
                })
            }

            fn supply(config: &$($mut)? SupplyConfig, parameter: Parameter) -> Lent<'_> {
                let SupplyConfig { id: _, analog: _, volts_per_code, range_v: Range { min, max }, regeneration_v } = config;
                Some(match (parameter, regeneration_v) {
                    (P::VoltsPerCode, _) => volts_per_code,
                    (P::VoltsMin, _) => min,
                    (P::VoltsMax, _) => max,
                    (P::RegenerationV, Some(volts)) => volts,
                    _ => return None,
                })
            }
        }
    };
}

lend!(read, get);
lend!(write, get_mut, mut);
