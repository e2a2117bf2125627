//! BERRY: a pneumatic gripper for berries, as a hand tool and on two axes.
//!
//! Paper: "Human evaluation of robotic grippers for berry picking", TAROS 2023. A soft gripper of eight flexible fingers and a hard
//! parallelogram, each on a cylinder of 16 mm bore and 25 mm stroke behind a 5/2 valve of 24 V, are used by four people as hand tools on
//! 34 berries of an artificial bush: 1.0 s a berry by hand, 2.1 s hard, 2.9 s soft.
//!
//! # Repairs
//! 5 bar on 16 mm is 100.5 N, and 90.7 N on the side of a rod of 5 mm; the printed "up to 50 N" belongs to 2.5 bar. "Almost twice" as
//! slow, of soft and hard, is 1.38 times.
//!
//! Times of people cannot be simulated: the printed ones stay printed, and [`trials`] records and compares those of
//! real trials. In the study two axes move the tool: in the paper's arms a declared hand presses the handle's
//! microswitch, in ours the board switches the valve itself. [`protocol`] runs them on a board, [`scene`] samples the
//! bushes.

pub mod missing;
pub mod protocol;
pub mod scene;
pub mod trials;

use r4_rig::{Rig, Session};

use crate::{
    About, Arm, Curve, Error, Figure, Limit, Metric, Panel, Paper, REPORTED, Source, Statistic, System, Target, Trial,
    Values,
};
use missing::{Change, Sheet};
use protocol::{Method, Outcome};
use scene::{Case, Gripper, PRINTED_N, PRINTED_PA, Setup};

/// Robot system BERRY, listed in [`crate::all`].
#[derive(Debug)]
pub struct BerryPicking;

/// Name of the system in commands and records.
const NAME: &str = "berry";

/// Names of the arms.
const PAPER: &str = "paper";
const HARD: &str = "baseline:hard-gripper";
const OURS: &str = "ours";
const IN_TURN: &str = "ablation:no-overlap";
const UNSEEN: &str = "ablation:no-pressure";
const BELIEF: &str = "ablation:printed-force";
/// Prefix of the arms with a hidden change; the name of the change, or `clean`, follows.
const BLIND: &str = "blind:";
const CLEAN: &str = "blind:clean";

const fn board(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn simulated(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

const fn printed(name: &'static str, unit: &'static str) -> Metric {
    Metric { name, unit, statistic: Statistic::Mean, source: Source::Printed, targets: &[] }
}

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper { title: "Human evaluation of robotic grippers for berry picking", published: "TAROS 2023" },
    question: "How fast, and with how few dropped, missed and crushed berries, does a pneumatic gripper pick a bush?",
    robot: "berry-picker",
    reported: REPORTED,
    sampled: &[
        "34 berries 40 mm apart, each 10 mm in reach and 4 mm along the row beside its place, uniform",
        "diameter 16 to 22 mm, stiffness 1.2 to 1.8 N/mm, friction 0.4 to 0.7, uniform (synthetic)",
        "stalk and cane 120 to 200 N/m, stalk off at 0.6 to 2.4 N, berry crushed above 7 to 14 N, uniform (synthetic)",
        "error of seen places normal, 2 to 4 mm of standard deviation in reach and row, new for each attempt",
        "in blind arms, a valve 8 to 30 ms slower, an inlet of 0.5 to 0.8 of its conductance, a compressor of 0.2 to 0.7 of its delivery, \
         uniform, or nothing",
        "noise of the board's analog input, bounce of the handle's switch",
    ],
    arms: &[
        board(PAPER, "the soft gripper at 5 bar: handle, 20 ms debounce, relay, moved by a declared hand"),
        board(HARD, "the same with the hard gripper"),
        board(
            OURS,
            "the soft gripper at a pressure by statics: valve and axes overlap, pressure detects a miss, retries",
        ),
        board(IN_TURN, "ours, one thing after the other"),
        board(UNSEEN, "ours without pressure: fixed waits, no retry"),
        board(BELIEF, "ours with the regulator set by the printed force, 50 N at 5 bar"),
        board("blind:slow-valve", "names what has changed since the gripper was new: its valve"),
        board("blind:narrow-tube", "the same: its inlet"),
        board("blind:weak-compressor", "the same: its compressor"),
        board(CLEAN, "the same: nothing"),
    ],
    metrics: &[
        simulated(
            "cycle_s",
            "s",
            Statistic::Mean,
            &[Target { arm: OURS, limit: Limit::AtMost(1.0), from: "set by this project: the printed time by hand" }],
        ),
        simulated(
            "dropped",
            "1",
            Statistic::Mean,
            &[Target { arm: OURS, limit: Limit::AtMost(0.01), from: "set by this project" }],
        ),
        simulated(
            "missed",
            "1",
            Statistic::Mean,
            &[Target { arm: OURS, limit: Limit::AtMost(0.02), from: "set by this project" }],
        ),
        simulated("crushed", "1", Statistic::Mean, &[]),
        simulated("attempts", "1", Statistic::Mean, &[]),
        simulated("squeeze_max_n", "N", Statistic::Quantile(1.0), &[]),
        simulated("rod_force_n", "N", Statistic::Quantile(0.5), &[]),
        printed("rod_force_printed_n", "N"),
        printed("cycle_printed_s", "s"),
        simulated("receiver_min_pa", "Pa", Statistic::Quantile(0.5), &[]),
        simulated(
            "effect_named",
            "1",
            Statistic::Share,
            &[
                Target { arm: "blind:slow-valve", limit: Limit::AtLeast(0.9), from: "set by this project" },
                Target { arm: "blind:narrow-tube", limit: Limit::AtLeast(0.9), from: "set by this project" },
                Target { arm: "blind:weak-compressor", limit: Limit::AtLeast(0.9), from: "set by this project" },
            ],
        ),
        simulated(
            "clean_quiet",
            "1",
            Statistic::Share,
            &[Target { arm: CLEAN, limit: Limit::AtLeast(0.95), from: "set by this project" }],
        ),
        simulated("effect_size_error", "1", Statistic::Quantile(0.5), &[]),
        simulated("effect_rmse_before", "1", Statistic::Quantile(0.5), &[]),
        simulated("effect_rmse_after", "1", Statistic::Quantile(0.5), &[]),
    ],
};

impl System for BerryPicking {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        match trial.arm.strip_prefix(BLIND) {
            Some(hidden) => blind(trial, hidden),
            None => Ok(evaluate(trial.arm, &picked(trial)?)),
        }
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure(trial).map(Some)
    }
}

fn figure(trial: &Trial) -> Result<Figure, Error> {
    let of = |arm| picked(&Trial { arm, ..trial.clone() });
    let (ours, in_turn) = (of(OURS)?, of(IN_TURN)?);
    let first = |outcome: &Outcome, of: &[(f64, f64)], scale: f64| -> Vec<(f64, f64)> {
        let begin_s = outcome.reach_m.iter().find(|(_, reach_m)| *reach_m > 0.03).map_or(0.0, |(at_s, _)| *at_s);
        let shown = of.iter().filter(|(at_s, _)| (begin_s..begin_s + 3.0).contains(at_s));
        shown.map(|(at_s, value)| (at_s - begin_s, value * scale)).collect()
    };
    let curve = |name, points| Curve { name, points };
    Ok(Figure {
        description: format!(
            "the first berries of a bush, seed {}, on {}: reach and pressure",
            trial.seed, trial.board
        ),
        axis: "Time (s)",
        panels: vec![
            Panel {
                title: "Reach of the tool (mm)",
                curves: vec![
                    curve("ours", first(&ours, &ours.reach_m, 1e3)),
                    curve("no overlap", first(&in_turn, &in_turn.reach_m, 1e3)),
                ],
            },
            Panel {
                title: "Pressure of the closing chamber (kPa)",
                curves: vec![
                    curve("ours", first(&ours, &ours.pressure_pa, 1e-3)),
                    curve("no overlap", first(&in_turn, &in_turn.pressure_pa, 1e-3)),
                ],
            },
        ],
    })
}

/// Picking method and gripper of an arm.
fn method(arm: &str) -> (Method, Gripper) {
    let by_handle = matches!(arm, PAPER | HARD);
    let method = Method { by_handle, overlaps: !by_handle && arm != IN_TURN, detects: !by_handle && arm != UNSEEN };
    (method, if arm == HARD { Gripper::Hard } else { Gripper::Soft })
}

/// Runs a trial along its bush.
///
/// # Errors
/// [`Error::Unsuitable`] when the board does not fit; [`Error::Rig`] when the session fails.
pub fn picked(trial: &Trial) -> Result<Outcome, Error> {
    let unsuitable = |why: String| Error::Unsuitable { system: NAME, board: trial.board.to_string(), why };
    let case = Case::of(trial.seed);
    let (method, gripper) = method(trial.arm);
    let mut rig = Rig::new(trial.board.clone());
    rig.seed = trial.seed;
    let nominal = rig.robot()?;
    let picker = scene::picker(&nominal).map_err(unsuitable)?;
    // The paper's arms run at its supply, ours at the pressure from statics; the ablation trusts the printed force.
    let regulated_pa = match trial.arm {
        PAPER | HARD => PRINTED_PA,
        BELIEF => scene::stall_pa(picker, PRINTED_N / PRINTED_PA),
        _ => scene::stall_pa(picker, picker.cylinder().areas_m2()[0]),
    };
    let setup = Setup::of(&nominal, regulated_pa).map_err(unsuitable)?;
    // Tried on a copy first: the rig's own change cannot report an error.
    case.put_into(&mut nominal.clone(), gripper, regulated_pa).map_err(unsuitable)?;
    rig.alter = Some(case.altered(gripper, regulated_pa));
    let work = async |session: &Session<'_>| protocol::pick(session, &setup, &case, method).await;
    Ok(rig.run(None, work)?.0)
}

/// Records the gripper when it is new and with the change `hidden`, and searches for that change.
fn blind(trial: &Trial, hidden: &str) -> Result<Values, Error> {
    let unsuitable = |why: String| Error::Unsuitable { system: NAME, board: trial.board.to_string(), why };
    let change = Change::named(hidden, trial.seed);
    let rig = |run: usize| {
        let mut rig = Rig::new(trial.board.clone());
        // Own noise for each recording: repeated noise would look like a constant effect.
        rig.seed = trial.seed.wrapping_mul(64) + run as u64;
        rig
    };
    let nominal = rig(0).robot()?;
    let picker = scene::picker(&nominal).map_err(unsuitable)?.clone();
    let setup = Setup::of(&nominal, PRINTED_PA).map_err(unsuitable)?;
    let sheet = Sheet::of(&picker, PRINTED_PA);
    let record = |change: Option<Change>, first: usize| {
        let changed = change.map_or(Ok(picker.clone()), |change| change.put_into(&picker));
        let changed = changed.map_err(|error| unsuitable(error.to_string()))?;
        let run = |run: usize| {
            let mut rig = rig(first + run);
            rig.alter = Some(scene::replaced(changed.clone()));
            let schedule = missing::schedule(trial.seed, first + run);
            let work = async |session: &Session<'_>| protocol::close_often(session, &setup, &schedule).await;
            Ok(rig.run(None, work)?.0)
        };
        (0..missing::RUNS).map(run).collect::<Result<Vec<_>, Error>>()
    };
    // Other run numbers for the second set: the same noise would cancel in the comparison.
    let (new, now) = (record(None, 0)?, record(change, missing::RUNS)?);
    let found = missing::found(&sheet, &new, &now)?;
    let mut values = Values::new();
    let share = |is: bool| f64::from(u8::from(is));
    match change {
        Some(_) => values.insert("effect_named".into(), share(found.is_some_and(|found| found.name == hidden))),
        None => values.insert("clean_quiet".into(), share(found.is_none())),
    };
    if let Some(found) = found {
        values.insert("effect_rmse_before".into(), found.before);
        values.insert("effect_rmse_after".into(), found.after);
        let size = change.map(|change| match change {
            Change::SlowValve(added_s) => added_s * 1e3,
            Change::NarrowTube(share) | Change::WeakCompressor(share) => share,
        });
        if let Some(size) = size.filter(|_| found.name == hidden) {
            values.insert("effect_size_error".into(), (found.size / size - 1.0).abs());
        }
    }
    Ok(values)
}

/// Computes the metrics of a trial.
fn evaluate(arm: &str, outcome: &Outcome) -> Values {
    let count = outcome.fates.len().max(1) as f64;
    let share =
        |of: &dyn Fn(&r4_world::Fate) -> bool| outcome.fates.iter().filter(|fate| of(fate)).count() as f64 / count;
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    put("cycle_s", outcome.picks_s.iter().sum::<f64>() / count);
    put("dropped", share(&|fate| fate.place == r4_world::Place::Ground));
    put("missed", share(&|fate| fate.place == r4_world::Place::Hanging));
    put("crushed", share(&|fate| fate.is_crushed));
    put("attempts", outcome.attempts.iter().sum::<usize>() as f64 / count);
    put("squeeze_max_n", outcome.fates.iter().map(|fate| fate.squeeze_max_n).fold(0.0, f64::max));
    put("rod_force_n", outcome.air_max_n);
    put("receiver_min_pa", outcome.receiver_min_pa);
    let printed_s = match arm {
        PAPER => Some(2.9),
        HARD => Some(2.1),
        _ => None,
    };
    if let Some(printed_s) = printed_s {
        put("cycle_printed_s", printed_s);
        put("rod_force_printed_n", PRINTED_N);
    }
    values
}

#[cfg(test)]
mod tests;
