//! Search for a change in the air system of a gripper since it was commissioned: valve, tube or compressor.
//!
//! The fingers close and open over the tray in [`RUNS`] recordings, each from a full receiver. Each closing gives three
//! numbers: the time from the command to the rise of the pressure, the duration of the rise, and the final pressure.
//! The same recordings of the new gripper are the base model, up to the gain of the transmitter. Candidates:
//!
//! | effect | changes | size |
//! | --- | --- | --- |
//! | `slow-valve` | the start of the rise | added delay, ms |
//! | `narrow-tube` | the duration of the rise, by 1 over the size, and its start | conductance over that when new |
//! | `weak-compressor` | the final pressure, from where the receiver falls below the regulator on, and with it the rise | delivery over that when new |
//!
//! The last follows from an isothermal balance of air per cycle, without the rod's motion: no formula of the simulated
//! gripper is used.

use r4_world::{ATMOSPHERE_PA, BerryPicker};

use crate::{
    Error, Sampler,
    effects::{Effect, Found, Search},
};

/// Number of recordings; the last is held out.
pub const RUNS: usize = 4;
/// Number of closings in a recording.
pub const CLOSINGS: usize = 14;
/// Pressures between which the rise is timed, Pa: in the chamber at the rod's end while the rod still rests. With an
/// upper limit of 300 kPa the rod begins to move in some closings and not in others, and sizes were off by 70 % (seeds
/// 1 to 12).
pub const RISES_PA: [f64; 2] = [20e3, 150e3];
/// Purposes of the random numbers: size of the change, and times of the closings.
const OF_CHANGE: u64 = 7_001;
const OF_TIMES: u64 = 7_002;
/// Units of pressures, Pa, and times, s. They make the scatter of both alike, between half and the whole unit, as the
/// fit needs it.
const UNIT_PA: f64 = 1e3;
const UNIT_S: f64 = 1e-3;

/// Smallest changes that are claimed, in the units of the table: 0.5 ms of a valve, 2 % of conductance, 5 % of
/// delivery. The driver's map of the board's clock differs by some 0.05 ms between sessions, which the scatter within
/// one session does not show.
const LEAST: [f64; 3] = [0.5, 0.02, 0.05];
/// Pressure of reference air, Pa, to which a conductance refers: ISO 6358-1, 3.3.
const REFERENCE_PA: f64 = 100e3;

/// Names of the candidate effects, in their order.
pub const NAMES: [&str; 3] = ["slow-valve", "narrow-tube", "weak-compressor"];

/// Hidden change of a gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// Additional delay between the relay's contact and the spool's motion, s.
    SlowValve(f64),
    /// Conductance of inlet and tube over the nominal one.
    NarrowTube(f64),
    /// Delivery of the compressor over the nominal one.
    WeakCompressor(f64),
}

impl Change {
    /// The change of this name, with a size sampled from `seed`; `None` for any other name.
    #[must_use]
    pub fn named(name: &str, seed: u64) -> Option<Self> {
        let mut sampler = Sampler::new(seed, OF_CHANGE);
        match NAMES.iter().position(|known| *known == name)? {
            0 => Some(Self::SlowValve(sampler.uniform(0.008, 0.030))),
            1 => Some(Self::NarrowTube(sampler.uniform(0.5, 0.8))),
            _ => Some(Self::WeakCompressor(sampler.uniform(0.2, 0.7))),
        }
    }

    /// Returns the gripper with this change.
    ///
    /// # Errors
    /// The error of [`BerryPicker::new`] when the changed gripper is not valid.
    pub fn put_into(self, picker: &BerryPicker) -> Result<BerryPicker, r4_world::BerryError> {
        let (mut supply, mut valve) = (*picker.supply(), *picker.valve());
        match self {
            Self::SlowValve(added_s) => valve.delay_s[0] += added_s,
            Self::NarrowTube(share) => valve.inlet.conductance_m3_s_pa *= share,
            Self::WeakCompressor(share) => supply.compressor_m3_s *= share,
        }
        let berries = picker.berries().to_vec();
        BerryPicker::new(supply, valve, *picker.cylinder(), *picker.fingers(), *picker.axes(), berries)
    }
}

/// Durations for which the fingers close and open in a recording, s. They scatter by 4 ms, so that no phase of the
/// samples repeats.
#[must_use]
pub fn schedule(seed: u64, run: usize) -> Vec<[f64; 2]> {
    let mut sampler = Sampler::new(seed, OF_TIMES + run as u64);
    (0..CLOSINGS).map(|_| [0.45, 0.35].map(|time_s| time_s + sampler.uniform(0.0, 0.004))).collect()
}

/// A closing, described by its pressure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closing {
    /// Time from the command to the lower pressure of [`RISES_PA`], s.
    pub begins_s: f64,
    /// Time between both pressures of [`RISES_PA`], s.
    pub rises_s: f64,
    /// Mean pressure of the last samples, Pa.
    pub ends_pa: f64,
    /// Time of the command, s.
    pub at_s: f64,
}

impl Closing {
    /// Evaluates samples of time, s, and pressure, Pa, from the command at `at_s` on; `None` where the pressure does
    /// not rise.
    #[must_use]
    pub fn of(at_s: f64, pressure_pa: &[(f64, f64)]) -> Option<Self> {
        let crosses_s = |level_pa: f64| {
            pressure_pa.windows(2).find(|pair| pair[0].1 < level_pa && pair[1].1 >= level_pa).map(|pair| {
                let [(from_s, from_pa), (to_s, to_pa)] = [pair[0], pair[1]];
                from_s + (to_s - from_s) * (level_pa - from_pa) / (to_pa - from_pa)
            })
        };
        let [begin_s, end_s] = RISES_PA.map(crosses_s);
        let (begin_s, end_s) = (begin_s?, end_s?);
        // The mean of ten samples reduces the transmitter's noise.
        let last = &pressure_pa[pressure_pa.len().saturating_sub(10)..];
        let ends_pa = last.iter().map(|(_, pressure_pa)| pressure_pa).sum::<f64>() / last.len() as f64;
        Some(Self { begins_s: begin_s - at_s, rises_s: end_s - begin_s, ends_pa, at_s })
    }
}

/// Datasheet of the air system: volumes of the receiver and of a cycle, m³; compressor, m³/s; pressures, Pa; time to
/// the first rise, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sheet {
    receiver_m3: f64,
    cycle_m3: f64,
    compressor_m3_s: f64,
    runs_between_pa: [f64; 2],
    regulated_pa: f64,
    begins_s: f64,
}

impl Sheet {
    /// Reads the datasheet values of a gripper.
    #[must_use]
    pub fn of(picker: &BerryPicker, regulated_pa: f64) -> Self {
        let supply = picker.supply();
        let cylinder = picker.cylinder();
        let swept_m3 = cylinder.areas_m2().iter().sum::<f64>() * cylinder.stroke_m;
        Self {
            receiver_m3: supply.receiver_m3,
            cycle_m3: swept_m3 + 2.0 * cylinder.dead_m3,
            compressor_m3_s: supply.compressor_m3_s,
            runs_between_pa: supply.runs_between_pa,
            regulated_pa,
            // Sonic inflow into the chamber of a resting rod: dp/dt = C p_supply p_reference / V (ISO 6358-1).
            begins_s: RISES_PA[0] * cylinder.dead_m3
                / (picker.valve().inlet.conductance_m3_s_pa * (regulated_pa + ATMOSPHERE_PA) * REFERENCE_PA),
        }
    }

    /// Pressure after the regulator at the end of each closing, Pa, with a share of the compressor's delivery. Each
    /// cycle takes its volume of air at the final pressure.
    fn ends_pa(&self, closings: &[Closing], share: f64) -> Vec<f64> {
        let [low_pa, high_pa] = self.runs_between_pa;
        let (mut receiver_pa, mut runs) = (high_pa, false);
        let mut before_s = closings.first().map_or(0.0, |closing| closing.at_s);
        let mut ends_pa = Vec::with_capacity(closings.len());
        for closing in closings {
            let source_pa = receiver_pa.min(self.regulated_pa);
            let after_s = closing.at_s - before_s;
            before_s = closing.at_s;
            // Hysteresis of the pressure switch: on below the low limit, off at the high one.
            runs = receiver_pa < if runs { high_pa } else { low_pa };
            let delivered_pa = if runs { share * self.compressor_m3_s * ATMOSPHERE_PA * after_s } else { 0.0 };
            receiver_pa += (delivered_pa - self.cycle_m3 * source_pa) / self.receiver_m3;
            ends_pa.push(receiver_pa.min(self.regulated_pa));
        }
        ends_pa
    }
}

/// Searches for the change between recordings of the new gripper and of the present one; `None` where they show none.
///
/// # Errors
/// [`Error::Effects`] for too few recordings, or recordings that differ in length from those of the new gripper.
pub fn found(sheet: &Sheet, new: &[Vec<Closing>], now: &[Vec<Closing>]) -> Result<Option<Found>, Error> {
    if new.len() != now.len() || new.iter().zip(now).any(|(new, now)| new.len() != now.len()) {
        return Err(Error::Effects("recordings of other lengths than when the gripper was new".into()));
    }
    let effects = [
        Effect { name: NAMES[0], start: &[5.0], absent: 0.0, least: LEAST[0] },
        Effect { name: NAMES[1], start: &[0.8], absent: 1.0, least: LEAST[1] },
        Effect { name: NAMES[2], start: &[0.7], absent: 1.0, least: LEAST[2] },
    ];
    let observed: Vec<Vec<f64>> = now.iter().map(|run| run.iter().flat_map(numbers).collect()).collect();
    let predict = |effect: Option<usize>, parameters: &[f64], run: usize| {
        let (gain, size) = (parameters[0], parameters.get(1).copied());
        let closings = &new[run];
        let lowered_pa = match (effect, size) {
            (Some(2), Some(share)) => {
                let [with, without] = [share, 1.0].map(|share| sheet.ends_pa(closings, share));
                with.iter().zip(&without).map(|(with_pa, without_pa)| with_pa - without_pa).collect()
            }
            _ => vec![0.0; closings.len()],
        };
        let predicted = closings.iter().zip(lowered_pa).flat_map(|(closing, lowered_pa)| {
            // Sonic inflow is proportional to the upstream pressure.
            let slower = (closing.ends_pa + ATMOSPHERE_PA) / (closing.ends_pa + lowered_pa + ATMOSPHERE_PA);
            let mut closing =
                Closing { ends_pa: closing.ends_pa + lowered_pa, rises_s: closing.rises_s * slower, ..*closing };
            match (effect, size) {
                (Some(0), Some(added_ms)) => closing.begins_s += added_ms * 1e-3,
                (Some(1), Some(share)) => {
                    closing.rises_s /= share;
                    closing.begins_s += sheet.begins_s * (1.0 / share - 1.0);
                }
                _ => {}
            }
            closing.ends_pa *= gain;
            numbers(&closing)
        });
        predicted.collect()
    };
    Search { base_start: &[1.0], effects: &effects, observed: &observed, predict: &predict }.run()
}

/// The numbers of a closing in units of their scatter.
fn numbers(closing: &Closing) -> [f64; 3] {
    [closing.begins_s / UNIT_S, closing.rises_s / UNIT_S, closing.ends_pa / UNIT_PA]
}
