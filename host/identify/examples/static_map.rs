//! Nonlinearities in the maps of two gear motors on an H-bridge (`data/micromouse_drv8833`), and the influence of the
//! battery.
//!
//! `cargo run --release -p r4-identify --example static_map [data/micromouse_drv8833]`

use std::{error::Error, path::PathBuf};

use r4_identify::{
    data::{Mapping, Options, Run, read},
    family::{Model, Term},
    fit,
    select::{self, Found},
    statics::map::{MapRun, StaticMap, alternate_rows},
};
use r4_maths::statistics::RootMeanSquare;

/// Angular speed of 1 rpm, rad/s.
const RPM: f64 = std::f64::consts::TAU / 60.0;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "data/micromouse_drv8833".to_owned()));
    for wheel in ["left", "right"] {
        let load = |name: &str| -> Result<Run, Box<dyn Error>> {
            let roles = vec![
                Mapping::driving("input", "command_duty256"),
                Mapping::measured("output", &format!("{wheel}_rpm")),
                Mapping::driving("supply", "battery_mV"),
            ];
            let recorded = read(&[folder.join(name)], &Options { roles, ..Options::default() })?;
            for note in &recorded.notes {
                println!("  {note}");
            }
            Ok(recorded.runs.into_iter().next().ok_or("no run")?)
        };
        let alternate = |name: &str| -> Result<(MapRun, MapRun), Box<dyn Error>> {
            let (fitted, held_out) = alternate_rows(&load(name)?, 2).ok_or("too few rows")?;
            Ok((MapRun::new(&fitted)?, MapRun::new(&held_out)?))
        };
        let (fitted, held_out) = alternate("static_3.csv")?;
        println!("{wheel}: even rows of static_3, held out: odd rows");
        close(std::slice::from_ref(&fitted), &[("static_3 odd", &held_out)])?;

        let (fitted_4, held_out_4) = alternate("static_4.csv")?;
        let other_code = MapRun::new(&load("static_6.csv")?)?;
        println!("{wheel}: even rows of static_3 (7.93 V) and static_4 (7.39 V)");
        let held_out = [("static_3 odd", &held_out), ("static_4 odd", &held_out_4), ("static_6", &other_code)];
        close(&[fitted, fitted_4], &held_out)?;
    }
    Ok(())
}

fn close(fitted: &[MapRun], held_out: &[(&str, &MapRun)]) -> Result<(), Box<dyn Error>> {
    let map = StaticMap::new(&fitted.iter().collect::<Vec<_>>(), "rad/s")?;
    let start = std::time::Instant::now();
    let found = select::search(&map, fitted, &|_| ());
    let scores = |fit: &fit::Fit| {
        for (name, run) in held_out {
            let residuals = fit::residuals(&map, &fit.structure, &[], run);
            let known: RootMeanSquare = residuals.into_iter().filter(|residual| residual.is_finite()).collect();
            print!("  {name} {:.1} rpm", known.value().unwrap_or(f64::NAN) / RPM);
        }
        println!();
    };
    scores(&found.base);
    show(&map, &found);
    scores(&found.last);
    println!("  in {:.1} s", start.elapsed().as_secs_f64());
    Ok(())
}

fn show(map: &StaticMap, found: &Found<MapRun>) {
    for step in &found.steps {
        let name = match &step.term {
            Term::Known(index) => map.catalogue()[*index].name,
            Term::Curve(curve) => curve.over.name(),
        };
        println!(
            "  {name}: left-out blocks {:.1} to {:.1} rpm, p {:.1e}, {:?} better, z {:.1}, as good: {:?}",
            step.blocked_rmse[0] / RPM,
            step.blocked_rmse[1] / RPM,
            step.p_value,
            step.blocks_better,
            step.z,
            step.rivals.iter().map(|(index, _)| map.catalogue()[*index].name).collect::<Vec<_>>()
        );
    }
    let structure = &found.last.structure;
    let values = structure.base.iter().chain(structure.added.iter().flatten());
    for ((parameter, value), deviation) in
        fit::parameters(map, &structure.terms).iter().zip(values).zip(&found.deviations)
    {
        println!("    {} = {value:.4} ± {deviation:.4?} {}", parameter.name, parameter.unit);
    }
    for refused in &found.rejected {
        println!("    not {}: {:.1} rpm, {}", refused.name, refused.blocked_rmse / RPM, refused.reason);
    }
}
