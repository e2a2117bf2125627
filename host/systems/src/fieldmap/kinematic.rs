//! The same programs on perfect actuators: robots move as commanded and know their pose, and the mill has neither lag
//! nor noise.

use r4_maps::pose::Point;
use r4_rig::Place;
use r4_world::Field;

use super::scene::{Mill, Scene, VOLTS_PER_UNIT};
use crate::rover::Program;

/// Time step of the simulation without a board, s.
const STEP_S: f64 = 0.2;
/// Radius of the wheels, m, of the robot's file.
const WHEEL_M: f64 = 0.056;

struct Robot {
    at: Place,
    charge: f64,
    path: Vec<(f64, Point)>,
    has_ended: bool,
}

impl Robot {
    fn step(&mut self, time_s: f64, field: &mut Field, mill: &Mill, program: &mut impl Program) {
        let undisturbed = field.value(time_s, [self.at.x_m, self.at.y_m]);
        let volts = mill.zero_v + VOLTS_PER_UNIT * mill.form * (undisturbed + mill.charge.rest + self.charge);
        program.sense(time_s, self.at, volts);
        let Some(velocity) = program.drive(time_s, self.at, f64::INFINITY) else {
            self.has_ended = true;
            return;
        };
        let (sin, cos) = (self.at.yaw_rad + velocity.yaw_rad_s * STEP_S / 2.0).sin_cos();
        self.at.x_m += velocity.forward_m_s * cos * STEP_S;
        self.at.y_m += velocity.forward_m_s * sin * STEP_S;
        self.at.yaw_rad += velocity.yaw_rad_s * STEP_S;
        let rate_rad_s = velocity.forward_m_s.abs() / WHEEL_M;
        self.charge += STEP_S * (mill.charge.per_rad * rate_rad_s - self.charge / mill.charge.leak_s);
        program.rolled(time_s + STEP_S, rate_rad_s * STEP_S);
        self.path.push((time_s + STEP_S, [self.at.x_m, self.at.y_m]));
    }
}

/// Runs programs, each from its start, until all have ended. Returns their paths: time, s, and position, m.
pub fn run(scene: &Scene, starts: &[Place], programs: &mut [impl Program]) -> Vec<Vec<(f64, Point)>> {
    let mut field = scene.field();
    let robot = |at: &Place| Robot { at: *at, charge: 0.0, path: vec![(0.0, [at.x_m, at.y_m])], has_ended: false };
    let mut robots: Vec<Robot> = starts.iter().map(robot).collect();
    for step in 0u32.. {
        let time_s = f64::from(step) * STEP_S;
        let mut goes_on = false;
        for (robot, program) in robots.iter_mut().zip(programs.iter_mut()).filter(|(robot, _)| !robot.has_ended) {
            robot.step(time_s, &mut field, &scene.mill, program);
            goes_on = true;
        }
        if !goes_on {
            break;
        }
    }
    robots.into_iter().map(|robot| robot.path).collect()
}
