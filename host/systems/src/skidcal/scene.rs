//! Robots that the study samples, and the noise of their sensors.

use std::rc::Rc;

use r4_boards::Robot;
use r4_rig::Alter;
use r4_world::{AnyBody, GRAVITY_M_S2, SlipLaw, Wheeled};

use super::{missing::Effect, protocol::Recording};
use crate::sampler::Sampler;

/// Purposes of the random numbers: robots, tracker, inertial sensor, hidden effects.
const OF_ROBOT: u64 = 1;
const OF_NOISE: u64 = 2;
const OF_INERTIAL: u64 = 3;
const OF_HIDDEN: u64 = 4;

/// A sampled robot, whose compliances the estimator does not know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Longitudinal compliance: slip along a wheel per force, 1/N.
    pub c_long_per_n: f64,
    /// Lateral compliance: slip across a wheel per force, 1/N.
    pub c_lat_per_n: f64,
    /// Mass, kg; known to the protocol, from scales.
    pub mass_kg: f64,
    /// Friction coefficient; known to the protocol, from a table.
    pub friction: f64,
}

/// Friction coefficient of a floor on which wheels slide in the spin.
const SLIPPERY: f64 = 0.2;
/// Friction coefficient of a floor on which wheels with stiff tyres slide in the spin, but not in straight runs with an
/// off-centre mass.
const SLIPPERY_IN_TURNS: f64 = 0.3;

/// An effect of a robot that the estimator's base model lacks, with its size as [`missing`](super::missing) defines it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hidden {
    /// Hidden effect of the robot.
    pub effect: Effect,
    /// Size of the effect: rad/s shown per rad/s, true radius over the configured one, or m.
    pub size: f64,
}

/// Noise of the tracker and of the inertial sensor.
#[derive(Clone, Debug)]
pub struct Noise {
    tracker: Sampler,
    inertial: Sampler,
}

/// Standard deviation of a tracked position, m.
pub const POSITION_M: f64 = 1e-3;
/// Standard deviation of a tracked heading, rad: of two markers 0.14 m apart.
pub const HEADING_RAD: f64 = 1e-2;
/// Standard deviation of the inertial sensor's specific force, m/s².
pub const INERTIAL_M_S2: f64 = 0.05;

/// Samples the robot of a seed. [`About::sampled`](crate::About::sampled) has the ranges.
#[must_use]
pub fn sample(seed: u64) -> Truth {
    let mut sampler = Sampler::new(seed, OF_ROBOT);
    let c_long_per_n = sampler.log_uniform(0.01, 0.03);
    let ratio = sampler.log_uniform(2.0, 12.0);
    let mass_kg = sampler.uniform(9.0, 14.0);
    let friction = if seed % 4 == 3 { SLIPPERY } else { 10.0 };
    Truth { c_long_per_n, c_lat_per_n: ratio * c_long_per_n, mass_kg, friction }
}

/// Samples a robot with at most one hidden effect: with stiff tyres, on a floor on which they slide in the spin.
#[must_use]
pub fn hidden(seed: u64) -> (Truth, Option<Hidden>) {
    let mut sampler = Sampler::new(seed, OF_HIDDEN);
    let which = sampler.uniform(0.0, 4.0);
    let sign = if sampler.uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
    let mut of = |effect, low, high, none| Some(Hidden { effect, size: none + sign * sampler.uniform(low, high) });
    let hidden = match which {
        ..1.0 => None,
        // The datasheet of the ICM-20948 allows 1.5 % at 25 °C.
        ..2.0 => of(Effect::GyroScale, 0.005, 0.015, 1.0),
        ..3.0 => of(Effect::WheelRadius, 0.01, 0.05, 1.0),
        // OpenScout's axles are 0.12 m before and behind its middle.
        _ => of(Effect::CentreOfMass, 0.02, 0.06, 0.0),
    };
    let c_long_per_n = sampler.log_uniform(0.01, 0.015);
    let c_lat_per_n = c_long_per_n * sampler.log_uniform(2.0, 6.0);
    (Truth { c_long_per_n, c_lat_per_n, friction: SLIPPERY_IN_TURNS, ..sample(seed) }, hidden)
}

impl Hidden {
    /// Changes a robot's body, or the scale of its inertial sensors.
    pub fn put_into(&self, robot: &mut Robot) {
        let Self { effect, size } = *self;
        if effect == Effect::GyroScale {
            robot.simulation.imus.iter_mut().for_each(|imu| imu.rate_scale[2] = size);
        }
        let Some(AnyBody::Wheeled(body)) = robot.simulation.body.as_mut().map(|body| &mut body.kind) else { return };
        let changed = body.changed(|chassis, wheels| match effect {
            Effect::GyroScale => {}
            Effect::WheelRadius => wheels.iter_mut().for_each(|wheel| wheel.radius_m *= size),
            Effect::CentreOfMass => chassis.centre_m[0] += size,
        });
        // Valid for all sampled sizes: the centre of mass stays between the axles.
        if let Ok(changed) = changed {
            **body = changed;
        }
    }
}

impl Truth {
    /// Gives the body of a robot this mass and these tyres.
    pub fn put_into(&self, robot: &mut Robot) {
        let Some(AnyBody::Wheeled(body)) = robot.simulation.body.as_mut().map(|body| &mut body.kind) else { return };
        if let Some(changed) = self.wheeled(body) {
            **body = changed;
        }
    }

    /// Returns a body with this mass and these tyres, by the linear slip law of the simulator that the paper
    /// calibrates; `None` when they are not valid.
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
        // A chassis is valid for positive parameters, which the sampled and the estimated ones are.
        changed.ok()
    }

    /// Returns true when a wheel slides in the spin of a recording, by the forces of the linear law.
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

/// Returns the function by which a rig changes its robot to this one, with a hidden effect.
pub fn altered(truth: Truth, hidden: Option<Hidden>) -> Alter {
    Rc::new(move |robot| {
        truth.put_into(robot);
        hidden.iter().for_each(|hidden| hidden.put_into(robot));
    })
}

impl Noise {
    /// Creates the noise of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        Self { tracker: Sampler::new(seed, OF_NOISE), inertial: Sampler::new(seed, OF_INERTIAL) }
    }

    /// Noise of the next tracked pose: x and y, m, and heading, rad.
    pub fn place(&mut self) -> [f64; 3] {
        [POSITION_M, POSITION_M, HEADING_RAD].map(|deviation| self.tracker.normal(deviation))
    }

    /// Noise of the inertial sensor's next specific force, m/s².
    pub fn inertial_m_s2(&mut self) -> f64 {
        self.inertial.normal(INERTIAL_M_S2)
    }
}
