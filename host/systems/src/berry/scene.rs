//! Bushes that the study samples, the two grippers, and what the program knows of them.

use std::rc::Rc;

use r4_boards::Robot;
use r4_protocol::ChannelId;
use r4_rig::Alter;
use r4_world::{AirSupply, AnyBody, Berry, BerryError, BerryPicker, Cylinder, Fingers};

use crate::sampler::Sampler;

/// Purposes of random numbers.
const OF_BUSH: u64 = 1;
const OF_SIGHT: u64 = 2;

/// Berries of a trial, as in the paper.
pub const BERRIES: usize = 34;
/// Between berries along the bush, m.
pub const PITCH_M: f64 = 0.04;
/// Mean reach of the bush, m.
pub const BUSH_M: f64 = 0.13;
/// Printed: the force of a gripper at 5 bar, N.
pub const PRINTED_N: f64 = 50.0;
/// Printed: the supply, Pa.
pub const PRINTED_PA: f64 = 5e5;
/// Squeeze that ours asks for, N: between what the strongest stalk needs on the smoothest berry, 2.4 N over twice 0.4, and the 7 N of the
/// weakest berry, below the middle because larger berries are squeezed more. Seeds 1 to 15: 5.06 N at most, nothing slipped.
pub const SQUEEZE_N: f64 = 4.5;

/// The paper's grippers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gripper {
    /// Eight flexible fingers pulled by tendons: as in the robot's file.
    Soft,
    /// A parallelogram of rigid parts, which the rod closes outwards.
    Hard,
}

/// A bush and how well it is seen. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Berries along the row.
    pub berries: Vec<Berry>,
    seed: u64,
    sight_m: f64,
}

impl Case {
    /// The case of a seed.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_BUSH);
        let mut berry = |number: usize| {
            let diameter_m = sampler.uniform(0.016, 0.022);
            Berry {
                place_m: [
                    BUSH_M + sampler.uniform(-0.01, 0.01),
                    PITCH_M * (number + 1) as f64 + sampler.uniform(-0.004, 0.004),
                ],
                diameter_m,
                // Of the density of water.
                mass_kg: 1000.0 * std::f64::consts::PI / 6.0 * diameter_m.powi(3),
                stiffness_n_per_m: sampler.uniform(1200.0, 1800.0),
                friction: sampler.uniform(0.4, 0.7),
                stalk_n_per_m: sampler.uniform(120.0, 200.0),
                detach_n: sampler.uniform(0.6, 2.4),
                crush_n: sampler.uniform(7.0, 14.0),
            }
        };
        let berries = (0..BERRIES).map(&mut berry).collect();
        Self { berries, seed, sight_m: sampler.uniform(0.002, 0.004) }
    }

    /// Where a camera sees a berry in an attempt: reach and row, m.
    #[must_use]
    pub fn seen_m(&self, berry: usize, attempt: usize) -> [f64; 2] {
        let mut sampler = Sampler::new(self.seed, OF_SIGHT + (berry * 16 + attempt) as u64);
        self.berries[berry].place_m.map(|place_m| place_m + sampler.normal(self.sight_m))
    }

    /// What a rig does to a robot to make it this case.
    pub fn altered(&self, gripper: Gripper, regulated_pa: f64) -> Alter {
        let case = self.clone();
        // A robot without a gripper stays as it is: `Setup::of` has refused it.
        Rc::new(move |robot| drop(case.put_into(robot, gripper, regulated_pa)))
    }

    /// Changes a robot to this case.
    ///
    /// # Errors
    /// What the robot's file has in place of a gripper, or why it cannot be this one.
    pub fn put_into(&self, robot: &mut Robot, gripper: Gripper, regulated_pa: f64) -> Result<(), String> {
        let changed = body(picker(robot)?, gripper, regulated_pa, self.berries.clone());
        let changed = changed.map_err(|error| error.to_string())?;
        if let Some(body) = &mut robot.simulation.body {
            body.kind = AnyBody::BerryPicker(Box::new(changed));
        }
        Ok(())
    }
}

/// What a rig does to a robot to give it another gripper.
pub(super) fn replaced(picker: BerryPicker) -> Alter {
    Rc::new(move |robot| {
        if let Some(body) = &mut robot.simulation.body {
            body.kind = AnyBody::BerryPicker(Box::new(picker.clone()));
        }
    })
}

fn body(
    nominal: &BerryPicker,
    gripper: Gripper,
    regulated_pa: f64,
    berries: Vec<Berry>,
) -> Result<BerryPicker, BerryError> {
    let (mut cylinder, mut fingers): (Cylinder, Fingers) = (*nominal.cylinder(), *nominal.fingers());
    if gripper == Gripper::Hard {
        cylinder.closes_outwards = true;
        // Synthetic: rigid fingers with thin pads that stop 12 mm apart.
        fingers = Fingers { stiffness_n_per_m: 6000.0, bending_n_per_m: 0.0, gap_ratio: 0.96, ..fingers };
    }
    let supply = AirSupply { regulated_pa, ..*nominal.supply() };
    BerryPicker::new(supply, *nominal.valve(), cylinder, fingers, *nominal.axes(), berries)
}

/// The gripper of a robot.
pub(super) fn picker(robot: &Robot) -> Result<&BerryPicker, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::BerryPicker(picker)) => Ok(picker),
        _ => Err("it has no [body.berry-picker]".into()),
    }
}

/// What the program knows before it starts: channels and data sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// The valve's relay.
    pub valve: ChannelId,
    /// Reach and row.
    pub axes: [ChannelId; 2],
    /// m per rad of both axes.
    pub m_per_rad: f64,
    /// Reach over the tray, m.
    pub tray_m: f64,
    /// Transmitter at the closing chamber: V without pressure, and V per Pa.
    pub pressure_v: [f64; 2],
    /// Setting of the regulator, Pa.
    pub regulated_pa: f64,
}

/// The closing chamber's pressure.
pub const PRESSURE: ChannelId = ChannelId::new(r4_protocol::ChannelKind::Analog, 0);
/// The handle's microswitch.
pub const HANDLE: ChannelId = ChannelId::new(r4_protocol::ChannelKind::Switch, 0);

impl Setup {
    /// That of a robot with its regulator at some pressure.
    ///
    /// # Errors
    /// What the robot lacks.
    pub fn of(robot: &Robot, regulated_pa: f64) -> Result<Self, String> {
        let picker = picker(robot)?;
        let channels = robot.simulation.body.as_ref().map_or(&[][..], |body| &body.channels);
        let channel = |shaft: usize| channels.get(shaft).copied().ok_or("a shaft has no channel");
        let [reach, row] = picker.axes().shafts;
        let sensor = robot.simulation.analogs.iter().find(|analog| analog.channel == PRESSURE);
        let sensor = sensor.and_then(|analog| analog.reads).ok_or("no pressure is on analog0")?;
        Ok(Self {
            valve: channel(picker.valve().shaft)?,
            axes: [channel(reach)?, channel(row)?],
            m_per_rad: picker.axes().m_per_rad,
            tray_m: picker.axes().tray_m,
            pressure_v: [sensor.zero, sensor.per_unit],
            regulated_pa,
        })
    }
}

/// Pressure at which the rod of the soft gripper stalls on a berry of mean size with [`SQUEEZE_N`], Pa, by statics of the data sheet:
/// bending, squeeze and half of the dry friction over the area. `area_m2` is what the designer takes for it.
#[must_use]
pub fn stall_pa(picker: &BerryPicker, area_m2: f64) -> f64 {
    const DIAMETER_M: f64 = 0.019;
    const BERRY_N_PER_M: f64 = 1500.0;
    let fingers = picker.fingers();
    let squashed_m = SQUEEZE_N * (1.0 / fingers.stiffness_n_per_m + 1.0 / BERRY_N_PER_M);
    let travel_m = (fingers.open_gap_m - DIAMETER_M + squashed_m) / fingers.gap_ratio;
    let rod_n = fingers.bending_n_per_m * travel_m + fingers.gap_ratio * SQUEEZE_N + picker.cylinder().coulomb_n;
    rod_n / area_m2
}
