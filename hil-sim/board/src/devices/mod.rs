//! Actuators and their drives, described by their input lines.
//!
//! | type | part | modelled | not modelled |
//! | --- | --- | --- | --- |
//! | [`osmc::OsmcBridge`] | OSMC full bridge behind an HIP4081A | truth table, exact to the PWM count; lock-out; bootstrap; dead time between directions | currents, heat |
//! | [`dhb::DhbMotor`] | DHB-12 dual H-bridge, one motor | truth table, exact to the PWM count; supply range; duty limit; pause before a reversal | current sense and limit, heat, dead time of the FETs |
//! | [`rc_servo::RcServo`] | hobby servo | windows for pulse and frame, rate, dead band, end stops, no torque without pulses or supply | load, acceleration, current, servos that hold without pulses |
//! | [`bldc_drive::BldcDrive`] | brushless drive with analog throttle, and its motor | dead zone, lock until neutral, direction by line or voltage, brake, first-order speed | load, current, commutation |
//! | [`stepper_driver::StepperDriver`] | M542-class stepper driver, and the motor's rotor | times of step, direction and enable; start-stop rate and acceleration; stall | torque, load, resonance, optocoupler current |
//!
//! Each takes times in integer nanoseconds and does nothing until it is called; the frequency of queries does not
//! change the result. An input that a part ignores or that damages it has the effect of the real part, and is recorded
//! as [`misuse`](crate::misuse). Every number states its source: maker's data, or a modelling choice.

pub mod bldc_drive;
pub mod dhb;
pub mod osmc;
pub mod rc_servo;
mod reversal;
pub mod stepper_driver;

#[cfg(test)]
mod tests {
    use crate::misuse::{Misuse, MisuseKind};

    #[test]
    fn texts_say_what_happens_and_what_to_do() {
        let text = |kind| Misuse { time_ns: 1, chip: "part", address: 2, kind }.to_string();
        let throttle = |throttle_mv| MisuseKind::ThrottleOutsideWindow { throttle_mv, low_mv: 1220, high_mv: 3080 };
        let rest = ": the drive stops and may be damaged; keep it between 1220 and 3080 mV, and return to the dead zone \
                    to run again";
        assert_eq!(text(throttle(Some(5000))), format!("1 ns, part 0x02: throttle at 5000 mV{rest}"));
        assert_eq!(text(throttle(None)), format!("1 ns, part 0x02: throttle at no voltage at all{rest}"));
        assert_eq!(
            text(MisuseKind::StepPulseTooShort { high: false, lasted_ns: 900, needed_ns: 2500 }),
            "1 ns, part 0x02: step input low for 900 ns: the driver may miss the step, here it does; hold it for 2500 ns \
             or more"
        );
    }
}
