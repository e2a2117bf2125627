//! OSMC: the evaluation of a motor driver by set points, repeated on plants with a hidden effect each.
//!
//! Alabi, Camara, Fox, *Evaluation of OSMC open source motor driver for reproducible robotics research*, TAROS 2023,
//! drives a small motor by an L298N, and a 24 V geared motor and a linear actuator by an OSMC, all under a PID. It
//! prints the final positions (Tables 1 and 2), and rise, overshoot and steady-state error over gains (Tables 3 to 5).
//! The printed numbers, with units and definitions as we read them, are in [`r4_identify::statics::table::osmc`],
//! together with the laws that explain them.
//!
//! | module | subject |
//! | --- | --- |
//! | [`bench`](mod@bench) | the three motors, their set points, and what is printed of them |
//! | [`pid`] | the paper's controller, without the defects of the released code |
//! | [`protocol`] | the experiments on a board |
//! | [`response`] | every metric, with its definition |
//! | [`mod@scene`] | what a seed hides in the motors |
//! | [`calibration`] | scale and offset of a sensor, by an instrument beside the board |
//! | [`naming`] | which effect is hidden, from recordings of the board |
//! | [`comparison`] | the paper, its controller and ours beside each other |
//! | [`ladder`] | laws for the printed rows and for ours |

pub mod bench;
pub mod calibration;
pub mod comparison;
mod figure;
mod kinematic;
pub mod ladder;
pub mod naming;
pub mod pid;
pub mod protocol;
pub mod response;
pub mod scene;

use r4_boards::Robot;
use r4_rig::{Rig, Session};

use crate::{
    About, Arm, Error, Figure, Limit, Metric, Paper, REPORTED, Record, Source, Statistic, System, Target, Trial,
    Values, sampler::Sampler,
};
use bench::Bench;
use calibration::Calibration;
use protocol::Controller;
use response::{Measured, Response};
use scene::{Motor, Scene};

/// Robot system OSMC, listed in [`crate::all`].
#[derive(Debug)]
pub struct Osmc;

/// Name of the system in commands and records.
pub const NAME: &str = "osmc";
/// Arm of the paper's controller.
pub const PAPER: &str = "paper";
/// Arm of the board's own loops, after a calibration.
pub const OURS: &str = "ours";
const UNBOUNDED: &str = "baseline:unbounded-sum";
const NO_FEED_FORWARD: &str = "ablation:no-feed-forward";
const UNCALIBRATED: &str = "ablation:uncalibrated";
/// Arm that identifies the hidden effect.
pub const BLIND: &str = "blind:one-effect";
const PERFECT: &str = "ablation:perfect-actuators";
/// Duration of the hold at the last set point, s, on a simulated board. Other boards, which are slower, have a shorter
/// one.
pub const HOLD_S: f64 = 60.0;
const SHORT_HOLD_S: f64 = 5.0;
/// Purpose of the random numbers of the instrument.
const OF_INSTRUMENT: u64 = 1;

const fn arm(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn of(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

/// Largest value of all trials.
const WORST: Statistic = Statistic::Quantile(1.0);

const fn ours(limit: Limit, from: &'static str) -> Target {
    Target { arm: OURS, limit, from }
}

const ERROR_DEG: &[Target] = &[ours(Limit::AtMost(1.0), "set by this project: 1 deg, the best row of Table 1")];
const ERROR_MM: &[Target] = &[ours(Limit::AtMost(0.2), "set by this project: printed 1 to 3 mm")];
const COUNTS: &[Target] = &[ours(Limit::AtMost(1.0), "set by this project: one count")];
const OVERSHOOT: &[Target] = &[ours(Limit::AtMost(1.0), "set by this project: printed 3 to 19")];
const RISE: &[Target] = &[ours(Limit::AtMost(2.75), "printed: the fastest row of Table 5, at the same duty clip")];
const CYCLES: &[Target] = &[ours(Limit::AtMost(0.0), "set by this project: none in 60 s")];
const SETTLED: &[Target] = &[ours(Limit::AtLeast(1.0), "set by this project: the board says so at each")];
const NAMED: &[Target] = &[Target { arm: BLIND, limit: Limit::AtLeast(0.9), from: "set by this project" }];

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Evaluation of OSMC open source motor driver for reproducible robotics research",
        published: "Alabi, Camara, Fox; TAROS 2023",
    },
    question: "How exactly, how fast and how steadily do motors reach their set points, whatever is hidden in them?",
    robot: "osmc-evaluation",
    reported: REPORTED,
    sampled: &[
        "in each of the three motors one of the following or nothing, all as likely",
        "coulomb friction, 2 to 10 % of the stall torque or force at full duty",
        "static friction beside it, 4.8 to 14 % of that, falling over 5 to 25 % of the top speed",
        "a dead band, 0.015 to 0.055 of duty, beside the bridge's own",
        "backlash, 1.1 to 7.2 degrees, or 0.3 to 2 % of the way in a second",
        "sag of the supply, 0.3 to 1.5 of the winding's resistance",
        "an offset of the sensor, 2 to 10 degrees or 0.3 to 1.5 mm, to either side",
        "a scale of the sensor, 0.5 to 3 % to either side",
        "each made smaller until the plant turns by 270 degrees in 2.5 s (the small motor: 1 s) at the duty clip, or the actuator moves at 6.6 mm/s",
        "reading errors of protractor and caliper, half a division of 0.5 degrees or 0.05 mm, uniform; noise of the converters",
    ],
    arms: &[
        arm(PAPER, "a plain PID at the paper's gains 10, 4, 3, on the host at 100 Hz, with a bounded sum"),
        arm(UNBOUNDED, "the same with a sum without bound, as in the released code"),
        arm(OURS, "the board's own position loop and profile, after a calibration by an instrument"),
        arm(NO_FEED_FORWARD, "ours without feed-forward"),
        arm(UNCALIBRATED, "ours without calibration: what a sensor's scale and offset do"),
        arm(
            BLIND,
            "names what is hidden in one of the motors, the seed's rest by three, from three recordings of it and the calibration",
        ),
        Arm {
            name: PERFECT,
            does: "ours with motors that are where their profile says, without board, friction and duty clip",
            is_kinematic: true,
        },
    ],
    metrics: METRICS,
};

macro_rules! metrics {
    ($($bench:literal in $unit:literal: $($point:literal)+; $error:expr; $($rise:literal)?;)+) => {
        &[$(
            $(of(concat!($bench, "_error_", $point, "_", $unit), $unit, WORST, $error),)+
            of(concat!($bench, "_error_uncalibrated_", $unit), $unit, WORST, &[]),
            of(concat!($bench, "_error_counts"), "1", WORST, COUNTS),
            of(concat!($bench, "_overshoot_percent"), "%", WORST, OVERSHOOT),
            $(of($rise, "s", WORST, RISE),)?
            of(concat!($bench, "_steady_", $unit), $unit, WORST, &[]),
            of(concat!($bench, "_limit_cycles"), "1", WORST, CYCLES),
            of(concat!($bench, "_settled"), "1", Statistic::Share, SETTLED),
            of(concat!($bench, "_stopped"), "1", Statistic::Share, &[]),
            of(concat!($bench, "_hidden_effect_named"), "1", Statistic::Share, NAMED),
            of(concat!($bench, "_nothing_hidden_nothing_named"), "1", Statistic::Share, NAMED),
            of(concat!($bench, "_held_out_error_after_over_before"), "1", Statistic::Quantile(0.5), &[]),
        )+]
    };
}

const METRICS: &[Metric] = metrics! {
    "small" in "deg": "90" "180" "270" "360"; ERROR_DEG; "small_rise_s";
    "geared" in "deg": "90" "180" "270" "360"; ERROR_DEG; "geared_rise_s";
    "linear" in "mm": "10" "25" "40" "70" "85"; ERROR_MM; ;
};

impl System for Osmc {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        let scene = scene(trial)?;
        let hold_s = if matches!(trial.board, r4_rig::Target::Sim(_)) { HOLD_S } else { SHORT_HOLD_S };
        let mut values = Values::new();
        for (index, motor) in scene.motors.iter().enumerate() {
            match trial.arm {
                // One motor per seed: its fits take half a minute.
                BLIND if index as u64 != trial.seed % scene.motors.len() as u64 => {}
                BLIND => naming::put(&scene, index, trial, &mut values)?,
                PERFECT => put(motor, &kinematic::driven(motor, trial.seed), &mut values),
                _ => put(motor, &driven(&scene, index, trial, hold_s)?, &mut values),
            }
        }
        Ok(values)
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure::of(trial).map(Some)
    }
}

fn unsuitable(trial: &Trial, why: impl ToString) -> Error {
    Error::Unsuitable { system: NAME, board: trial.board.to_string(), why: why.to_string() }
}

/// Metrics of a record that miss their targets, with their values.
#[must_use]
pub fn missed(record: &Record) -> Vec<(String, f64)> {
    let missed = METRICS.iter().filter_map(|metric| {
        let value = *record.values.get(metric.name)?;
        let limit = metric.target(&record.arm)?.limit;
        // A target on a share is for many trials; in one record, 0 misses it.
        let limit = if metric.statistic == Statistic::Share { Limit::AtLeast(1.0) } else { limit };
        (!limit.is_held_by(value)).then(|| (metric.name.to_owned(), value))
    });
    missed.collect()
}

/// Samples the scene of a trial's seed: motors with a hidden effect each.
///
/// # Errors
/// [`Error::Unsuitable`] for a board whose robot lacks a motor; [`Error::Rig`] when the robot cannot be read.
pub fn scene(trial: &Trial) -> Result<Scene, Error> {
    let rig = Rig::new(trial.board.clone());
    Scene::of(&rig.robot()?, trial.seed).map_err(|why| unsuitable(trial, why))
}

/// Result of one motor's trial.
#[derive(Clone, Debug)]
pub struct Driven {
    /// Response of the motor.
    pub response: Response,
    /// Calibration in the configuration of the board, or of the host.
    pub calibration: Calibration,
    /// Largest error of the true position over the set points before the calibration, deg or mm; `None` without a
    /// calibration run.
    pub uncalibrated: Option<f64>,
}

impl Driven {
    /// Metrics of the response.
    #[must_use]
    pub fn measured(&self, bench: &Bench) -> Measured {
        let count = self.calibration.count(bench);
        self.response.measured(&Bench { count, ..*bench }, |set| self.calibration.asked(bench, set))
    }
}

/// Runs motor number `index` of a scene by the controller of the trial's arm; the last set point is held for `hold_s`.
///
/// # Errors
/// [`Error::Rig`] when the session fails. A board that stops is a result.
pub fn driven(scene: &Scene, index: usize, trial: &Trial, hold_s: f64) -> Result<Driven, Error> {
    let bench = scene.motors[index].bench;
    let change = if trial.arm == NO_FEED_FORWARD { without_feed_forward } else { |_: &mut Robot| () };
    let controller = match trial.arm {
        PAPER => Controller::Host { sum_max: pid::SUM_MAX },
        UNBOUNDED => Controller::Host { sum_max: f64::INFINITY },
        _ => Controller::Board,
    };
    let is_calibrated = matches!(trial.arm, OURS | NO_FEED_FORWARD);
    let (calibration, uncalibrated) = match is_calibrated.then(|| calibrated(scene, index, trial)).transpose()? {
        Some((found, uncalibrated)) => (found.calibration, uncalibrated),
        None => (Calibration::NONE, None),
    };
    let rig = rig(scene, index, trial, calibration, change);
    let work =
        async |session: &Session<'_>| protocol::evaluate(session, &bench, &calibration, controller, hold_s).await;
    let (response, _) = rig.run(None, work)?;
    Ok(Driven { response, calibration, uncalibrated })
}

/// Calibrates a motor's sensor. Returns the calibration and the largest error of the true position before it, deg or
/// mm.
///
/// # Errors
/// The errors of [`driven`].
pub fn calibrated(scene: &Scene, index: usize, trial: &Trial) -> Result<(calibration::Found, Option<f64>), Error> {
    let bench = scene.motors[index].bench;
    // Bits 48 and up keep the sequences of the motors apart: seeds are small numbers.
    let mut noise = Sampler::new(trial.seed ^ ((index as u64) << 48), OF_INSTRUMENT);
    let rig = rig(scene, index, trial, Calibration::NONE, |_| ());
    let work = async |session: &Session<'_>| protocol::readings(session, &bench, &mut noise).await;
    let ((response, readings), _) = rig.run(None, work)?;
    let measured = response.measured(&bench, |set| set);
    let worst = measured.true_errors.iter().map(|error| error.abs()).reduce(f64::max);
    // After a stop there are too few rows: the sensor keeps its calibration.
    let none = calibration::Found { calibration: Calibration::NONE, effects: Vec::new() };
    Ok((calibration::found(&bench, &readings).unwrap_or(none), worst))
}

/// Rig of a board with the motors of a scene, of which number `index` has a calibration.
fn rig(scene: &Scene, index: usize, trial: &Trial, calibration: Calibration, change: fn(&mut Robot)) -> Rig {
    let mut calibrations = vec![Calibration::NONE; scene.motors.len()];
    calibrations[index] = calibration;
    let mut rig = Rig::new(trial.board.clone());
    rig.seed = trial.seed;
    rig.alter = Some(scene.altered(&calibrations, change));
    rig
}

fn without_feed_forward(robot: &mut Robot) {
    for control in robot.config.motors.iter_mut().filter_map(|motor| motor.control.as_mut()) {
        control.feed_forward.static_duty = 0.0;
        control.feed_forward.duty_per_speed = 0.0;
    }
}

/// Puts the metrics of a motor's trial into `values`.
fn put(motor: &Motor, driven: &Driven, values: &mut Values) {
    let Motor { bench, .. } = motor;
    let (name, unit) = (bench.name, bench.unit());
    let measured = driven.measured(bench);
    let mut put = |metric: String, value: f64| {
        values.insert(format!("{name}_{metric}"), value);
    };
    let share = |is: bool| f64::from(u8::from(is));
    for (set, error) in bench.set_points.iter().zip(&measured.true_errors) {
        put(format!("error_{set}_{unit}"), error.abs());
    }
    put("error_counts".to_owned(), measured.counts);
    put("overshoot_percent".to_owned(), measured.overshoot_percent);
    for (metric, value) in [
        (format!("error_uncalibrated_{unit}"), driven.uncalibrated),
        ("rise_s".to_owned(), measured.rise_s),
        (format!("steady_{unit}"), measured.steady),
        ("limit_cycles".to_owned(), measured.limit_cycles),
    ] {
        if let Some(value) = value {
            put(metric, value);
        }
    }
    put("settled".to_owned(), share(measured.is_settled));
    put("stopped".to_owned(), share(driven.response.stopped.is_some()));
}

#[cfg(test)]
mod tests;
