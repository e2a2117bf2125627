//! The robot's program on a plot: where it drives, and the readings that it takes on its way.

use r4_maps::{
    pose::{Point, distance_m},
    process::{Criterion, Kernel, Process, Sample, next_sites},
};
use r4_rig::{Follower, Limits, Place, Velocity};

use super::mill::{Calibration, ChargeState};
use crate::rover::Program;

/// A reading is the mean of the mill's signal over this time, s: 0.8 m of way, a fifth of the smallest space charge.
pub const PERIOD_S: f64 = 2.0;
/// Distance of the lawn-mower's rows, m: the size of the smallest space charge. Our choice; other values were not compared.
pub const SPACING_M: f64 = 5.0;
/// Laps of the loop.
pub const LAPS: usize = 3;
/// Sites that may be next, along a side.
const SITES: usize = 8;
/// Of the best sites this many are compared, and the nearest is driven to, so that the robot does not cross the plot to and fro. Our
/// choice; other values were not compared.
const NEAREST_OF: usize = 4;
/// What is expected of the plot before there are readings: the middle of the ranges.
pub const EXPECTED: Kernel =
    Kernel { place_deviation: 35.0, length_m: 6.0, time_deviation: 30.0, time_s: 150.0, noise: 3.0 };
/// An obstacle that stays this long in front makes the robot go elsewhere, s.
const PATIENCE_S: f64 = 12.0;

/// How the robot finds its way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Row by row.
    LawnMower,
    /// Round a square of half the plot's side, [`LAPS`] times.
    Loop,
    /// From site to site by their mutual information with the plot.
    Sites,
}

/// Speeds of the robot: four fifths of its top speed.
#[must_use]
pub fn limits() -> Limits {
    Limits { speed_m_s: 0.4, turn_rate_rad_s: 1.0, braking_m_s2: 0.5, stop_m: 0.35, reached_m: 0.2 }
}

/// The mill on its way: voltages become readings.
#[derive(Clone, Debug)]
pub struct Mapper {
    calibration: Calibration,
    charge: ChargeState,
    period_s: f64,
    begin_s: Option<f64>,
    window: Vec<Taken>,
    /// Voltages with the field of the charge at their time: what other calibrations make readings of.
    taken: Vec<Taken>,
}

/// A reading before it is a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taken {
    /// Place, m.
    pub at: Point,
    /// s
    pub at_s: f64,
    /// Mean voltage, V.
    pub volts: f64,
    /// Mean field of the body's charge, V/m.
    pub charge: f64,
}

impl Taken {
    /// The reading by a calibration, in V/m; with the charge left out where that has none.
    #[must_use]
    pub fn by(&self, calibration: &Calibration) -> Sample {
        let charge = if calibration.per_rad == 0.0 { 0.0 } else { self.charge };
        Sample { at: self.at, at_s: self.at_s, value: calibration.field(self.volts, charge) }
    }
}

impl Mapper {
    /// A mill with its calibration, of which each period, s, is a reading.
    #[must_use]
    pub fn new(calibration: Calibration, period_s: f64) -> Self {
        let charge = ChargeState::default();
        Self { calibration, charge, period_s, begin_s: None, window: Vec::new(), taken: Vec::new() }
    }

    /// Takes a voltage, V, at a place.
    pub fn sense(&mut self, time_s: f64, at: Place, volts: f64) -> Option<Taken> {
        self.window.push(Taken { at: [at.x_m, at.y_m], at_s: time_s, volts, charge: self.charge.field() });
        let begin_s = *self.begin_s.get_or_insert(time_s);
        if time_s - begin_s < self.period_s {
            return None;
        }
        self.begin_s = Some(time_s);
        let count = self.window.len() as f64;
        let mean = |of: &dyn Fn(&Taken) -> f64| self.window.iter().map(of).sum::<f64>() / count;
        let taken = Taken {
            at: [mean(&|sample| sample.at[0]), mean(&|sample| sample.at[1])],
            at_s: mean(&|sample| sample.at_s),
            volts: mean(&|sample| sample.volts),
            charge: mean(&|sample| sample.charge),
        };
        self.window.clear();
        self.taken.push(taken);
        Some(taken)
    }

    /// Takes what the wheels turned, rad.
    pub fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        self.charge.roll(&self.calibration, time_s, angle_rad);
    }

    /// Readings so far.
    #[must_use]
    pub fn taken(&self) -> &[Taken] {
        &self.taken
    }

    /// Its calibration.
    #[must_use]
    pub const fn calibration(&self) -> &Calibration {
        &self.calibration
    }
}

/// A survey of a plot.
#[derive(Debug)]
pub struct Survey {
    strategy: Strategy,
    until_s: f64,
    mapper: Mapper,
    process: Process,
    offset: Option<f64>,
    rows: Vec<Point>,
    sites: Vec<Point>,
    follower: Follower,
    goal: Option<Point>,
    stands_since_s: Option<f64>,
    left_out: Vec<(f64, Point)>,
}

impl Survey {
    /// A survey from its start; a lawn-mower's ends with its last row, if not before.
    ///
    /// # Errors
    /// In words: numbers that make no regression.
    pub fn new(strategy: Strategy, side_m: f64, until_s: f64, calibration: Calibration) -> Result<Self, String> {
        let process = Process::new(EXPECTED).map_err(|error| error.to_string())?;
        let pitch_m = side_m / SITES as f64;
        let site = |number: usize| [number % SITES, number / SITES].map(|place| (place as f64 + 0.5) * pitch_m);
        let mut rows = if strategy == Strategy::Loop { laps_m(side_m) } else { rows_m(side_m) };
        rows.reverse();
        Ok(Self {
            strategy,
            until_s,
            mapper: Mapper::new(calibration, PERIOD_S),
            process,
            offset: None,
            rows,
            sites: (0..SITES * SITES).map(site).collect(),
            follower: Follower::new(limits(), []),
            goal: None,
            stands_since_s: None,
            left_out: Vec::new(),
        })
    }

    /// Readings so far.
    #[must_use]
    pub fn taken(&self) -> &[Taken] {
        self.mapper.taken()
    }

    /// Gives up a goal that somebody stands before.
    fn mind_obstacles(&mut self, time_s: f64, at: Place, free_m: f64) {
        if free_m > limits().stop_m {
            self.stands_since_s = None;
            return;
        }
        let since_s = *self.stands_since_s.get_or_insert(time_s);
        if time_s - since_s < PATIENCE_S {
            return;
        }
        self.stands_since_s = None;
        let Some(goal) = self.goal else { return };
        if self.strategy == Strategy::Sites {
            self.left_out.push((time_s, goal));
            self.follower = Follower::new(limits(), []);
            return;
        }
        // Round it, to the left, and on along the row.
        let (sin, cos) = at.yaw_rad.sin_cos();
        let beside = |ahead_m: f64, aside_m: f64| {
            [at.x_m + ahead_m * cos - aside_m * sin, at.y_m + ahead_m * sin + aside_m * cos]
        };
        self.follower = Follower::new(limits(), [beside(0.0, 1.2), beside(2.0, 1.2), goal]);
    }

    fn next(&mut self, time_s: f64, at: Place) -> Option<Point> {
        match self.strategy {
            Strategy::LawnMower | Strategy::Loop => self.rows.pop(),
            Strategy::Sites => {
                const LEFT_OUT_S: f64 = 60.0;
                self.left_out.retain(|(since_s, _)| time_s - since_s < LEFT_OUT_S);
                let here = [at.x_m, at.y_m];
                let open = |site: &&Point| {
                    distance_m(**site, here) > 2.0 * limits().reached_m
                        && !self.left_out.iter().any(|(_, other)| distance_m(*other, **site) < 1.0)
                };
                let open: Vec<Point> = self.sites.iter().filter(open).copied().collect();
                let best = next_sites(&self.process, &open, NEAREST_OF, Criterion::MutualInformation).ok()?;
                let far = |site: &Point| distance_m(*site, here);
                best.into_iter().map(|index| open[index]).min_by(|a, b| far(a).total_cmp(&far(b)))
            }
        }
    }
}

impl Program for Survey {
    fn sense(&mut self, time_s: f64, at: Place, volts: f64) {
        let Some(taken) = self.mapper.sense(time_s, at, volts) else { return };
        let sample = taken.by(self.mapper.calibration());
        let offset = *self.offset.get_or_insert(sample.value);
        if self.strategy == Strategy::Sites {
            // One that cannot be told from another says nothing of where to go next.
            let _ = self.process.add(Sample { value: sample.value - offset, ..sample });
        }
    }

    fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        self.mapper.rolled(time_s, angle_rad);
    }

    fn drive(&mut self, time_s: f64, at: Place, free_m: f64) -> Option<Velocity> {
        if time_s >= self.until_s {
            return None;
        }
        self.mind_obstacles(time_s, at, free_m);
        if let Some(velocity) = self.follower.velocity(at, free_m) {
            return Some(velocity);
        }
        let goal = self.next(time_s, at)?;
        self.goal = Some(goal);
        self.follower = Follower::new(limits(), [goal]);
        Some(self.follower.velocity(at, free_m).unwrap_or_default())
    }
}

/// Ends of the lawn-mower's rows, which go to and fro, and the way back to the start across them: the place where it began is seen again.
fn rows_m(side_m: f64) -> Vec<Point> {
    let (first_m, last_m) = (SPACING_M / 2.0, side_m - SPACING_M / 2.0);
    let rows = (side_m / SPACING_M).floor() as usize;
    let mut ends: Vec<Point> = (0..rows)
        .flat_map(|row| {
            let y_m = (row as f64 + 0.5) * SPACING_M;
            let [from_m, to_m] = if row % 2 == 0 { [first_m, last_m] } else { [last_m, first_m] };
            [[from_m, y_m], [to_m, y_m]]
        })
        .collect();
    ends.push([side_m / 2.0, side_m / 2.0]);
    ends.push([first_m, first_m]);
    ends
}

/// Corners of the loop, lap by lap; the robot starts at the first.
fn laps_m(side_m: f64) -> Vec<Point> {
    let (low_m, high_m) = (SPACING_M / 2.0, SPACING_M / 2.0 + side_m / 2.0);
    let lap = [[high_m, low_m], [high_m, high_m], [low_m, high_m], [low_m, low_m]];
    (0..LAPS).flat_map(|_| lap).collect()
}

/// Time that the lawn-mower takes, s: its way at full speed and its turns, each as on the board within a second.
#[must_use]
pub fn mission_s(side_m: f64) -> f64 {
    const TURN_S: f64 = 2.5;
    let ends = rows_m(side_m);
    let way_m: f64 = ends.windows(2).map(|pair| distance_m(pair[0], pair[1])).sum();
    way_m / limits().speed_m_s + TURN_S * ends.len() as f64
}
