//! INHAND: size and position of an object between two fingers, estimated from the joints' encoders alone.
//!
//! Paper: "Object Feature Reconstruction via Robotic In-Hand-Manipulation and Haptic Proprioception", TAROS 2023. The
//! gripper holds an object, pivots it by widening and narrowing the palm, rolls it by turning both fingers, and models
//! fingers and object as a four-bar linkage with constant links: [`four_bar`].
//!
//! In fact the contacts move: round edges roll along the fingers. Our method ([`rolling`]) also estimates the radius,
//! and corrects the encoders by the datasheet's play and compliance ([`protocol::Stop::corrected`]). [`missing`]
//! searches for the effect that the linkage lacks. [`protocol`] manipulates on a board, [`scene`] samples objects.

mod bounded;
pub mod four_bar;
pub mod missing;
pub mod protocol;
pub mod rolling;
pub mod scene;

use r4_rig::{Rig, Session};

use crate::{
    About, Arm, Curve, Error, Figure, Limit, Metric, Panel, Paper, REPORTED, Source, Statistic, System, Target, Trial,
    Values,
};
use four_bar::{Linkage, Observation};
use protocol::{Motion, Stop};
use scene::{Case, Hidden, Setup};

/// Robot system INHAND, listed in [`crate::all`].
#[derive(Debug)]
pub struct Inhand;

/// Name of the system in commands and records.
const NAME: &str = "inhand";

/// Names of the arms.
const PAPER: &str = "paper";
const ROLL: &str = "baseline:roll-only";
const PIVOT: &str = "baseline:pivot-only";
const OURS: &str = "ours";
const SHARP: &str = "ablation:no-migration";
const PLAIN: &str = "ablation:plain-readings";
const EXACT: &str = "ablation:perfect-encoders";
const CLEAN: &str = "blind:clean";
/// Arms with a hidden effect, or none as a control.
const BLIND: [(&str, Hidden); 5] = [
    ("blind:migration", Hidden::Migration),
    ("blind:slip", Hidden::Slip),
    ("blind:backlash", Hidden::Backlash),
    ("blind:zero-offset", Hidden::ZeroOffset),
    (CLEAN, Hidden::Nothing),
];
/// Number of repetitions in blind arms, of the gauge's pivot and of the object's both motions; the last is held out.
const BLIND_REPEATS: usize = 4;

const fn board(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn measured(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

const fn named(arm: &'static str) -> Target {
    Target { arm, limit: Limit::AtLeast(0.9), from: "set by this project" }
}

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Object Feature Reconstruction via Robotic In-Hand-Manipulation and Haptic Proprioception",
        published: "TAROS 2023",
    },
    question: "How large is an object between two fingers, and where do they touch it, by the encoders of three servos?",
    robot: "two-finger-gripper",
    reported: REPORTED,
    sampled: &[
        "object 15 to 45 mm across, uniform; half of them discs, the others squares held across two edges of 0.05 to 0.3 of that as radius",
        "its centre 68 to 88 mm from the palm and within 2 mm of the middle, 40 to 80 g, friction 0.2 to 0.4 on the table, uniform",
        "fingers lean towards each other by 0.06 to 0.12 rad in the grip, uniform",
        "friction 0.7 to 1.0 and stiffness 6e4 to 1e5 N/m of the pads, uniform",
        "compliance and play behind the encoders 0.8 to 1.2 times the file's, uniform",
        "zeros of the encoders wrong by 0.5 mrad, normal; noise of encoders and analog inputs",
        "blind arms: square with sharp edges, 25 to 45 mm, and one of: radius 0.15 to 0.4 of its size; creep 1.5 to 4 /s; play of the \
         rack 1 to 2.5 mm; left zero wrong by 20 to 35 mrad",
        "gauge of the blind arms: rod of 30 mm, 0 to 13 um thinner (h6), placed and gripped within the objects' ranges",
    ],
    arms: &[
        board(PAPER, "four-bar linkage with constant links, encoders as they are, both motions"),
        board(ROLL, "the same, rolling alone"),
        board(PIVOT, "the same, pivoting by the palm alone"),
        board(
            OURS,
            "contacts that roll by a radius that is fitted, readings corrected by play and compliance of the data sheet",
        ),
        board(SHARP, "ours without migration of the contacts"),
        board(PLAIN, "ours with the encoders as they are"),
        board(EXACT, "ours on the true angles of fingers and palm"),
        board("blind:migration", "edges are round: what the constant linkage lacks, by search"),
        board("blind:slip", "contacts creep"),
        board("blind:backlash", "the palm's rack has play that is in no data sheet"),
        board("blind:zero-offset", "the left encoder's zero is wrong"),
        board(CLEAN, "nothing is hidden"),
    ],
    metrics: &[
        measured(
            "size_error_m",
            "m",
            Statistic::Quantile(0.5),
            &[Target { arm: OURS, limit: Limit::AtMost(3e-4), from: "set by this project" }],
        ),
        measured(
            "contact_error_m",
            "m",
            Statistic::Quantile(0.5),
            &[Target { arm: OURS, limit: Limit::AtMost(1e-3), from: "set by this project" }],
        ),
        measured("size_error_p90_m", "m", Statistic::Quantile(0.9), &[]),
        measured("contact_error_p90_m", "m", Statistic::Quantile(0.9), &[]),
        measured("across_error_m", "m", Statistic::Quantile(0.5), &[]),
        measured("migration_m", "m", Statistic::Quantile(0.5), &[]),
        measured("held", "1", Statistic::Share, &[]),
        measured(
            "effect_named",
            "1",
            Statistic::Share,
            &[named("blind:migration"), named("blind:slip"), named("blind:backlash"), named("blind:zero-offset")],
        ),
        measured(
            "clean_quiet",
            "1",
            Statistic::Share,
            &[Target { arm: CLEAN, limit: Limit::AtLeast(0.95), from: "set by this project" }],
        ),
        measured("effect_rmse_before", "rad", Statistic::Quantile(0.5), &[]),
        measured("effect_rmse_after", "rad", Statistic::Quantile(0.5), &[]),
    ],
};

impl System for Inhand {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        match hidden(trial.arm) {
            Some(hidden) => {
                let case = Case::hiding(trial.seed, hidden);
                let (_, gauge) = recorded(trial, &case.gauging(), &[Motion::Pivot], BLIND_REPEATS)?;
                let (setup, stops) = recorded(trial, &case, &Motion::BOTH, BLIND_REPEATS)?;
                found(hidden, &setup, &gauge, &stops)
            }
            None => {
                let case = Case::of(trial.seed);
                let (setup, stops) = recorded(trial, &case, &Motion::BOTH, 1)?;
                Ok(evaluate(trial.arm, &case, &setup, &stops))
            }
        }
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure(trial).map(Some)
    }
}

/// Effect that an arm hides; `None` for arms that estimate.
fn hidden(arm: &str) -> Option<Hidden> {
    BLIND.iter().find(|(name, _)| *name == arm).map(|(_, hidden)| *hidden)
}

/// Manipulates a case's object on the trial's board. Returns the values that the program knows of the gripper, and the
/// readings.
fn recorded(trial: &Trial, case: &Case, motions: &[Motion], repeats: usize) -> Result<(Setup, Vec<Stop>), Error> {
    let unsuitable = |why: String| Error::Unsuitable { system: NAME, board: trial.board.to_string(), why };
    let mut rig = Rig::new(trial.board.clone());
    rig.seed = case.seed;
    let nominal = rig.robot()?;
    let setup = Setup::of(&nominal).map_err(unsuitable)?;
    rig.alter = Some(case.altered(&nominal).map_err(unsuitable)?);
    let work = async |session: &Session<'_>| protocol::manipulate(session, &setup, case.palm_m, motions, repeats).await;
    let (stops, _) = rig.run(None, work)?;
    Ok((setup, stops))
}

/// Stops that an arm uses: those of one motion in the baselines, all otherwise.
fn used(arm: &str, stops: &[Stop]) -> Vec<Stop> {
    let only = match arm {
        ROLL => Some(Motion::Roll),
        PIVOT => Some(Motion::Pivot),
        _ => None,
    };
    stops.iter().filter(|stop| only.is_none_or(|motion| stop.motion == motion)).copied().collect()
}

/// Computes the metrics of an estimate against the truth at the first stop that it uses.
fn evaluate(arm: &str, case: &Case, setup: &Setup, stops: &[Stop]) -> Values {
    let w_m = setup.finger.half_width_m;
    let used = used(arm, stops);
    let mut values = Values::new();
    let share = |is: bool| f64::from(u8::from(is));
    // The size is NaN without both contacts: the object was lost.
    let held = stops.iter().all(|stop| stop.truth.size_m.is_finite());
    values.insert("held".into(), share(held));
    // Both methods estimate the grasp at their first stop.
    let Some(truth) = used.first().map(|stop| stop.truth) else { return values };
    let plain: Vec<Observation> = used.iter().map(|stop| stop.plain(setup)).collect();
    let corrected: Vec<Observation> = used.iter().map(|stop| stop.corrected(setup)).collect();
    let (contact_m, size_m, across_m) = match arm {
        PAPER | ROLL | PIVOT => {
            let Linkage { b_m, c_m, d_m } = four_bar::fit(w_m, &plain);
            ([b_m, d_m], c_m, None)
        }
        _ => {
            let exact: Vec<Observation> = used.iter().map(|stop| stop.truth.at).collect();
            let seen = match arm {
                PLAIN => &plain,
                EXACT => &exact,
                _ => &corrected,
            };
            let Some(grasp) = rolling::fit(w_m, seen, arm != SHARP) else { return values };
            (grasp.contact_m, grasp.size_m, Some(grasp.across_m))
        }
    };
    let contact_error_m = [0, 1].map(|side| (contact_m[side] - truth.contact_m[side]).abs());
    let size_error_m = (size_m - truth.size_m).abs();
    let ways_m: Vec<f64> = stops.iter().map(|stop| stop.truth.contact_m[0]).collect();
    let migration_m =
        ways_m.iter().fold(f64::NEG_INFINITY, |a, b| a.max(*b)) - ways_m.iter().fold(f64::INFINITY, |a, b| a.min(*b));
    let contact_error_m = contact_error_m[0].max(contact_error_m[1]);
    let mut put = |name: &str, value: f64| {
        // A lost object has no truth to compare with: the metric is absent then.
        if value.is_finite() {
            values.insert(name.to_owned(), value);
        }
    };
    put("size_error_m", size_error_m);
    put("size_error_p90_m", size_error_m);
    put("contact_error_m", contact_error_m);
    put("contact_error_p90_m", contact_error_m);
    put("migration_m", migration_m);
    if let Some(across_m) = across_m {
        put("across_error_m", (across_m - case.across_m).abs());
    }
    values
}

/// Computes the metrics of a search for the hidden effect.
fn found(hidden: Hidden, setup: &Setup, gauge: &[Stop], stops: &[Stop]) -> Result<Values, Error> {
    // A base model that cannot be fitted, as when the object was lost, identifies nothing, and is no clean run either.
    let (found, was_searched) = match missing::find(setup, gauge, stops) {
        Err(Error::Effects(_)) => (None, false),
        found => (found?, true),
    };
    let share = |is: bool| f64::from(u8::from(is));
    let Some(name) = missing::name(hidden) else {
        return Ok(Values::from([("clean_quiet".to_owned(), share(was_searched && found.is_none()))]));
    };
    let is_named = found.as_ref().is_some_and(|found| found.name == name);
    let mut values = Values::from([("effect_named".to_owned(), share(is_named))]);
    if let Some(found) = found {
        values.insert("effect_rmse_before".to_owned(), found.before);
        values.insert("effect_rmse_after".to_owned(), found.after);
    }
    Ok(values)
}

/// Figure of the contacts over a manipulation, and of the estimates of both methods.
fn figure(trial: &Trial) -> Result<Figure, Error> {
    let case = Case::of(trial.seed);
    let (setup, stops) = recorded(trial, &case, &Motion::BOTH, 1)?;
    let w_m = setup.finger.half_width_m;
    let plain: Vec<Observation> = stops.iter().map(|stop| stop.plain(&setup)).collect();
    let corrected: Vec<Observation> = stops.iter().map(|stop| stop.corrected(&setup)).collect();
    let only = |motion: Motion| {
        let seen: Vec<Observation> =
            stops.iter().filter(|stop| stop.motion == motion).map(|stop| stop.plain(&setup)).collect();
        four_bar::fit(w_m, &seen)
    };
    let (both, pivot, roll) = (four_bar::fit(w_m, &plain), only(Motion::Pivot), only(Motion::Roll));
    let grasp = rolling::fit(w_m, &corrected, true);
    let ours = grasp.map_or_else(Vec::new, |grasp| grasp.contacts_m(w_m, &corrected));
    let over = |name: &'static str, value: &dyn Fn(usize) -> f64| Curve {
        name,
        points: (0..stops.len()).map(|stop| (stop as f64, value(stop))).collect(),
    };
    let ours_mm = |stop: usize| ours.get(stop).map_or(f64::NAN, |contacts| 1e3 * contacts[0]);
    Ok(Figure {
        description: format!(
            "an object {:.1} mm across, seed {}, on {}: pivoted at stops 0 to 20, rolled at stops 21 to 41",
            1e3 * case.across_m,
            trial.seed,
            trial.board
        ),
        axis: "Stop",
        panels: vec![
            Panel {
                title: "Left contact from the joint (mm)",
                curves: vec![
                    over("true", &|stop| 1e3 * stops[stop].truth.contact_m[0]),
                    over("ours", &ours_mm),
                    over("four-bar, both motions", &|_| 1e3 * both.b_m),
                    over("four-bar, pivot", &|_| 1e3 * pivot.b_m),
                ],
            },
            Panel {
                title: "Between the contacts (mm)",
                curves: vec![
                    over("true", &|stop| 1e3 * stops[stop].truth.size_m),
                    over("four-bar, both motions", &|_| 1e3 * both.c_m),
                    over("four-bar, pivot", &|_| 1e3 * pivot.c_m),
                    over("four-bar, roll", &|_| 1e3 * roll.c_m),
                ],
            },
            Panel {
                title: "Palm (mm)",
                curves: vec![over("between the joints", &|stop| 1e3 * corrected[stop].palm_m)],
            },
            Panel {
                title: "Fingers from upright (rad)",
                curves: vec![
                    over("left", &|stop| corrected[stop].finger_rad[0] - std::f64::consts::FRAC_PI_2),
                    over("right", &|stop| corrected[stop].finger_rad[1] - std::f64::consts::FRAC_PI_2),
                ],
            },
        ],
    })
}

#[cfg(test)]
mod mujoco;
#[cfg(test)]
mod tests;
