//! Trial on perfect actuators, without a board: wheels follow a ramp, the servo turns at its rated speed. Laws are
//! tuned on it.

use r4_boards::Robot;
use r4_world::{Body as _, MAX_STEP_S, Scene, ShaftMotion};

use super::{
    law::{Law, Seen},
    protocol::{Moment, Run},
    scene::{Case, Setup, TRIAL_S, shell_of},
};

/// Ramp of the wheel speeds, m/s²: that of the robot's profile.
const RAMP_M_S2: f64 = 1.0;
/// Steps of the body between two calls of the law: 10 ms.
const STEPS: usize = 40;

/// Drives a case of a robot by a law.
///
/// The law reads the shown bends without a board's delay: it must have a `settles_s` of 0.
///
/// # Errors
/// The reason in words: the robot has no shell, or the case is not valid.
pub fn drive(robot: &Robot, setup: &Setup, case: &Case, law: &mut Law) -> Result<Run, String> {
    let nominal = shell_of(robot)?;
    let (mut body, mut scene) = (case.body(nominal)?, Scene::default());
    case.put_boxes(0.5 * setup.shell.length_m(setup.shell.rest_rad), &mut scene)?;
    let channels = robot.simulation.body.as_ref().map_or(&[][..], |body| &body.channels);
    let side_of = |channel| {
        let sides = [&setup.drive.left, &setup.drive.right];
        sides.into_iter().position(|side| side.contains(channel))
    };
    let sides: Vec<Option<usize>> = channels.iter().map(side_of).collect();
    let (mut wheels_rad, mut rim_m_s, mut servo_rad) = ([0.0; 2], [0.0; 2], 0.0);
    let mut shafts = vec![ShaftMotion::default(); channels.len()];
    let mut loads = vec![0.0; channels.len()];
    let mut run = Run::default();
    let (mut order, mut steps) = (None::<super::law::Order>, 0_usize);
    let first = (case.waits_s / (STEPS as f64 * MAX_STEP_S)).round() as usize * STEPS;
    while (steps as f64) < first as f64 + TRIAL_S / MAX_STEP_S {
        let time_s = steps as f64 * MAX_STEP_S;
        if steps >= first && steps.is_multiple_of(STEPS) {
            let seen = Seen { time_s, bent_rad: [body.reading(0), body.reading(1)], wheels_rad };
            order = Some(law.next(seen));
            run.moments.push(Moment::new(time_s - first as f64 * MAX_STEP_S, seen, &body));
        }
        if let Some(order) = order {
            let most_rad = setup.servo_rad_s * MAX_STEP_S;
            servo_rad += (order.servo_rad - servo_rad).clamp(-most_rad, most_rad);
            let across_m_s = 0.5 * order.velocity.yaw_rad_s * setup.drive.track_m;
            for (rim_m_s, sign) in rim_m_s.iter_mut().zip([-1.0, 1.0]) {
                let most_m_s = RAMP_M_S2 * MAX_STEP_S;
                let wanted_m_s = order.velocity.forward_m_s + sign * across_m_s;
                *rim_m_s += (wanted_m_s - *rim_m_s).clamp(-most_m_s, most_m_s);
            }
        }
        for (shaft, side) in shafts.iter_mut().zip(&sides) {
            *shaft = match side {
                Some(side) => ShaftMotion { position: 0.0, speed: rim_m_s[*side] / setup.drive.wheel_radius_m },
                None => ShaftMotion { position: servo_rad, speed: 0.0 },
            };
        }
        body.step(&mut scene, time_s, &shafts, &mut loads, MAX_STEP_S);
        for side in [0, 1] {
            wheels_rad[side] += rim_m_s[side] / setup.drive.wheel_radius_m * MAX_STEP_S;
        }
        steps += 1;
    }
    Ok(run)
}
