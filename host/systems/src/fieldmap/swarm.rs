//! Robots that share an open field. Each chooses the site with the largest expected gain per second, from what it has
//! heard over an intermittent link.
//!
//! When the link is up, a robot sends its samples to a base and hears of the others' samples and goals. The base ends
//! the mission when the pattern, the spatial part less its mean, is known well enough: a constant belongs to drift as
//! well as to place, whatever is measured. All robots share one time: samples at many positions at one
//! moment separate drift from position.

use std::{cell::RefCell, rc::Rc};

use r4_maps::{
    grid::{Frame, Grid},
    pose::Point,
    process::{Kernel, Process, ProcessError, Sample},
};
use r4_rig::{Follower, Limits, Place, Velocity};

use super::{
    mill::Calibration,
    scene::{Plot, from_m},
    survey::{Mapper, limits},
};
use crate::{rover::Program, sampler::Sampler};

/// Prior kernel of the open field: the middle of the sampled ranges. Bells of a size s at random places have a covariance
/// of length √2 s.
pub const EXPECTED: Kernel =
    Kernel { place_deviation: 40.0, length_m: 200.0, time_deviation: 30.0, time_s: 150.0, noise: 5.0 };
/// Uncertainty at which the mission ends: root mean square deviation of the pattern at all sites, V/m. Half of the
/// spatial part's prior one.
pub const ENOUGH_V_PER_M: f64 = 20.0;
/// Averaging time of a reading, s: 13 m of travel.
pub const PERIOD_S: f64 = 30.0;
/// Number of sites along a side, at which the uncertainty is computed and to which robots may drive.
const SITES: usize = 10;
/// Period at which the base computes the uncertainty, s.
const LOOKS_S: f64 = 20.0;
/// Time that a goal costs besides its path, s: the average over a reading and the turn.
const OVERHEAD_S: f64 = 60.0;
/// Mean times for which a link is up and down, s.
const UP_S: f64 = 120.0;
const DOWN_S: f64 = 60.0;
/// Prior mean of the field, V/m: fair weather.
const FAIR_V_PER_M: f64 = 80.0;
/// Purpose of the random numbers of the links.
const OF_LINKS: u64 = 1_403;
/// Time limit of the mission, s: at 0.45 m/s the wheels have then turned for less than the 5.6 km of the robot's file.
pub const LATEST_S: f64 = 12_000.0;

/// Base station: the samples and goals that it received.
#[derive(Debug)]
pub struct Base {
    process: Process,
    /// Goals of the robots as last received; `None` for none.
    claims: Vec<Option<Point>>,
    sites: Vec<Point>,
    looked_s: f64,
    /// Time, s, and root mean square deviation of the pattern, V/m.
    pub deviation: Vec<(f64, f64)>,
    /// Time at which the deviation was low enough, s; `None` before.
    pub reached_s: Option<f64>,
}

impl Base {
    /// Creates a base station for `robots` robots.
    ///
    /// # Errors
    /// [`ProcessError`] when the prior kernel is not valid.
    pub fn new(plot: &Plot, robots: usize) -> Result<Rc<RefCell<Self>>, ProcessError> {
        let pitch_m = plot.side_m / SITES as f64;
        let site = |number: usize| [number % SITES, number / SITES].map(|place| (place as f64 + 0.5) * pitch_m);
        Ok(Rc::new(RefCell::new(Self {
            process: Process::new(EXPECTED)?,
            claims: vec![None; robots],
            sites: (0..SITES * SITES).map(site).collect(),
            looked_s: 0.0,
            deviation: Vec::new(),
            reached_s: None,
        })))
    }

    /// Samples that the base received, in their order.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        self.process.samples()
    }

    fn look(&mut self, time_s: f64) {
        if time_s - self.looked_s < LOOKS_S || self.reached_s.is_some() {
            return;
        }
        self.looked_s = time_s;
        let deviation = (self.process.pattern_covariance(&self.sites).trace() / self.sites.len() as f64).sqrt();
        self.deviation.push((time_s, deviation));
        if deviation <= ENOUGH_V_PER_M {
            self.reached_s = Some(time_s);
        }
    }
}

/// A link that is up and down for exponentially distributed times.
#[derive(Debug)]
struct Link {
    sampler: Sampler,
    is_up: bool,
    until_s: f64,
}

impl Link {
    fn is_up(&mut self, time_s: f64) -> bool {
        while time_s >= self.until_s {
            self.is_up = !self.is_up;
            let mean_s = if self.is_up { UP_S } else { DOWN_S };
            // Inversion of the exponential distribution; the lower bound keeps the logarithm finite.
            self.until_s -= mean_s * self.sampler.uniform(1e-9, 1.0).ln();
        }
        self.is_up
    }
}

/// One robot of the swarm.
#[derive(Debug)]
pub struct Member {
    number: usize,
    base: Rc<RefCell<Base>>,
    mapper: Mapper,
    link: Link,
    /// Samples of the base that the robot has heard of; goals of the others; samples that wait for the link.
    known: Vec<Sample>,
    heard: Vec<Option<Point>>,
    waiting: Vec<Sample>,
    follower: Follower,
    goal: Option<Point>,
}

/// Limits of the motion on open ground. At both limits at once the outer wheels turn at 9.47 rad/s; the robot's file
/// allows 9.5, and the board refuses more, which ends the mission.
pub(super) fn speeds() -> Limits {
    Limits { speed_m_s: 0.45, turn_rate_rad_s: 0.38, reached_m: 1.0, ..limits() }
}

impl Member {
    /// Creates robot number `number`, from 0 on.
    #[must_use]
    pub fn new(base: Rc<RefCell<Base>>, number: usize, seed: u64, calibration: Calibration) -> Self {
        let sampler = Sampler::new(seed, OF_LINKS + number as u64);
        let heard = base.borrow().claims.clone();
        Self {
            number,
            base,
            mapper: Mapper::new(calibration, PERIOD_S),
            link: Link { sampler, is_up: false, until_s: 0.0 },
            known: Vec::new(),
            heard,
            waiting: Vec::new(),
            follower: Follower::new(speeds(), []),
            goal: None,
        }
    }

    /// Number of samples that wait for the link.
    #[cfg(test)]
    pub(super) fn waiting(&self) -> usize {
        self.waiting.len()
    }

    /// Sends waiting samples and the own goal, and receives those of the others, when the link is up.
    fn exchange(&mut self, time_s: f64) {
        if !self.link.is_up(time_s) {
            return;
        }
        let mut base = self.base.borrow_mut();
        for sample in self.waiting.drain(..) {
            // A sample too close to an earlier one cannot be added, and would add nothing.
            let _ = base.process.add(sample);
        }
        base.claims[self.number] = self.goal;
        base.look(time_s);
        let new = base.samples().get(self.known.len()..).unwrap_or_default();
        self.known.extend_from_slice(new);
        self.heard.clone_from(&base.claims);
    }

    /// Site that reduces the pattern's variance at all sites most per second of its time, with the others' goals as if
    /// they were measured already.
    fn next(&self, time_s: f64, at: Place) -> Option<Point> {
        let others = self.heard.iter().enumerate().filter(|(number, _)| *number != self.number);
        // Their values are unknown and have no effect: only the covariance is used below.
        let claimed = others.filter_map(|(_, goal)| Some(Sample { at: (*goal)?, at_s: time_s, value: 0.0 }));
        let samples: Vec<Sample> = self.known.iter().chain(&self.waiting).copied().chain(claimed).collect();
        let process = Process::of(EXPECTED, &samples).ok()?;
        let base = self.base.borrow();
        let covariance = process.pattern_covariance(&base.sites);
        // A reading at the goal contains a drift that is not known yet. Without it, readings at sites that were measured
        // at other times seem to be worth as much as those at new ones, and the robots stay at a few sites.
        let unknown = EXPECTED.time_deviation.powi(2) + EXPECTED.noise.powi(2);
        let worth = |site: &usize| {
            let gain = covariance.column(*site).norm_squared() / (covariance[(*site, *site)] + unknown);
            gain / (from_m(at, base.sites[*site]) / speeds().speed_m_s + OVERHEAD_S)
        };
        let far_enough = |site: &usize| from_m(at, base.sites[*site]) > 2.0 * speeds().reached_m;
        let best = (0..base.sites.len()).filter(far_enough).max_by(|a, b| worth(a).total_cmp(&worth(b)))?;
        Some(base.sites[best])
    }
}

impl Program for Member {
    fn sense(&mut self, time_s: f64, at: Place, volts: f64) {
        if let Some(taken) = self.mapper.sense(time_s, at, volts) {
            let sample = taken.by(self.mapper.calibration());
            self.waiting.push(Sample { value: sample.value - FAIR_V_PER_M, ..sample });
        }
        self.exchange(time_s);
    }

    fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        self.mapper.rolled(time_s, angle_rad);
    }

    fn drive(&mut self, time_s: f64, at: Place, free_m: f64) -> Option<Velocity> {
        if time_s >= LATEST_S || self.base.borrow().reached_s.is_some() {
            return None;
        }
        if let Some(velocity) = self.follower.velocity(at, free_m) {
            return Some(velocity);
        }
        let goal = self.next(time_s, at)?;
        self.goal = Some(goal);
        self.follower = Follower::new(speeds(), [goal]);
        Some(self.follower.velocity(at, free_m).unwrap_or_default())
    }
}

/// Poses of the robots at the start: in a row across the middle of the plot, 2 m apart.
#[must_use]
pub fn starts(plot: &Plot, robots: usize) -> Vec<Place> {
    let middle_m = plot.side_m / 2.0;
    let place = |number: usize| Place { x_m: middle_m, y_m: middle_m + 2.0 * number as f64, yaw_rad: 0.0 };
    (0..robots).map(place).collect()
}

/// Map of the mean over a mission, V/m, from the base's samples.
///
/// # Errors
/// [`ProcessError`] for samples that define no regression.
pub fn map(frame: Frame, samples: &[Sample], until_s: f64) -> Result<Grid<f64>, ProcessError> {
    let process = Process::of(EXPECTED, samples)?;
    let steps = (until_s / LOOKS_S).ceil().max(1.0);
    let times_s = (0..steps as usize).map(|step| (step as f64 + 0.5) * until_s / steps);
    let middle = frame.centre(frame.cell(frame.cells() / 2));
    let drift = times_s.map(|time_s| process.predict(middle, time_s).time.mean).sum::<f64>() / steps;
    let value = |cell| FAIR_V_PER_M + drift + process.predict(frame.centre(cell), 0.0).place.mean;
    Ok(Grid::from_fn(frame, value))
}
