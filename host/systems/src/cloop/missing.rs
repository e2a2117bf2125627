//! Search for the effect that a spring model lacks: capstan friction, creep or drift of the sensor, from recordings of
//! the retracted loop.
//!
//! The spool draws the retracted loop against the tip, holds, releases partly, holds and draws again: no vial is
//! needed. The base model is a linear spring from the contact on, `F = zero + K (contact - angle)`; each candidate adds
//! one effect.
//!
//! | candidate | prediction | size |
//! | --- | --- | --- |
//! | `bowden` | the force stays while the spring's line lies between `K (1 + q (e^a - 1))` in and `K (1 + q (e^-a - 1))` out, and follows the nearer one | `a`, friction times angle |
//! | `creep` | the contact recedes: `y' = (s / (1 - s) F / K - y) / t` | `s`, share of the force |
//! | `drift` | `d t` on the reading | `d`, N/s |
//! | `stiffening` | `b` of the stretch squared on the force | `b`, 1/rad |
//!
//! `q` is the tube's share of the stretch, from the datasheet. The body of the simulator integrates two springs about a
//! play; the model here has lines with a clamp, and trapezoids between samples.

use r4_rig::{Error as RigError, Session};

use super::{
    grip::{Gripper, Uses},
    prepared,
    scene::Setup,
};
use crate::{
    Error, Sampler, Trial, Values,
    effects::{Effect, Search},
};

/// Purpose of the random numbers of the hidden effect.
const OF_HIDDEN: u64 = 3;

/// Number of recordings; the last is held out.
const FOLDS: usize = 5;
/// Depths of the recordings' first draws, rad beyond the contact.
const DEPTHS_RAD: [f64; FOLDS] = [0.20, 0.26, 0.16, 0.23, 0.19];
/// Largest motion of the spool in [`STANDS`] samples for which a sample is used, rad. The board's filter of the force
/// lags behind the angle, which in motion looks like friction (0 of 60 clean recordings stayed quiet with all samples).
const STANDS_RAD: f64 = 1e-3;
/// Number of samples in 100 ms.
const STANDS: usize = 10;
/// Candidate effects. Least sizes: the encoder's quantisation, 12 mN at a hold, is the same over the whole hold, so
/// that the interval of a size is too narrow (13 of 40 clean recordings claimed an effect without a least size).
const EFFECTS: [Effect; 4] = [
    Effect { name: "bowden", start: &[0.3], absent: 0.0, least: 0.05 },
    Effect { name: "creep", start: &[0.1, 1.0], absent: 0.0, least: 0.03 },
    Effect { name: "drift", start: &[0.01], absent: 0.0, least: 0.004 },
    Effect { name: "stiffening", start: &[0.1], absent: 0.0, least: 0.1 },
];

/// Effect hidden in a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hidden {
    /// Capstan friction of the Bowden tube.
    Bowden,
    /// Creep of the loop's material.
    Creep,
    /// Drift of the force sensor.
    Drift,
    /// No effect, as a control.
    Nothing,
}

impl Hidden {
    /// Effect that the arm of this name hides; `None` for arms without recordings.
    #[must_use]
    pub fn of(arm: &str) -> Option<Self> {
        Some(match arm {
            super::BLIND_BOWDEN => Self::Bowden,
            super::BLIND_CREEP => Self::Creep,
            super::BLIND_DRIFT => Self::Drift,
            super::BLIND_CLEAN => Self::Nothing,
            _ => return None,
        })
    }

    const fn name(self) -> Option<&'static str> {
        match self {
            Self::Bowden => Some("bowden"),
            Self::Creep => Some("creep"),
            Self::Drift => Some("drift"),
            Self::Nothing => None,
        }
    }
}

/// Samples of a recording: time since the first recording's start, s; spool angle, rad; force as the sensor shows it,
/// N.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    samples: Vec<[f64; 3]>,
}

/// Records the loop five times: draws it tight and releases it.
async fn record(session: &Session<'_>, setup: &Setup) -> Result<Vec<Recording>, RigError> {
    session
        .armed(async || {
            let mut gripper = Gripper::open(session, setup, Uses::OURS).await?;
            let contact_rad = gripper.find_contact().await?;
            let mut recordings = Vec::new();
            for depth_rad in DEPTHS_RAD {
                let mut recording = Recording::default();
                // Out, in, held, half back, held, in again, out. The loop goes so far out that no straight line
                // without a contact fits.
                for (place, hold_s) in [(-1.0, 0.4), (1.0, 0.9), (0.6, 0.5), (0.9, 0.5), (-1.0, 0.1)] {
                    gripper.record_to(contact_rad - place * depth_rad, hold_s, &mut recording.samples).await?;
                }
                recordings.push(recording);
            }
            gripper.stop().await?;
            let begin_s =
                recordings.first().and_then(|first: &Recording| first.samples.first()).map_or(0.0, |first| first[0]);
            let all = recordings.iter_mut().flat_map(|recording| &mut recording.samples);
            all.for_each(|sample| sample[0] -= begin_s);
            Ok(recordings)
        })
        .await
}

/// Predicts the forces of the last of several consecutive recordings, whose initial state is the end of those before
/// it. Parameters: `[zero, K, contact]` and those of an effect.
fn predict(effect: Option<usize>, parameters: &[f64], recordings: &[Recording], tube_share: f64) -> Vec<f64> {
    let [zero_n, n_per_rad, contact_rad, ref added @ ..] = *parameters else { return Vec::new() };
    let spring_n = |angle_rad: f64, given_rad: f64| (n_per_rad * (contact_rad - given_rad - angle_rad)).max(0.0);
    let at = |place: usize| added.get(place).copied().unwrap_or(0.0);
    let mut before: Option<(f64, f64)> = None;
    let mut given_rad = 0.0;
    let samples = recordings.iter().flat_map(|recording| &recording.samples);
    let predicted = samples.map(|[time_s, angle_rad, _]| {
        let elastic_n = spring_n(*angle_rad, 0.0);
        let force_n = match effect {
            Some(0) => {
                let line = |sign: f64| elastic_n / (1.0 + tube_share * ((sign * at(0)).exp() - 1.0));
                let (low_n, high_n) = (line(1.0).min(line(-1.0)), line(1.0).max(line(-1.0)));
                before.map_or(low_n, |(_, force_n)| force_n.clamp(low_n, high_n))
            }
            Some(1) => {
                let (share, over_s) = (at(0).clamp(-0.9, 0.9), at(1).abs().max(0.02));
                let first_n = spring_n(*angle_rad, given_rad);
                // First-order creep over one sample period, with the force's trapezoid as its input.
                if let Some((before_s, before_n)) = before {
                    let mean_n = f64::midpoint(before_n, first_n);
                    let end_rad = share / (1.0 - share) * mean_n / n_per_rad;
                    given_rad = end_rad + (given_rad - end_rad) * (-(time_s - before_s) / over_s).exp();
                }
                spring_n(*angle_rad, given_rad)
            }
            Some(2) => elastic_n + at(0) * time_s,
            Some(_) => elastic_n + at(0) * n_per_rad * (elastic_n / n_per_rad).powi(2),
            None => elastic_n,
        };
        before = Some((*time_s, force_n));
        zero_n + force_n
    });
    let [earlier @ .., last] = recordings else { return Vec::new() };
    let skipped = earlier.iter().map(|recording| recording.samples.len()).sum();
    predicted.skip(skipped).enumerate().filter(|(place, _)| stands(last, *place)).map(|(_, force_n)| force_n).collect()
}

/// Returns true when the spool stands still at a sample.
fn stands(Recording { samples }: &Recording, place: usize) -> bool {
    place >= STANDS && (samples[place][1] - samples[place - STANDS][1]).abs() <= STANDS_RAD
}

/// Forces that the sensor of a recording showed while the spool stood.
fn observed(recording: &Recording) -> Vec<f64> {
    let standing = recording.samples.iter().enumerate().filter(|(place, _)| stands(recording, *place));
    standing.map(|(_, sample)| sample[2]).collect()
}

/// Runs a trial: records a loop with at most one effect, and searches for it.
///
/// # Errors
/// [`Error::Unsuitable`] when the board does not fit; [`Error::Rig`] when
/// the session fails; [`Error::Effects`] when the base model cannot be fitted.
pub fn run(trial: &Trial, hidden: Hidden) -> Result<Values, Error> {
    let (mut rig, setup, case) = prepared(trial)?;
    let mut sampler = Sampler::new(trial.seed, OF_HIDDEN);
    let mut size = |is: Hidden, low: f64, high: f64| {
        let value = sampler.uniform(low, high);
        if hidden == is { value } else { 0.0 }
    };
    let (friction_angle, share) = (size(Hidden::Bowden, 0.3, 0.75), size(Hidden::Creep, 0.1, 0.3));
    let drift_n_per_s = size(Hidden::Drift, 0.02, 0.05) * if trial.seed.is_multiple_of(2) { 1.0 } else { -1.0 };
    rig.alter = Some(case.with_only(friction_angle, share, drift_n_per_s).altered());
    let work = async |session: &Session<'_>| record(session, &setup).await;
    let (recordings, _) = rig.run(None, work)?;
    let found = search(&recordings, &setup)?;
    let mut values = Values::new();
    let mut put = |name: &str, value: f64| values.insert(name.to_owned(), value);
    match hidden.name() {
        Some(name) => {
            let is_right = found.is_some_and(|found| found.name == name);
            put("effect_named", f64::from(u8::from(is_right)));
            if let Some(found) = found.filter(|_| is_right) {
                put("effect_rmse_before", found.before);
                put("effect_rmse_after", found.after);
            }
        }
        None => {
            put("clean_quiet", f64::from(u8::from(found.is_none())));
        }
    }
    Ok(values)
}

/// Searches the recordings for an effect.
fn search(recordings: &[Recording], setup: &Setup) -> Result<Option<crate::effects::Found>, Error> {
    let observed: Vec<Vec<f64>> = recordings.iter().map(observed).collect();
    let slack_n = recordings[0].samples.iter().map(|sample| sample[2]).fold(f64::INFINITY, f64::min);
    // Initial guess of the spring: the deepest sample of the first recording, and its force.
    let deepest = recordings[0].samples.iter().copied().min_by(|a, b| a[1].total_cmp(&b[1])).unwrap_or_default();
    let contact_rad = deepest[1] + DEPTHS_RAD[0];
    let base_start = [slack_n, (deepest[2] - slack_n) / DEPTHS_RAD[0], contact_rad];
    let predict = |effect: Option<usize>, parameters: &[f64], fold: usize| {
        predict(effect, parameters, &recordings[..=fold], setup.tube_share)
    };
    Search { base_start: &base_start, effects: &EFFECTS, observed: &observed, predict: &predict }.run()
}
