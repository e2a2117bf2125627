//! Program of the robot on a plot: its path, and the readings that it takes.

use r4_maps::{
    pose::{Point, distance_m},
    process::{Criterion, Kernel, Process, Sample, next_sites},
};
use r4_rig::{Follower, Limits, Place, Velocity};

use super::mill::{Calibration, ChargeState};
use crate::rover::Program;

/// Averaging time of a reading, s: 0.8 m of travel, a fifth of the smallest space charge.
pub const PERIOD_S: f64 = 2.0;
/// Distance of the lawn-mower's rows, m: the size of the smallest space charge. Our choice; other values were not
/// compared.
const SPACING_M: f64 = 5.0;
/// Number of rows, and of columns, that cross each other, and their distance from the border, m. On tuning seeds 1 to 6
/// (`sim:`) the map's error was 8.6 V/m, with the lawn-mower's rows 9.4. By the expected variance, four of each leave 8 %
/// more error than five, in 830 s in place of 1000 s.
const CROSSING: usize = 5;
const MARGIN_M: f64 = 4.0;
/// Number of laps round the loop. A drift that wanders leaves an independent error in each lap, so that n laps leave at
/// least 1/√n of the first lap's error, and three cannot leave half. Of the sampled fields of the tuning seeds 1 to 100,
/// read without noise and without a board, the median left is 0.48 with six laps, 0.39 with nine, 0.38 with twelve and
/// 0.32 with sixteen. Medians of twenty of them reach 0.47 with nine laps, 0.36 with sixteen. Turning at
/// the end of each lap, so that every second one runs backwards, left 0.31 with sixteen.
pub const LAPS: usize = 16;
/// Number of candidate sites along a side.
const SITES: usize = 8;
/// Number of best sites, of which the nearest is chosen, so that the robot does not cross the plot to and fro. Our
/// choice; other values were not compared.
const NEAREST_OF: usize = 4;
/// Prior kernel before there are readings: the middle of the sampled ranges.
pub const EXPECTED: Kernel =
    Kernel { place_deviation: 35.0, length_m: 9.0, time_deviation: 30.0, time_s: 150.0, noise: 3.0 };
/// Time for which an obstacle may stand in front before the robot changes its path, s.
const PATIENCE_S: f64 = 12.0;

/// Strategy by which the robot chooses its path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// Rows over the plot, then columns, which meet each row again at another time.
    Crossing,
    /// Row by row over the plot.
    LawnMower,
    /// Laps round a square of half the plot's side, [`LAPS`] times.
    Loop,
    /// From site to site, by their mutual information with the plot.
    Sites,
}

/// Limits of the robot's motion: four fifths of its top speed.
#[must_use]
pub fn limits() -> Limits {
    Limits { speed_m_s: 0.4, turn_rate_rad_s: 1.0, braking_m_s2: 0.5, stop_m: 0.35, reached_m: 0.2 }
}

/// Mill in motion: averages voltages to readings.
#[derive(Clone, Debug)]
pub struct Mapper {
    calibration: Calibration,
    charge: ChargeState,
    period_s: f64,
    begin_s: Option<f64>,
    window: Vec<Taken>,
    /// Raw readings, from which other calibrations compute fields.
    taken: Vec<Taken>,
}

/// A reading before its conversion to a field.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taken {
    /// Mean position of the samples, m.
    pub at: Point,
    /// Mean time of the samples, s.
    pub at_s: f64,
    /// Mean voltage of the mill, V.
    pub volts: f64,
    /// Mean field of the body's charge, V/m.
    pub charge: f64,
}

impl Taken {
    /// Converts the reading to a field by a calibration, V/m; a calibration without charge ignores that of the body.
    #[must_use]
    pub fn by(&self, calibration: &Calibration) -> Sample {
        let charge = if calibration.per_rad == 0.0 { 0.0 } else { self.charge };
        Sample { at: self.at, at_s: self.at_s, value: calibration.field(self.volts, charge) }
    }
}

impl Mapper {
    /// Creates a mill with its calibration, which gives one reading each period, s.
    #[must_use]
    pub fn new(calibration: Calibration, period_s: f64) -> Self {
        let charge = ChargeState::default();
        Self { calibration, charge, period_s, begin_s: None, window: Vec::new(), taken: Vec::new() }
    }

    /// Takes a voltage, V, at a pose. Returns a reading when its period is complete.
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

    /// Updates the body's charge by the angle that the wheels turned, rad.
    pub fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        self.charge.roll(&self.calibration, time_s, angle_rad);
    }

    /// Raw readings taken so far.
    #[must_use]
    pub fn taken(&self) -> &[Taken] {
        &self.taken
    }

    /// Calibration of the mill.
    #[must_use]
    pub const fn calibration(&self) -> &Calibration {
        &self.calibration
    }
}

/// Program of a survey over a plot.
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
    /// Creates a survey before its start. It ends at `until_s`, or with its last row.
    ///
    /// # Errors
    /// A kernel that defines no regression, in words.
    pub fn new(strategy: Strategy, side_m: f64, until_s: f64, calibration: Calibration) -> Result<Self, String> {
        let process = Process::new(EXPECTED).map_err(|error| error.to_string())?;
        let pitch_m = side_m / SITES as f64;
        let site = |number: usize| [number % SITES, number / SITES].map(|place| (place as f64 + 0.5) * pitch_m);
        let mut rows = ends_m(strategy, side_m);
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

    /// Raw readings taken so far.
    #[must_use]
    pub fn taken(&self) -> &[Taken] {
        self.mapper.taken()
    }

    /// Changes the path when an obstacle has stood in front for [`PATIENCE_S`].
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
        // Round the obstacle, to the left, and back to the row.
        let (sin, cos) = at.yaw_rad.sin_cos();
        let beside = |ahead_m: f64, aside_m: f64| {
            [at.x_m + ahead_m * cos - aside_m * sin, at.y_m + ahead_m * sin + aside_m * cos]
        };
        self.follower = Follower::new(limits(), [beside(0.0, 1.2), beside(2.0, 1.2), goal]);
    }

    fn next(&mut self, time_s: f64, at: Place) -> Option<Point> {
        match self.strategy {
            Strategy::Crossing | Strategy::LawnMower | Strategy::Loop => self.rows.pop(),
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
        // The process has a mean of 0, from which raw readings are far away.
        let offset = *self.offset.get_or_insert(sample.value);
        if self.strategy == Strategy::Sites {
            // A sample too close to an earlier one cannot be added, and would not change the choice of the next site.
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

/// Ends of the straight legs of a path, from its start on; a survey from site to site gets the time of the crossing one.
pub(super) fn ends_m(strategy: Strategy, side_m: f64) -> Vec<Point> {
    match strategy {
        Strategy::Crossing | Strategy::Sites => crossing_m(side_m),
        Strategy::LawnMower => rows_m(side_m),
        Strategy::Loop => laps_m(side_m),
    }
}

/// Ends of rows from south to north, then of columns from the last row's end on. Each place where they cross is
/// measured twice, at times that differ by up to a whole mission, and so are its neighbours.
fn crossing_m(side_m: f64) -> Vec<Point> {
    let (first_m, last_m) = (MARGIN_M, side_m - MARGIN_M);
    let middle_m = |number: usize| first_m + (last_m - first_m) * number as f64 / (CROSSING - 1) as f64;
    // To and fro: every second line runs backwards.
    let line = |number: usize| if number.is_multiple_of(2) { [first_m, last_m] } else { [last_m, first_m] };
    let rows = (0..CROSSING).flat_map(|row| line(row).map(|x_m| [x_m, middle_m(row)]));
    // An odd number of rows ends in the north-eastern corner.
    let columns = (0..CROSSING).flat_map(|column| line(column + 1).map(|y_m| [middle_m(CROSSING - 1 - column), y_m]));
    rows.chain(columns).collect()
}

/// Ends of the lawn-mower's rows, which run to and fro, then the return to the start across them: the first position is
/// measured again.
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

/// Corners of the loop, lap by lap, from its start to its start.
fn laps_m(side_m: f64) -> Vec<Point> {
    let (low_m, high_m) = (SPACING_M / 2.0, SPACING_M / 2.0 + side_m / 2.0);
    let lap = [[high_m, low_m], [high_m, high_m], [low_m, high_m], [low_m, low_m]];
    std::iter::once([low_m, low_m]).chain((0..LAPS).flat_map(|_| lap)).collect()
}

/// Start of the robot: where its path starts, facing east.
#[must_use]
pub fn start(strategy: Strategy, side_m: f64) -> Place {
    let [x_m, y_m] = ends_m(strategy, side_m)[0];
    Place { x_m, y_m, yaw_rad: 0.0 }
}

/// Duration of a mission, s: its path at full speed and its turns.
#[must_use]
pub fn mission_s(strategy: Strategy, side_m: f64) -> f64 {
    const TURN_S: f64 = 2.5;
    let ends = ends_m(strategy, side_m);
    let way_m: f64 = ends.windows(2).map(|pair| distance_m(pair[0], pair[1])).sum();
    way_m / limits().speed_m_s + TURN_S * ends.len() as f64
}
