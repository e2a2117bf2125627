//! Identification of the hidden effect in a motor, from data that any user of the board can record: three recordings of
//! an excitation, the last of which is held out, and the calibration's readings for errors of the sensor, which no
//! recording shows.
//!
//! The identifier knows the plant as the robot's file declares it. The hidden effect counts as identified when it is
//! the only claimed one, or when it is collinear with the claimed one and the report says so (`rivals`).

use r4_identify::{
    Task,
    data::{self, Mapping, Options, Recorded},
    report::Report,
};
use r4_plants::{Effect, Fitted as _, PlantKind};
use r4_rig::{
    Session,
    excite::{self, Care, Excitation, Next, TRAIN},
    recording,
};

use super::{
    Calibration, calibrated, rig,
    scene::{Motor, Scene},
    unsuitable,
};
use crate::{Error, Trial, Values};

/// Length of each recording, s. Twice the length takes more than twice the time to fit.
const LENGTH_S: f64 = 6.0;
/// Limits for a declared friction, which is claimed as hidden when its estimate differs from the file's value by this
/// number of standard errors and by this share.
const OTHER_DEVIATIONS: f64 = 4.0;
const OTHER_SHARE: f64 = 0.25;

/// A claimed effect with those that are collinear with it.
#[derive(Clone, Debug, PartialEq)]
pub struct Claim {
    /// Names of the effect and of its rivals.
    pub names: Vec<String>,
}

/// Result of the search in one motor.
#[derive(Clone, Debug)]
pub struct Named {
    /// Claimed effects that the declared plant does not have.
    pub claims: Vec<Claim>,
    /// RMSE on the held-out recording with the claimed effects over that without them.
    pub after_over_before: f64,
}

/// Records and identifies motor number `index` of a scene.
///
/// # Errors
/// [`Error::Rig`] when the motor cannot be excited; [`Error::Unsuitable`] when its recordings cannot be used.
pub fn named(scene: &Scene, index: usize, trial: &Trial) -> Result<Named, Error> {
    let motor = &scene.motors[index];
    let (calibration, _) = calibrated(scene, index, trial)?;
    let report = identified(motor, &recordings(scene, index, trial)?, trial)?;
    let by_instrument = calibration.effects.iter().map(|name| Claim { names: vec![(*name).to_owned()] });
    let claims = claims(motor, &report).into_iter().chain(by_instrument).collect();
    Ok(Named { claims, after_over_before: report.last.holdout.rmse / report.baseline.holdout.rmse })
}

/// Puts the metrics of a motor into `values`.
pub(super) fn put(scene: &Scene, index: usize, trial: &Trial, values: &mut Values) -> Result<(), Error> {
    let motor = &scene.motors[index];
    let found = named(scene, index, trial)?;
    let name = motor.bench.name;
    let share = |is: bool| f64::from(u8::from(is));
    match &motor.truth {
        None => {
            values.insert(format!("{name}_nothing_hidden_nothing_named"), share(found.claims.is_empty()));
        }
        Some(truth) => {
            let is = |name: &String| name == truth.name || truth.rivals.contains(&name.as_str());
            let is_named = matches!(&found.claims[..], [only] if only.names.iter().any(is));
            values.insert(format!("{name}_hidden_effect_named"), share(is_named));
            if !matches!(truth.name, "encoder-scale" | "encoder-offset") {
                values.insert(format!("{name}_held_out_error_after_over_before"), found.after_over_before);
            }
        }
    }
    Ok(())
}

/// Records the excitation; the logs for the fit come first, the held-out one last.
fn recordings(scene: &Scene, index: usize, trial: &Trial) -> Result<Vec<Vec<u8>>, Error> {
    let bench = scene.motors[index].bench;
    let excitation = Excitation { channel: bench.channel, length_s: LENGTH_S, duty: None };
    let (mut logs, mut care) = (Vec::new(), Care::default());
    // One more than the fit takes: the last log is held out.
    while logs.len() <= TRAIN {
        let rig = rig(scene, index, trial, Calibration::NONE, |_| ());
        let tap = |output| {
            recording::tap(&trial.board, trial.seed, "r4-systems".to_owned(), "system run osmc".to_owned(), output)
        };
        let number = logs.len();
        let work = async |session: &Session<'_>| {
            if bench.step.is_none() {
                // From the middle of its stroke the actuator can move in both directions.
                let middle = r4_rig::Quantity::new(0.05, bench.si());
                session.move_to(bench.channel, middle, 30.0).await?;
            }
            excite::excite(session, &excitation, number, &care, &|_| ()).await
        };
        let recorded = rig.recorded(tap, work);
        if care.judge(&excitation, recorded.result.map(|(excited, _)| excited))? == Next::Keep {
            logs.push(recorded.log);
        }
    }
    Ok(logs)
}

fn identified(motor: &Motor, logs: &[Vec<u8>], trial: &Trial) -> Result<Report, Error> {
    let channel = motor.bench.channel;
    let (model, position) = match motor.declared.kind() {
        PlantKind::Rotary => ("dc-motor", "position_rad"),
        PlantKind::Linear => ("linear-actuator", "position_m"),
    };
    let roles = vec![
        Mapping::driving("input", &format!("{channel}.duty")),
        Mapping::measured("output", &format!("{channel}.{position}")),
    ];
    let options = Options { roles, ..Options::default() };
    let bridge: Vec<Effect> =
        motor.declared.effects().iter().copied().take_while(|effect| effect.at_once(0.0).is_some()).collect();
    let read = |(index, log): (usize, &Vec<u8>)| -> Result<Recorded, Error> {
        let name = format!("recording-{}.mcap", index + 1);
        let mut recorded = data::read_bytes(&name, log, &options).map_err(|why| unsuitable(trial, why))?;
        // The input is the duty after the declared effects of the bridge, as in `r4 identify close`.
        let signals = recorded.runs.iter_mut().filter_map(|run| run.signals.get_mut("input"));
        for duty in signals.flat_map(|signal| &mut signal.values) {
            *duty = bridge.iter().fold(*duty, |duty, effect| effect.at_once(duty).unwrap_or(duty));
        }
        Ok(recorded)
    };
    let mut runs = Vec::new();
    for log in logs.iter().enumerate() {
        runs.extend(read(log)?.runs);
    }
    let (train, holdout) = runs.split_at(TRAIN.min(runs.len()));
    let task = Task {
        model: model.to_owned(),
        parameters: [("supply_v".to_owned(), motor.supply_v)].into(),
        plant: Some(motor.declared.clone()),
        seed: trial.seed,
        ..Task::default()
    };
    let found = r4_identify::identify(&task, train, holdout, Vec::new(), &|_| ());
    Ok(found.map_err(|why| unsuitable(trial, why))?.report)
}

/// Effects of a report that the declared plant does not have, or has with another size.
fn claims(motor: &Motor, report: &Report) -> Vec<Claim> {
    let kind = motor.declared.kind();
    let declared = |name: &str| motor.declared.effects().iter().find(|effect| effect.name() == name);
    let is_news = |effect: &&r4_identify::report::EffectReport| {
        let Some(known) = declared(&effect.name).filter(|known| known.at_once(0.0).is_none()) else { return true };
        effect.parameters.iter().any(|(name, found)| {
            let off = known.get(kind, name).map_or(0.0, |size| (found.value - size).abs() / size.max(1e-12));
            let std = found.std.unwrap_or(f64::INFINITY);
            let size = known.get(kind, name).unwrap_or(found.value);
            off > OTHER_SHARE && (found.value - size).abs() > OTHER_DEVIATIONS * std
        })
    };
    let claim = |effect: &r4_identify::report::EffectReport| {
        let rivals = effect.rivals.iter().map(|rival| rival.name.clone());
        Claim { names: [effect.name.clone()].into_iter().chain(rivals).collect() }
    };
    report.effects.iter().filter(is_news).map(claim).collect()
}
