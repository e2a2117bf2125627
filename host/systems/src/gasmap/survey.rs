//! Program of the robot: its path, and the readings of gas along it. It receives poses, the sensor's signal and the
//! free distance in front, either from a board or from perfect actuators.

use std::rc::Rc;

use r4_maps::{
    field::{Field, Reading, Weights},
    grid::{Cell, Grid},
    pose::{Point, distance_m},
};
use r4_maths::statistics::RootMeanSquare;
use r4_rig::{Follower, Limits, Place, Velocity};

use super::{
    goals::{self, Variances},
    plan::Plan,
};
use crate::rover::Program;

/// Period of readings, s: the paper's 1 Hz.
pub const PERIOD_S: f64 = 1.0;
/// Position of the gas sensor in front of the robot's middle, m.
pub const SENSOR_M: f64 = 0.18;
/// Time for which an obstacle may stand in front before the robot changes its path, s.
const PATIENCE_S: f64 = 12.0;
/// Time for which the cells of an obstacle are excluded, s.
const BLACKLISTED_S: f64 = 120.0;

/// Weights of the field, in its unit: set on seeds 1 to 12 for the least error of the lawn-mower's maps.
pub const WEIGHTS: Weights = Weights { smoothness: 0.5, reading: 0.5, forgetting_s: 1e6, prior: 1e-3 };
/// Weights of the published program.
pub const PUBLISHED: Weights = Weights { smoothness: 0.5, reading: 10.0, forgetting_s: 1e6, prior: 1e-4 };

/// Strategy by which the robot chooses its path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Strategy {
    /// Row by row over the whole hall.
    LawnMower,
    /// From goal to goal by their utility.
    Goals(goals::Utility),
}

/// Parameters of a survey.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Strategy of the path.
    pub strategy: Strategy,
    /// Weights of the map's field.
    pub weights: Weights,
    /// Time constant of the sensor's lag that readings are corrected for, s; 0 uses the signal as it is.
    pub lag_s: f64,
    /// Time limit of the survey, s; a lawn-mower ends earlier with its last row.
    pub until_s: f64,
}

/// Limits of the robot's motion: four fifths of its top speed, as in the fleets of `absim`, and the room that an aisle
/// of 2 m leaves.
pub fn limits() -> Limits {
    Limits { speed_m_s: 0.4, turn_rate_rad_s: 1.0, braking_m_s2: 0.5, stop_m: 0.35, reached_m: 0.1 }
}

/// A goal that the survey chose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Time of the choice, s.
    pub chosen_s: f64,
    /// Position of the goal, m.
    pub at: Point,
    /// True when the goal was given up because of an obstacle, or when no path led to it.
    pub failed: bool,
    /// Distance from the goal that variances of belief propagation would have chosen, m; `None` where they chose it, or
    /// no variances did.
    pub propagated_off_m: Option<f64>,
}

/// State of a survey.
#[derive(Debug)]
pub struct Survey {
    plan: Rc<Plan>,
    settings: Settings,
    /// Map of the readings so far.
    field: Field,
    readings: Vec<Reading>,
    signals: Vec<Reading>,
    window: Window,
    follower: Follower,
    rows: Vec<Point>,
    goals: Vec<Goal>,
    stands_since_s: Option<f64>,
    blacklist: Vec<(f64, Cell)>,
    other: Option<Point>,
    is_over: bool,
}

/// Samples of the signal in the present period.
#[derive(Debug, Default)]
struct Window {
    /// Time, s; position of the sensor, m; signal, ppm.
    samples: Vec<(f64, Point, f64)>,
}

/// One completed period of the signal.
struct Period {
    at_s: f64,
    middle_place: Point,
    last_place: Point,
    mean_ppm: f64,
    last_ppm: f64,
    change_ppm_s: f64,
}

impl Window {
    /// Adds a sample and returns the period when it is complete. A first-order lag obeys `T dy/dt = x - y`. The mean of
    /// the gas x over a period is therefore the mean of the signal y plus T times the change rate of y over it,
    /// exactly: the lag's state at both ends is the signal itself.
    fn take(&mut self, sample: (f64, Point, f64)) -> Option<Period> {
        self.samples.push(sample);
        let (first, last) = (*self.samples.first()?, *self.samples.last()?);
        let length_s = last.0 - first.0;
        if length_s < PERIOD_S - 1e-6 {
            return None;
        }
        let steps = self.samples.windows(2);
        let sum = steps.map(|pair| f64::midpoint(pair[0].2, pair[1].2) * (pair[1].0 - pair[0].0)).sum::<f64>();
        let middle_place = self.samples[self.samples.len() / 2].1;
        self.samples = vec![last];
        Some(Period {
            at_s: last.0,
            middle_place,
            last_place: last.1,
            mean_ppm: sum / length_s,
            last_ppm: last.2,
            change_ppm_s: (last.2 - first.2) / length_s,
        })
    }
}

impl Survey {
    /// Creates a survey before its start.
    ///
    /// # Errors
    /// Weights that define no field, in words.
    pub fn new(plan: Rc<Plan>, settings: Settings) -> Result<Self, String> {
        let field = Field::new(plan.free(), settings.weights).map_err(|error| error.to_string())?;
        let mut rows: Vec<Point> = plan.rows_m().into_iter().flatten().collect();
        rows.reverse();
        Ok(Self {
            plan,
            settings,
            field,
            readings: Vec::new(),
            signals: Vec::new(),
            window: Window::default(),
            follower: Follower::new(limits(), []),
            rows,
            goals: Vec::new(),
            stands_since_s: None,
            blacklist: Vec::new(),
            other: None,
            is_over: false,
        })
    }

    /// Readings taken so far, corrected for the lag.
    #[must_use]
    pub fn readings(&self) -> &[Reading] {
        &self.readings
    }

    /// The same readings without correction for the lag.
    #[must_use]
    pub fn signals(&self) -> &[Reading] {
        &self.signals
    }

    /// Goals chosen so far.
    #[must_use]
    pub fn goals(&self) -> &[Goal] {
        &self.goals
    }

    /// Gives up a goal when an obstacle has stood in front for [`PATIENCE_S`], and excludes the obstacle's cells for a
    /// time.
    fn mind_obstacles(&mut self, time_s: f64, at: Place, free_m: f64) {
        if free_m > limits().stop_m {
            self.stands_since_s = None;
            return;
        }
        let since_s = *self.stands_since_s.get_or_insert(time_s);
        let (Some(goal), true) = (self.goals.last_mut(), time_s - since_s > PATIENCE_S) else { return };
        goal.failed = true;
        let goal = goal.at;
        self.stands_since_s = None;
        let frame = self.plan.roomy().frame();
        let (sin, cos) = at.yaw_rad.sin_cos();
        for ahead_m in [0.75, 1.0, 1.25] {
            for aside_m in [-0.5, 0.0, 0.5] {
                let place = [at.x_m + ahead_m * cos - aside_m * sin, at.y_m + ahead_m * sin + aside_m * cos];
                self.blacklist.extend(frame.cell_at(place).map(|cell| (time_s + BLACKLISTED_S, cell)));
            }
        }
        match self.settings.strategy {
            // The row continues, round the obstacle.
            Strategy::LawnMower => self.go(time_s, at, goal),
            Strategy::Goals(_) => self.follower = Follower::new(limits(), []),
        }
    }

    fn go(&mut self, time_s: f64, at: Place, goal: Point) {
        self.blacklist.retain(|(until_s, _)| *until_s > time_s);
        let blocked: Vec<Cell> = self.blacklist.iter().map(|(_, cell)| *cell).collect();
        let from = [at.x_m, at.y_m];
        let way = self.plan.way(from, goal, &blocked);
        let failed = way.is_none();
        // The goal is behind blocked cells: the robot drives up to them and waits.
        let way = way.or_else(|| self.plan.way(from, goal, &[])).unwrap_or_default();
        self.goals.push(Goal {
            chosen_s: time_s,
            at: goal,
            failed,
            propagated_off_m: self.other.take().map(|other| distance_m(goal, other)),
        });
        self.follower = Follower::new(limits(), way);
    }

    fn next(&mut self, at: Place) -> Option<Point> {
        match self.settings.strategy {
            Strategy::LawnMower => {
                self.is_over = self.rows.is_empty();
                self.rows.pop()
            }
            Strategy::Goals(utility) => {
                // A solve that misses its tolerance by rounding still leaves the best available means.
                let _ = self.field.solve(1e-2);
                let means = self.field.means();
                let blocked: Vec<Cell> = self.blacklist.iter().map(|(_, cell)| *cell).collect();
                let best = |by| {
                    let variances = by_variances(&self.field, by);
                    utility.best(&self.plan, &means, &variances, [at.x_m, at.y_m], &blocked)
                };
                let goal = best(utility.by());
                self.other = if utility.by() == Variances::Exact { best(Variances::Propagated) } else { None };
                self.is_over = goal.is_none();
                goal
            }
        }
    }
}

impl Program for Survey {
    fn sense(&mut self, time_s: f64, at: Place, signal_ppm: f64) {
        let (sin, cos) = at.yaw_rad.sin_cos();
        let place = [at.x_m + SENSOR_M * cos, at.y_m + SENSOR_M * sin];
        let Some(taken) = self.window.take((time_s, place, signal_ppm)) else { return };
        let frame = *self.plan.free().frame();
        let signal =
            frame.cell_at(taken.last_place).map(|cell| Reading { cell, value: taken.last_ppm, at_s: taken.at_s });
        let corrected_ppm = taken.mean_ppm + self.settings.lag_s * taken.change_ppm_s;
        let corrected =
            frame.cell_at(taken.middle_place).map(|cell| Reading { cell, value: corrected_ppm, at_s: taken.at_s });
        let reading = if self.settings.lag_s > 0.0 { corrected } else { signal };
        // The pose is off by centimetres: a position in a cell of a wall is discarded.
        if let (Ok(reading), Ok(signal)) = (reading, signal)
            && self.field.observe(reading).is_ok()
        {
            self.readings.push(reading);
            self.signals.push(signal);
            self.field.wildfire(0.1, 2_000);
        }
    }

    fn drive(&mut self, time_s: f64, at: Place, free_m: f64) -> Option<Velocity> {
        if self.is_over || time_s >= self.settings.until_s {
            return None;
        }
        self.mind_obstacles(time_s, at, free_m);
        for _ in 0..4 {
            if let Some(velocity) = self.follower.velocity(at, free_m) {
                return Some(velocity);
            }
            let goal = self.next(at)?;
            self.go(time_s, at, goal);
        }
        // Four goals in a row that the robot has already reached: it stands for this period.
        Some(Velocity::default())
    }
}

fn by_variances(field: &Field, by: Variances) -> Grid<Option<f64>> {
    match by {
        Variances::Exact => field.variances(),
        Variances::Propagated => field.propagated_variances(),
    }
}

/// Means of maps with their times, s.
pub type Maps = Vec<(f64, Grid<Option<f64>>)>;

/// Computes the map again from readings in their order, and returns its means every `every_s`, with the times, s.
///
/// # Errors
/// Weights that define no field, or a solve that does not converge, in words.
pub fn replayed(
    plan: &Plan,
    weights: Weights,
    readings: &[Reading],
    every_s: f64,
    until_s: f64,
) -> Result<Maps, String> {
    let mut field = Field::new(plan.free(), weights).map_err(|error| error.to_string())?;
    let mut maps = Vec::new();
    let mut readings = readings.iter().peekable();
    let steps = (until_s / every_s).ceil() as usize;
    for step in 0..=steps {
        let time_s = (step as f64 * every_s).min(until_s);
        while let Some(reading) = readings.next_if(|reading| reading.at_s <= time_s) {
            field.observe(*reading).map_err(|error| error.to_string())?;
        }
        field.advance(time_s).map_err(|error| error.to_string())?;
        field.solve(1e-3).map_err(|error| error.to_string())?;
        maps.push((time_s, field.means()));
    }
    Ok(maps)
}

/// Root mean square difference of two maps over the cells that both have, in their unit.
#[must_use]
pub fn rmse(map: &Grid<Option<f64>>, truth: &Grid<Option<f64>>) -> f64 {
    let pairs = map.values().iter().zip(truth.values());
    let errors = pairs.filter_map(|(map, truth)| Some(map.as_ref()? - truth.as_ref()?));
    errors.collect::<RootMeanSquare>().value().unwrap_or(f64::NAN)
}
