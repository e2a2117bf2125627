//! Grippers, vials and disturbances that the study samples, and the values that the controller knows of them.

use std::{f64::consts::PI, rc::Rc};

use r4_boards::{BodyReading, Robot, Simulation};
use r4_protocol::{ChannelId, ChannelKind};
use r4_rig::Alter;
use r4_world::{
    AnyBody, CableLoop,
    cable_loop::{Axes, Bowden, Creep, Finger, Jerk, TipSensor, Vial},
};

use crate::sampler::Sampler;

/// Purposes of the random numbers: the case, and the camera's noise.
const OF_CASE: u64 = 1;
const OF_CAMERA: u64 = 2;

/// Number of frames that the camera takes of a vial.
const FRAMES: u32 = 20;
/// Standard deviation of one frame's measurement, m.
const FRAME_NOISE_M: f64 = 0.3e-3;

/// A gripper with its vial and its disturbances. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Vial to be gripped.
    pub vial: Vial,
    /// Knock while the vial is in the air.
    pub jerk: Option<Jerk>,
    /// Friction coefficient times wrap angle of the Bowden tube; dimensionless.
    pub friction_angle: f64,
    /// Creep of the loop's material.
    pub creep: Creep,
    /// Zero, N, and drift, N/s, of the force sensor.
    pub force_zero: [f64; 2],
    /// Scales, true over nominal: stiffness of the tip, stiffness of the strand, radius of the spool.
    pub scales: [f64; 3],
    /// Deviation of the legs' length from the nominal, m.
    pub legs_off_m: f64,
    /// Length of the loop at the start, m.
    pub start_m: f64,
    /// Offset of the range sensor, m.
    pub range_off_m: f64,
    /// Offsets of the camera: position, positive to the left, and diameter, m.
    pub camera_off_m: [f64; 2],
}

/// Measurement of a camera above the gripper: declared, as the board has none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Position of the vial to the left of the tip, m.
    pub aside_m: f64,
    /// Diameter of the vial, m.
    pub diameter_m: f64,
}

impl Case {
    /// Samples the case of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_CASE);
        let mut uniform = |low, high| sampler.uniform(low, high);
        Self {
            vial: Vial {
                diameter_m: uniform(0.010, 0.050),
                mass_kg: uniform(0.02, 0.15),
                height_m: 0.045,
                place_m: [uniform(0.040, 0.056), uniform(-0.008, 0.008)],
                friction: uniform(0.45, 0.9),
                kinetic_share: uniform(0.8, 0.95),
                crush_n: uniform(8.5, 12.0),
                clearance_m: 0.003,
            },
            jerk: Some(Jerk {
                after_s: uniform(0.2, 0.6),
                lasts_s: uniform(0.03, 0.12),
                acceleration_m_s2: uniform(0.0, 18.0),
            }),
            friction_angle: uniform(0.15, 0.75),
            creep: Creep { share: uniform(0.1, 0.3), time_s: uniform(0.5, 2.0) },
            force_zero: [uniform(-1.0, 1.0), uniform(-0.05, 0.05)],
            scales: [uniform(0.8, 1.2), uniform(0.8, 1.2), uniform(0.995, 1.005)],
            legs_off_m: uniform(-0.3e-3, 0.3e-3),
            start_m: uniform(0.050, 0.060),
            range_off_m: uniform(-0.15e-3, 0.15e-3),
            camera_off_m: [uniform(-0.15e-3, 0.15e-3), uniform(-0.2e-3, 0.2e-3)],
        }
    }

    /// Returns the same loop with only one of tube friction, creep and sensor drift.
    #[must_use]
    pub fn with_only(self, friction_angle: f64, share: f64, drift_n_per_s: f64) -> Self {
        Self {
            friction_angle,
            creep: Creep { share, ..self.creep },
            force_zero: [self.force_zero[0], drift_n_per_s],
            ..self
        }
    }

    /// Measurement of the camera: the mean of its frames.
    #[must_use]
    pub fn seen(&self, seed: u64) -> Seen {
        let mut sampler = Sampler::new(seed, OF_CAMERA);
        let mut noise_m = || (0..FRAMES).map(|_| sampler.normal(FRAME_NOISE_M)).sum::<f64>() / f64::from(FRAMES);
        Seen {
            aside_m: self.vial.place_m[1] + self.camera_off_m[0] + noise_m(),
            diameter_m: self.vial.diameter_m + self.camera_off_m[1] + noise_m(),
        }
    }

    /// Returns the function by which a rig changes its robot to this case.
    pub fn altered(self) -> Alter {
        // A robot without a gripper stays as it is: `Setup::of` has refused it.
        Rc::new(move |robot| drop(self.put_into(robot)))
    }

    /// Changes a robot to this case.
    ///
    /// # Errors
    /// The reason in words: the robot has no such gripper, or the changed one is not valid.
    pub fn put_into(&self, robot: &mut Robot) -> Result<(), String> {
        let nominal = gripper(robot)?;
        let [tip, strand, spool] = self.scales;
        let finger = Finger {
            spool_radius_m: nominal.finger().spool_radius_m * spool,
            legs_m: nominal.finger().legs_m + self.legs_off_m,
            strand_n: nominal.finger().strand_n * strand,
            tip_n_per_m: nominal.finger().tip_n_per_m * tip,
            start_m: self.start_m,
            ..*nominal.finger()
        };
        let bowden = Bowden { friction_angle: self.friction_angle, ..*nominal.bowden() };
        let [zero_n, drift_n_per_s] = self.force_zero;
        let sensor = TipSensor { zero_n, drift_n_per_s, ..*nominal.sensor() };
        let changed = CableLoop::new((finger, bowden, self.creep, sensor), *nominal.axes(), self.vial, self.jerk);
        let changed = changed.map_err(|error| error.to_string())?;
        let range = Setup::of(robot)?.range;
        for sensor in robot.simulation.distances.iter_mut().filter(|sensor| sensor.channel == range) {
            sensor.offset_m += self.range_off_m;
        }
        if let Some(body) = &mut robot.simulation.body {
            body.kind = AnyBody::CableLoop(Box::new(changed));
        }
        Ok(())
    }
}

/// The gripper of a robot; an error in words when it has none.
fn gripper(robot: &Robot) -> Result<&CableLoop, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::CableLoop(gripper)) => Ok(gripper),
        _ => Err("it has no [body.cable-loop]".into()),
    }
}

/// Channels and datasheet values that the controller knows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Channel of the spool's motor.
    pub spool: ChannelId,
    /// Channels of the axes: lift, forwards, left.
    pub axes: [ChannelId; 3],
    /// Displacement of the axes per rad of their motors, m/rad.
    pub axes_m_per_rad: [f64; 3],
    /// Height of the loop with the lift at 0, m.
    pub raised_m: f64,
    /// Channel of the load cell at the tip.
    pub force: ChannelId,
    /// Channel of the distance sensor in front of the tip.
    pub range: ChannelId,
    /// Radius of the spool, m.
    pub spool_radius_m: f64,
    /// Length of a tight loop minus the circumference that it surrounds, m.
    pub legs_m: f64,
    /// Least radius of the loop, m: that of the retracted one.
    pub bend_radius_m: f64,
    /// Clearance between the vial and the loop's inner side that leaves the same clearance outside it, m.
    pub gap_m: f64,
    /// Half the angle between the strands, rad.
    pub half_angle_rad: f64,
    /// Elongation of the strand per newton: of the tube and of the tip, m/N, and of each metre of loop, 1/N.
    pub stretch: [f64; 3],
    /// Share of the Bowden tube in the stretch of the retracted loop, without friction; dimensionless.
    pub tube_share: f64,
}

impl Setup {
    /// Reads the setup of a robot.
    ///
    /// # Errors
    /// The part that the robot lacks, in words.
    pub fn of(robot: &Robot) -> Result<Self, String> {
        let body = gripper(robot)?;
        let channels = robot.simulation.body.as_ref().map_or(&[][..], |body| &body.channels);
        let [spool, lift, ahead, aside] = *channels else { return Err("its loop needs a spool and three axes".into()) };
        let is = |reads: Option<BodyReading>, number| reads.is_some_and(|reads| reads.number == number);
        let Simulation { forces, distances, .. } = &robot.simulation;
        let force = forces.iter().find(|cell| is(cell.reads, 0)).ok_or("no load cell measures its force")?.channel;
        let range = distances.iter().find(|sensor| is(sensor.reads, 1));
        let range = range.ok_or("no distance sensor measures its range")?.channel;
        let spools = robot.config.motors.iter().filter(|motor| motor.id == spool);
        if !spools.filter_map(|motor| motor.control.as_ref()).any(|control| control.force.is_some()) {
            return Err(format!("{spool} has no force loop: its table needs a [dhb.force]"));
        }
        let Axes { raised_m, lift_m_per_rad, ahead_m_per_rad, aside_m_per_rad } = *body.axes();
        let Finger {
            spool_radius_m, legs_m, bend_radius_m, thickness_m, strand_n, half_angle_rad, tip_n_per_m, ..
        } = *body.finger();
        let tight_m = 2.0 * PI * bend_radius_m + legs_m;
        let outer_m_per_n = 0.5 * tight_m / strand_n + 2.0 * half_angle_rad.cos().powi(2) / tip_n_per_m;
        let tube_m_per_n = 1.0 / body.bowden().stiffness_n_per_m;
        if spool.kind != ChannelKind::Dhb {
            return Err(format!("its spool is on {spool}, not on a DHB"));
        }
        Ok(Self {
            spool,
            axes: [lift, ahead, aside],
            axes_m_per_rad: [lift_m_per_rad, ahead_m_per_rad, aside_m_per_rad],
            raised_m,
            force,
            range,
            spool_radius_m,
            legs_m,
            bend_radius_m,
            half_angle_rad,
            // The cosine enters twice: for the force of the strands on the tip, and for the deflection of the tip along
            // a strand.
            stretch: [tube_m_per_n, 2.0 * half_angle_rad.cos().powi(2) / tip_n_per_m, 0.5 / strand_n],
            // The loop lies around the vial, so that both of its sides share the clearance.
            gap_m: 0.5 * (body.vial().clearance_m - thickness_m),
            tube_share: tube_m_per_n / (tube_m_per_n + outer_m_per_n),
        })
    }

    /// Length of a loop that is tight round a diameter, m.
    #[must_use]
    pub fn tight_m(&self, diameter_m: f64) -> f64 {
        PI * diameter_m + self.legs_m
    }

    /// Spool angle between the contact and a force on the tip, rad, by datasheet values and without friction in the
    /// tube.
    #[must_use]
    pub fn stretch_rad(&self, diameter_m: f64, force_n: f64) -> f64 {
        let [tube_m_per_n, tip_m_per_n, loop_per_n] = self.stretch;
        let tension_n = force_n / (2.0 * self.half_angle_rad.cos());
        tension_n * (tube_m_per_n + tip_m_per_n + loop_per_n * self.tight_m(diameter_m)) / self.spool_radius_m
    }
}
