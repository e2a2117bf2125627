//! GASMAP: a rover that maps gas in a factory and drives to the most informative positions.
//!
//! Paper: *Automating Robotic Gas Distribution Mapping in Unknown and GPS-denied Environments*, TAROS 2023. Free cells
//! are a Gauss-Markov random field, whose means follow by Gaussian belief propagation from one reading each second; the
//! robot drives to the reachable position with the largest utility.
//!
//! The robot's program is a [`survey`]: it receives poses and the sensor's signal, keeps the map (`r4-maps`) and
//! returns velocities. `crate::rover` runs it on a board, with the pose from wheels, gyroscope and two lidar beams on
//! the floor [`plan`] ([`localise`]); [`kinematic`] runs it on perfect actuators. [`goals`] has both utilities, the
//! paper's and ours. [`scene`] samples leaks, [`missing`] searches for the effect that the sensor's model lacks,
//! [`field`] measures means, variances and computing times of the map itself.
//!
//! # Differences from the paper
//! - The floor plan is given: the robot has single beams and no scanning lidar. Nothing is claimed about unknown halls.
//! - Variances are exact marginals. Those of belief propagation are too small by up to several times, and lead a
//!   planner to other goals.
//! - Readings are corrected for the sensor's lag.

pub mod field;
mod figure;
pub mod goals;
pub mod kinematic;
pub mod localise;
pub mod missing;
pub mod plan;
pub mod scene;
pub mod survey;

use r4_maps::{field::Reading, grid::Grid, pose::Point};
use r4_rig::{Rig, Session};
use r4_world::Person;

use crate::{
    About, Arm, Error, Figure, Limit, Metric, Paper, Row, Source, Statistic, System, Target, Trial, Values, View,
    rover::{self, Driven, Program, Setup},
};
use goals::{Utility, Variances};
use localise::Beams;
use missing::{Change, Crossings};
use plan::CELL_M;
use scene::{Case, Hall};
use survey::{PUBLISHED, Settings, Strategy, Survey, WEIGHTS, replayed, rmse};

/// Robot system GASMAP, listed in [`crate::all`].
#[derive(Debug)]
pub struct Gasmap;

/// Name of the system in commands and records.
const NAME: &str = "gasmap";

/// Names of the arms.
const PRINTED: &str = "paper";
const OURS: &str = "ours";
const LAWN: &str = "baseline:lawn-mower";
const PROPAGATED: &str = "ablation:propagated-variances";
const PERFECT: &str = "ablation:perfect-actuators";
const LAG: &str = "blind:sensor-lag";
const PLACE: &str = "blind:sensor-place";
const INTERFERENCE: &str = "blind:drive-interference";
const CLEAN: &str = "blind:nothing";

/// Time constant of the gas sensor, s: its datasheet's value in the robot's file.
const LAG_S: f64 = 2.0;
/// Period at which the error of the map is sampled, s.
const LOOKS_S: f64 = 20.0;
/// Share of the lawn-mower's time at which a survey from goal to goal ends.
const SHARE: f64 = 0.6;

/// Utility of our arm, fixed on seeds 1 to 12 on perfect actuators. With a tenth of the overhead the robot moves back
/// and forth near the first gas that it finds, and never maps the rest of the plume.
pub const UTILITY: Utility = Utility::ErrorRate { floor_ppm: 15.0, overhead_s: 60.0, by: Variances::Exact };
/// Utility of the paper's form with the weights of the published program's example: the same for variance, mean and
/// path.
pub const PRINTED_UTILITY: Utility = Utility::Weighted { weights: [1.0, 1.0, 1.0], by: Variances::Propagated };

const fn board(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn perfect(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: true }
}

const fn measured(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

const SET: &str = "set by this project";
const MEDIAN: Statistic = Statistic::Quantile(0.5);
const MOST: Statistic = Statistic::Quantile(1.0);

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Automating Robotic Gas Distribution Mapping in Unknown and GPS-denied Environments",
        published: "TAROS 2023",
    },
    question: "How soon does a rover know where gas is in a factory, and how sure is its map?",
    robot: "gas-scout",
    reported: 201_001..201_021,
    sampled: &[
        "leak in one of nine aisles, 9 to 27 or 33 to 47 m along it, within 0.6 m of its middle; uniform",
        "release 0.5e-4 to 2e-4 m3/s, logarithmic; puffs of 0.4 to 0.8 m at first, uniform",
        "puffs and the wandering of the wind",
        "noise of the board's sensors",
        "blind arms: lag 1 to 4 s, place 0.3 to 0.6 m ahead or behind, interference 0.3 to 1 ppm s/rad, uniform",
    ],
    arms: &[
        perfect(
            PRINTED,
            "the paper's utility with variances of belief propagation and its weights; the signal is taken for the gas",
        ),
        perfect(LAWN, "row by row through every aisle, with our map and lag state"),
        board(
            OURS,
            "goals by expected squared error per second, exact variances, lag state; its pose from wheels, gyroscope and two beams",
        ),
        perfect(PERFECT, "ours on actuators that move as commanded, with a pose that is true"),
        perfect(PROPAGATED, "the same with variances of belief propagation"),
        board(LAG, "a sensor with a lag of 1 to 4 s crosses a plume: what does a model without lag lack?"),
        board(PLACE, "the same with the sensor elsewhere on the robot than drawn"),
        board(INTERFERENCE, "the same with a signal that grows with the wheels' rate"),
        board(CLEAN, "the same with nothing hidden"),
    ],
    metrics: &[
        measured(
            "time_share",
            "1",
            Statistic::Mean,
            &[
                Target { arm: OURS, limit: Limit::AtMost(SHARE), from: SET },
                Target { arm: PERFECT, limit: Limit::AtMost(SHARE), from: SET },
            ],
        ),
        measured("reached", "1", Statistic::Share, &[]),
        measured("lawn_mower_better_than_no_map", "1", Statistic::Share, &[]),
        measured("rmse_ppm", "ppm", Statistic::Mean, &[]),
        measured("rmse_without_lag_state_ppm", "ppm", Statistic::Mean, &[]),
        measured("rmse_relative", "1", MEDIAN, &[]),
        measured("duration_s", "s", Statistic::Mean, &[]),
        measured("other_goals", "1", Statistic::Mean, &[]),
        measured(
            "drift_m",
            "m",
            MOST,
            &[Target {
                arm: OURS,
                limit: Limit::AtMost(0.10),
                from: "set by this project; printed: below about 0.1 m by Cartographer",
            }],
        ),
        measured("drift_dead_reckoned_m", "m", MEDIAN, &[]),
        measured(
            "effect_named",
            "1",
            Statistic::Share,
            &[
                Target { arm: LAG, limit: Limit::AtLeast(0.9), from: SET },
                Target { arm: PLACE, limit: Limit::AtLeast(0.9), from: SET },
                Target { arm: INTERFERENCE, limit: Limit::AtLeast(0.9), from: SET },
            ],
        ),
        measured("size_in_interval", "1", Statistic::Share, &[]),
        measured("size_error", "1", MEDIAN, &[]),
        measured(
            "effect_claimed",
            "1",
            Statistic::Share,
            &[Target { arm: CLEAN, limit: Limit::AtMost(0.0), from: SET }],
        ),
        measured("held_out_before", "1", MEDIAN, &[]),
        measured("held_out_after", "1", MEDIAN, &[]),
    ],
};

impl System for Gasmap {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        if let Some(hidden) = trial.arm.strip_prefix("blind:") {
            return blind(trial, hidden);
        }
        let hall = Hall::of(Case::of(trial.seed), CELL_M)?;
        let lawn = lawn_mower(&hall)?;
        if trial.arm == LAWN {
            return Ok(evaluate(&hall, &lawn, &lawn, WEIGHTS));
        }
        let (surveyed, weights) = surveyed(trial, &hall, SHARE * lawn.until_s)?;
        Ok(evaluate(&hall, &surveyed, &lawn, weights))
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure::curves(trial).map(Some)
    }

    fn views(&self, trial: &Trial) -> Result<Vec<View>, Error> {
        figure::views(trial)
    }

    fn timings(&self, is_quick: bool) -> Result<Vec<Row>, Error> {
        field::rows(is_quick)
    }
}

/// Result of a completed survey.
#[derive(Debug)]
pub(crate) struct Surveyed {
    survey: Survey,
    /// True path of the robot: time, s, and position, m.
    path: Vec<(f64, Point)>,
    /// Record of the drive; `None` without a board.
    driven: Option<Driven>,
    /// Time at which the survey ended, s.
    until_s: f64,
}

fn unsuitable(trial: &Trial, why: String) -> Error {
    Error::Unsuitable { system: NAME, board: trial.board.to_string(), why }
}

fn settings(arm: &str, until_s: f64) -> Settings {
    let ErrorRates { exact, propagated } = RATES;
    match arm {
        PRINTED => Settings { strategy: Strategy::Goals(PRINTED_UTILITY), weights: PUBLISHED, lag_s: 0.0, until_s },
        LAWN => Settings { strategy: Strategy::LawnMower, weights: WEIGHTS, lag_s: LAG_S, until_s },
        PROPAGATED => Settings { strategy: Strategy::Goals(propagated), weights: WEIGHTS, lag_s: LAG_S, until_s },
        _ => Settings { strategy: Strategy::Goals(exact), weights: WEIGHTS, lag_s: LAG_S, until_s },
    }
}

/// Utilities of our arm with either kind of variances.
struct ErrorRates {
    exact: Utility,
    propagated: Utility,
}

const RATES: ErrorRates = ErrorRates {
    exact: UTILITY,
    propagated: Utility::ErrorRate { floor_ppm: 15.0, overhead_s: 60.0, by: Variances::Propagated },
};

/// Runs the lawn-mower on perfect actuators, the reference of all arms of a seed.
fn lawn_mower(hall: &Hall) -> Result<Surveyed, Error> {
    perfectly(hall, settings(LAWN, f64::INFINITY))
}

fn perfectly(hall: &Hall, settings: Settings) -> Result<Surveyed, Error> {
    let failed = |why: String| Error::Unsuitable { system: NAME, board: scene::WORLD.to_owned(), why };
    let mut survey = Survey::new(hall.plan.clone(), settings).map_err(failed)?;
    let path = kinematic::run(hall, &mut survey);
    let until_s = path.last().map_or(0.0, |(time_s, _)| *time_s);
    Ok(Surveyed { survey, path, driven: None, until_s })
}

/// Runs a trial's survey; also returns the weights of its map.
fn surveyed(trial: &Trial, hall: &Hall, until_s: f64) -> Result<(Surveyed, r4_maps::field::Weights), Error> {
    let settings = settings(trial.arm, until_s);
    let is_kinematic = ABOUT.arm(trial.arm).is_some_and(|arm| arm.is_kinematic);
    let surveyed = if is_kinematic { perfectly(hall, settings)? } else { on_board(trial, hall, settings, Vec::new())? };
    Ok((surveyed, settings.weights))
}

/// Runs a survey on the trial's board, with `people` in the hall.
pub(crate) fn on_board(trial: &Trial, hall: &Hall, settings: Settings, people: Vec<Person>) -> Result<Surveyed, Error> {
    let rig = hall.rig(&trial.board, trial.seed, people);
    let mut survey = Survey::new(hall.plan.clone(), settings).map_err(|why| unsuitable(trial, why))?;
    let driven = driven(trial, &rig, hall, &mut survey)?;
    let path: Vec<(f64, Point)> = driven.path.iter().map(|(time_s, _, truth)| (*time_s, *truth)).collect();
    let until_s = path.last().map_or(0.0, |(time_s, _)| *time_s);
    Ok(Surveyed { survey, path, driven: Some(driven), until_s })
}

fn driven(trial: &Trial, rig: &Rig, hall: &Hall, program: &mut impl Program) -> Result<Driven, Error> {
    let setup = Setup::of(rig, survey::limits().stop_m).map_err(|why| unsuitable(trial, why))?;
    let mut beams = Beams::new(hall.plan.clone());
    let work = async |session: &Session<'_>| rover::run(session, &setup, &mut beams, program).await;
    Ok(rig.run(None, work)?.0)
}

/// Error of the map over time: time, s, and RMSE, ppm.
fn errors(
    hall: &Hall,
    weights: r4_maps::field::Weights,
    readings: &[Reading],
    until_s: f64,
    truth: &Grid<Option<f64>>,
) -> Result<Vec<(f64, f64)>, String> {
    let maps = replayed(&hall.plan, weights, readings, LOOKS_S, until_s)?;
    Ok(maps.iter().map(|(time_s, map)| (*time_s, rmse(map, truth))).collect())
}

fn evaluate(hall: &Hall, surveyed: &Surveyed, lawn: &Surveyed, weights: r4_maps::field::Weights) -> Values {
    let truth = hall.truth_ppm(lawn.until_s);
    let last = |of: &Surveyed, weights, readings: &[Reading]| {
        let maps = replayed(&hall.plan, weights, readings, of.until_s, of.until_s);
        maps.ok().and_then(|maps| maps.last().map(|(_, map)| rmse(map, &truth))).unwrap_or(f64::NAN)
    };
    let to_reach_ppm = last(lawn, WEIGHTS, lawn.survey.readings());
    let errors = errors(hall, weights, surveyed.survey.readings(), surveyed.until_s, &truth).unwrap_or_default();
    let end_ppm = errors.last().map_or(f64::NAN, |(_, ppm)| *ppm);
    let reached_s = errors.iter().find(|(_, ppm)| *ppm <= to_reach_ppm).map(|(time_s, _)| *time_s);
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    put("rmse_ppm", end_ppm);
    put("rmse_without_lag_state_ppm", last(surveyed, weights, surveyed.survey.signals()));
    put("rmse_relative", end_ppm / to_reach_ppm);
    put("duration_s", surveyed.until_s);
    let empty_ppm = rmse(&truth.map(|ppm| ppm.map(|_| 0.0)), &truth);
    // Where the lawn-mower is worse than an empty map, every arm would reach its error before the first reading.
    let is_useful = to_reach_ppm < empty_ppm;
    put("lawn_mower_better_than_no_map", f64::from(u8::from(is_useful)));
    if is_useful {
        // A survey that did not reach the error counts like one that takes as long as the lawn-mower.
        put("time_share", reached_s.map_or(1.0, |reached_s| reached_s / lawn.until_s));
        put("reached", f64::from(u8::from(reached_s.is_some())));
    }
    let other = surveyed.survey.goals().iter().filter_map(|goal| goal.propagated_off_m);
    // Two cells apart counts as another goal; a neighbouring cell is as good.
    let (others, goals) =
        other.fold((0.0, 0.0), |(others, goals), off_m| (others + f64::from(u8::from(off_m > 1.0)), goals + 1.0));
    if goals > 0.0 {
        put("other_goals", others / goals);
    }
    if let Some(driven) = &surveyed.driven {
        let off_m = driven.path.iter().map(|(_, at, truth)| r4_maps::pose::distance_m(*at, *truth));
        put("drift_m", off_m.fold(0.0, f64::max));
        put("drift_dead_reckoned_m", driven.dead_reckoned_off_m.iter().copied().fold(0.0, f64::max));
    }
    values
}

/// Runs a blind arm: searches laps across a plume for the sensor's hidden change.
fn blind(trial: &Trial, hidden: &str) -> Result<Values, Error> {
    let change = Change::named(hidden, trial.seed);
    let laps = laps(trial, change)?;
    let found = missing::found(&laps)?;
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    put("effect_claimed", f64::from(u8::from(found.is_some())));
    if let Some(change) = change {
        let named = found.filter(|found| found.name == hidden);
        put("effect_named", f64::from(u8::from(named.is_some())));
        if let Some(found) = named {
            put("size_in_interval", f64::from(u8::from(found.interval.contains(change.size()))));
            put("size_error", (found.size / change.size() - 1.0).abs());
            put("held_out_before", found.before);
            put("held_out_after", found.after);
        }
    }
    Ok(values)
}

/// Drives laps across a plume on the trial's board.
fn laps(trial: &Trial, change: Option<Change>) -> Result<Vec<missing::Lap>, Error> {
    let case = Case { source_m: missing::SOURCE_M, release_m3_s: missing::RELEASE_M3_S, ..Case::of(trial.seed) };
    let hall = Hall::of(case, CELL_M)?;
    let mut rig = hall.rig(&trial.board, trial.seed, Vec::new());
    let altered = rig.alter.take();
    rig.alter = Some(std::rc::Rc::new(move |robot| {
        if let Some(altered) = &altered {
            altered(robot);
        }
        missing::hide(change, robot);
        if let Some(body) = &mut robot.simulation.body {
            let [x_m, y_m] = missing::ENDS_M[0];
            body.kind.set_pose(r4_world::Pose { x_m, y_m, yaw_rad: std::f64::consts::FRAC_PI_2 });
        }
    }));
    let mut program = Crossings::default();
    driven(trial, &rig, &hall, &mut program)?;
    Ok(program.laps)
}

#[cfg(test)]
mod tests;
