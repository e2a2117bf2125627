//! TAIL: a two-link tail on a person's back that moves its weight against a load that the person lifts.
//!
//! Paper: "Prototyping Mechanical Design of a Robotic Tail for Human Balance Support", TAROS 2023. It is mechanics only: links of 0.70
//! and 0.40 m, at most 7 kg, cable drives of 20 to 30, 0.625 N/m (taken for N m) and 573 W for motor 1, 4 N/m and 262 W for motor 2.
//!
//! The printed data contradict each other: at a ratio of 25 the motors give 15.6 and 100 N m, but the tail's weight
//! needs about 50 N m at the back and 10 N m at the middle joint. Three readings:
//!
//! | reading | at the back | at the middle joint |
//! | --- | --- | --- |
//! | as printed, motor 1 at the back | 0.625 N m, 573 W | 4 N m, 262 W |
//! | motor 1 is the outer joint's | 4 N m, 262 W | 0.625 N m, 573 W |
//! | columns of torque and power crossed | 4 N m, 573 W | 0.625 N m, 262 W |
//!
//! The controller is ours: [`law`] is a pure function from measurements to commands of the drives, [`model`] is its
//! model of person and tail, [`lqr`] computes its gain, [`trunk`] estimates the lean from an inertial sensor.
//! [`protocol`] runs it on a board, [`scene`] samples the persons. The person is a declared inverted pendulum: nothing
//! is claimed about people.

mod kinematic;
pub mod law;
pub mod lqr;
pub mod model;
pub mod protocol;
pub mod scene;
pub mod trunk;

use r4_rig::{Rig, Session};

use crate::{
    About, Arm, Curve, Error, Figure, Limit, Metric, Panel, Paper, REPORTED, Source, Statistic, System, Target, Trial,
    Values,
};
use law::Regulator;
use protocol::{Moment, Trace};
use scene::{Case, Reading, Setup};

/// Robot system TAIL, listed in [`crate::all`].
#[derive(Debug)]
pub struct Tail;

/// Name of the system in commands and records.
const NAME: &str = "tail";

/// Names of the arms.
const PRINTED: &str = "paper";
const OURS: &str = "ours";
const NO_TAIL: &str = "baseline:no-tail";
const HANGING: &str = "baseline:hanging-tail";
const CROSSED: &str = "ablation:crossed-powers";
const PLAIN: &str = "ablation:plain-bearings";
const PERFECT: &str = "ablation:perfect-actuators";

const fn board(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: false }
}

const fn measured(name: &'static str, unit: &'static str, statistic: Statistic, targets: &'static [Target]) -> Metric {
    Metric { name, unit, statistic, source: Source::Simulated, targets }
}

/// Robot, arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Prototyping Mechanical Design of a Robotic Tail for Human Balance Support",
        published: "TAROS 2023",
    },
    question: "How far does a two-link tail on the back keep a person from leaning forwards who lifts 10 kg?",
    robot: "balance-tail",
    reported: REPORTED,
    sampled: &[
        "mass of the person 60 to 90 kg, uniform",
        "ankle 1.6 to 2.0 times as stiff as gravity asks for, damping 150 to 250 N m s/rad, uniform",
        "10 kg lifted 0.30 to 0.40 m in front of the ankle, within 0.3 to 0.7 s, uniform",
        "pulleys that take 0.5 to 2 % per half turn, cables of 0.7 to 1.3 times the file's stiffness, uniform",
        "noise of the board's inertial sensor",
    ],
    arms: &[
        board(PRINTED, "our controller on the motors as printed: motor 1, 0.625 N m, at the back"),
        Arm { name: NO_TAIL, does: "the person alone", is_kinematic: true },
        board(HANGING, "the tail hangs on its brakes"),
        board(OURS, "regulator with gravity compensation inside the motors' limits; motor 1 moves the outer link"),
        board(CROSSED, "ours with the printed powers exchanged between the motors"),
        board(PLAIN, "ours with pulleys on plain bearings, 10 % per half turn, which the controller knows nothing of"),
        Arm { name: PERFECT, does: "ours on drives and sensors without a board between", is_kinematic: true },
    ],
    metrics: &[
        measured("excursion_m", "m", Statistic::Quantile(0.5), &[]),
        measured(
            "excursion_relative",
            "1",
            Statistic::Quantile(0.5),
            &[Target {
                arm: OURS,
                limit: Limit::AtMost(0.5),
                from: "set by this project: half of that without a tail",
            }],
        ),
        measured(
            "excursion_halved",
            "1",
            Statistic::Share,
            &[Target { arm: OURS, limit: Limit::AtLeast(0.9), from: "set by this project" }],
        ),
        measured(
            "at_limit_s",
            "s",
            Statistic::Quantile(1.0),
            &[Target { arm: OURS, limit: Limit::AtMost(0.0), from: "set by this project: no trial at a limit" }],
        ),
        measured("end_m", "m", Statistic::Quantile(0.5), &[]),
        measured("back_torque_max_nm", "N m", Statistic::Quantile(1.0), &[]),
        measured("outer_torque_max_nm", "N m", Statistic::Quantile(1.0), &[]),
        measured("power_max_w", "W", Statistic::Quantile(1.0), &[]),
    ],
};

impl System for Tail {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        let (without, _) = trace(&Trial { arm: NO_TAIL, ..trial.clone() })?;
        let (with, setup) = trace(trial)?;
        Ok(evaluate(&Case::of(trial.seed), &setup, &with, &without))
    }

    fn figure(&self, trial: &Trial) -> Result<Option<Figure>, Error> {
        figure(trial).map(Some)
    }
}

/// Figure of one lift without a tail, with the motors as printed, and with ours.
fn figure(trial: &Trial) -> Result<Figure, Error> {
    let of = |arm| trace(&Trial { arm, ..trial.clone() });
    let ((without, _), (printed, _), (ours, setup)) = (of(NO_TAIL)?, of(PRINTED)?, of(OURS)?);
    let curve = |name, trace: &Trace, value: &dyn Fn(&Moment) -> f64| {
        Curve::new(name, &trace.moments, |moment| (moment.time_s, value(moment)))
    };
    let lean_mm = |moment: &Moment| moment.wearer_x_m * 1e3;
    let angle_rad = |number: usize| move |moment: &Moment| moment.angle_rad[number];
    let share = |number: usize| {
        let most_nm = setup.joints[number].motor.torque_max_nm;
        move |moment: &Moment| moment.torque_nm[number] / most_nm
    };
    Ok(Figure {
        description: format!(
            "a lift of 10 kg at {:.1} s, seed {}, on {}: the person's lean, the joints and the motors' torque",
            Case::of(trial.seed).lift.at_s,
            trial.seed,
            trial.board
        ),
        axis: "Time (s)",
        panels: vec![
            Panel {
                title: "Person's centre of mass in front of the ankle (mm)",
                curves: vec![
                    curve("no tail", &without, &lean_mm),
                    curve("motors as printed", &printed, &lean_mm),
                    curve("motor 1 outside", &ours, &lean_mm),
                ],
            },
            Panel {
                title: "Joints, motor 1 outside (rad)",
                curves: vec![
                    curve("back", &ours, &angle_rad(1)),
                    curve("outer", &ours, &angle_rad(2)),
                    curve("back, motors as printed", &printed, &angle_rad(1)),
                ],
            },
            Panel {
                title: "Torque over the drive's limit, motor 1 outside",
                curves: vec![curve("back", &ours, &share(0)), curve("outer", &ours, &share(1))],
            },
        ],
    })
}

/// Runs a trial. Returns the true states and the values that its controller knows.
///
/// # Errors
/// [`Error::Unsuitable`] when the board does not fit; [`Error::Rig`] when the session fails.
pub fn trace(trial: &Trial) -> Result<(Trace, Setup), Error> {
    let unsuitable = |why: String| Error::Unsuitable { system: NAME, board: trial.board.to_string(), why };
    let reading = match trial.arm {
        PRINTED => Reading::Printed,
        CROSSED => Reading::CrossedPowers,
        _ => Reading::OuterFirst,
    };
    let case = Case::of(trial.seed);
    let case = if trial.arm == PLAIN { case.with_plain_bearings() } else { case };
    let mut rig = Rig::new(trial.board.clone());
    rig.seed = trial.seed;
    let nominal = rig.robot()?;
    let setup = Setup::of(&nominal, reading, case.mass_kg).map_err(unsuitable)?;
    let regulator = Regulator::of(&setup).map_err(|error| unsuitable(error.to_string()))?;
    let mut robot = nominal.clone();
    case.put_into(&mut robot, reading).map_err(unsuitable)?;
    let perfect = |moments| Trace { moments, armed_at_s: 0.0 };
    let trace = match trial.arm {
        // Without a tail there is nothing for a board to drive.
        NO_TAIL => {
            let body = case.without_tail(&nominal).map_err(unsuitable)?;
            Trace { moments: kinematic::without_tail(body, &case), armed_at_s: f64::INFINITY }
        }
        PERFECT => {
            perfect(kinematic::with_tail(scene::tail(&robot).map_err(unsuitable)?.clone(), &case, &setup, &regulator))
        }
        arm => {
            rig.alter = Some(case.altered(reading));
            // Without a regulator the motors stay on their brakes.
            let regulator = Some(&regulator).filter(|_| arm != HANGING);
            let work = async |session: &Session<'_>| protocol::lift(session, &setup, case.lift.at_s, regulator).await;
            rig.run(None, work)?.0
        }
    };
    Ok((trace, setup))
}

/// Computes the metrics of a trial, relative to the same person without a tail.
fn evaluate(case: &Case, setup: &Setup, with: &Trace, without: &Trace) -> Values {
    let lifted = |moments: &[Moment]| {
        let start = moments.partition_point(|moment| moment.time_s < case.lift.at_s);
        // Relative to the stance before the lift, which the tail's weight alone shifts.
        let rest_m = moments.get(start).map_or(0.0, |moment| moment.wearer_x_m);
        let lean = move |moment: &Moment| (moment.wearer_x_m - rest_m).abs();
        let farthest = moments[start..].iter().map(lean).fold(0.0, f64::max);
        (farthest, moments.last().map_or(0.0, lean))
    };
    let (excursion_m, end_m) = lifted(&with.moments);
    let relative = excursion_m / lifted(&without.moments).0;
    let armed = &with.moments[with.moments.partition_point(|moment| moment.time_s < with.armed_at_s)..];
    let most = |of: &dyn Fn(&Moment) -> f64| armed.iter().map(of).fold(0.0, f64::max);
    let at_limit = armed.iter().filter(|moment| is_at_limit(moment, setup)).count();
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    put("excursion_m", excursion_m);
    put("excursion_relative", relative);
    put("excursion_halved", f64::from(u8::from(relative <= 0.5)));
    put("end_m", end_m);
    // Torques and limits exist only where the motors were armed.
    if with.armed_at_s.is_finite() {
        put("at_limit_s", at_limit as f64 * protocol::WATCHED_EVERY_S);
        put("back_torque_max_nm", most(&|moment| moment.torque_nm[0].abs()));
        put("outer_torque_max_nm", most(&|moment| moment.torque_nm[1].abs()));
        let power_w = |moment: &Moment, number: usize| moment.torque_nm[number] * moment.speed_rad_s[number];
        put("power_max_w", most(&|moment| power_w(moment, 0).max(power_w(moment, 1))));
    }
    values
}

/// Returns true when a motor is at its limit of torque, power or speed, which the drive enforces, or a joint is outside
/// its range.
fn is_at_limit(moment: &Moment, setup: &Setup) -> bool {
    (0..2).any(|number| {
        let law::Motor { torque_max_nm, power_max_w, top_speed_rad_s, .. } = setup.joints[number].motor;
        let (torque_nm, speed_rad_s) = (moment.torque_nm[number], moment.speed_rad_s[number]);
        let [low_rad, high_rad] = setup.settings.range_rad[number];
        // With a tolerance for the rounding of a power.
        let at = |value: f64, limit: f64| value >= limit * (1.0 - 1e-9);
        at(torque_nm.abs(), torque_max_nm)
            || at(torque_nm * speed_rad_s, power_max_w)
            || at(speed_rad_s.abs(), top_speed_rad_s)
            || !(low_rad..=high_rad).contains(&moment.angle_rad[number + 1])
    })
}

#[cfg(test)]
mod tests;
