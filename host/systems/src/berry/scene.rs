//! Bushes that the study samples, the two grippers, and the values that the program knows of them.

use std::rc::Rc;

use r4_boards::Robot;
use r4_protocol::ChannelId;
use r4_rig::Alter;
use r4_world::{AirSupply, AnyBody, Berry, BerryError, BerryPicker, Cylinder, Fingers};

use crate::sampler::Sampler;

/// Purposes of the random numbers: the bush, and the camera's errors.
const OF_BUSH: u64 = 1;
const OF_SIGHT: u64 = 2;

/// Number of berries in a trial, as in the paper.
pub const BERRIES: usize = 34;
/// Distance between berries along the bush, m.
pub const PITCH_M: f64 = 0.04;
/// Mean reach of the bush, m.
pub const BUSH_M: f64 = 0.13;
/// Force of a gripper at 5 bar, N: printed.
pub const PRINTED_N: f64 = 50.0;
/// Supply pressure, Pa: printed.
pub const PRINTED_PA: f64 = 5e5;
/// Squeeze that our arm requests, N: between what the strongest stalk needs on the smoothest berry, 2.4 N over twice
/// 0.4, and the 7 N of the weakest berry; below the middle, because larger berries are squeezed more. Seeds 1 to 15: at
/// most 5.06 N, and nothing slipped.
pub const SQUEEZE_N: f64 = 4.5;

/// The two grippers of the paper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gripper {
    /// Soft gripper of the robot's file: eight flexible fingers pulled by tendons.
    Soft,
    /// Hard gripper: a parallelogram of rigid parts, which closes when the rod extends.
    Hard,
}

/// A bush and the accuracy of the camera. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Debug, PartialEq)]
pub struct Case {
    /// Berries of the bush, along the row.
    pub berries: Vec<Berry>,
    seed: u64,
    sight_m: f64,
}

impl Case {
    /// Samples the case of a seed.
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
                // The density of water, 1000 kg/m³.
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

    /// Position of a berry as the camera measures it in an attempt: reach and row, m.
    #[must_use]
    pub fn seen_m(&self, berry: usize, attempt: usize) -> [f64; 2] {
        let mut sampler = Sampler::new(self.seed, OF_SIGHT + (berry * 16 + attempt) as u64);
        self.berries[berry].place_m.map(|place_m| place_m + sampler.normal(self.sight_m))
    }

    /// Returns the function by which a rig changes its robot to this case.
    pub fn altered(&self, gripper: Gripper, regulated_pa: f64) -> Alter {
        let case = self.clone();
        // A robot without a gripper stays as it is: `Setup::of` has refused it.
        Rc::new(move |robot| drop(case.put_into(robot, gripper, regulated_pa)))
    }

    /// Changes a robot to this case.
    ///
    /// # Errors
    /// The reason in words: the robot has no gripper, or the changed one is not valid.
    pub fn put_into(&self, robot: &mut Robot, gripper: Gripper, regulated_pa: f64) -> Result<(), String> {
        let changed = body(picker(robot)?, gripper, regulated_pa, self.berries.clone());
        let changed = changed.map_err(|error| error.to_string())?;
        if let Some(body) = &mut robot.simulation.body {
            body.kind = AnyBody::BerryPicker(Box::new(changed));
        }
        Ok(())
    }
}

/// Returns the function by which a rig replaces its robot's gripper.
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
        // Synthetic: rigid fingers with thin pads, which stop 12 mm apart.
        fingers = Fingers { stiffness_n_per_m: 6000.0, bending_n_per_m: 0.0, gap_ratio: 0.96, ..fingers };
    }
    let supply = AirSupply { regulated_pa, ..*nominal.supply() };
    BerryPicker::new(supply, *nominal.valve(), cylinder, fingers, *nominal.axes(), berries)
}

/// The gripper of a robot; an error in words when it has none.
pub(super) fn picker(robot: &Robot) -> Result<&BerryPicker, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::BerryPicker(picker)) => Ok(picker),
        _ => Err("it has no [body.berry-picker]".into()),
    }
}

/// Channels and datasheet values that the program knows before it starts.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Channel of the valve's relay.
    pub valve: ChannelId,
    /// Channels of the axes: reach and row.
    pub axes: [ChannelId; 2],
    /// Displacement of both axes per rad of their motors, m/rad.
    pub m_per_rad: f64,
    /// Reach of the tool over the tray, m.
    pub tray_m: f64,
    /// Transmitter at the closing chamber: voltage without pressure, V, and gain, V/Pa.
    pub pressure_v: [f64; 2],
    /// Pressure set at the regulator, Pa.
    pub regulated_pa: f64,
}

/// Analog channel of the closing chamber's pressure.
pub const PRESSURE: ChannelId = ChannelId::new(r4_protocol::ChannelKind::Analog, 0);
/// Channel of the handle's microswitch.
pub const HANDLE: ChannelId = ChannelId::new(r4_protocol::ChannelKind::Switch, 0);

impl Setup {
    /// Reads the setup of a robot whose regulator is set to `regulated_pa`.
    ///
    /// # Errors
    /// The part that the robot lacks, in words.
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

/// Pressure at which the soft gripper's rod stalls on a berry of mean size with [`SQUEEZE_N`], Pa, by statics with
/// datasheet values: bending, squeeze and dry friction over the piston area. `area_m2` is the area that the designer
/// assumes.
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
