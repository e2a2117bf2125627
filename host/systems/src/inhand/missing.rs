//! Search for the effect that a four-bar linkage with constant links lacks, in repeated manipulations of one grasp.
//!
//! The observation is the right finger's angle at each stop; the half-angle form predicts it from the palm, the left
//! finger and b, c, d. Each repetition is a run; the last is held out.
//!
//! | effect | its size | in the prediction |
//! | --- | --- | --- |
//! | `migration` | radius of the edges, m | contacts roll: `db = r (delta - d theta_l)`, `dd = -r (delta - d theta_r)`; links join the arcs' centres |
//! | `slip` | m/s | b and d change with time |
//! | `backlash` | m | the palm lags its encoder by half of it, on the side it came from |
//! | `zero-offset` | rad | constant error of the left encoder |

use super::{
    four_bar::{self, Linkage, Observation},
    protocol::Stop,
    scene::{Hidden, Setup},
};
use crate::{
    Error,
    effects::{Effect, Found, Search},
};

/// Candidate effects, with initial guesses of their scale. Below its least size an effect is within the gripper's
/// tolerances. For play: a servo's dead band of 2 µs bends each finger by another 0.2 mrad when it comes from the other
/// side, which looks like 0.04 to 0.08 mm of play in the rack (seeds 1 to 8, nothing hidden).
const EFFECTS: [Effect; 4] = [
    Effect { name: "migration", start: &[0.003], absent: 0.0, least: 5e-4 },
    Effect { name: "slip", start: &[-2e-5], absent: 0.0, least: 2e-6 },
    Effect { name: "backlash", start: &[5e-4], absent: 0.0, least: 1.5e-4 },
    Effect { name: "zero-offset", start: &[0.01], absent: 0.0, least: 5e-3 },
];
/// Largest sizes, beyond which an effect is obvious without a search: radius of an edge, 1 mm/s of slip, 5 mm of play,
/// 6 degrees.
const MOST: [f64; 4] = [0.03, 1e-3, 5e-3, 0.1];
/// Newton steps for the rotation of an object with round edges.
const TURN_STEPS: usize = 8;

/// Name of a trial's hidden effect in the search's result; `None` for none.
pub(super) fn name(hidden: Hidden) -> Option<&'static str> {
    Some(match hidden {
        Hidden::Nothing => return None,
        Hidden::Migration => "migration",
        Hidden::Slip => "slip",
        Hidden::Backlash => "backlash",
        Hidden::ZeroOffset => "zero-offset",
    })
}

/// Inputs of the search from one stop.
#[derive(Clone, Copy)]
struct Seen {
    at: Observation,
    palm_direction: f64,
    time_s: f64,
}

/// Searches the recordings of one grasp for an effect; `None` where they show none.
///
/// # Errors
/// [`Error::Effects`] for fewer than three repetitions, or when the base model cannot be fitted.
pub fn find(setup: &Setup, stops: &[Stop]) -> Result<Option<Found>, Error> {
    let w_m = setup.finger.half_width_m;
    let repeats = stops.iter().map(|stop| stop.repeat + 1).max().unwrap_or(0);
    let seen =
        |stop: &Stop| Seen { at: stop.corrected(setup), palm_direction: stop.palm_direction, time_s: stop.time_s };
    let of = |repeat: usize| stops.iter().filter(move |stop| stop.repeat == repeat).map(seen).collect::<Vec<_>>();
    let runs: Vec<Vec<Seen>> = (0..repeats).map(of).collect();
    let observed: Vec<Vec<f64>> =
        runs.iter().map(|run| run.iter().map(|seen| seen.at.finger_rad[1]).collect()).collect();
    let first: Vec<Observation> = runs.first().into_iter().flatten().map(|seen| seen.at).collect();
    let Linkage { b_m, c_m, d_m } = four_bar::fit(w_m, &first);
    let predict =
        |effect: Option<usize>, parameters: &[f64], run: usize| predicted(w_m, effect, parameters, &runs[run]);
    Search { base_start: &[b_m, c_m, d_m], effects: &EFFECTS, observed: &observed, predict: &predict }.run()
}

fn predicted(w_m: f64, effect: Option<usize>, parameters: &[f64], run: &[Seen]) -> Vec<f64> {
    let &[b_m, c_m, d_m, ref rest @ ..] = parameters else { return Vec::new() };
    let base = Linkage { b_m, c_m, d_m };
    let size = rest.first().copied().unwrap_or(0.0);
    // An empty prediction scores as NaN, which rejects the candidate.
    if effect.is_some_and(|effect| size.abs() > MOST[effect]) {
        return Vec::new();
    }
    if effect == Some(0) {
        return rolling(w_m, base, size, run);
    }
    let right = |seen: &Seen| {
        let Observation { mut palm_m, finger_rad: [mut left_rad, near_rad] } = seen.at;
        let mut linkage = base;
        match effect {
            Some(1) => {
                linkage.b_m += size * seen.time_s;
                linkage.d_m += size * seen.time_s;
            }
            Some(2) => palm_m -= 0.5 * size * seen.palm_direction,
            Some(_) => left_rad -= size,
            None => {}
        }
        linkage.right_rad(w_m, palm_m, left_rad, near_rad)
    };
    run.iter().map(right).collect()
}

/// Right finger's angles, rad, with edges of radius `r_m`: the linkage joins the centres of the edges, which move along
/// the fingers.
fn rolling(w_m: f64, base: Linkage, r_m: f64, run: &[Seen]) -> Vec<f64> {
    let along_m = |contact_m: f64| (contact_m * contact_m - w_m * w_m).sqrt();
    let (left_m, right_m) = (along_m(base.b_m), along_m(base.d_m));
    let off_m = w_m + r_m;
    // The right finger's angle and the direction from centre to centre, for centres at these positions along the
    // fingers.
    let closed = |seen: &Seen, left_m: f64, right_m: f64, near_rad: f64| {
        let Observation { palm_m, finger_rad: [left_rad, _] } = seen.at;
        let linkage = Linkage { b_m: left_m.hypot(off_m), c_m: base.c_m, d_m: right_m.hypot(off_m) };
        let right_rad = linkage.right_rad(off_m, palm_m, left_rad, near_rad);
        let ((sin_l, cos_l), (sin_r, cos_r)) = (left_rad.sin_cos(), right_rad.sin_cos());
        let x = palm_m + right_m * cos_r - off_m * sin_r - left_m * cos_l - off_m * sin_l;
        let y = right_m * sin_r + off_m * cos_r - left_m * sin_l + off_m * cos_l;
        (right_rad, y.atan2(x))
    };
    let Some(first) = run.first() else { return Vec::new() };
    let (first_rad, first_way_rad) = closed(first, left_m, right_m, first.at.finger_rad[1]);
    let mut turn_rad = 0.0;
    let right = |seen: &Seen| {
        let mut right_rad = seen.at.finger_rad[1];
        for _ in 0..TURN_STEPS {
            let rolled = |turn_rad: f64, right_rad: f64| {
                let left = left_m + r_m * (turn_rad - (seen.at.finger_rad[0] - first.at.finger_rad[0]));
                (left, right_m - r_m * (turn_rad - (right_rad - first_rad)))
            };
            let (left, right) = rolled(turn_rad, right_rad);
            let way_rad;
            (right_rad, way_rad) = closed(seen, left, right, right_rad);
            // Newton's method with an approximate slope, -(1 + 2 r / c): the further the edges roll, the less the
            // centres' line turns with the object.
            turn_rad += (way_rad - first_way_rad - turn_rad) / (1.0 + 2.0 * r_m / base.c_m);
        }
        right_rad
    };
    run.iter().map(right).collect()
}
