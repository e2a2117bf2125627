//! Benchmark of the static models on the measured data and the printed tables of `data/`, with pass limits.

use std::path::Path;

use r4_maths::statistics::RootMeanSquare;
use serde::Serialize;

use super::{
    hysteresis::play,
    map::{MapRun, StaticMap, alternate_rows},
    table::{gains, osmc},
};
use crate::{
    data::{Mapping, Options, Run, read},
    error::IdentifyError,
    family::Term,
    fit, select,
};

/// One line of the benchmark's table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the data.
    pub data: String,
    /// Quantity that is compared.
    pub metric: String,
    /// Unit of the numbers; `1` for counts.
    pub unit: &'static str,
    /// Error without the identified effects.
    pub baseline: f64,
    /// Error with the identified effects.
    pub after: f64,
    /// Pass limit: the largest error allowed, or for counts the required number.
    pub at_least: f64,
    /// True if the limit is met and the expected effects were found.
    pub met: bool,
}

/// Angular speed of 1 rpm, rad/s.
const RPM: f64 = std::f64::consts::TAU / 60.0;

/// Computes all lines; `data` is the folder of that name.
///
/// # Errors
/// An error for files that are missing or not as published.
pub fn rows(data: &Path, effort: gains::GainsEffort) -> Result<Vec<Row>, IdentifyError> {
    let mut rows = Vec::new();
    for (wheel, at_least) in [("left", 17.0), ("right", 7.0)] {
        rows.extend(wheel_rows(&data.join("micromouse_drv8833"), wheel, at_least)?);
    }
    for (servo, loaded) in [("sts3215_single", 1.30), ("sts3250_single", 0.33)] {
        rows.push(servo_row(&data.join("sts_servo_backlash"), servo, loaded)?);
    }
    rows.extend(table_rows(effort)?);
    Ok(rows)
}

fn first(file: &Path, options: &Options) -> Result<Run, IdentifyError> {
    read(&[file.to_owned()], options)?.runs.into_iter().next().ok_or(IdentifyError::NoRuns)
}

/// Returns the RMSE of a structure on the measured rows of a run.
fn rmse(map: &StaticMap, fit: &fit::Fit, run: &MapRun) -> f64 {
    let residuals = fit::residuals(map, &fit.structure, &[], run);
    let known = residuals.into_iter().filter(|residual| residual.is_finite());
    known.collect::<RootMeanSquare>().value().unwrap_or(0.0)
}

fn wheel_rows(folder: &Path, wheel: &str, at_least: f64) -> Result<[Row; 2], IdentifyError> {
    let load = |name: &str| -> Result<(MapRun, MapRun), IdentifyError> {
        let roles = vec![
            Mapping::driving("input", "command_duty256"),
            Mapping::measured("output", &format!("{wheel}_rpm")),
            Mapping::driving("supply", "battery_mV"),
        ];
        let run = first(&folder.join(name), &Options { roles, ..Options::default() })?;
        let (fitted, held_out) = alternate_rows(&run, 2).ok_or(IdentifyError::NoHoldout)?;
        Ok((MapRun::new(&fitted)?, MapRun::new(&held_out)?))
    };
    let search = |fitted: &[MapRun]| -> Result<(StaticMap, select::Found<MapRun>, Vec<&'static str>), IdentifyError> {
        let map = StaticMap::new(&fitted.iter().collect::<Vec<_>>(), "rad/s")?;
        let found = select::search(&map, fitted, &|_| ());
        let name = |step: &select::Step| match &step.term {
            Term::Known(index) => Some(crate::family::Model::catalogue(&map)[*index].name),
            Term::Curve(_) => None,
        };
        let names = found.steps.iter().filter_map(name).collect();
        Ok((map, found, names))
    };
    let (fitted, held_out) = load("static_3.csv")?;
    let (map, alone, names) = search(std::slice::from_ref(&fitted))?;
    let after = rmse(&map, &alone.last, &held_out) / RPM;
    let one = Row {
        data: format!("micromouse, {wheel}, odd rows of static_3"),
        metric: format!("speed; {}", names.join(", ")),
        unit: "rpm",
        baseline: rmse(&map, &alone.base, &held_out) / RPM,
        after,
        at_least,
        met: after <= at_least && ["dead-zone", "saturation"].iter().all(|name| names.contains(name)),
    };
    let (at_7v4, held_out_at_7v4) = load("static_4.csv")?;
    let baseline = rmse(&map, &alone.last, &held_out_at_7v4) / RPM;
    let (map, both, names) = search(&[fitted, at_7v4])?;
    let after = rmse(&map, &both.last, &held_out_at_7v4) / RPM;
    let other = Row {
        data: format!("micromouse, {wheel}, odd rows of static_4"),
        metric: format!("speed, from a map of one battery state to one with the supply; {}", names.join(", ")),
        unit: "rpm",
        baseline,
        after,
        at_least,
        met: after <= at_least && names.iter().any(|name| name.starts_with("supply")),
    };
    Ok([one, other])
}

fn servo_row(folder: &Path, servo: &str, published: f64) -> Result<Row, IdentifyError> {
    let roles = vec![
        Mapping::measured("output", "dut_pos_cnt"),
        Mapping::driving("goal", "dut_target_cnt"),
        Mapping::driving("pull_a", "pullA_target_cnt"),
        Mapping::driving("pull_b", "pullB_target_cnt"),
    ];
    let options = Options { roles, counts_per_turn: Some(4096.0), ..Options::default() };
    let play = play(&first(&folder.join(format!("{servo}.csv")), &options)?)?;
    let after = (play.loaded.value.abs().to_degrees() - published).abs();
    Ok(Row {
        data: servo.to_owned(),
        metric: format!("gap under load against the published {published:.2} deg"),
        unit: "deg",
        baseline: published,
        after,
        at_least: 0.1,
        met: after <= 0.1,
    })
}

fn table_rows(effort: gains::GainsEffort) -> Result<Vec<Row>, IdentifyError> {
    let printed = osmc::Printed::new()?;
    let mut ladders = vec![osmc::rotary(&printed, 1)?, osmc::linear(&printed, 1)?];
    ladders.extend(osmc::closed_forms(&printed, 1)?);
    // The limit is the reference ladder's error with its chosen law, plus a hundredth for rounding.
    let references = [
        ("scale", 0.31),
        ("released formula, stops beyond", 0.64),
        ("stopping duty over Kp", 1.61),
        ("integral sum at the same stopping duty", 0.95),
        ("exponential in Kd", 0.42),
        ("constant and inverse of Kp", 0.02),
    ];
    let mut rows = Vec::new();
    for (ladder, (law, at_least)) in ladders.iter().zip(references) {
        let Some((first, step)) = ladder.steps.first().zip(ladder.step(law)) else { continue };
        // Rejection is tolerated for the overshoot: a law with a stopping duty of its own fits the three rows of
        // Table 4 better.
        let rejected = ladder.rejected.iter().any(|refused| refused.law == law);
        rows.push(Row {
            data: ladder.data.clone(),
            metric: format!("{}: {law}", ladder.quantity),
            unit: if ladder.unit == "mm" {
                "mm"
            } else if ladder.unit == "s" {
                "s"
            } else {
                "deg"
            },
            baseline: first.rmse,
            after: step.rmse,
            at_least,
            met: step.rmse <= at_least && (!rejected || ladder.quantity == "overshoot"),
        });
    }
    let report = gains::loop_ladders(&printed, effort, 1)?;
    for ladder in &report.ladders {
        let cost =
            |effect: &str| ladder.steps.iter().find(|step| step.effect == effect).map_or(f64::NAN, |step| step.cost);
        let refused = ladder.steps.last().is_some_and(|step| !step.taken);
        rows.push(Row {
            data: "OSMC Tables 3 to 5".to_owned(),
            metric: format!(
                "misfit of a simulated loop to {} deg: up to {}; static friction refused",
                ladder.target_deg, ladder.chosen
            ),
            unit: "1",
            baseline: cost("linear motor"),
            after: cost(ladder.chosen),
            // A printed number that is off by its own tolerance costs 0.9; this allows for three such numbers each.
            at_least: 80.0,
            met: refused && cost(ladder.chosen) <= 80.0,
        });
    }
    let open = usize::from(!report.target_identified) + usize::from(report.leaves_kd_open());
    rows.push(Row {
        data: "OSMC Tables 3 to 5".to_owned(),
        metric: "said to be open: the target; a trend over Kd".to_owned(),
        unit: "1",
        baseline: 0.0,
        after: open as f64,
        at_least: 2.0,
        met: open == 2,
    });
    Ok(rows)
}
