//! ABSIM: an abstract fleet on an event clock, beside the same fleet of simulated boards.
//!
//! Roberts-Elliott et al., *Towards an Abstract Lightweight Multi-robot ROS Simulator for Rapid Experimentation*, TAROS 2023. Navigation
//! is a wait of distance over speed behind the standard action interface, and simulated time is slowed to real time while the coordinator
//! computes. Shown on soil-compaction mapping: 2.87 times real time at a nominal 10, 14.18 at 15, of which the second gave other results.
//!
//! One [`mission`] creates sampling goals where the map is least certain and auctions them. A [`fleet`] runs it on the
//! event clock of `r4-rig`, with robots of two fidelities: [`boards`], each with its firmware, wheels and body; and
//! timed events of a [`queue`], by the trapezoid of [`motion`], whose parameters are identified from boards
//! ([`calibration`]). Goals have the states of a ROS action server ([`action`]). [`wall`] converts compute time to
//! simulated time, by the paper's method and ours; [`soil`] has the field and its map.
//!
//! # Repairs
//! - "Multiplying Euclidean distance by a given constant speed": a division is meant.
//! - The published package has the position `v t - v²/(2a)` during a leg, which is negative at first, and a duration of
//!   `D/v + v/(2a)`: half of the ramps. [`motion::Trapezoid`] has both ramps, and legs too short for the top speed.
//! - Its poses are updated every 2 s, so that a preemption is late by as much; here it is an event like others.
//! - 2.87 at a nominal 10 means that 27.6 % of simulated time ran at 1; 14.18 at 15 means 0.41 %. In the second
//!   experiment the slow-down practically never acted ([`wall::share_at_1`]). With the first's share, a nominal 15
//!   gives 3.08.

pub mod action;
pub mod boards;
pub mod calibration;
pub mod fleet;
pub mod ideal;
pub mod mission;
pub mod motion;
mod picture;
pub mod queue;
pub mod scene;
pub mod soil;
mod speed;
pub mod wall;

use r4_rig::{Pace, Target as Board};

use crate::{
    About, Arm, Error, Figure, Limit, Metric, Paper, REPORTED, Row, Source, Statistic, System, Target, Trial, Values,
    View,
};
use action::State;
use fleet::{Fidelity, Run};
use ideal::IdealDrive;
use mission::Mission;
use motion::Motion;
use scene::Scene;
use wall::{Charging, Wall};

/// Robot system ABSIM, listed in [`crate::all`].
#[derive(Debug)]
pub struct Absim;

/// Name of the system in commands and records.
const NAME: &str = "absim";

/// Names of the arms.
const PRINTED: &str = "paper";
const FASTER: &str = "baseline:15x";
const FASTER_SLOWED: &str = "baseline:15x-slowed";
const OURS: &str = "ours";
const NO_TURNS: &str = "ablation:no-turns";
const NO_CHARGE: &str = "ablation:no-charge";
const PERFECT: &str = "ablation:perfect-actuators";
const BOARDS: &str = "baseline:boards";
const ONE_BOARD: &str = "baseline:one-board";

/// Factors of simulated time over wall time at which a result must be the same.
const SPEEDS: [f64; 4] = [1.0, 10.0, 15.0, 1_000.0];
/// Nominal factors printed in the paper.
const NOMINAL: f64 = 10.0;
const NOMINAL_FASTER: f64 = 15.0;

const fn timed(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: true }
}

const fn measured(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

const SET: &str = "set by this project";
const MEDIAN: Statistic = Statistic::Quantile(0.5);
const LEAST: Statistic = Statistic::Quantile(0.0);
const MOST: Statistic = Statistic::Quantile(1.0);

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Towards an Abstract Lightweight Multi-robot ROS Simulator for Rapid Experimentation",
        published: "Roberts-Elliott et al.; TAROS 2023",
    },
    question: "How fast can a simulation of many robots run without a change of its results?",
    robot: "openscout",
    reported: REPORTED,
    sampled: &[
        "side of the plot 15 to 25 m; starts on its southern edge and headings; duration of a sample 3 to 7 s; uniform",
        "soil compaction: standard deviation 300 to 600 kPa, range 3 to 6 m, uniform; 2 MPa in the mean",
        "noise of a penetrometer's reading, 50 kPa",
        "compute times on the paper's wall clock, 10 % from run to run",
        "noise of the boards' sensors",
    ],
    arms: &[
        timed(
            PRINTED,
            "distance over speed; simulated time ten times as fast as the wall, slowed to 1 while the coordinator computes",
        ),
        timed(FASTER, "the paper's at a nominal 15, as its numbers say it ran: the slow-down does not act"),
        timed(FASTER_SLOWED, "the paper's at a nominal 15 with the slow-down of its runs at 10"),
        timed(OURS, "event queue, trapezoids identified from boards, compute time charged by counted operations"),
        timed(NO_TURNS, "ours without time for turns on the spot"),
        timed(NO_CHARGE, "ours without compute time"),
        timed(PERFECT, "the boards' program on wheels that turn as commanded and do not slip"),
        Arm { name: BOARDS, does: "three boards with firmware, wheels and bodies on one clock", is_kinematic: false },
        Arm { name: ONE_BOARD, does: "one board on a plot of 6 m", is_kinematic: false },
    ],
    metrics: &[
        measured("completion_s", "s", Statistic::Mean, &[]),
        measured("distance_per_robot_m", "m", Statistic::Mean, &[]),
        measured("waiting_per_robot_s", "s", Statistic::Mean, &[]),
        measured("map_rmse_kpa", "kPa", Statistic::Mean, &[]),
        measured("map_rmse_over_time_kpa", "kPa", Statistic::Mean, &[]),
        measured("charged_share", "1", MEDIAN, &[]),
        measured(
            "unfinished_goals",
            "1",
            MOST,
            &[
                Target { arm: OURS, limit: Limit::AtMost(0.0), from: SET },
                Target { arm: BOARDS, limit: Limit::AtMost(0.0), from: SET },
            ],
        ),
        measured(
            "cosine",
            "1",
            LEAST,
            &[Target { arm: OURS, limit: Limit::AtLeast(1.0), from: "printed: 0.870 at 15" }],
        ),
        measured("bit_equal", "1", Statistic::Share, &[Target { arm: OURS, limit: Limit::AtLeast(1.0), from: SET }]),
        measured("speed_factor", "1", MEDIAN, &[]),
        measured(
            "completion_error",
            "1",
            MEDIAN,
            &[Target { arm: BOARDS, limit: Limit::AtMost(0.02), from: "set by this project: of the calibrated fleet" }],
        ),
        measured("completion_error_nominal", "1", MEDIAN, &[]),
        measured("completion_error_printed", "1", MEDIAN, &[]),
        measured("odometry_error_m", "m", MOST, &[]),
    ],
};

impl System for Absim {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        match trial.arm {
            BOARDS => on_boards(trial, Scene::of(trial.seed)),
            ONE_BOARD => on_boards(trial, Scene::small(trial.seed)),
            arm => {
                let (run, others) = abstracted(trial, arm)?;
                Ok(compare(arm, &run, &others))
            }
        }
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        picture::figure(trial).map(Some)
    }

    fn views(&self, trial: &Trial) -> Result<Vec<View>, Error> {
        picture::views(trial)
    }

    fn timings(&self, is_quick: bool) -> Result<Vec<Row>, Error> {
        speed::rows(is_quick)
    }
}

/// Runs a mission at the abstract fidelity.
fn timed_run(
    scene: Scene,
    robot: Fidelity,
    charging: Charging,
    factor: f64,
    is_reversed: bool,
) -> Result<Run<Mission>, Error> {
    let robots = vec![robot; scene.robots];
    let wall = Wall::new(scene.seed, factor, charging);
    let mut run = Run::new(Mission::new(scene), robots, wall);
    run.is_reversed = is_reversed;
    run.alone(Pace::Free)
}

/// Runs one trial of an arm without boards. Also returns the runs that it is compared with: those at other speeds and
/// in other orders.
fn abstracted(trial: &Trial, arm: &str) -> Result<(Run<Mission>, Vec<Run<Mission>>), Error> {
    let scene = Scene::of(trial.seed);
    let printed = |factor: f64, slows: bool| {
        let robot = Fidelity::Abstract(Motion::PRINTED);
        timed_run(scene.clone(), robot, Charging::Measured { slows }, factor, false)
    };
    let ours = |motion: Motion, charging: Charging, factor: f64, is_reversed: bool| {
        timed_run(scene.clone(), Fidelity::Abstract(motion), charging, factor, is_reversed)
    };
    let calibrated = calibration::CALIBRATED;
    let run;
    let mut others = Vec::new();
    match arm {
        PRINTED | FASTER | FASTER_SLOWED => {
            let (factor, slows) = match arm {
                PRINTED => (NOMINAL, true),
                FASTER => (NOMINAL_FASTER, false),
                _ => (NOMINAL_FASTER, true),
            };
            run = printed(factor, slows)?;
            // The reference runs at real time.
            others.push(printed(1.0, slows)?);
        }
        OURS => {
            run = ours(calibrated, Charging::Declared, SPEEDS[0], false)?;
            // Neither the speed nor the order of orders may change a result.
            for factor in SPEEDS {
                for is_reversed in [false, true] {
                    others.push(ours(calibrated, Charging::Declared, factor, is_reversed)?);
                }
            }
        }
        NO_TURNS => run = ours(calibrated.without_turns(), Charging::Declared, 1.0, false)?,
        NO_CHARGE => run = ours(calibrated, Charging::Free, 1.0, false)?,
        _ => {
            let board = Board::Sim(ABOUT.robot.to_owned());
            let drive = boards::skid_steer(&Trial { board, ..trial.clone() })?;
            let robot = Fidelity::Ideal(IdealDrive::new(drive));
            run = timed_run(scene, robot, Charging::Declared, 1.0, false)?;
        }
    }
    Ok((run, others))
}

/// Computes the metrics of a run, and its agreement with the other runs of its arm.
fn compare(arm: &str, run: &Run<Mission>, others: &[Run<Mission>]) -> Values {
    let mut values = evaluate(run);
    if !others.is_empty() {
        let same = others.iter().all(|other| is_same(run, other));
        let cosine = others.iter().map(|other| cosine(&compared(run), &compared(other)));
        values.insert("cosine".into(), cosine.fold(f64::INFINITY, f64::min));
        values.insert("bit_equal".into(), f64::from(u8::from(same)));
    }
    if matches!(arm, PRINTED | FASTER | FASTER_SLOWED) {
        values.insert("speed_factor".into(), run.wall.speed_factor(completion_s(run)));
    }
    values
}

/// Runs a trial of boards, and computes the errors of the abstract fidelities on the same scene.
fn on_boards(trial: &Trial, scene: Scene) -> Result<Values, Error> {
    let wall = Wall::new(scene.seed, 1.0, Charging::Declared);
    let (run, driven) = boards::run(trial, Mission::new(scene.clone()), wall, None)?;
    let mut values = evaluate(&run);
    let truth_s = completion_s(&run);
    for (name, motion) in [
        ("completion_error", calibration::CALIBRATED),
        ("completion_error_nominal", Motion::NOMINAL),
        ("completion_error_printed", Motion::PRINTED),
    ] {
        let timed = timed_run(scene.clone(), Fidelity::Abstract(motion), Charging::Declared, 1.0, false)?;
        values.insert(name.into(), (completion_s(&timed) / truth_s - 1.0).abs());
    }
    let off_m = driven.iter().flat_map(|driven| &driven.off_m).copied().fold(0.0, f64::max);
    values.insert("odometry_error_m".into(), off_m);
    Ok(values)
}

fn completion_s(run: &Run<Mission>) -> f64 {
    run.mission.ended_us().map_or(f64::NAN, |at_us| at_us as f64 * 1e-6)
}

/// Metrics of a mapping study that are compared between runs, in the order of [`compared`].
const NAMES: [&str; 5] =
    ["completion_s", "distance_per_robot_m", "waiting_per_robot_s", "map_rmse_kpa", "map_rmse_over_time_kpa"];

fn compared(run: &Run<Mission>) -> [f64; 5] {
    let mission = &run.mission;
    let robots = mission.scene().robots as f64;
    let taken = mission.taken();
    // The map's error is constant from one sample to the next; before the first sample it is that of the prior.
    let mut over_time = 0.0;
    let mut before = (0.0, mission.first_rmse_kpa());
    for sample in taken {
        let at_s = sample.at_us as f64 * 1e-6;
        over_time += before.1 * (at_s - before.0);
        before = (at_s, sample.rmse_kpa);
    }
    [
        completion_s(run),
        mission.driven_m().sum::<f64>() / robots,
        mission.waited_s().sum::<f64>() / robots,
        before.1,
        if before.0 > 0.0 { over_time / before.0 } else { before.1 },
    ]
}

fn evaluate(run: &Run<Mission>) -> Values {
    let mut values: Values = NAMES.into_iter().map(str::to_owned).zip(compared(run)).collect();
    values.insert("charged_share".into(), run.wall.charged_s() / completion_s(run));
    let goals = run.mission.goals();
    let open = goals.iter().filter(|goal| !goal.state.is_terminal()).count();
    let sampled = goals.iter().filter(|goal| goal.state == State::Succeeded).count();
    let missing = run.mission.scene().samples.saturating_sub(sampled);
    values.insert("unfinished_goals".into(), (open + missing) as f64);
    values
}

/// Cosine similarity of two runs' metrics, each divided by that of the second run: otherwise the metric with the
/// largest unit decides alone.
fn cosine(run: &[f64; 5], reference: &[f64; 5]) -> f64 {
    let relative = run.iter().zip(reference).map(|(value, reference)| value / reference);
    let (sum, squares) = relative.fold((0.0, 0.0), |(sum, squares), value| (sum + value, squares + value * value));
    sum / (squares * run.len() as f64).sqrt()
}

/// Returns true when goals, samples and metrics of two runs are equal to the last bit.
fn is_same(run: &Run<Mission>, other: &Run<Mission>) -> bool {
    let bits = |run: &Run<Mission>| compared(run).map(f64::to_bits);
    bits(run) == bits(other)
        && run.mission.goals() == other.mission.goals()
        && run.mission.taken() == other.mission.taken()
}

#[cfg(test)]
mod tests;
