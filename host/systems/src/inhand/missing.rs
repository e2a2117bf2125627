//! Search for the effect that a four-bar linkage with constant links lacks, in repeated manipulations of one grasp, and
//! of a rod of known diameter as a gauge.
//!
//! The observation is the right finger's angle at each stop; the half-angle form predicts it from the palm, the left
//! finger and b, c, d, and for the rod by rolling from its place on the left finger. Each repetition is a run; the last is
//! held out.
//!
//! # Why a gauge
//! To the linkage, a zero error of 27.5 mrad is a `c` longer by 2 mm: fitted b, c and d leave 0.3 to 0.6 mrad of it, as
//! much as the servos' dead bands and the contacts' compliance do. A rod of known diameter has no `c` to be fitted, and
//! 10 to 20 mrad remain. It does not tell whose zero is wrong: zero errors of the left finger, the right finger and the
//! palm differ by less than a tenth of that, so that `zero-offset` is their sum, as an error of the left encoder.
//!
//! | effect | its size | in the prediction |
//! | --- | --- | --- |
//! | `migration` | radius of the edges, m | contacts roll: `db = r (delta - d theta_l)`, `dd = -r (delta - d theta_r)`; links join the arcs' centres |
//! | `slip` | m/s | b and d change with time, and the rod's contacts at a rate of their own |
//! | `backlash` | m | the palm lags its encoder by half of it, on the side it came from |
//! | `zero-offset` | rad | constant error of the left encoder |

use super::{
    four_bar::{self, Linkage, Observation},
    protocol::Stop,
    scene::{GAUGE_M, Hidden, Setup},
};
use crate::{
    Error,
    effects::{Effect, Found, Search},
};

/// Indices of the candidate effects.
const MIGRATION: usize = 0;
const SLIP: usize = 1;
const BACKLASH: usize = 2;
const ZERO_OFFSET: usize = 3;
/// Candidate effects, with initial guesses of their scale. Below its least size an effect is within the gripper's
/// tolerances. For play: a servo's dead band of 2 µs bends each finger by another 0.2 mrad when it comes from the other
/// side, which looks like 0.04 to 0.08 mm of play in the rack (seeds 1 to 8, nothing hidden). For the zero: tolerances of play and
/// compliance, and pads that yield, look like an error of up to 5 mrad on the gauge; hidden ones are 20 mrad at least.
const EFFECTS: [Effect; 4] = [
    Effect { name: "migration", start: &[0.003], absent: 0.0, least: 5e-4 },
    Effect { name: "slip", start: &[-2e-5, -2e-5], absent: 0.0, least: 2e-6 },
    Effect { name: "backlash", start: &[5e-4], absent: 0.0, least: 1.5e-4 },
    Effect { name: "zero-offset", start: &[0.01], absent: 0.0, least: 1e-2 },
];
/// Largest sizes, beyond which an effect is obvious without a search: radius of an edge, 1 mm/s of slip, 5 mm of play,
/// 6 degrees.
const MOST: [f64; 4] = [0.03, 1e-3, 5e-3, 0.1];
/// Newton steps for the rotation of an object with round edges.
const TURN_STEPS: usize = 8;

/// Weight of the rod's stops: play and compliance may differ from the data sheet by a fifth, which the gauge shows as
/// 1 to 2 mrad, four times what the object's stops leave unexplained.
const GAUGE_WEIGHT: f64 = 0.25;
/// Initial guess of the rod's contact along the left finger, m: the middle of the fingers' reach.
const GAUGE_ALONG_M: f64 = 0.075;

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

/// Stops of one repetition, with the gauge and with the object.
struct Run {
    gauge: Vec<Seen>,
    object: Vec<Seen>,
}

/// Recordings of a gripper, with what the program knows of it.
struct Recordings {
    /// Half the width of a finger, m.
    w_m: f64,
    /// Servo's stiffness over the link's: a wrong zero shows as torque that bends the link.
    softer: f64,
    runs: Vec<Run>,
}

/// Searches the recordings of the gauge and of one grasp for an effect; `None` where they show none. Both have the same
/// number of repetitions.
///
/// # Errors
/// [`Error::Effects`] for fewer than three repetitions, or when the base model cannot be fitted.
pub fn find(setup: &Setup, gauge: &[Stop], stops: &[Stop]) -> Result<Option<Found>, Error> {
    let repeats = stops.iter().map(|stop| stop.repeat + 1).max().unwrap_or(0);
    let seen =
        |stop: &Stop| Seen { at: stop.corrected(setup), palm_direction: stop.palm_direction, time_s: stop.time_s };
    let of = |stops: &[Stop], repeat: usize| stops.iter().filter(|stop| stop.repeat == repeat).map(seen).collect();
    let run = |repeat: usize| Run { gauge: of(gauge, repeat), object: of(stops, repeat) };
    let recordings = Recordings {
        w_m: setup.finger.half_width_m,
        softer: setup.finger.servo_nm_per_rad / setup.finger.link_nm_per_rad,
        runs: (0..repeats).map(run).collect(),
    };
    let observed: Vec<Vec<f64>> = recordings.runs.iter().map(observed).collect();
    let predict = |effect: Option<usize>, parameters: &[f64], run: usize| recordings.predicted(effect, parameters, run);
    Search { base_start: &recordings.start(), effects: &EFFECTS, observed: &observed, predict: &predict }.run()
}

/// Right finger's angles in a run, rad; those with the gauge times its weight.
fn observed(run: &Run) -> Vec<f64> {
    let right_rad = |seen: &Seen| seen.at.finger_rad[1];
    let gauge = run.gauge.iter().map(|seen| GAUGE_WEIGHT * right_rad(seen));
    gauge.chain(run.object.iter().map(right_rad)).collect()
}

impl Recordings {
    /// Initial guess of the base model: b, c, d, and the rod's contact along the left finger, m.
    fn start(&self) -> [f64; 4] {
        let first: Vec<Observation> =
            self.runs.iter().take(1).flat_map(|run| &run.object).map(|seen| seen.at).collect();
        let Linkage { b_m, c_m, d_m } = four_bar::fit(self.w_m, &first);
        [b_m, c_m, d_m, GAUGE_ALONG_M]
    }

    fn predicted(&self, effect: Option<usize>, parameters: &[f64], run: usize) -> Vec<f64> {
        let &[b_m, c_m, d_m, along_m, ref rest @ ..] = parameters else { return Vec::new() };
        let base = Linkage { b_m, c_m, d_m };
        let size = rest.first().copied().unwrap_or(0.0);
        // An empty prediction scores as NaN, which rejects the candidate.
        if effect.is_some_and(|effect| size.abs() > MOST[effect]) {
            return Vec::new();
        }
        let really = |seen: &Seen| {
            let mut seen = *seen;
            match effect {
                Some(BACKLASH) => seen.at.palm_m -= 0.5 * size * seen.palm_direction,
                Some(ZERO_OFFSET) => seen.at.finger_rad[0] -= size * (1.0 + self.softer),
                _ => {}
            }
            seen
        };
        let Run { gauge, object } = &self.runs[run];
        let gauge: Vec<Seen> = gauge.iter().map(really).collect();
        let object: Vec<Seen> = object.iter().map(really).collect();
        let creeps_m_s = rest.get(1).copied().unwrap_or(0.0);
        let mut angles = rod(self.w_m, along_m, creeps_m_s, &gauge);
        for angle_rad in &mut angles {
            *angle_rad *= GAUGE_WEIGHT;
        }
        if effect == Some(MIGRATION) {
            angles.extend(rolling(self.w_m, base, size, &object));
            return angles;
        }
        let slips_m_s = if effect == Some(SLIP) { size } else { 0.0 };
        angles.extend(object.iter().map(|seen| {
            let Observation { palm_m, finger_rad: [left_rad, near_rad] } = seen.at;
            let slipped_m = slips_m_s * seen.time_s;
            let linkage = Linkage { b_m: b_m + slipped_m, d_m: d_m + slipped_m, ..base };
            linkage.right_rad(self.w_m, palm_m, left_rad, near_rad)
        }));
        angles
    }
}

/// Right finger's angles, rad, with the gauge `along_m` along the left finger at time 0. The rod rolls along both fingers;
/// in addition, both contacts move by `creeps_m_s`.
fn rod(w_m: f64, along_m: f64, creeps_m_s: f64, run: &[Seen]) -> Vec<f64> {
    let radius_m = 0.5 * GAUGE_M;
    let off_m = w_m + radius_m;
    // The right finger's angle, and the rod's place along it, for a place along the left one.
    let touched = |seen: &Seen, left_m: f64| {
        let Observation { palm_m, finger_rad: [left_rad, _] } = seen.at;
        let (sin, cos) = left_rad.sin_cos();
        let (x, y) = (left_m * cos + off_m * sin - palm_m, left_m * sin - off_m * cos);
        let right_m = (x * x + y * y - off_m * off_m).sqrt();
        (y.atan2(x) - off_m.atan2(right_m), right_m)
    };
    let Some(first) = run.first() else { return Vec::new() };
    let first_left_m = along_m + creeps_m_s * first.time_s;
    let (first_rad, first_right_m) = touched(first, first_left_m);
    let mut turn_rad = 0.0;
    let right = |seen: &Seen| {
        let crept_m = creeps_m_s * (seen.time_s - first.time_s);
        let left_turn_rad = seen.at.finger_rad[0] - first.at.finger_rad[0];
        let mut right_rad = first_rad;
        for _ in 0..TURN_STEPS {
            let right_m;
            (right_rad, right_m) = touched(seen, first_left_m + crept_m + radius_m * (turn_rad - left_turn_rad));
            let rolled_m = first_right_m + crept_m - radius_m * (turn_rad - (right_rad - first_rad));
            // Newton's method with the slope of parallel fingers: each contact moves by the radius times the turn.
            turn_rad -= (right_m - rolled_m) / (2.0 * radius_m);
        }
        right_rad
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

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use r4_maths::{least_squares::nonlinear, statistics::rmse};

    use super::*;
    use crate::inhand::{protocol::SHARES, rolling};

    const W_M: f64 = 0.008;

    /// Stops of one motion, without the right finger's angle.
    fn moved(palm_m: f64, left_rad: f64, to_palm_m: f64, to_left_rad: f64) -> Vec<Seen> {
        let stop = |share: f64| {
            let finger_rad = [left_rad + share * to_left_rad, PI - left_rad];
            Seen {
                at: Observation { palm_m: palm_m + share * to_palm_m, finger_rad },
                palm_direction: 1.0,
                time_s: 0.0,
            }
        };
        SHARES.map(stop).to_vec()
    }

    /// Recordings of a grasp without an effect, of an object of `across_m` at `height_m` from the palm, with fingers that
    /// lean by `lean_rad`; and the parameters that predict them.
    fn recordings(across_m: f64, lean_rad: f64, height_m: f64) -> (Recordings, [f64; 4]) {
        let left_rad = FRAC_PI_2 - lean_rad;
        let palm = |across_m: f64| across_m + 2.0 * (W_M + height_m * lean_rad);
        let pivot = |across_m: f64| moved(palm(across_m), left_rad, 0.015, -0.094);
        let object = [pivot(across_m), moved(palm(across_m), left_rad, 0.0, 0.175)].concat();
        let side_m = height_m.hypot(W_M);
        let runs = vec![Run { gauge: pivot(GAUGE_M), object }];
        let mut recordings = Recordings { w_m: W_M, softer: 0.1, runs };
        let parameters = [side_m, across_m, side_m, height_m];
        // The right angle that is nearest decides between both solutions of the linkage: from stop to stop.
        let mut near_rad = FRAC_PI_2 + lean_rad;
        for seen in &mut recordings.runs[0].object {
            let Observation { palm_m, finger_rad } = &mut seen.at;
            let linkage = Linkage { b_m: side_m, c_m: across_m, d_m: side_m };
            near_rad = linkage.right_rad(W_M, *palm_m, finger_rad[0], near_rad);
            finger_rad[1] = near_rad;
        }
        (recordings, parameters)
    }

    /// What the base model leaves of the angles that a zero error changes: the reason for the gauge, in figures.
    #[test]
    fn a_zero_error_hides_in_the_linkage_and_shows_on_the_gauge() {
        const ZERO_RAD: f64 = 0.0275;
        for (across_m, lean_rad, height_m) in [(0.025, 0.09, 0.078), (0.035, 0.06, 0.070), (0.045, 0.12, 0.086)] {
            let (recordings, parameters) = recordings(across_m, lean_rad, height_m);
            let with = recordings.predicted(Some(ZERO_OFFSET), &[&parameters[..], &[ZERO_RAD]].concat(), 0);
            let stops = recordings.runs[0].gauge.len();
            let residuals =
                |at: &[f64]| with.iter().zip(recordings.predicted(None, at, 0)).map(|(a, b)| a - b).collect::<Vec<_>>();
            // Without the gauge, its place is not determined, and is no parameter.
            let linkage =
                nonlinear(&parameters[..3], |at: &[f64]| residuals(&[at, &parameters[3..]].concat()).split_off(stops));
            let fit = linkage.expect("a linkage");
            let at = [fit.parameters.as_slice(), &parameters[3..]].concat();
            let left_rad = rmse(&with[stops..], &recordings.predicted(None, &at, 0)[stops..]).expect("angles");
            let both = nonlinear(&parameters, residuals).expect("a linkage and a place");
            let predicted = recordings.predicted(None, both.parameters.as_slice(), 0);
            let gauge_rad = rmse(&with[..stops], &predicted[..stops]).expect("angles") / GAUGE_WEIGHT;
            println!(
                "{across_m} m, lean {lean_rad}: {:.2} mrad of the linkage, c by {:.2} mm; {:.1} mrad of the gauge",
                1e3 * left_rad,
                1e3 * (fit.parameters[1] - across_m),
                1e3 * gauge_rad
            );
            assert!(left_rad < 0.6e-3 && gauge_rad > 8e-3, "{left_rad} {gauge_rad}");
        }
    }

    /// The rod's angles are those of the estimator's rolling arcs, whose closure is another one, in a disc.
    #[test]
    fn a_rod_is_found_as_a_disc_of_its_diameter() {
        let mut seen = moved(0.062, 1.49, 0.015, -0.094);
        let angles = rod(W_M, 0.078, 0.0, &seen);
        for (seen, right_rad) in seen.iter_mut().zip(angles) {
            seen.at.finger_rad[1] = right_rad;
        }
        let seen: Vec<Observation> = seen.iter().map(|seen| seen.at).collect();
        let grasp = rolling::fit(W_M, &seen, true).expect("a grasp");
        assert!((grasp.across_m - GAUGE_M).abs() < 1e-5, "{grasp:?}");
        assert!((grasp.contact_m[0] - 0.078_f64.hypot(W_M)).abs() < 1e-5, "{grasp:?}");
    }
}
