//! Robots that the study samples, and the noise of their sensors.

use std::rc::Rc;

use r4_boards::Robot;
use r4_rig::Alter;
use r4_world::{AnyBody, GRAVITY_M_S2, SlipLaw, Wheeled};

use super::protocol::Recording;
use crate::sampler::Sampler;

/// Purposes of random numbers.
const OF_ROBOT: u64 = 1;
const OF_NOISE: u64 = 2;
const OF_INERTIAL: u64 = 3;

/// A robot that the estimator does not know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Slip along a wheel per force, 1/N.
    pub c_long_per_n: f64,
    /// Slip across a wheel per force, 1/N.
    pub c_lat_per_n: f64,
    /// Mass, kg; the protocol knows it, from scales.
    pub mass_kg: f64,
    /// Friction, 1; the protocol knows it, from a table.
    pub friction: f64,
}

/// Noise of the sensors.
#[derive(Clone, Debug)]
pub struct Noise {
    tracker: Sampler,
    inertial: Sampler,
}

/// Standard deviation of a tracked position, m, and heading, rad.
pub const POSITION_M: f64 = 1e-3;
/// rad; of two markers 0.14 m apart.
pub const HEADING_RAD: f64 = 1e-2;
/// Standard deviation of the inertial sensor's specific force, m/s².
pub const INERTIAL_M_S2: f64 = 0.05;

/// The robot of a seed. [`About::sampled`](crate::About::sampled) has the ranges.
#[must_use]
pub fn sample(seed: u64) -> Truth {
    let mut sampler = Sampler::new(seed, OF_ROBOT);
    let c_long_per_n = sampler.log_uniform(0.01, 0.03);
    let ratio = sampler.log_uniform(2.0, 12.0);
    let mass_kg = sampler.uniform(9.0, 14.0);
    let friction = if seed % 4 == 3 { 0.2 } else { 10.0 };
    Truth { c_long_per_n, c_lat_per_n: ratio * c_long_per_n, mass_kg, friction }
}

impl Truth {
    /// Changes the body of a robot to this one.
    pub fn put_into(&self, robot: &mut Robot) {
        let Some(AnyBody::Wheeled(body)) = robot.simulation.body.as_mut().map(|body| &mut body.kind) else { return };
        if let Some(changed) = self.wheeled(body) {
            **body = changed;
        }
    }

    /// A body with this mass and these tyres, by the linear slip law of the simulator that the paper calibrates.
    #[must_use]
    pub fn wheeled(&self, body: &Wheeled) -> Option<Wheeled> {
        let changed = body.changed(|chassis, wheels| {
            chassis.inertia_kg_m2 *= self.mass_kg / chassis.mass_kg;
            chassis.mass_kg = self.mass_kg;
            for tyre in wheels.iter_mut().filter_map(|wheel| wheel.tyre.as_mut()) {
                tyre.compliance_per_n = [self.c_long_per_n, self.c_lat_per_n];
                tyre.friction = self.friction;
                tyre.law = SlipLaw::Linear;
            }
        });
        // Positive numbers are all that a chassis asks for, and the sampled and the estimated ones are.
        changed.ok()
    }

    /// Whether a wheel slides in the spin of a recording, with the forces of the linear law.
    #[must_use]
    pub fn slides(&self, recording: &Recording) -> bool {
        let [half_base_m, half_track_m] = recording.robot.half_m;
        let (l2, b2) = (half_base_m * half_base_m, half_track_m * half_track_m);
        let ratio = self.c_lat_per_n / self.c_long_per_n;
        // Equilibrium of the spin: b F_long = l F_lat.
        let turns = ratio * b2 / (l2 + ratio * b2);
        let along_n = (1.0 - turns) / self.c_long_per_n;
        let across_n = half_base_m * turns / (half_track_m * self.c_lat_per_n);
        along_n.hypot(across_n) > self.friction * self.mass_kg * GRAVITY_M_S2 / 4.0
    }
}

/// What a rig does to a robot to make it this one.
pub fn altered(truth: Truth) -> Alter {
    Rc::new(move |robot| truth.put_into(robot))
}

impl Noise {
    /// That of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        Self { tracker: Sampler::new(seed, OF_NOISE), inertial: Sampler::new(seed, OF_INERTIAL) }
    }

    /// Noise of the next tracked place: x and y, m, and heading, rad.
    pub fn place(&mut self) -> [f64; 3] {
        [POSITION_M, POSITION_M, HEADING_RAD].map(|deviation| self.tracker.normal(deviation))
    }

    /// Noise of the inertial sensor's next specific force, m/s².
    pub fn inertial_m_s2(&mut self) -> f64 {
        self.inertial.normal(INERTIAL_M_S2)
    }
}
