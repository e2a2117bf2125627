//! Motor channel: closed loop with feedback, open-loop duty without.

use r4_protocol::{
    Causes, Mode, Setpoint,
    config::{MotorConfig, PidGains, Tuning},
};

use super::{
    motor::Motor,
    pid::{BadPeriod, OutputLimits},
};
use crate::shared::MotorStatus;
use crate::within::Within;

/// Motor channel, stepped once each control period.
#[allow(clippy::large_enum_variant, reason = "no heap, and most motors are measured")]
pub(super) enum Axis {
    Measured(Motor),
    Open(OpenMotor),
}

/// Motor without feedback: its duty follows the set point within its limits.
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

    /// Takes the supply voltage as a share of the nominal one.
    pub(super) fn set_supply(&mut self, share: f32) {
        if let Self::Measured(motor) = self {
            motor.set_supply(share);
        }
    }

    // Not inlined into the control tick, which has to fit into ITCM: a tuning comes from a person.
    #[inline(never)]
    pub(super) fn set_tuning(&mut self, tuning: Tuning) {
        if let Self::Measured(motor) = self {
            motor.set_tuning(tuning);
        }
    }

    /// Returns the motor if it follows a path.
    pub(super) fn following(&mut self) -> Option<&mut Motor> {
        match self {
            Self::Measured(motor) => Some(motor).filter(|motor| motor.follows()),
            Self::Open(_) => None,
        }
    }

    // Kept out of RAM (stays in flash): it does not run while the motor is driven.
    #[inline(never)]
    pub(super) fn stop(&mut self) {
        match self {
            Self::Measured(motor) => motor.stop(),
            Self::Open(motor) => (motor.setpoint, motor.duty, motor.applied) = (Setpoint::NONE, 0.0, 0.0),
        }
    }

    /// Returns the duty for the bridge and the causes seen in the motor's response.
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

    /// Returns the duty that the bridge applies and the speed, 0 without feedback.
    pub(super) fn applied(&self) -> (f32, f32) {
        match self {
            Self::Measured(motor) => motor.applied(),
            Self::Open(motor) => (motor.applied, 0.0),
        }
    }

    // A function of its own: inlined into loops over motors it would make them carry a pointer to each field.
    #[inline(never)]
    pub(super) fn status(&self) -> MotorStatus {
        match self {
            Self::Measured(motor) => motor.status(),
            Self::Open(motor) => MotorStatus { setpoint: motor.setpoint, duty: motor.applied, ..MotorStatus::IDLE },
        }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::config::FeedForward;

    use super::*;
    use crate::testing::robot;

    const PERIOD_S: f32 = 1.0 / 1024.0;
    const DUTY: fn(f32) -> Setpoint = |value| Setpoint { mode: Mode::Duty, value };

    /// Motor with 8/s of slew, 1/128 per period, and duties up to 0.75.
    fn axis(config: MotorConfig) -> Axis {
        let config = MotorConfig { duty_max: 0.75, duty_slew_per_s: 8.0, ..config };
        Axis::new(&config, PERIOD_S).expect("a period")
    }

    fn duty_after(axis: &mut Axis, periods: u32) -> f32 {
        let (duty, causes) = (0..periods).map(|_| axis.step()).last().expect("one at least");
        assert_eq!(causes, Causes::NONE);
        duty
    }

    #[test]
    fn a_motor_that_nothing_measures_follows_its_duty_at_the_slew_limit() {
        let mut open = axis(MotorConfig { control: None, ..robot("osmc-bench").motors[0] });
        for sign in [1.0, -1.0] {
            open.command(DUTY(sign * 2.0));
            assert_eq!(duty_after(&mut open, 1), sign / 128.0);
            assert_eq!(duty_after(&mut open, 31), sign * 0.25);
            assert_eq!(duty_after(&mut open, 1024), sign * 0.75);
            // The status shows the duty that the bridge applies.
            open.set_applied(sign * 0.5);
            assert_eq!(open.applied(), (sign * 0.5, 0.0));
            let status = MotorStatus { setpoint: DUTY(sign * 2.0), duty: sign * 0.5, ..MotorStatus::IDLE };
            assert_eq!(open.status(), status);
            open.stop();
            assert_eq!((open.applied(), open.status()), ((0.0, 0.0), MotorStatus::IDLE));
            assert_eq!(duty_after(&mut open, 10), 0.0);
        }
    }

    #[test]
    fn gains_are_those_of_a_motor_that_is_measured() {
        let mut config = robot("osmc-bench").motors[0];
        let control = config.control.as_mut().expect("it has an encoder");
        control.feed_forward = FeedForward { static_duty: 0.0, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
        let speed_duty = |gains: Option<PidGains>| {
            let mut axis = axis(config);
            gains.into_iter().for_each(|gains| axis.set_gains(Mode::Speed, gains));
            axis.command(Setpoint { mode: Mode::Speed, value: 1.0 });
            duty_after(&mut axis, 100)
        };
        assert!(speed_duty(None) > 0.0);
        assert_eq!(speed_duty(Some(PidGains { kp: 0.0, ki: 0.0, kd: 0.0 })), 0.0);
        // Without feedback there is no loop that could take gains.
        let mut open = axis(MotorConfig { control: None, ..config });
        open.set_gains(Mode::Speed, PidGains { kp: 9.0, ki: 9.0, kd: 9.0 });
        open.command(DUTY(0.5));
        assert_eq!(duty_after(&mut open, 100), 0.5);
    }
}
