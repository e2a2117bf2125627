//! A motor channel: closed loop where something measures it, an open duty where nothing does.

use r4_protocol::{
    Causes, Mode, Setpoint,
    config::{MotorConfig, PidGains},
};

use super::{
    motor::Motor,
    pid::{BadPeriod, OutputLimits},
};
use crate::shared::MotorStatus;
use crate::within::Within;

/// A motor channel, stepped once each control period.
#[allow(clippy::large_enum_variant, reason = "no heap, and most motors are measured")]
pub(super) enum Axis {
    Measured(Motor),
    Open(OpenMotor),
}

/// A motor without feedback: its duty is what it is told, within its limits.
pub(super) struct OpenMotor {
    limits: OutputLimits,
    period_s: f32,
    setpoint: Setpoint,
    duty: f32,
    applied: f32,
}

impl Axis {
    pub(super) fn new(config: &MotorConfig, period_s: f32) -> Result<Self, BadPeriod> {
        let limits = OutputLimits { magnitude: config.duty_max, slew_per_s: config.duty_slew_per_s };
        Ok(match config.control {
            Some(control) => Self::Measured(Motor::new(control, limits, period_s)?),
            None => Self::Open(OpenMotor { limits, period_s, setpoint: Setpoint::NONE, duty: 0.0, applied: 0.0 }),
        })
    }

    pub(super) fn command(&mut self, setpoint: Setpoint) {
        match self {
            Self::Measured(motor) => motor.command(setpoint),
            Self::Open(motor) => motor.setpoint = setpoint,
        }
    }

    pub(super) fn set_gains(&mut self, mode: Mode, gains: PidGains) {
        if let Self::Measured(motor) = self {
            motor.set_gains(mode, gains);
        }
    }

    pub(super) fn stop(&mut self) {
        match self {
            Self::Measured(motor) => motor.stop(),
            Self::Open(motor) => (motor.setpoint, motor.duty, motor.applied) = (Setpoint::NONE, 0.0, 0.0),
        }
    }

    /// The duty for the bridge, and what is wrong with how the motor answers.
    pub(super) fn step(&mut self) -> (f32, Causes) {
        match self {
            Self::Measured(motor) => motor.step(),
            Self::Open(OpenMotor { limits, period_s, setpoint, duty, .. }) => {
                let step = limits.slew_per_s * *period_s;
                *duty = setpoint.value.within(*duty - step, *duty + step).within(-limits.magnitude, limits.magnitude);
                (*duty, Causes::NONE)
            }
        }
    }

    pub(super) fn set_applied(&mut self, applied: f32) {
        match self {
            Self::Measured(motor) => motor.set_applied(applied),
            Self::Open(motor) => motor.applied = applied,
        }
    }

    /// The duty that the bridge applies, and the speed, 0 where nothing measures it.
    pub(super) fn applied(&self) -> (f32, f32) {
        match self {
            Self::Measured(motor) => motor.applied(),
            Self::Open(motor) => (motor.applied, 0.0),
        }
    }

    pub(super) fn status(&self) -> MotorStatus {
        match self {
            Self::Measured(motor) => motor.status(),
            Self::Open(motor) => MotorStatus { setpoint: motor.setpoint, duty: motor.applied, ..MotorStatus::IDLE },
        }
    }
}
