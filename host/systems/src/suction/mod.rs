//! SUCTION: a strip with two suction cups, detached by three inflatable membranes.
//!
//! Paper: "Suction Cup Detachment Mechanism based on Fluidic Soft Actuators Strain for In-vivo Applications", TAROS 2023: a strip of
//! 68 x 18 x 5 mm of Ecoflex 00-50 with membranes of 1 mm, cups of 18 mm, inflated at 0.38 bar, middle then outers or the other way round.
//!
//! 0.38 bar is three to six times what such a membrane can hold: its pressure has a maximum at a stretch of 1.383, 11.8
//! kPa with a wall of a fifth of its radius, 6.5 kPa with a ninth. Pressure control beyond this limit point runs away;
//! volume control does not. [`law`] is ours: syringes, an interlock on pressure, and an end on the pressure drop that a
//! detachment causes. [`adhesion`] interprets the printed pull-off forces, [`blind`] identifies missing effects from
//! recordings. The tissue is a plane with a stiffness: no claim is made about bodies.

pub mod adhesion;
pub mod blind;
pub mod law;
pub mod protocol;
pub mod scene;

use r4_rig::{Rig, Session};

use crate::{
    About, Arm, Curve, Error, Figure, Limit, Metric, Panel, Paper, REPORTED, Sampler, Source, Statistic, System,
    Target, Trial, Values,
};
use law::{MIDDLE_FIRST, OUTERS_FIRST, Settings};
use protocol::{Method, Moment, Trace};
use scene::{Blind, Case, Feed, Hidden, Setup};

/// Robot system SUCTION, listed in [`crate::all`].
#[derive(Debug)]
pub struct Suction;

/// Name of the system in commands and records.
const NAME: &str = "suction";

/// Names of the arms.
const PRINTED: &str = "paper";
const OTHER_ORDER: &str = "baseline:outers-first";
const OURS: &str = "ours";
const LOW_PRESSURE: &str = "ablation:pressure-control";
const NO_SIGNATURE: &str = "ablation:no-signature";
const NO_INTERLOCK: &str = "ablation:no-interlock";
const BLIND: [(&str, Option<Hidden>); 4] = [
    ("blind:clean", None),
    ("blind:mullins", Some(Hidden::Mullins)),
    ("blind:creep", Some(Hidden::Creep)),
    ("blind:leak", Some(Hidden::Leak)),
];

/// Printed inflation pressure, Pa.
const PRINTED_PA: f64 = 38e3;
/// Pressure that our arm must stay below, Pa.
const MOST_PA: f64 = 20e3;
/// Time for which a group's valves are open before the next group's, s: not printed, our choice.
const GROUP_S: f64 = 5.0;
/// Number of recordings in a blind trial; the last is held out.
const RECORDINGS: usize = 4;
/// Purpose of the random numbers of recordings.
const OF_RECORDINGS: u64 = 3;

const fn board(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn measured(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

const fn ours(limit: Limit, from: &'static str) -> Target {
    Target { arm: OURS, limit, from }
}

const fn at_least(arm: &'static str, share: f64) -> Target {
    Target { arm, limit: Limit::AtLeast(share), from: "set by this project" }
}

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Suction Cup Detachment Mechanism based on Fluidic Soft Actuators Strain for In-vivo Applications",
        published: "TAROS 2023",
    },
    question: "Can inflatable membranes take a suction cup off at 0.2 bar at most, without bursting?",
    robot: "suction-pad",
    reported: REPORTED,
    sampled: &[
        "modulus 0.80 to 1.20 of the data sheet's: a batch 0.83 to 1.17, each membrane 0.03 about it, uniform",
        "radius of the membranes 5 to 7 mm, uniform: walls of a fifth to a seventh",
        "bursting stretch 3.6 to 4.4, uniform",
        "suction 3.7 to 11.6 kPa, the printed range from oil to moist, uniform",
        "tangential stiffness of each rim 600 to 1000 N/m, its leak beyond a strain of 0.06 to 0.20, uniform",
        "a kinked tube to the middle membrane in one of ten trials",
        "noise of the pressure sensors, 25 Pa",
        "blind: modulus 0.8 to 1.2; softening 15 to 35 %; 10 to 25 % relaxing in 1 to 3 s; leak of 2e-13 to 6e-13 m3/(s Pa)",
    ],
    arms: &[
        board(PRINTED, "sequence A, middle then outers, by pressure control at the printed 0.38 bar"),
        board(OTHER_ORDER, "sequence B, outers then middle, at 0.38 bar"),
        board(OURS, "sequence A by syringes, with an interlock at 0.18 bar and an end on the drop of pressure"),
        board(LOW_PRESSURE, "sequence A by pressure control at 0.2 bar"),
        board(NO_SIGNATURE, "ours, which fills all membranes whatever the pressure shows"),
        board(NO_INTERLOCK, "ours without a limit on the pressure"),
        board(BLIND[0].0, "recordings of a membrane without an effect"),
        board(BLIND[1].0, "recordings of a membrane that softens: one of three effects is to be named"),
        board(BLIND[2].0, "recordings of a membrane that creeps"),
        board(BLIND[3].0, "recordings of a membrane that leaks"),
    ],
    metrics: &[
        measured(
            "detached",
            "1",
            Statistic::Share,
            &[ours(Limit::AtLeast(0.95), "set by this project: one of ten tubes is kinked")],
        ),
        measured("burst", "1", Statistic::Share, &[ours(Limit::AtMost(0.0), "set by this project: 0 of 1000 cycles")]),
        measured(
            "peak_pressure_pa",
            "Pa",
            Statistic::Quantile(1.0),
            &[ours(Limit::AtMost(MOST_PA), "set by this project: 0.2 bar")],
        ),
        measured("time_to_detach_s", "s", Statistic::Quantile(0.5), &[]),
        measured("below_limit_point", "1", Statistic::Share, &[]),
        measured("residual_adhesion_n", "N", Statistic::Quantile(0.5), &[]),
        measured("stretch_max", "1", Statistic::Quantile(1.0), &[]),
        measured("shear_max_n", "N", Statistic::Quantile(0.5), &[]),
        measured("stopped_by_signature", "1", Statistic::Share, &[]),
        measured("false_signature", "1", Statistic::Share, &[]),
        measured("interlocked", "1", Statistic::Share, &[]),
        measured(
            "effect_named",
            "1",
            Statistic::Share,
            &[at_least(BLIND[1].0, 0.9), at_least(BLIND[2].0, 0.9), at_least(BLIND[3].0, 0.9)],
        ),
        measured("clean_quiet", "1", Statistic::Share, &[at_least(BLIND[0].0, 0.95)]),
        measured("effect_rmse_before", "Pa", Statistic::Quantile(0.5), &[]),
        measured("effect_rmse_after", "Pa", Statistic::Quantile(0.5), &[]),
    ],
};

impl System for Suction {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        if let Some((_, hidden)) = BLIND.iter().find(|(arm, _)| *arm == trial.arm) {
            return blind_trial(trial, *hidden);
        }
        Ok(evaluate(&trace(trial)?))
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure(trial).map(Some)
    }
}

fn unsuitable(trial: &Trial) -> impl Fn(String) -> Error {
    let board = trial.board.to_string();
    move |why| Error::Unsuitable { system: NAME, board: board.clone(), why }
}

/// Supply and inflation method of an arm.
fn method(arm: &str) -> (Feed, Method) {
    let ours = Settings::default();
    let by_volume = |settings| (Feed::Syringes, Method::Volume(settings));
    match arm {
        OURS => by_volume(ours),
        NO_SIGNATURE => by_volume(Settings { drop_pa: None, ..ours }),
        NO_INTERLOCK => by_volume(Settings { pressure_max_pa: None, ..ours }),
        LOW_PRESSURE => (Feed::Supply(MOST_PA), Method::Pressure { group_s: GROUP_S }),
        _ => (Feed::Supply(PRINTED_PA), Method::Pressure { group_s: GROUP_S }),
    }
}

/// Runs a trial and returns the true states during it.
///
/// # Errors
/// [`Error::Unsuitable`] when the board does not fit; [`Error::Rig`] when the session fails.
pub fn trace(trial: &Trial) -> Result<Trace, Error> {
    let (feed, method) = method(trial.arm);
    let case = Case::of(trial.seed);
    let mut rig = Rig::new(trial.board.clone());
    rig.seed = trial.seed;
    let mut robot = rig.robot()?;
    let setup = Setup::of(&robot).map_err(unsuitable(trial))?;
    // Tried on this copy first: the rig's own change cannot report an error.
    case.put_into(&mut robot, feed).map_err(unsuitable(trial))?;
    rig.alter = Some(case.altered(feed));
    let order = if trial.arm == OTHER_ORDER { OUTERS_FIRST } else { MIDDLE_FIRST };
    let work = async |session: &Session<'_>| protocol::inflate(session, &setup, order, method).await;
    Ok(rig.run(None, work)?.0)
}

/// Computes the metrics of a trial.
fn evaluate(trace: &Trace) -> Values {
    let Trace { moments, began_s, signature_s, is_interlocked } = trace;
    // Before the first membrane is fed the world settles; the metrics ignore that time.
    let moments = &moments[moments.partition_point(|moment| moment.time_s < *began_s)..];
    let detached = moments.iter().find(|moment| moment.is_attached != [true; 2]);
    let most = |of: &dyn Fn(&Moment) -> f64| moments.iter().map(of).fold(0.0, f64::max);
    let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
    let is = |holds: bool| f64::from(u8::from(holds));
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    put("detached", is(detached.is_some()));
    put("burst", is(moments.last().is_some_and(|last| last.is_burst.contains(&true))));
    put("peak_pressure_pa", most(&|moment| largest(&moment.line_pa).max(largest(&moment.balloon_pa))));
    if let Some(detached) = detached {
        put("time_to_detach_s", detached.time_s - began_s);
        put("below_limit_point", is(largest(&detached.stretch) < r4_world::LIMIT_STRETCH));
    }
    put("residual_adhesion_n", moments.last().map_or(0.0, |last| last.adhesion_n.iter().sum()));
    put("stretch_max", most(&|moment| largest(&moment.stretch)));
    put("shear_max_n", most(&|moment| largest(&moment.shear_n)));
    // A signature is true when a cup was off the tissue before it.
    let is_true = |at_s: f64| detached.is_some_and(|detached| detached.time_s <= at_s);
    put("stopped_by_signature", is(signature_s.is_some_and(is_true)));
    put("false_signature", is(signature_s.is_some_and(|at_s| !is_true(at_s))));
    put("interlocked", is(*is_interlocked));
    values
}

/// Records virgin membranes and searches for the effect that their base model lacks.
fn blind_trial(trial: &Trial, hidden: Option<Hidden>) -> Result<Values, Error> {
    let mut sampler = Sampler::new(trial.seed, OF_RECORDINGS);
    let mut rig = Rig::new(trial.board.clone());
    let setup = Setup::of(&rig.robot()?).map_err(unsuitable(trial))?;
    rig.alter = Some(Blind::of(trial.seed, hidden).altered());
    let mut runs = Vec::new();
    for number in 0..RECORDINGS {
        // Each recording has noise of its own.
        rig.seed = trial.seed.wrapping_mul(RECORDINGS as u64).wrapping_add(number as u64);
        let first_m3 = sampler.uniform(2.4e-6, 3.2e-6);
        // Load, unload, and reload a little beyond: the reload shows softening, the rests show creep and leaks.
        let volumes_m3 = [first_m3, 1e-6, first_m3 + 0.5e-6];
        let work = async |session: &Session<'_>| protocol::record(session, &setup, &volumes_m3, 0.8e-6, 1.0).await;
        runs.push(rig.run(None, work)?.0);
    }
    let found = blind::find(&setup, &runs)?;
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    match hidden {
        None => drop(put("clean_quiet", f64::from(u8::from(found.is_none())))),
        Some(hidden) => {
            let right = found.is_some_and(|found| found.name == blind::EFFECTS[hidden as usize].name);
            put("effect_named", f64::from(u8::from(right)));
        }
    }
    if let Some(found) = found {
        put("effect_rmse_before", found.before);
        put("effect_rmse_after", found.after);
    }
    Ok(values)
}

/// Figure of one case: pressure control as printed and at 0.2 bar, and volume control by our arm.
fn figure(trial: &Trial) -> Result<Figure, Error> {
    let of = |arm| trace(&Trial { arm, ..trial.clone() });
    let (printed, low, ours) = (of(PRINTED)?, of(LOW_PRESSURE)?, of(OURS)?);
    let curve = |name, trace: &Trace, value: &dyn Fn(&Moment) -> f64| {
        Curve::new(name, &trace.moments, |moment| (moment.time_s, value(moment)))
    };
    let middle_kpa = |moment: &Moment| moment.balloon_pa[1] * 1e-3;
    Ok(Figure {
        description: format!(
            "membranes inflated by pressure and by volume, seed {}, on {}: pressure and stretch of the middle one, pull-off force",
            trial.seed, trial.board
        ),
        axis: "Time (s)",
        panels: vec![
            Panel {
                title: "Pressure in the middle membrane (kPa)",
                curves: vec![
                    curve("0.38 bar", &printed, &middle_kpa),
                    curve("0.2 bar", &low, &middle_kpa),
                    curve("by volume", &ours, &middle_kpa),
                ],
            },
            Panel {
                title: "Stretch of the middle membrane",
                curves: vec![
                    curve("0.38 bar", &printed, &|moment| moment.stretch[1]),
                    curve("0.2 bar", &low, &|moment| moment.stretch[1]),
                    curve("by volume", &ours, &|moment| moment.stretch[1]),
                ],
            },
            Panel {
                title: "Pull-off force of the cups, by volume (N)",
                curves: vec![
                    curve("first cup", &ours, &|moment| moment.adhesion_n[0]),
                    curve("second cup", &ours, &|moment| moment.adhesion_n[1]),
                ],
            },
        ],
    })
}

#[cfg(test)]
mod tests;
