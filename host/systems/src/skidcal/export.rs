//! Compliances for other simulators.

use std::fmt::Write;

/// Slip compliances and friction of a robot's wheels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Along a wheel, 1/N.
    pub c_long_per_n: f64,
    /// Across a wheel, 1/N.
    pub c_lat_per_n: f64,
    /// Friction, 1; for an estimate that did not reach it a large number, such as 10.
    pub friction: f64,
}

/// `wheel_slip` plugin and ODE surface of each wheel for Gazebo's SDF, by the names of the wheels' links.
///
/// Tag names: Gazebo's `WheelSlipPlugin` and SDFormat's `surface/friction/ode`. The plugin multiplies by its normal force, which is 1
/// so that compliances stay 1/N; ODE's own slip stays 0, for the plugin sets it as the wheel turns.
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
