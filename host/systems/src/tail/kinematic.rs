//! The same lift without a board: drives that follow their commands, and sensors that measure exactly.

use r4_world::{BalanceTail, Body as _, MAX_STEP_S, Scene, ShaftMotion};

use super::{
    law::{Command, Measured, Motor, Regulator},
    protocol::{AFTER_S, Moment, WATCHED_EVERY_S},
    scene::{Case, Joint, Setup},
};

/// Simulates the person without a tail.
pub(super) fn without_tail(mut body: BalanceTail, case: &Case) -> Vec<Moment> {
    run(&mut body, case, &mut |_, _, _, _| {})
}

/// Simulates the person with a tail on perfect actuators: the regulator measures trunk and motors exactly, without
/// delay.
pub(super) fn with_tail(mut body: BalanceTail, case: &Case, setup: &Setup, regulator: &Regulator) -> Vec<Moment> {
    let every = (setup.settings.period_s / MAX_STEP_S).round() as usize;
    let (mut command, mut integral) = (Command::default(), 0.0);
    run(&mut body, case, &mut |body, step, motors: &mut [MotorState; 2], loads: &[f64; 2]| {
        if step % every == 0 {
            let state = body.state();
            let of =
                |number: usize, by: fn(&ShaftMotion) -> f64| by(&motors[number].shaft) / setup.joints[number].ratio;
            let measured = Measured {
                angle_rad: [state.angle_rad[0], of(0, |shaft| shaft.position), of(1, |shaft| shaft.position)],
                rate_rad_s: [state.rate_rad_s[0], of(0, |shaft| shaft.speed), of(1, |shaft| shaft.speed)],
            };
            (command, integral) = regulator.next(&measured, [0.0; 2], integral);
        }
        for (number, motor) in motors.iter_mut().enumerate() {
            motor.step(&setup.joints[number], command.share[number], loads[number]);
        }
    })
}

/// A motor with the speed loop of its drive.
#[derive(Clone, Copy, Debug, Default)]
struct MotorState {
    shaft: ShaftMotion,
    torque_nm: f64,
}

impl MotorState {
    fn step(&mut self, joint: &Joint, share: f64, load_nm: f64) {
        let Motor { torque_max_nm, power_max_w, top_speed_rad_s, speed_gain_nm_s } = joint.motor;
        let target = share * top_speed_rad_s;
        // Implicit step: a time constant of 6 ms at steps of 0.25 ms stays stable under a held load.
        let rate = speed_gain_nm_s / joint.rotor_kg_m2;
        let ShaftMotion { position, speed } = self.shaft;
        let free = (speed + MAX_STEP_S * (rate * target + load_nm / joint.rotor_kg_m2)) / (1.0 + MAX_STEP_S * rate);
        let asked_nm = speed_gain_nm_s * (target - free);
        let by_power_nm =
            if asked_nm * speed > 0.0 { power_max_w / speed.abs().max(free.abs()) } else { f64::INFINITY };
        let most_nm = torque_max_nm.min(by_power_nm);
        self.torque_nm = asked_nm.clamp(-most_nm, most_nm);
        let next = speed + MAX_STEP_S * (self.torque_nm + load_nm) / joint.rotor_kg_m2;
        self.shaft = ShaftMotion { position: position + MAX_STEP_S * f64::midpoint(speed, next), speed: next };
    }
}

/// Callback that moves the motors in each step. Arguments: the body before the step, the step's number, motors and
/// loads.
type Drive<'d> = &'d mut dyn FnMut(&BalanceTail, usize, &mut [MotorState; 2], &[f64; 2]);

fn run(body: &mut BalanceTail, case: &Case, drive: Drive<'_>) -> Vec<Moment> {
    let shaft_of = body.links().map(|link| link.cable.shaft);
    let (mut motors, mut loads) = ([MotorState::default(); 2], [0.0; 2]);
    let watched_every = (WATCHED_EVERY_S / MAX_STEP_S).round() as usize;
    let steps = ((case.lift.at_s + AFTER_S) / MAX_STEP_S).ceil() as usize;
    let mut moments = Vec::with_capacity(steps / watched_every + 1);
    for step in 0..steps {
        let time_s = step as f64 * MAX_STEP_S;
        drive(body, step, &mut motors, &shaft_of.map(|shaft| loads[shaft]));
        let mut shafts = [ShaftMotion::default(); 2];
        for (motor, shaft) in motors.iter().zip(shaft_of) {
            shafts[shaft] = motor.shaft;
        }
        body.step(&mut Scene::default(), time_s, &shafts, &mut loads, MAX_STEP_S);
        if step % watched_every == 0 {
            let torque_nm = motors.map(|motor| motor.torque_nm);
            moments.push(Moment::of(body, time_s, torque_nm, motors.map(|motor| motor.shaft.speed)));
        }
    }
    moments
}
