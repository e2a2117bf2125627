//! Export of compliances for simulated boards and other simulators.

use std::fmt::Write;

use r4_boards::{Robot, SimulatedBody};
use r4_rig::Rig;

use super::{Recorded, bristle, estimate, scene::Truth};
use crate::{Error, ResultFile, Trial};

/// Writes the result of a trial as a body for `--body` and as `wheel_slip` for Gazebo.
pub(super) fn files(trial: &Trial) -> Result<Vec<ResultFile>, Error> {
    let Recorded { truth, recording, .. } = Recorded::of(trial)?;
    if estimate::reaches_friction(&recording, truth.friction) {
        let why = "wheels slide in the spin, which then says nothing of c_lat: repeat it on a floor with more friction";
        return Err(super::unsuitable(trial, why));
    }
    let found = bristle::c_long(&recording).zip(estimate::ratio(&recording));
    let (c_long, ratio) = found.ok_or_else(|| super::without_estimate(trial))?;
    let slip = Slip { c_long_per_n: c_long.value, c_lat_per_n: c_long.value * ratio.value, friction: truth.friction };
    let robot = Rig::new(trial.board.clone()).robot()?;
    let mut comments = vec![format!("Slip found by `r4 system run skidcal`, arm {}, seed {}.", trial.arm, trial.seed)];
    for (what, found, unit) in [("c_long", c_long, "1/N"), ("c_lat / c_long", ratio, "1")] {
        if let Some(interval) = found.interval {
            comments.push(format!("{what}: {} to {} {unit}, 95 % confidence interval.", interval.low, interval.high));
        }
    }
    let text = body(&robot, &slip, truth.mass_kg, &comments).ok_or_else(|| super::without_estimate(trial))?;
    let radius_m = recording.robot.drive.wheel_radius_m;
    Ok(vec![
        ResultFile { name: "body.toml", text },
        ResultFile { name: "wheel_slip.sdf", text: sdf(&slip, &LINKS, radius_m) },
    ])
}

/// Links of the wheels in the SDF file; the user replaces them by the model's own.
const LINKS: [&str; 4] = ["front_left_wheel", "front_right_wheel", "rear_left_wheel", "rear_right_wheel"];

/// Formats a robot's body with these tyres and this mass, as a file that a simulated board loads; `None` for a robot
/// without wheels.
#[must_use]
pub fn body(robot: &Robot, slip: &Slip, mass_kg: f64, comments: &[String]) -> Option<String> {
    let body = robot.simulation.body.as_ref()?;
    let Slip { c_long_per_n, c_lat_per_n, friction } = *slip;
    let truth = Truth { c_long_per_n, c_lat_per_n, mass_kg, friction };
    let calibrated = truth.wheeled(body.wheeled()?)?;
    Some(SimulatedBody::wheeled_toml(&calibrated, &body.channels, comments))
}

/// Slip compliances and friction of a robot's wheels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Compliance along a wheel, 1/N.
    pub c_long_per_n: f64,
    /// Compliance across a wheel, 1/N.
    pub c_lat_per_n: f64,
    /// Friction coefficient; for an estimate that did not reach it a large number, such as 10.
    pub friction: f64,
}

/// Formats the `wheel_slip` plugin and the ODE surface of each wheel for Gazebo's SDF, by the names of the wheels'
/// links.
///
/// Tag names: Gazebo's `WheelSlipPlugin` and SDFormat's `surface/friction/ode`. The plugin multiplies by its normal
/// force, which is 1 so that compliances stay in 1/N; ODE's own slip stays 0, since the plugin sets it as the wheel
/// turns.
#[must_use]
pub fn sdf(slip: &Slip, links: &[&str], wheel_radius_m: f64) -> String {
    let Slip { c_long_per_n, c_lat_per_n, friction } = slip;
    let mut text = String::from("<plugin filename=\"libWheelSlipPlugin.so\" name=\"wheel_slip\">\n");
    for link in links {
        // Writing into a string does not fail.
        let _ = write!(
            text,
            "  <wheel link_name=\"{link}\">\n    \
             <slip_compliance_lateral>{c_lat_per_n}</slip_compliance_lateral>\n    \
             <slip_compliance_longitudinal>{c_long_per_n}</slip_compliance_longitudinal>\n    \
             <wheel_normal_force>1.0</wheel_normal_force>\n    \
             <wheel_radius>{wheel_radius_m}</wheel_radius>\n  \
             </wheel>\n"
        );
    }
    text.push_str("</plugin>\n<!-- in each wheel's collision -->\n");
    let _ = write!(
        text,
        "<surface>\n  <friction>\n    <ode>\n      <mu>{friction}</mu>\n      <mu2>{friction}</mu2>\n      \
         <fdir1>0 0 1</fdir1>\n      <slip1>0</slip1>\n      <slip2>0</slip2>\n    </ode>\n  </friction>\n</surface>\n"
    );
    text
}
