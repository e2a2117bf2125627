//! SKIDCAL: the two slip compliances of a four-wheel skid-steer robot, from two tests on a floor.
//!
//! Trimble, Fox, *Skid-steer friction calibration protocol for digital twin creation*, TAROS 2023. A straight run with
//! steps of the speed gives `c_long`, a spin on the spot the ratio `c_lat / c_long`. [`protocol`] drives both on any
//! skid-steer board; [`estimate`] has the paper's formulas and the repaired one, [`bristle`] ours; [`missing`] searches
//! for unmodelled effects; [`scene`] samples the robots of the study.
//!
//! # Repairs
//! Newton's law for four wheels, `a = 4 (v_r - v) / (c v_r m)`, solves to `v_r = v / (1 - a c m / 4)`. Equations (1) and (2) print
//! `v / (1 - 4 a c m)`: typed in as printed they return a sixteenth of `c_long`. The print's bound on `c_long` belongs to the
//! repaired form.

pub mod bristle;
pub mod estimate;
pub mod export;
mod figure;
mod kinematic;
pub mod missing;
pub mod protocol;
pub mod scene;

use r4_rig::{Rig, Session};

use crate::{
    About, Arm, Error, Figure, Limit, Metric, Paper, REPORTED, ResultFile, Source, Statistic, System, Target, Trial,
    Values,
};

/// Robot system SKIDCAL, listed in [`crate::all`].
#[derive(Debug)]
pub struct Skidcal;

/// Name of the system in commands and records.
const NAME: &str = "skidcal";
/// Arm with a hidden effect in the robot.
const BLIND: &str = "blind:one-effect";
/// Number of straight runs there and back in that arm.
const BLIND_RUNS: usize = 4;

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Skid-steer friction calibration protocol for digital twin creation",
        published: "Trimble, Fox; TAROS 2023",
    },
    question: "Which slip compliances make a simulated skid-steer robot move as the real one, from two tests on a floor?",
    robot: "openscout",
    reported: REPORTED,
    sampled: &[
        "c_long 0.01 to 0.03 1/N, log-uniform",
        "c_lat / c_long 2 to 12, log-uniform",
        "mass 9 to 14 kg, uniform; inertia in proportion",
        "friction 10, or 0.2 for every fourth seed: the wheels then slide in the spin",
        "noise of the tracked positions, 1 mm, and headings, 0.01 rad, at 20 Hz",
        "noise of the inertial sensor, 0.05 m/s², at 100 Hz",
        "in blind:one-effect, c_long 0.01 to 0.015 1/N, c_lat / c_long 2 to 6, friction 0.3, and a gyroscope's scale 0.5 to 1.5 % off, a wheel radius 1 to 5 % off, a centre of mass 20 to \
         60 mm before or behind the middle, or nothing",
    ],
    arms: &[
        Arm {
            name: "paper",
            does: "equation (2) as printed, on accelerations from positions differentiated twice; equation (3)",
            is_kinematic: false,
        },
        Arm { name: "baseline:repaired", does: "the same with the repaired equation", is_kinematic: false },
        Arm {
            name: "ours",
            does: "least squares of tracked positions over all steps, repeated until the interval is narrow",
            is_kinematic: false,
        },
        Arm { name: "ablation:one-run", does: "ours without repeats", is_kinematic: false },
        Arm {
            name: BLIND,
            does: "names an unmodelled effect from four runs, a spin with sliding wheels and the board's gyroscope",
            is_kinematic: false,
        },
        Arm {
            name: "ablation:perfect-actuators",
            does: "ours on wheels that turn as they are commanded, without motors and board",
            is_kinematic: true,
        },
    ],
    metrics: &[
        Metric {
            name: "c_long_relative",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[],
        },
        Metric {
            name: "c_long_error",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtMost(0.05), from: "set by this project" }],
        },
        Metric {
            name: "c_long_within_5_percent",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtLeast(0.9), from: "set by this project" }],
        },
        Metric {
            name: "c_long_covered",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtLeast(0.9), from: "set by this project: 95 % intervals" }],
        },
        Metric {
            name: "inertial_c_long_relative",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[],
        },
        Metric {
            name: "inertial_c_long_error",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtMost(0.05), from: "set by this project" }],
        },
        Metric {
            name: "inertial_c_long_within_5_percent",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtLeast(0.9), from: "set by this project" }],
        },
        Metric {
            name: "inertial_c_long_covered",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtLeast(0.9), from: "set by this project: 95 % intervals" }],
        },
        Metric {
            name: "ratio_error",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[],
        },
        Metric {
            name: "ratio_error_noise_free",
            unit: "1",
            statistic: Statistic::Quantile(0.95),
            source: Source::Simulated,
            targets: &[Target {
                arm: "ours",
                limit: Limit::AtMost(2e-4),
                from: "printed: 9.998 of 10, 0.02 %; the text says 0.2 %",
            }],
        },
        Metric {
            name: "ratio_covered",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtLeast(0.9), from: "set by this project: 95 % intervals" }],
        },
        Metric {
            name: "coulomb_check_right",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: "ours", limit: Limit::AtLeast(0.95), from: "set by this project" }],
        },
        Metric {
            name: "hidden_effect_named",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: BLIND, limit: Limit::AtLeast(0.9), from: "set by this project" }],
        },
        Metric {
            name: "nothing_hidden_nothing_named",
            unit: "1",
            statistic: Statistic::Share,
            source: Source::Simulated,
            targets: &[Target { arm: BLIND, limit: Limit::AtLeast(0.9), from: "set by this project" }],
        },
        Metric {
            name: "held_out_error_after_over_before",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[Target { arm: BLIND, limit: Limit::AtMost(0.5), from: "set by this project" }],
        },
        Metric {
            name: "effect_size_error",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[Target { arm: BLIND, limit: Limit::AtMost(0.1), from: "set by this project" }],
        },
        Metric {
            name: "straight_runs",
            unit: "1",
            statistic: Statistic::Quantile(0.5),
            source: Source::Simulated,
            targets: &[],
        },
    ],
};

impl System for Skidcal {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        let Recorded { truth, hidden, recording } = Recorded::of(trial)?;
        Ok(match trial.arm {
            BLIND => named(hidden, &missing::findings(&recording, truth.friction)),
            arm => evaluate(arm, &truth, &recording),
        })
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure::of(trial).map(Some)
    }

    fn files(&self, trial: &Trial) -> Result<Vec<ResultFile>, Error> {
        export::files(trial)
    }
}

/// A trial's robot and recording.
struct Recorded {
    truth: scene::Truth,
    hidden: Option<scene::Hidden>,
    recording: protocol::Recording,
}

impl Recorded {
    fn of(trial: &Trial) -> Result<Self, Error> {
        let (truth, hidden) = match trial.arm {
            BLIND => scene::hidden(trial.seed),
            _ => (scene::sample(trial.seed), None),
        };
        let noise = scene::Noise::of(trial.seed);
        if trial.arm == "ablation:perfect-actuators" {
            let recording = kinematic::recorded(&truth, protocol::Repeats::UntilNarrow, noise)?;
            return Ok(Self { truth, hidden, recording });
        }
        let mut rig = Rig::new(trial.board.clone());
        rig.seed = trial.seed;
        rig.alter = Some(scene::altered(truth, hidden));
        let simulated = rig.robot()?;
        let robot = protocol::SkidRobot::of(&simulated, truth.mass_kg);
        let (robot, repeats) = match trial.arm {
            "ours" => (robot, protocol::Repeats::UntilNarrow),
            BLIND => (robot.and_then(|robot| robot.with_gyroscope(&simulated)), protocol::Repeats::Times(BLIND_RUNS)),
            _ => (robot, protocol::Repeats::Once),
        };
        let robot = robot.map_err(|why| unsuitable(trial, why))?;
        let work = async |session: &Session<'_>| protocol::drive(session, &robot, repeats, noise).await;
        let (recording, _) = rig.run(None, work)?;
        Ok(Self { truth, hidden, recording })
    }
}

/// Computes the metrics of a search in a robot with at most one hidden effect.
fn named(hidden: Option<scene::Hidden>, found: &[missing::Finding]) -> Values {
    let share = |is: bool| f64::from(u8::from(is));
    let Some(hidden) = hidden else {
        return Values::from([("nothing_hidden_nothing_named".to_owned(), share(found.is_empty()))]);
    };
    let is_named = matches!(found, [only] if only.effect == hidden.effect);
    let mut values = Values::from([("hidden_effect_named".to_owned(), share(is_named))]);
    if let Some(finding) = found.iter().find(|finding| finding.effect == hidden.effect) {
        values.insert("held_out_error_after_over_before".to_owned(), finding.after / finding.before);
        let none = if hidden.effect == missing::Effect::CentreOfMass { 0.0 } else { 1.0 };
        let error = (finding.size - hidden.size) / (hidden.size - none);
        values.insert("effect_size_error".to_owned(), error.abs());
    }
    values
}

fn unsuitable(trial: &Trial, why: impl Into<String>) -> Error {
    Error::Unsuitable { system: NAME, board: trial.board.to_string(), why: why.into() }
}

fn without_estimate(trial: &Trial) -> Error {
    unsuitable(trial, "its runs give no estimate: is it a skid-steer robot that moves?")
}

/// Computes the metrics of one recording.
fn evaluate(arm: &str, truth: &scene::Truth, recording: &protocol::Recording) -> Values {
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| {
        values.insert(name.to_owned(), value);
    };
    let share = |is: bool| f64::from(u8::from(is));
    let is_paper = arm == "paper" || arm == "baseline:repaired";
    let ratio = truth.c_lat_per_n / truth.c_long_per_n;
    let (c_long, found_ratio) = match arm {
        "paper" => (estimate::printed(recording), estimate::commanded_ratio(recording)),
        "baseline:repaired" => (estimate::repaired(recording), estimate::commanded_ratio(recording)),
        _ => (bristle::c_long(recording), estimate::ratio(recording)),
    };
    let inertial = if is_paper { None } else { bristle::c_long_inertial(recording) };
    for (prefix, found) in [("", c_long), ("inertial_", inertial)] {
        let Some(found) = found else { continue };
        let relative = found.value / truth.c_long_per_n;
        put(&format!("{prefix}c_long_relative"), relative);
        put(&format!("{prefix}c_long_error"), (relative - 1.0).abs());
        put(&format!("{prefix}c_long_within_5_percent"), share((relative - 1.0).abs() <= 0.05));
        if let Some(interval) = found.interval {
            put(&format!("{prefix}c_long_covered"), share(interval.contains(truth.c_long_per_n)));
        }
    }
    put("straight_runs", recording.runs as f64);
    let slides = truth.slides(recording);
    if !is_paper {
        put("coulomb_check_right", share(estimate::reaches_friction(recording, truth.friction) == slides));
    }
    // Sliding wheels do not obey the linear law: the check reports them, and there is no ratio to compare.
    if slides {
        return values;
    }
    if let Some(found) = found_ratio {
        put("ratio_error", (found.value / ratio - 1.0).abs());
        if let Some(interval) = found.interval {
            put("ratio_covered", share(interval.contains(ratio)));
        }
    }
    if let Some(found) = estimate::ratio(&recording.without_noise()) {
        put("ratio_error_noise_free", (found.value / ratio - 1.0).abs());
    }
    values
}

#[cfg(test)]
mod husky;
#[cfg(test)]
mod mujoco;
#[cfg(test)]
mod tests;
