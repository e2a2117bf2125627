//! Objects and grippers that the study samples, the hidden effects, and the values that a program knows of a gripper.

use std::rc::Rc;

use r4_boards::Robot;
use r4_protocol::ChannelId;
use r4_rig::Alter;
use r4_world::{AnyBody, Encoders, Finger, Held, Pads, Palm, TwoFingers};

use crate::sampler::Sampler;

/// Purposes of the random numbers: objects, hidden effects, and the gauge.
const OF_CASE: u64 = 1;
const OF_HIDDEN: u64 = 2;
const OF_GAUGE: u64 = 3;

/// Nominal diameter of the gauge, a rod, m; and the most by which a rod of tolerance h6 (ISO 286) is thinner.
pub const GAUGE_M: f64 = 0.030;
const GAUGE_THINNER_M: f64 = 13e-6;

/// Radius of edges that practically do not roll, m: in blind trials without hidden migration.
const SHARP_M: f64 = 5e-5;
/// Least width of an object in blind trials, m.
const SMALLEST_HIDING_M: f64 = 0.025;
/// Distance along the finger from its joint to a contact in the middle of the sampled range, m.
const MIDDLE_M: f64 = 0.078;

/// An effect that a blind trial hides.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hidden {
    /// No effect, as a control.
    Nothing,
    /// Round edges: the contacts roll along the fingers.
    Migration,
    /// Slip: the contacts creep along the fingers.
    Slip,
    /// Play of the palm's rack beyond the datasheet.
    Backlash,
    /// Wrong zero of the left encoder.
    ZeroOffset,
}

/// A sampled object in a gripper. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Width of the object where the fingers hold it, m.
    pub across_m: f64,
    /// Radius of the object's edges, m.
    pub edge_m: f64,
    /// Palm width for the grip, m: chosen by the person who puts the object down.
    pub palm_m: f64,
    /// Position of the object's centre, m.
    pub place_m: [f64; 2],
    mass_kg: f64,
    table_friction: f64,
    pads: Pads,
    link: f64,
    play: f64,
    encoder_rad: [f64; 3],
    rack_m: Option<f64>,
    /// Size of the hidden effect, in SI units.
    pub hidden: f64,
    /// Seed of the noise.
    pub(super) seed: u64,
}

impl Case {
    /// Samples the case of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_CASE);
        let across_m = sampler.uniform(0.015, 0.045);
        let is_disc = sampler.uniform(0.0, 1.0) < 0.5;
        let share = sampler.uniform(0.05, 0.3);
        let lean_rad = sampler.uniform(0.06, 0.12);
        let height_m = sampler.uniform(0.068, 0.088);
        Self {
            across_m,
            edge_m: if is_disc { 0.5 * across_m } else { share * across_m },
            palm_m: across_m + 2.0 * (0.008 + MIDDLE_M * lean_rad),
            place_m: [sampler.uniform(-0.002, 0.002), height_m],
            mass_kg: sampler.uniform(0.04, 0.08),
            table_friction: sampler.uniform(0.2, 0.4),
            pads: Pads {
                stiffness_n_per_m: sampler.uniform(6e4, 1e5),
                damping_n_s_per_m: 30.0,
                friction: sampler.uniform(0.7, 1.0),
                creep_per_s: 0.0,
            },
            link: sampler.uniform(0.8, 1.2),
            play: sampler.uniform(0.8, 1.2),
            encoder_rad: [0, 1, 2].map(|_| sampler.normal(0.0005)),
            rack_m: None,
            hidden: 0.0,
            seed,
        }
    }

    /// Samples the same gripper with a sharp-edged object and a hidden effect, whose size the seed decides.
    #[must_use]
    pub fn hiding(seed: u64, hidden: Hidden) -> Self {
        let mut sampler = Sampler::new(seed, OF_HIDDEN);
        let mut case = Self { edge_m: SHARP_M, ..Self::of(seed) };
        // Smaller squares with sharp edges leave the friction cone during the paper's rolling: no grasp remains to be
        // compared.
        case.resize(sampler.uniform(SMALLEST_HIDING_M, 0.045), sampler.uniform(0.06, 0.12));
        match hidden {
            Hidden::Nothing => {}
            Hidden::Migration => {
                case.hidden = sampler.uniform(0.15, 0.4) * case.across_m;
                case.edge_m = case.hidden;
            }
            Hidden::Slip => {
                case.hidden = sampler.uniform(1.5, 4.0);
                case.pads.creep_per_s = case.hidden;
            }
            Hidden::Backlash => {
                case.hidden = sampler.uniform(0.001, 0.0025);
                case.rack_m = Some(case.hidden);
            }
            Hidden::ZeroOffset => {
                let sign = if sampler.uniform(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
                case.hidden = sign * sampler.uniform(0.02, 0.035);
                case.encoder_rad[0] += case.hidden;
            }
        }
        case
    }

    /// Samples the same gripper with the gauge in place of the object.
    #[must_use]
    pub fn gauging(&self) -> Self {
        let mut sampler = Sampler::new(self.seed, OF_GAUGE);
        let across_m = GAUGE_M - sampler.uniform(0.0, GAUGE_THINNER_M);
        let place_m = [sampler.uniform(-0.002, 0.002), sampler.uniform(0.068, 0.088)];
        // Another sequence of noise than that of the object's session.
        let mut case = Self { edge_m: 0.5 * across_m, place_m, seed: !self.seed, ..*self };
        case.resize(across_m, sampler.uniform(0.06, 0.12));
        case
    }

    fn resize(&mut self, across_m: f64, lean_rad: f64) {
        self.across_m = across_m;
        self.palm_m = across_m + 2.0 * (0.008 + MIDDLE_M * lean_rad);
    }

    /// Lays the object across the fingers with two opposite edges; a disc has no orientation.
    fn held(&self) -> Held {
        let half_m = (0.5 * self.across_m - self.edge_m) * std::f64::consts::FRAC_1_SQRT_2;
        Held {
            side_m: 2.0 * (half_m + self.edge_m),
            edge_m: self.edge_m,
            mass_kg: self.mass_kg,
            table_friction: self.table_friction,
            place_m: self.place_m,
            angle_rad: std::f64::consts::FRAC_PI_4,
        }
    }

    /// Returns the gripper of `nominal` in this case.
    ///
    /// # Errors
    /// The reason in words when the changed gripper is not valid.
    pub fn body(&self, nominal: &TwoFingers) -> Result<TwoFingers, String> {
        let finger = nominal.finger();
        let finger = Finger {
            link_nm_per_rad: finger.link_nm_per_rad * self.link,
            play_rad: finger.play_rad * self.play,
            ..*finger
        };
        let palm = Palm { play_m: self.rack_m.unwrap_or(nominal.palm().play_m), ..*nominal.palm() };
        let encoders = Encoders { offset_rad: self.encoder_rad, seed: self.seed, ..*nominal.encoders() };
        TwoFingers::new(palm, finger, self.pads, self.held(), encoders).map_err(|error| error.to_string())
    }

    /// Returns the function by which a rig changes its robot to this case.
    ///
    /// # Errors
    /// The reason in words: the robot has no such gripper, or the changed one is not valid.
    pub fn altered(&self, robot: &Robot) -> Result<Alter, String> {
        let body = self.body(gripper(robot)?)?;
        Ok(Rc::new(move |robot| {
            if let Some(simulated) = &mut robot.simulation.body {
                simulated.kind = AnyBody::TwoFingers(Box::new(body.clone()));
            }
        }))
    }
}

/// The gripper of a robot; an error in words when it has none.
pub(super) fn gripper(robot: &Robot) -> Result<&TwoFingers, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::TwoFingers(gripper)) => Ok(gripper),
        _ => Err("it has no [body.two-fingers]".into()),
    }
}

/// A servo and the analog encoder on its shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Channel of the servo.
    pub servo: ChannelId,
    /// Analog channel of the encoder.
    pub encoder: ChannelId,
    /// Voltage of the encoder at 0 rad, V.
    pub zero_v: f64,
    /// Gain of the encoder, V/rad.
    pub v_per_rad: f64,
}

/// Channels and datasheet values that a program knows of a gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Joints in the order left finger, right finger, palm.
    pub joints: [Joint; 3],
    /// Geometry and play of the palm.
    pub palm: Palm,
    /// Geometry, stiffness and play of either finger.
    pub finger: Finger,
}

impl Setup {
    /// Reads the setup of a robot.
    ///
    /// # Errors
    /// The part that the robot lacks, in words.
    pub fn of(robot: &Robot) -> Result<Self, String> {
        let gripper = gripper(robot)?;
        let channels = robot.simulation.body.as_ref().map_or(&[][..], |body| &body.channels);
        let joint = |number: usize| {
            let encoder = robot.simulation.analogs.iter().find_map(|analog| {
                let reads = analog.reads.filter(|reads| reads.number == number)?;
                Some((analog.channel, reads))
            });
            let (encoder, reads) = encoder.ok_or_else(|| format!("no analog input reads encoder {number}"))?;
            let servo = *channels.get(number).ok_or("a joint has no servo")?;
            Ok::<_, String>(Joint { servo, encoder, zero_v: reads.zero, v_per_rad: reads.per_unit })
        };
        Ok(Self { joints: [joint(0)?, joint(1)?, joint(2)?], palm: *gripper.palm(), finger: *gripper.finger() })
    }
}
