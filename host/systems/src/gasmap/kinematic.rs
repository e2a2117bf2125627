//! The same survey on perfect actuators: the robot moves as commanded and knows its pose; the sensor has its lag.

use r4_maps::pose::Point;
use r4_rig::Place;
use r4_world::Lag;

use super::{scene::Hall, survey::SENSOR_M};
use crate::rover::Program;

/// Time step of the simulation, s.
const STEP_S: f64 = 0.1;
/// Time constant of the simulated sensor, s: that of the robot's file.
const LAG_S: f64 = 2.0;

/// Runs a program to its end. Returns the path: time, s, and position, m.
pub fn run(hall: &Hall, program: &mut impl Program) -> Vec<(f64, Point)> {
    let start = hall.world.start;
    let mut at = Place { x_m: start.x_m, y_m: start.y_m, yaw_rad: start.yaw_rad };
    let mut gas = hall.field();
    let mut lag = Lag::new(LAG_S);
    let mut path = vec![(0.0, [at.x_m, at.y_m])];
    for step in 0u32.. {
        let time_s = f64::from(step) * STEP_S;
        let (sin, cos) = at.yaw_rad.sin_cos();
        lag.follow(time_s, gas.value(time_s, [at.x_m + SENSOR_M * cos, at.y_m + SENSOR_M * sin]));
        program.sense(time_s, at, lag.reading());
        let Some(velocity) = program.drive(time_s, at, f64::INFINITY) else { break };
        let (sin, cos) = (at.yaw_rad + velocity.yaw_rad_s * STEP_S / 2.0).sin_cos();
        at.x_m += velocity.forward_m_s * cos * STEP_S;
        at.y_m += velocity.forward_m_s * sin * STEP_S;
        at.yaw_rad += velocity.yaw_rad_s * STEP_S;
        path.push((time_s + STEP_S, [at.x_m, at.y_m]));
    }
    path
}
