//! Which effect is hidden in a motor, by what anybody with the board can record: three recordings of an excitation, of which the last is
//! held out, for what shows in them; and the calibration's readings for what does not.
//!
//! The identifier knows the plant as the robot's file declares it. The hidden effect is named when it is the only one that is claimed,
//! or when the data cannot tell the claimed one from it and the report says so (`rivals`).

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

/// Length of each recording, s. Twice of it takes more than twice the time to fit.
const LENGTH_S: f64 = 6.0;
/// A friction that the file declares is claimed as hidden when it is found so many standard errors, and this share, from what the file
/// says.
const OTHER_DEVIATIONS: f64 = 4.0;
const OTHER_SHARE: f64 = 0.25;

/// An effect that is claimed, with those that the data cannot tell from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Claim {
    /// Its name and its rivals'.
    pub names: Vec<String>,
}

/// What was found in a motor.
#[derive(Clone, Debug)]
pub struct Named {
    /// Effects that the declared plant does not have.
    pub claims: Vec<Claim>,
    /// Error on the held-out recording with them over that without.
    pub after_over_before: f64,
}

/// Records and identifies motor number `index` of a scene.
///
/// # Errors
/// When the motor cannot be excited or its recordings cannot be used.
pub fn named(scene: &Scene, index: usize, trial: &Trial) -> Result<Named, Error> {
    let motor = &scene.motors[index];
    let (calibration, _) = calibrated(scene, index, trial)?;
    let report = identified(motor, &recordings(scene, index, trial)?, trial)?;
    let by_instrument = calibration.effects.iter().map(|name| Claim { names: vec![(*name).to_owned()] });
    let claims = claims(motor, &report).into_iter().chain(by_instrument).collect();
    Ok(Named { claims, after_over_before: report.last.holdout.rmse / report.baseline.holdout.rmse })
}

/// Puts the metrics of a motor.
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

/// Logs of the excitation, those to fit to first.
fn recordings(scene: &Scene, index: usize, trial: &Trial) -> Result<Vec<Vec<u8>>, Error> {
    let bench = scene.motors[index].bench;
    let excitation = Excitation { channel: bench.channel, length_s: LENGTH_S, duty: None };
    let (mut logs, mut care) = (Vec::new(), Care::default());
    while logs.len() <= TRAIN {
        let rig = rig(scene, index, trial, Calibration::NONE, |_| ());
        let tap = |output| {
            recording::tap(&trial.board, trial.seed, "r4-systems".to_owned(), "system run osmc".to_owned(), output)
        };
        let number = logs.len();
        let work = async |session: &Session<'_>| {
            if bench.step.is_none() {
                // From the middle of its stroke, so that it can move both ways.
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
        // Behind what the file has of the bridge, as `r4 identify close` does.
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

/// Effects of a report that the declared plant does not have, or has at another size.
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
