//! FIELDMAP: rovers that map the atmospheric electric field with a field mill.
//!
//! Paper: *Toward Semi-Autonomous Terrestrial Robots for Atmospheric Electricity Measurement*, TAROS 2023. A rover with GNSS and an upward
//! field mill is driven in a loop and its readings go on a map; a sparse swarm is planned.
//!
//! [`mill`] converts the mill's voltage to the undisturbed field, by a calibration between plates. [`survey`] drives
//! over a plot, [`map`] computes the map of its readings by place and time (`r4-maps`), and the simpler maps for
//! comparison. In [`swarm`] several robots share an open field. [`gnss`] corrects the pose, [`scene`] samples fields
//! and mills, [`kinematic`] runs the same programs on perfect actuators, [`missing`] searches for effects that the
//! mill's model lacks.
//!
//! # Differences from the paper
//! - It prints no map error, no calibration and no swarm: its arm here follows its description, a loop with means of
//!   cells.
//! - The field is synthetic, with a drift as large as the structure. Nothing is claimed of the atmosphere.

mod figure;
pub mod gnss;
pub mod kinematic;
pub mod map;
pub mod mill;
pub mod missing;
mod run;
pub mod scene;
pub mod survey;
pub mod swarm;

use crate::{About, Arm, Error, Figure, Limit, Metric, Paper, Source, Statistic, System, Target, Trial, Values, View};

/// Robot system FIELDMAP, listed in [`crate::all`].
#[derive(Debug)]
pub struct Fieldmap;

/// Name of the system in commands and records.
const NAME: &str = "fieldmap";

/// Names of the arms.
const PRINTED: &str = "paper";
const OURS: &str = "ours";
const PERFECT: &str = "ablation:perfect-actuators";
const ROWS: &str = "ablation:rows";
const SITES: &str = "ablation:sites";
const SWARM: &str = "ours:swarm";
const SWARM_PERFECT: &str = "ablation:perfect-swarm";
const FORM: &str = "blind:form-factor";
const CHARGE: &str = "blind:wheel-charge";
const LAG: &str = "blind:mill-lag";
const CLEAN: &str = "blind:nothing";

const fn board(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn perfect(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: true }
}

const fn measured(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

const fn set(arm: &'static str, limit: Limit) -> Target {
    Target { arm, limit, from: "set by this project" }
}

const MEDIAN: Statistic = Statistic::Quantile(0.5);
const MOST: Statistic = Statistic::Quantile(1.0);
const HALF: Limit = Limit::AtMost(0.5);
const TWO_PERCENT: Limit = Limit::AtMost(0.02);
const QUARTER: Limit = Limit::AtMost(0.25);
const MOSTLY: Limit = Limit::AtLeast(0.9);

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Toward Semi-Autonomous Terrestrial Robots for Atmospheric Electricity Measurement",
        published: "TAROS 2023",
    },
    question: "How well does a rover with a field mill know an electric field that changes while it drives?",
    robot: "field-rover",
    reported: 1161..1181,
    sampled: &[
        "fair weather of 60 to 100 V/m; five space charges on 40 m by 40 m of 4 to 9 m, eight on 1 km by 1 km of 100 to 180 m, each 30 to 70 \
         V/m of either sign",
        "drift common to all places, 15 to 30 V/m over 60 to 300 s; the course of the day, 20 to 50 V/m over 2000 s",
        "a cloud nearby of 5 to 15 V/m, which no two places see alike",
        "mill: form factor 1.2 to 1.6, offset 2.4 to 2.6 V, charge at rest -8 to 8 V/m, wheels add 0.02 to 0.06 V/m a radian, leaking for 30 to \
         80 s",
        "plates: distance off by 0.3 %, voltages by 0.2 %, standard deviations",
        "links of the swarm: up for 120 s, down for 60 s in the mean",
        "noise of the board's sensors",
        "blind arms: form factor 5 to 15 % off either way, wheels add 0.02 to 0.06 V/m a radian, lag of 0.5 to 2 s",
    ],
    arms: &[
        board(PRINTED, "a loop of 20 m by 20 m driven sixteen times, means of cells"),
        board(OURS, "rows, then columns that cross them, map by place and time, calibrated mill"),
        board(ROWS, "row by row and back to the start, in place of crossing rows"),
        board(SITES, "from site to site by mutual information in the same time"),
        perfect(PERFECT, "ours on actuators that move as commanded, with a pose that is true, a mill without noise"),
        board(SWARM, "six robots on 1 km2, and one, until the map is known to 20 V/m; each on its board, on one clock"),
        perfect(SWARM_PERFECT, "the same on perfect actuators"),
        board(FORM, "the form factor is not the calibrated one: what does the model of the mill lack?"),
        board(CHARGE, "the same with wheels that charge the body"),
        board(LAG, "the same with a mill that lags"),
        board(CLEAN, "the same with nothing hidden"),
    ],
    metrics: &[
        measured("rmse_over_per_cell", "1", MEDIAN, &[set(OURS, HALF), set(SITES, HALF), set(PERFECT, HALF)]),
        measured("rmse_v_m", "V/m", Statistic::Mean, &[]),
        measured("rmse_per_cell_v_m", "V/m", Statistic::Mean, &[]),
        measured("rmse_without_time_v_m", "V/m", Statistic::Mean, &[]),
        measured("rmse_without_form_v_m", "V/m", Statistic::Mean, &[]),
        measured("rmse_without_charge_v_m", "V/m", Statistic::Mean, &[]),
        measured("pattern_rmse_v_m", "V/m", Statistic::Mean, &[]),
        measured("pattern_rmse_per_cell_v_m", "V/m", Statistic::Mean, &[]),
        measured("structure_v_m", "V/m", Statistic::Mean, &[]),
        measured("drift_v_m", "V/m", Statistic::Mean, &[]),
        measured("drift_error_share", "1", MEDIAN, &[set(OURS, HALF)]),
        measured("in_interval", "1", Statistic::Mean, &[]),
        measured("loop_once_v_m", "V/m", Statistic::Mean, &[]),
        measured("loop_closed_v_m", "V/m", Statistic::Mean, &[]),
        measured("loop_closed_over_once", "1", MEDIAN, &[set(PRINTED, HALF)]),
        measured("form_error", "1", MOST, &[set(OURS, TWO_PERCENT)]),
        measured("offset_error", "1", MOST, &[set(OURS, TWO_PERCENT)]),
        measured("offset_error_v_m", "V/m", MOST, &[]),
        measured("pose_error_m", "m", MOST, &[]),
        measured("duration_s", "s", Statistic::Mean, &[]),
        measured("time_share_of_six", "1", Statistic::Mean, &[set(SWARM, QUARTER), set(SWARM_PERFECT, QUARTER)]),
        measured("one_robot_s", "s", Statistic::Mean, &[]),
        measured("six_robots_s", "s", Statistic::Mean, &[]),
        measured("reached", "1", Statistic::Share, &[]),
        measured("effect_named", "1", Statistic::Share, &[set(FORM, MOSTLY), set(CHARGE, MOSTLY), set(LAG, MOSTLY)]),
        measured("size_in_interval", "1", Statistic::Share, &[]),
        measured("size_error", "1", MEDIAN, &[]),
        measured("effect_claimed", "1", Statistic::Share, &[set(CLEAN, Limit::AtMost(0.0))]),
        measured("held_out_before", "1", MEDIAN, &[]),
        measured("held_out_after", "1", MEDIAN, &[]),
    ],
};

impl System for Fieldmap {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        if let Some(hidden) = trial.arm.strip_prefix("blind:") {
            return run::blind(trial, hidden);
        }
        match trial.arm {
            SWARM | SWARM_PERFECT => run::swarm(trial),
            _ => run::plot(trial),
        }
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure::curves(trial).map(Some)
    }

    fn views(&self, trial: &Trial) -> Result<Vec<View>, Error> {
        figure::views(trial)
    }
}

fn unsuitable(board: &str, why: String) -> Error {
    Error::Unsuitable { system: NAME, board: board.to_owned(), why }
}

fn is_kinematic(arm: &str) -> bool {
    ABOUT.arm(arm).is_some_and(|arm| arm.is_kinematic)
}

#[cfg(test)]
mod tests;
