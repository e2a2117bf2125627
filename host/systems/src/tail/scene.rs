//! Persons, tails and lifts that the study samples, and the readings of the printed motor data.

use std::rc::Rc;

use r4_boards::{Robot, SimulatedBldc};
use r4_protocol::ChannelId;
use r4_rig::{Alter, inertial_sensor};
use r4_world::{Ankle, AnyBody, BalanceTail, GRAVITY_M_S2, Lift, Link, TailError, Wearer};

use super::{
    law::{self, Motor},
    model::{self, Model, Trunk},
};
use crate::sampler::Sampler;

/// Purpose of random numbers.
const OF_CASE: u64 = 1;

/// Force loss of pulleys on plain bearings per half turn, as a share.
const PLAIN_BEARINGS: f64 = 0.1;
/// Scale of the tail's weight that counts as none.
const WEIGHTLESS: f64 = 1e-6;

/// Assignment of motors and powers to the joints.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reading {
    /// Motor 1, 0.625 N m and 573 W, is at the back: as printed.
    Printed,
    /// Motor 1 is at the outer joint, as in the robot's file.
    OuterFirst,
    /// Motor 1 is at the outer joint and the powers are exchanged: 4 N m and 573 W at the back, 0.625 N m and 262 W
    /// outside.
    CrossedPowers,
}

/// A sampled person with a tail, and the lift. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Mass of the person, kg; known to the controller, from scales.
    pub mass_kg: f64,
    /// Stiffness of the ankle over that of gravity at it; dimensionless.
    pub ankle: f64,
    /// Damping of the ankle, N m s/rad.
    pub damping_nm_s_per_rad: f64,
    /// Force loss of a half turn over a pulley, as a share.
    pub loss_per_wrap: f64,
    /// Stiffness of the cables over that of the robot's file; dimensionless.
    pub cable: f64,
    /// Load that the person lifts, with time and place.
    pub lift: Lift,
}

impl Case {
    /// Samples the case of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_CASE);
        Self {
            mass_kg: sampler.uniform(60.0, 90.0),
            ankle: sampler.uniform(1.6, 2.0),
            damping_nm_s_per_rad: sampler.uniform(150.0, 250.0),
            loss_per_wrap: sampler.uniform(0.005, 0.02),
            cable: sampler.uniform(0.7, 1.3),
            lift: Lift {
                at_s: sampler.uniform(4.0, 5.0),
                over_s: sampler.uniform(0.3, 0.7),
                mass_kg: 10.0,
                place_m: [sampler.uniform(0.30, 0.40), 1.05],
            },
        }
    }

    /// Returns the same case with pulleys on plain bearings, whose loss is ten times what the controller's design
    /// allows for.
    #[must_use]
    pub fn with_plain_bearings(self) -> Self {
        Self { loss_per_wrap: PLAIN_BEARINGS, ..self }
    }

    /// The person of this case, with the height of `nominal`.
    fn wearer(&self, nominal: &Wearer) -> Wearer {
        let moment_nm = self.mass_kg * GRAVITY_M_S2 * nominal.centre_m;
        let ankle = Ankle {
            stiffness_nm_per_rad: self.ankle * moment_nm,
            damping_nm_s_per_rad: self.damping_nm_s_per_rad,
            ..nominal.ankle
        };
        // The height of the centre of mass stays the nominal one: the inertia is in proportion to the mass.
        let inertia_kg_m2 = nominal.inertia_kg_m2 * self.mass_kg / nominal.mass_kg;
        Wearer { mass_kg: self.mass_kg, inertia_kg_m2, ankle, ..*nominal }
    }

    /// The person of this case with the tail of `nominal`, whose weights are scaled by `weighs`.
    fn body(&self, nominal: &BalanceTail, weighs: f64) -> Result<BalanceTail, TailError> {
        let links = nominal.links().map(|mut link| {
            link.mass_kg *= weighs;
            link.inertia_kg_m2 *= weighs;
            // The cables are scaled like the masses, so that an almost weightless tail keeps the time constants of the
            // real one.
            link.cable.stiffness_nm_per_rad *= self.cable * weighs;
            link.cable.damping_nm_s_per_rad *= weighs;
            link.cable.friction_nm *= weighs;
            link.cable.loss_per_wrap = self.loss_per_wrap;
            link
        });
        BalanceTail::new(self.wearer(nominal.wearer()), links, [0.0; 2], Some(self.lift))
    }

    /// The person of this case without a tail.
    ///
    /// # Errors
    /// The reason in words: the robot has no tail, or the person cannot stand.
    pub fn without_tail(&self, robot: &Robot) -> Result<BalanceTail, String> {
        self.body(tail(robot)?, WEIGHTLESS).map_err(|error| error.to_string())
    }

    /// Returns the function by which a rig changes its robot to this case.
    pub fn altered(self, reading: Reading) -> Alter {
        // A robot without a tail stays as it is: `Setup::of` has refused it.
        Rc::new(move |robot| drop(self.put_into(robot, reading)))
    }

    /// Changes a robot to this case.
    ///
    /// # Errors
    /// The reason in words: the robot has no tail, or the person cannot stand.
    pub fn put_into(&self, robot: &mut Robot, reading: Reading) -> Result<(), String> {
        let changed = self.body(tail(robot)?, 1.0).map_err(|error| error.to_string())?;
        reading.put_into(robot);
        if let Some(body) = &mut robot.simulation.body {
            body.kind = AnyBody::BalanceTail(Box::new(changed));
        }
        Ok(())
    }
}

impl Reading {
    fn put_into(self, robot: &mut Robot) {
        match self {
            Self::OuterFirst => {}
            Self::Printed => robot.simulation.body.iter_mut().for_each(|body| body.channels.reverse()),
            Self::CrossedPowers => {
                let mut rotors: Vec<_> =
                    robot.simulation.bldcs.iter_mut().filter_map(|bldc| bldc.rotor.as_mut()).collect();
                if let [first, second] = &mut rotors[..] {
                    std::mem::swap(&mut first.power_max_w, &mut second.power_max_w);
                }
            }
        }
    }
}

/// The tail of a robot; an error in words when it has none.
pub(super) fn tail(robot: &Robot) -> Result<&BalanceTail, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::BalanceTail(tail)) => Ok(tail),
        _ => Err("it has no [body.balance-tail]".into()),
    }
}

/// A motor of the tail and its encoder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Channel of the motor's drive.
    pub channel: ChannelId,
    /// Channel of the encoder on the motor's shaft.
    pub encoder: ChannelId,
    /// Limits of motor and drive.
    pub motor: Motor,
    /// Inertia of the motor, kg m².
    pub rotor_kg_m2: f64,
    /// Gear ratio: turns of the motor for one of the joint.
    pub ratio: f64,
}

/// Channels, datasheet values, and the person's weight and height, known to the controller before the start.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Joints from the back outwards.
    pub joints: [Joint; 2],
    /// Model of person and tail.
    pub model: Model,
    /// Limits and weights of the controller.
    pub settings: law::Settings,
    /// Channel of the inertial sensor on the trunk.
    pub trunk: ChannelId,
}

impl Setup {
    /// Reads the setup of a robot with this reading of its motors, worn by a person of `mass_kg`.
    ///
    /// # Errors
    /// The part that the robot lacks, in words.
    pub fn of(robot: &Robot, reading: Reading, mass_kg: f64) -> Result<Self, String> {
        let mut robot = robot.clone();
        reading.put_into(&mut robot);
        let tail = tail(&robot)?;
        let channels = robot.simulation.body.as_ref().map_or(&[][..], |body| &body.channels);
        let joint = |link: &Link| {
            let channel = *channels.get(link.cable.shaft).ok_or("a link has no motor")?;
            let drive = robot.simulation.bldcs.iter().find(|bldc| bldc.channel == channel);
            let drive = drive.ok_or_else(|| format!("{channel} is no simulated brushless drive"))?;
            joint_of(drive, link.cable.ratio)
        };
        let [first, second] = tail.links();
        let joints = [joint(first)?, joint(second)?];
        let wearer = tail.wearer();
        let share = mass_kg / wearer.mass_kg;
        let person = Trunk {
            inertia_kg_m2: wearer.inertia_kg_m2 * share,
            moment_kg_m: [0.0, mass_kg * wearer.centre_m],
            tail_m: wearer.tail_m,
            ankle_nm_per_rad: wearer.ankle.stiffness_nm_per_rad * share,
            ankle_nm_s_per_rad: wearer.ankle.damping_nm_s_per_rad,
        };
        let link = |link: &Link, joint: &Joint| model::Link {
            mass_kg: link.mass_kg,
            length_m: link.length_m,
            centre_m: link.centre_m,
            inertia_kg_m2: link.inertia_kg_m2,
            rotor_kg_m2: joint.rotor_kg_m2,
            ratio: link.cable.ratio,
        };
        let model = Model { trunk: person, links: [link(first, &joints[0]), link(second, &joints[1])] };
        Ok(Self { joints, model, settings: law::Settings::default(), trunk: inertial_sensor(&robot)? })
    }
}

fn joint_of(drive: &SimulatedBldc, ratio: f64) -> Result<Joint, String> {
    let channel = drive.channel;
    let rotor = drive.rotor.ok_or_else(|| format!("{channel} has no rotor"))?;
    let encoder = drive.encoder.ok_or_else(|| format!("no encoder is on the shaft of {channel}"))?;
    let motor = Motor {
        torque_max_nm: rotor.torque_max_nm,
        power_max_w: rotor.power_max_w,
        top_speed_rad_s: drive.top_speed_rad_s,
        speed_gain_nm_s: rotor.inertia_kg_m2 / drive.time_constant_s,
    };
    let encoder = ChannelId::new(r4_protocol::ChannelKind::Encoder, encoder.input);
    Ok(Joint { channel, encoder, motor, rotor_kg_m2: rotor.inertia_kg_m2, ratio })
}
