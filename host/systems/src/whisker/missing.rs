//! Search for the effect that a rigid whisker's model lacks: dead time or play of its magnet, from recordings at two
//! standing boxes.
//!
//! The narrow robot drives up to the boxes and back, each recording at another speed, and touches them with its whiskers only. The base
//! model is geometry, with the near face `f`, the inner corner `y` and the magnet's zero: `d = f - x`, and the bend is `acos(d / l)`, the
//! tip on the face, before the face's plane and `atan2(y, d)`, the corner, past it, less the bearing at rest. Each candidate adds one effect.
//!
//! | candidate | prediction | size |
//! | --- | --- | --- |
//! | `dead time` | the bend where the robot was `t` ago | `t`, s |
//! | `hysteresis` | follows the bend within half of `h` to both sides | `h`, rad |
//! | `yielding` | the face gives way by `g` of the bend | `g`, m/rad |
//!
//! The speed separates a dead time, which lags in proportion to it, from play, which does not. The body of `r4-world`
//! computes the bend by intervals of bearings of everything within reach; the model here is two formulas.

use r4_rig::{Error as RigError, Session, Velocity};

use super::{
    law::{Order, Seen},
    prepared,
    protocol::Rider,
    scene::{Case, Load, Setup},
};
use crate::{
    Error, Sampler, Trial, Values,
    effects::{Effect, Found, Search},
};

/// Purpose of the random numbers of the hidden effect.
const OF_HIDDEN: u64 = 2;
/// Speeds of the recordings, m/s; the last one is held out.
const SPEEDS_M_S: [f64; 5] = [0.187, 0.06, 0.14, 0.09, 0.12];
/// Turning points of the robot, m from its start: one before the whiskers touch, one before the shell does.
const BETWEEN_M: [f64; 2] = [0.08, 0.19];
/// Number of approaches in a recording.
const TIMES: usize = 3;
/// Candidate effects. Least sizes: the board's samples are known 20 to 30 ms after they change; the noise of a magnet
/// is 2 mrad.
const EFFECTS: [Effect; 3] = [
    Effect { name: "dead time", start: &[0.05], absent: 0.0, least: 0.05 },
    Effect { name: "hysteresis", start: &[0.02], absent: 0.0, least: 0.01 },
    Effect { name: "yielding", start: &[0.002], absent: 0.0, least: 0.002 },
];

/// Weight of the prior on the inner corner's position, rad/m: the robot is put down to 5 mm, and a sample is known to 2
/// mrad. Without it 4 of 6 recordings with a dead time (seeds 1 to 6) had base models whose whisker never meets the
/// corner, which leaves its position undetermined.
const PUT_DOWN_RAD_PER_M: f64 = 2e-3 / 5e-3;

/// Effect hidden in a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hidden {
    /// Dead time: samples are shown late.
    DeadTime,
    /// Play of the magnets.
    Hysteresis,
    /// No effect, as a control.
    Nothing,
}

impl Hidden {
    /// Effect that the arm of this name hides; `None` for arms without recordings.
    #[must_use]
    pub fn of(arm: &str) -> Option<Self> {
        Some(match arm {
            super::BLIND_DEAD_TIME => Self::DeadTime,
            super::BLIND_HYSTERESIS => Self::Hysteresis,
            super::BLIND_CLEAN => Self::Nothing,
            _ => return None,
        })
    }

    const fn name(self) -> Option<&'static str> {
        match self {
            Self::DeadTime => Some("dead time"),
            Self::Hysteresis => Some("hysteresis"),
            Self::Nothing => None,
        }
    }
}

/// Samples shown by the board: time, s; travel, m; bend of the left whisker, rad.
type Recording = Vec<[f64; 3]>;

/// Drives to the boxes and back, at each of the speeds.
async fn record(session: &Session<'_>, setup: &Setup, case: &Case) -> Result<Vec<Recording>, RigError> {
    session
        .armed(async || {
            let mut rider = Rider::new(session, setup).await?;
            let servo_rad = setup.servo_max_rad;
            let order = |forward_m_s: f64| Order { servo_rad, velocity: Velocity { forward_m_s, yaw_rad_s: 0.0 } };
            rider.order(order(0.0)).await?;
            session.board.sleep_s(0.8 + case.waits_s).await;
            rider.skip();
            let travel_m = |seen: &Seen| 0.5 * (seen.wheels_rad[0] + seen.wheels_rad[1]) * setup.drive.wheel_radius_m;
            let first_m = travel_m(&rider.seen().await?);
            let mut recordings = Vec::new();
            for speed_m_s in SPEEDS_M_S {
                let mut recording = Recording::new();
                for _ in 0..TIMES {
                    for (sign, to_m) in [(1.0, BETWEEN_M[1]), (-1.0, BETWEEN_M[0])] {
                        rider.order(order(sign * speed_m_s)).await?;
                        loop {
                            let seen = rider.seen().await?;
                            let x_m = travel_m(&seen) - first_m;
                            recording.push([seen.time_s, x_m, seen.bent_rad[0]]);
                            if sign * (x_m - to_m) >= 0.0 {
                                break;
                            }
                        }
                    }
                }
                recordings.push(recording);
            }
            Ok(recordings)
        })
        .await
}

/// Indices of a recording at which a new sample is shown; the shown value is constant in between.
fn samples(recording: &Recording) -> Vec<usize> {
    let is_new = |place: &usize| recording[*place][2] != recording[*place - 1][2];
    (1..recording.len()).filter(is_new).collect()
}

/// Predicts the samples of a recording from `[f, y, zero]` and the parameter of an effect.
fn predict(effect: Option<usize>, parameters: &[f64], recording: &Recording, setup: &Setup) -> Vec<f64> {
    let [face_m, corner_m, zero_rad, ref added @ ..] = *parameters else { return Vec::new() };
    let size = added.first().copied().unwrap_or(0.0);
    let (length_m, rest_rad) = (setup.whiskers.length_m, setup.whiskers.rest_rad);
    let at = |ahead_m: f64| {
        // Past the face the corner counts for any length of the whisker. If it counted within reach only, a base model of
        // late samples would put the corner a whisker's length aside, where the slope jumps, and the fit would go to and
        // fro across this crease without an end.
        let bearing_rad = if ahead_m > 0.0 { (ahead_m / length_m).min(1.0).acos() } else { corner_m.atan2(ahead_m) };
        (bearing_rad - rest_rad).max(0.0)
    };
    let bend = |x_m: f64| match effect {
        Some(2) => at(face_m + size * at(face_m - x_m) - x_m),
        _ => at(face_m - x_m),
    };
    // A sample known late belongs to an earlier moment.
    let moment_s = |place: usize| recording[place][0] - setup.settles_s;
    if effect == Some(1) {
        let half_rad = 0.5 * size.abs();
        let mut magnet_rad = bend(recording[0][1]);
        let followed: Vec<f64> = recording
            .iter()
            .map(|[_, x_m, _]| {
                let bent_rad = bend(*x_m);
                magnet_rad = magnet_rad.clamp(bent_rad - half_rad, bent_rad + half_rad);
                magnet_rad
            })
            .collect();
        let at = |place: usize| {
            let then = recording.partition_point(|[at_s, ..]| *at_s < moment_s(place));
            zero_rad + followed[then.min(followed.len() - 1)]
        };
        return samples(recording).into_iter().map(at).collect();
    }
    let late_s = if effect == Some(0) { size } else { 0.0 };
    let place = |place: usize| zero_rad + bend(travelled_m(recording, moment_s(place) - late_s));
    samples(recording).into_iter().map(place).collect()
}

/// Travel at a time, m: linear between the samples of a recording, constant beyond its ends.
fn travelled_m(recording: &Recording, time_s: f64) -> f64 {
    let after = recording.partition_point(|[at_s, ..]| *at_s < time_s);
    match (after.checked_sub(1).map(|before| recording[before]), recording.get(after).copied()) {
        (Some([from_s, from_m, _]), Some([to_s, to_m, _])) => {
            from_m + (to_m - from_m) * (time_s - from_s) / (to_s - from_s)
        }
        (Some([_, only_m, _]), None) | (None, Some([_, only_m, _])) => only_m,
        (None, None) => f64::NAN,
    }
}

/// Runs a trial: records whiskers with at most one effect, and searches for it.
///
/// # Errors
/// [`Error::Unsuitable`] when the board does not fit; [`Error::Rig`] when the session fails; [`Error::Effects`] when
/// the base model cannot be fitted.
pub fn run(trial: &Trial, hidden: Hidden) -> Result<Values, Error> {
    let mut sampler = Sampler::new(trial.seed, OF_HIDDEN);
    // Both sizes are sampled in every arm, so that a seed's sequence does not depend on the arm.
    let mut size = |is: Hidden, low: f64, high: f64| {
        let value = sampler.uniform(low, high);
        if hidden == is { value } else { 0.0 }
    };
    let (late_s, hysteresis_rad) = (size(Hidden::DeadTime, 0.1, 0.3), size(Hidden::Hysteresis, 0.03, 0.08));
    let nominal = Case::of(trial.seed, Load::Heavy);
    // The robot is put down by hand, straight in front of the gap's middle.
    let case = Case { late_s, hysteresis_rad, aside_m: 0.1 * nominal.aside_m, yaw_rad: 0.0, ..nominal };
    let (rig, setup) = prepared(trial, &case)?;
    let work = async |session: &Session<'_>| record(session, &setup, &case).await;
    let (recordings, _) = rig.run(None, work)?;
    let found = search(&recordings, &setup)?;
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    match hidden.name() {
        Some(name) => {
            let right = found.filter(|found| found.name == name);
            put("effect_named", f64::from(u8::from(right.is_some())));
            if let Some(found) = right {
                put("effect_rmse_before", found.before);
                put("effect_rmse_after", found.after);
                put("effect_error", (found.size.abs() - late_s - hysteresis_rad).abs() / (late_s + hysteresis_rad));
            }
        }
        None => {
            put("clean_quiet", f64::from(u8::from(found.is_none())));
        }
    }
    Ok(values)
}

/// Searches the recordings for an effect.
fn search(recordings: &[Recording], setup: &Setup) -> Result<Option<Found>, Error> {
    // Nominal geometry: the hinge of the narrow robot, the nose at rest 20 cm before the boxes, half the gap beside
    // it.
    let shell = &setup.shell;
    let hinge_m = 0.5 * shell.length_m(shell.angle_rad(setup.servo_max_rad)) + setup.whiskers.hinge_m[0];
    let face_m = 0.5 * shell.length_m(shell.rest_rad) + super::scene::AHEAD_M - hinge_m;
    let corner_m = 0.5 * super::scene::GAP_M - setup.whiskers.hinge_m[1];
    let base_start = [face_m, corner_m, 0.0];
    // The position at which the robot was put down is one more observation.
    let put_down = |corner_m: f64| std::iter::once(PUT_DOWN_RAD_PER_M * corner_m);
    let shown = |recording: &Recording| {
        samples(recording).into_iter().map(|place| recording[place][2]).chain(put_down(corner_m)).collect()
    };
    let observed: Vec<Vec<f64>> = recordings.iter().map(shown).collect();
    let predict = |effect: Option<usize>, parameters: &[f64], run: usize| {
        let mut predicted = predict(effect, parameters, &recordings[run], setup);
        predicted.extend(parameters.get(1).copied().into_iter().flat_map(put_down));
        predicted
    };
    Search { base_start: &base_start, effects: &EFFECTS, observed: &observed, predict: &predict }.run()
}
