//! Pads and tissues that the study samples, and their channels on a robot.

use std::{f64::consts::TAU, rc::Rc};

use r4_boards::Robot;
use r4_protocol::ChannelId;
use r4_rig::Alter;
use r4_world::{AnyBody, Cup, MEMBRANES, MIDDLE, Membrane, SuctionPad};

use crate::sampler::Sampler;

/// Purposes of the random numbers: one sequence for cases, one for blind recordings.
const OF_CASE: u64 = 1;
const OF_BLIND: u64 = 2;

/// Supply of the membranes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Feed {
    /// Syringe pumps; the valves' supply ports are plugged.
    Syringes,
    /// A regulator at this gauge pressure, Pa.
    Supply(f64),
}

/// A sampled pad on tissue. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Modulus of each membrane over that of the robot's file.
    pub modulus: [f64; MEMBRANES],
    /// Radius of the membranes at rest, m.
    pub radius_m: f64,
    /// Stretch at which each membrane bursts.
    pub burst_stretch: [f64; MEMBRANES],
    /// Suction under both cups, Pa.
    pub suction_pa: f64,
    /// Tangential stiffness of each rim on the tissue, N/m.
    pub stiffness_n_m: [f64; 2],
    /// Strain beyond which each rim leaks; dimensionless.
    pub leak_strain: [f64; 2],
    /// Conductance of the middle line's tube over its nominal one: 0.01 with a kink, 1 without.
    pub kink: f64,
}

impl Case {
    /// Samples the case of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_CASE);
        let batch = sampler.uniform(0.83, 1.17);
        Self {
            modulus: [(); MEMBRANES].map(|()| batch + sampler.uniform(-0.03, 0.03)),
            radius_m: sampler.uniform(5e-3, 7e-3),
            burst_stretch: [(); MEMBRANES].map(|()| sampler.uniform(3.6, 4.4)),
            suction_pa: sampler.uniform(3.7e3, 11.6e3),
            stiffness_n_m: [(); 2].map(|()| sampler.uniform(600.0, 1000.0)),
            leak_strain: [(); 2].map(|()| sampler.uniform(0.06, 0.20)),
            kink: if sampler.uniform(0.0, 1.0) < 0.1 { 0.01 } else { 1.0 },
        }
    }

    /// Changes a robot to this case.
    ///
    /// # Errors
    /// The reason in words: the robot has no suction pad, or the changed pad is not valid.
    pub fn put_into(&self, robot: &mut Robot, feed: Feed) -> Result<(), String> {
        let nominal = pad(robot)?;
        let mut membranes = *nominal.membranes();
        for (number, membrane) in membranes.iter_mut().enumerate() {
            membrane.shear_pa *= self.modulus[number];
            membrane.radius_m = self.radius_m;
            membrane.burst_stretch = self.burst_stretch[number];
        }
        let mut cups = *nominal.cups();
        for (number, cup) in cups.iter_mut().enumerate() {
            *cup = Cup {
                suction_pa: self.suction_pa,
                stiffness_n_m: self.stiffness_n_m[number],
                leak_strain: self.leak_strain[number],
                ..*cup
            };
        }
        let mut lines = *nominal.lines();
        lines[MIDDLE].tube.conductance_m3_s_pa *= self.kink;
        let supply_pa = if let Feed::Supply(pa) = feed { Some(pa) } else { None };
        let changed = SuctionPad::new(*nominal.strip(), cups, membranes, lines, supply_pa);
        replace(robot, changed.map_err(|error| error.to_string())?);
        Ok(())
    }

    /// Returns the function by which a rig changes its robot to this case.
    pub fn altered(self, feed: Feed) -> Alter {
        // A robot without a pad stays as it is: `Setup::of` has refused it.
        Rc::new(move |robot| drop(self.put_into(robot, feed)))
    }
}

/// An effect that a recorded membrane may have and the base model of the search lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hidden {
    /// Mullins effect: less pressure on reloading than on the first loading.
    Mullins,
    /// Creep: pressure that relaxes at a constant stretch.
    Creep,
    /// Leak of the membrane, proportional to its pressure.
    Leak,
}

/// A pad in air whose middle membrane has a random modulus and at most one effect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blind {
    modulus: f64,
    hidden: Option<(Hidden, [f64; 2])>,
}

impl Blind {
    /// Samples the pad of a seed with this effect.
    #[must_use]
    pub fn of(seed: u64, hidden: Option<Hidden>) -> Self {
        let mut sampler = Sampler::new(seed, OF_BLIND);
        let modulus = sampler.uniform(0.8, 1.2);
        let hidden = hidden.map(|hidden| {
            let size = match hidden {
                Hidden::Mullins => [sampler.uniform(0.15, 0.35), 0.0],
                Hidden::Creep => [sampler.uniform(0.10, 0.25), sampler.uniform(1.0, 3.0)],
                Hidden::Leak => [sampler.uniform(2e-13, 6e-13), 0.0],
            };
            (hidden, size)
        });
        Self { modulus, hidden }
    }

    /// Returns the function by which a rig changes its robot to this pad.
    pub fn altered(self) -> Alter {
        Rc::new(move |robot| {
            let Ok(nominal) = pad(robot) else { return };
            let mut membranes = *nominal.membranes();
            let mut lines = *nominal.lines();
            let membrane = &mut membranes[MIDDLE];
            membrane.shear_pa *= self.modulus;
            match self.hidden {
                Some((Hidden::Mullins, [share, _])) => membrane.softening = share,
                Some((Hidden::Creep, [share, time_s])) => {
                    *membrane = Membrane { relaxing: share, relaxing_s: time_s, ..*membrane };
                }
                Some((Hidden::Leak, [conductance, _])) => lines[MIDDLE].leak.conductance_m3_s_pa = conductance,
                None => {}
            }
            let changed = SuctionPad::new(*nominal.strip(), *nominal.cups(), membranes, lines, None);
            if let Ok(changed) = changed {
                replace(robot, changed.in_air());
            }
        })
    }
}

fn replace(robot: &mut Robot, pad: SuctionPad) {
    if let Some(body) = &mut robot.simulation.body {
        body.kind = AnyBody::SuctionPad(Box::new(pad));
    }
}

/// The pad of a robot; an error in words when it has none.
pub(super) fn pad(robot: &Robot) -> Result<&SuctionPad, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::SuctionPad(pad)) => Ok(pad),
        _ => Err("it has no [body.suction-pad]".into()),
    }
}

/// Channels and scales of one line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Channel of the syringe pump's stepper.
    pub stepper: ChannelId,
    /// Channel of the valve.
    pub valve: ChannelId,
    /// Analog channel of the pressure sensor.
    pub sensor: ChannelId,
    /// Voltage of the sensor at atmospheric pressure, V.
    pub zero_v: f64,
    /// Gain of the sensor, V/Pa.
    pub volts_per_pa: f64,
    /// Volume displaced per rad of the pump's shaft, m³/rad.
    pub m3_per_rad: f64,
    /// Volume of syringe, tube and sensor with the pump at 0, m³.
    pub volume_m3: f64,
}

/// Channels and datasheet values that a program knows of its robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Lines in the order outer, middle, outer.
    pub lines: [Line; MEMBRANES],
    /// Middle membrane as cast, with the datasheet's modulus.
    pub membrane: Membrane,
}

impl Setup {
    /// Reads the setup of a robot.
    ///
    /// # Errors
    /// The part that the robot lacks, in words.
    pub fn of(robot: &Robot) -> Result<Self, String> {
        let pad = pad(robot)?;
        let channels = robot.simulation.body.as_ref().map_or(&[][..], |body| &body.channels);
        let line = |number: usize| {
            let line = &pad.lines()[number];
            let channel = |shaft: usize| channels.get(shaft).copied().ok_or("a line has no pump or valve");
            let reads = |analog: &&r4_boards::SimulatedAnalog| analog.reads.is_some_and(|reads| reads.number == number);
            let sensor = robot.simulation.analogs.iter().find(reads);
            let (sensor, reads) = sensor
                .and_then(|sensor| Some((sensor.channel, sensor.reads?)))
                .ok_or_else(|| format!("no analog input reads pressure_{number}_pa"))?;
            Ok::<_, String>(Line {
                stepper: channel(line.stepper)?,
                valve: channel(line.valve)?,
                sensor,
                zero_v: reads.zero,
                volts_per_pa: reads.per_unit,
                m3_per_rad: line.lead_m * line.bore_m2 / TAU,
                volume_m3: line.syringe_m3 + line.dead_m3,
            })
        };
        Ok(Self { lines: [line(0)?, line(1)?, line(2)?], membrane: pad.membranes()[MIDDLE] })
    }
}
