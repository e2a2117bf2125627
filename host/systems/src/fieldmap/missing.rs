//! Search for effects missing from the model of a field mill, in laps through a pair of plates.
//!
//! Plates of a known voltage stand across a lane in a hall without a field. The robot drives through them to and fro,
//! at two speeds, and stands before each lap. The base model is the calibrated mill with an offset that may have
//! changed. Each lap gives four numbers: the distance between the plates' apparent centres, to and fro; the relative
//! error of the field between them; the signal beside them while the robot drives; and the signal at rest.
//!
//! | effect | apart | height | beside | at rest | size |
//! | --- | --- | --- | --- | --- | --- |
//! | `form-factor` | | s | | | relative error s of the calibrated form factor, 1 |
//! | `wheel-charge` | | | q(t) | q(t) | field that a radian of the wheels adds, V/m |
//! | `mill-lag` | removed by y + T dy/dt in place of the signal y | the same | | | time constant T, s |
//!
//! None is a formula of the simulated mill, which samples the field and integrates.

use r4_boards::{Robot, SelfCharge};
use r4_maps::pose::Point;
use r4_rig::{Follower, Limits, Place, Velocity};
use r4_world::{Charge, ElectricSpec};

use super::{
    mill::{Calibration, ChargeState},
    scene::{Mill, Scene},
    survey::limits,
};
use crate::{
    Error, Sampler,
    effects::{Effect, Found, Search},
    rover::Program,
};

/// Number of laps, each at one of these speeds in turn, m/s. The last is held out.
pub const LAPS: usize = 10;
const SPEEDS_M_S: [f64; 2] = [0.4, 0.2];
/// Ends of the lane, m.
pub const ENDS_M: [Point; 2] = [[0.0, 0.0], [8.0, 0.0]];
/// Middle of the plates, m; size of their field, m; field in their middle, V/m.
const PLATES_M: Point = [4.0, 0.0];
const PLATES_SIZE_M: f64 = 0.7;
const PLATES_V_PER_M: f64 = 150.0;
/// Distance from the plates' middle beyond which their field is below 0.02 V/m, m.
const BESIDE_M: f64 = 3.0;
/// Calibration that the program assumes.
const CALIBRATED: Calibration = Calibration { offset_v: 2.5, form: 1.4, per_rad: 0.0, leak_s: LEAK_S };
/// Time constant of the charge's leak, s: known from the calibration.
const LEAK_S: f64 = 60.0;
/// Units of the four numbers, which make their scatter about alike: m, share of the plates' field, V/m, V/m. Our
/// choice.
const UNITS: [f64; 4] = [0.02, 0.001, 0.1, 0.1];
/// Purpose of the random numbers of the change.
const OF_CHANGE: u64 = 1_404;
/// Smallest changes that are claimed: above the errors from a telemetry period of 20 ms and the pose's 2 cm.
const LEAST: [f64; 3] = [0.01, 0.003, 0.15];

/// Names of the candidate effects, in their order.
pub const NAMES: [&str; 3] = ["form-factor", "wheel-charge", "mill-lag"];

/// Hidden change of a mill.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// Relative error of the form factor.
    Form(f64),
    /// Field that a radian of the wheels adds, V/m.
    Charge(f64),
    /// A first-order lag of the mill's signal, by its time constant, s.
    Lag(f64),
}

impl Change {
    /// The change of this name, with a size sampled from `seed`; `None` for any other name.
    #[must_use]
    pub fn named(name: &str, seed: u64) -> Option<Self> {
        let mut sampler = Sampler::new(seed, OF_CHANGE);
        match NAMES.iter().position(|known| *known == name)? {
            0 => {
                let way = if sampler.uniform(0.0, 1.0) < 0.5 { -1.0 } else { 1.0 };
                Some(Self::Form(way * sampler.uniform(0.05, 0.15)))
            }
            1 => Some(Self::Charge(sampler.uniform(0.02, 0.06))),
            _ => Some(Self::Lag(sampler.uniform(0.5, 2.0))),
        }
    }

    /// Size of the change, in the candidate's unit.
    #[must_use]
    pub const fn size(self) -> f64 {
        match self {
            Self::Form(size) | Self::Charge(size) | Self::Lag(size) => size,
        }
    }
}

/// The hall with the plates, and a mill as calibrated.
///
/// # Errors
/// [`Error::Unsuitable`] when the field is not valid.
pub fn scene() -> Result<Scene, Error> {
    let plates = Charge { place_m: PLATES_M, size_m: PLATES_SIZE_M, peak_v_per_m: PLATES_V_PER_M };
    let mill = Mill {
        form: CALIBRATED.form,
        zero_v: CALIBRATED.offset_v,
        charge: SelfCharge::NONE,
        gap_error: 0.0,
        voltage_errors: Default::default(),
    };
    Scene::with(ElectricSpec { charges: vec![plates], ..ElectricSpec::default() }, mill)
}

/// Hides a change in the mill of a robot, and removes the lag that its file has.
pub fn hide(change: Option<Change>, robot: &mut Robot) {
    for reading in robot.simulation.analogs.iter_mut().filter_map(|analog| analog.field.as_mut()) {
        reading.lag_s = 0.0;
        match change {
            Some(Change::Form(error)) => reading.enhancement *= 1.0 + error,
            Some(Change::Charge(per_rad)) => reading.charge = SelfCharge { rest: 0.0, per_rad, leak_s: LEAK_S },
            Some(Change::Lag(time_s)) => reading.lag_s = time_s,
            None => {}
        }
    }
}

/// One sample of the mill in a crossing or at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time of the reading, s.
    pub time_s: f64,
    /// Position along the lane, m.
    pub place_m: f64,
    /// Field by the calibration, V/m.
    pub field: f64,
    /// Field of the charge if a radian of the wheels added 1 V/m, V/m.
    pub per_charge: f64,
}

/// Samples of one lap.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lap {
    /// Samples of the drive there and back.
    pub crossings: [Vec<Sample>; 2],
    /// Samples at rest before the drive.
    pub rest: Vec<Sample>,
}

impl Lap {
    /// The four numbers in their units, after correction for a lag, s; `None` where a crossing did not meet the plates.
    fn numbers(&self, lag_s: f64) -> Option<[f64; 4]> {
        let [there, back] = [0, 1].map(|leg: usize| profile(&self.crossings[leg], lag_s));
        let (there, back) = (there?, back?);
        let height = f64::midpoint(there.height, back.height) / PLATES_V_PER_M - 1.0;
        let beside = mean(self.beside(), |sample| sample.field)?;
        let rest = mean(self.rest.iter(), |sample| sample.field)?;
        let numbers = [there.centre_m - back.centre_m, height, beside, rest];
        Some(std::array::from_fn(|index| numbers[index] / UNITS[index]))
    }

    fn beside(&self) -> impl Iterator<Item = &Sample> {
        self.crossings.iter().flatten().filter(|sample| (sample.place_m - PLATES_M[0]).abs() > BESIDE_M)
    }

    /// Field of the charge beside the plates and at rest if a radian added 1 V/m, V/m.
    fn per_charge(&self) -> [f64; 2] {
        let of = |sample: &Sample| sample.per_charge;
        [mean(self.beside(), of), mean(self.rest.iter(), of)].map(Option::unwrap_or_default)
    }
}

fn mean<'s>(samples: impl Iterator<Item = &'s Sample>, of: impl Fn(&Sample) -> f64) -> Option<f64> {
    let (sum, count) = samples.fold((0.0, 0.0), |(sum, count), sample| (sum + of(sample), count + 1.0));
    (count > 0.0).then_some(sum / count)
}

struct Profile {
    centre_m: f64,
    height: f64,
}

/// Centroid of the plates' field in a crossing, and its height above the signal beside the plates; the field is `y + T
/// dy/dt` for a lag T.
fn profile(crossing: &[Sample], lag_s: f64) -> Option<Profile> {
    let near = |place_m: f64| (place_m - PLATES_M[0]).abs() < BESIDE_M;
    let corrected: Vec<(f64, f64)> = crossing
        .windows(3)
        .map(|three| {
            let rate = (three[2].field - three[0].field) / (three[2].time_s - three[0].time_s);
            (three[1].place_m, three[1].field + lag_s * rate)
        })
        .collect();
    let beside: Vec<f64> = corrected.iter().filter(|(place_m, _)| !near(*place_m)).map(|(_, field)| *field).collect();
    let beside = (!beside.is_empty()).then(|| beside.iter().sum::<f64>() / beside.len() as f64)?;
    let inside: Vec<(f64, f64)> = corrected
        .iter()
        .filter(|(place_m, _)| near(*place_m))
        .map(|(place_m, field)| (*place_m, field - beside))
        .collect();
    let area = |of: &dyn Fn(f64) -> f64| -> f64 {
        let steps = inside.windows(2);
        steps
            .map(|pair| {
                f64::midpoint(pair[0].1, pair[1].1) * (pair[1].0 - pair[0].0) * of(f64::midpoint(pair[0].0, pair[1].0))
            })
            .sum()
    };
    let whole = area(&|_| 1.0);
    let height = inside.iter().map(|(_, field)| *field).fold(0.0, f64::max);
    (whole.abs() > 1.0).then(|| Profile { centre_m: area(&|place_m| place_m) / whole, height })
}

/// Searches the laps for the change; `None` where they show none.
///
/// # Errors
/// [`Error::Effects`] where a lap did not meet the plates, or for too few laps.
pub fn found(laps: &[Lap]) -> Result<Option<Found>, Error> {
    let effects = [0, 1, 2].map(|index| Effect {
        name: NAMES[index],
        start: &[[0.02], [0.01], [0.3]][index],
        absent: 0.0,
        least: LEAST[index],
    });
    let numbers: Option<Vec<[f64; 4]>> = laps.iter().map(|lap| lap.numbers(0.0)).collect();
    let numbers = numbers.ok_or_else(|| Error::Effects("a lap did not meet the plates".into()))?;
    let observed: Vec<Vec<f64>> = numbers.iter().copied().map(Vec::from).collect();
    let predict = |effect: Option<usize>, parameters: &[f64], run: usize| {
        // The base model: the offset may have changed since the calibration.
        let mut predicted = vec![0.0, 0.0, parameters[0] / UNITS[2], parameters[0] / UNITS[3]];
        let size = parameters.get(1).copied().unwrap_or(0.0);
        match effect {
            Some(0) => predicted[1] += size / UNITS[1],
            Some(1) => {
                let [beside, rest] = laps[run].per_charge();
                predicted[2] += size * beside / UNITS[2];
                predicted[3] += size * rest / UNITS[3];
            }
            // The lag's influence on the numbers is what its correction removes.
            Some(_) => {
                let corrected = laps[run].numbers(size).unwrap_or([f64::NAN; 4]);
                predicted[0] += numbers[run][0] - corrected[0];
                predicted[1] += numbers[run][1] - corrected[1];
            }
            None => {}
        }
        predicted
    };
    Search { base_start: &[0.0], effects: &effects, observed: &observed, predict: &predict }.run()
}

/// Time at rest before each lap, s.
const STANDS_S: f64 = 5.0;

/// Program that drives [`LAPS`] laps.
#[derive(Debug, Default)]
pub struct Crossings {
    laps: Vec<Lap>,
    charge: ChargeState,
    stands_until_s: Option<f64>,
    follower: Option<Follower>,
    /// Direction of the present leg: 0 there, 1 back.
    leg: usize,
    is_straight: bool,
}

impl Crossings {
    /// Returns the completed laps.
    #[must_use]
    pub fn into_laps(self) -> Vec<Lap> {
        self.laps
    }

    fn speed_m_s(&self) -> f64 {
        SPEEDS_M_S[self.laps.len().saturating_sub(1) % SPEEDS_M_S.len()]
    }

    fn follower(&self) -> Follower {
        Follower::new(Limits { speed_m_s: self.speed_m_s(), ..limits() }, [ENDS_M[1 - self.leg]])
    }
}

impl Program for Crossings {
    fn sense(&mut self, time_s: f64, at: Place, volts: f64) {
        let sample =
            Sample { time_s, place_m: at.x_m, field: CALIBRATED.field(volts, 0.0), per_charge: self.charge.field() };
        let Some(lap) = self.laps.last_mut() else { return };
        if self.follower.is_none() {
            lap.rest.push(sample);
        // Samples of ramps and turns are dropped: a profile needs one speed.
        } else if self.is_straight {
            lap.crossings[self.leg].push(sample);
        }
    }

    fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        self.charge.roll(&Calibration { per_rad: 1.0, ..CALIBRATED }, time_s, angle_rad);
    }

    fn drive(&mut self, time_s: f64, at: Place, free_m: f64) -> Option<Velocity> {
        loop {
            if let Some(follower) = &mut self.follower {
                if let Some(velocity) = follower.velocity(at, free_m) {
                    self.is_straight = velocity.forward_m_s > 0.99 * self.speed_m_s();
                    return Some(velocity);
                }
                self.is_straight = false;
                self.leg += 1;
                if self.leg < 2 {
                    self.follower = Some(self.follower());
                    continue;
                }
                (self.follower, self.stands_until_s) = (None, None);
            }
            let until_s = match self.stands_until_s {
                Some(until_s) => until_s,
                None if self.laps.len() == LAPS => return None,
                None => {
                    self.laps.push(Lap::default());
                    *self.stands_until_s.insert(time_s + STANDS_S)
                }
            };
            if time_s < until_s {
                return Some(Velocity::default());
            }
            self.leg = 0;
            self.follower = Some(self.follower());
        }
    }
}
