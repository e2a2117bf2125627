//! Candidate laws for the printed rows, and for our own rows: the best one must predict rows that it was not fitted to.

use std::fmt::Write as _;

use r4_identify::statics::table::{Ladder, Rows, TableError, osmc};

use super::{Driven, OURS, bench::Bench, driven, scene, unsuitable};
use crate::{Error, Trial};

/// Seed of the fits of all laws.
const SEED: u64 = 1;

/// Fits the laws for Tables 1 to 5 as printed.
///
/// # Errors
/// [`TableError`] when the built-in tables are damaged.
pub fn printed() -> Result<Vec<Ladder>, TableError> {
    let tables = osmc::Printed::new()?;
    let mut ladders = vec![osmc::rotary(&tables, SEED)?, osmc::linear(&tables, SEED)?];
    ladders.extend(osmc::closed_forms(&tables, SEED)?);
    Ok(ladders)
}

/// Fits the laws for the printed rows, and for the rows that our controller makes with each motor of a trial's seed.
///
/// # Errors
/// [`Error::Unsuitable`] when the board does not fit or the tables are damaged; [`Error::Rig`] when a session fails.
pub fn all(trial: &Trial) -> Result<Vec<Ladder>, Error> {
    let failed = |why: TableError| unsuitable(trial, why);
    let mut ladders = printed().map_err(failed)?;
    let scene = scene(trial)?;
    for (index, motor) in scene.motors.iter().enumerate() {
        let driven = driven(&scene, index, &Trial { arm: OURS, ..trial.clone() }, 0.0)?;
        // A board that stopped has too few rows for a law: it is skipped.
        ladders.extend(own(&motor.bench, &driven).ok());
    }
    Ok(ladders)
}

/// Fits the laws of Table 1 or 2 to the final positions of one of our motors.
///
/// # Errors
/// [`TableError`] when the board stopped before three set points.
pub fn own(bench: &Bench, driven: &Driven) -> Result<Ladder, TableError> {
    let mut tables = osmc::Printed::new()?;
    let unit = bench.unit();
    let mut csv = format!("set_{unit},observed_{unit}\n");
    for (set, error) in bench.set_points.iter().zip(driven.measured(bench).true_errors) {
        // Writing to a string does not fail.
        let _ = writeln!(csv, "{set},{}", set + error);
    }
    let rows = Rows::read(csv.as_bytes())?;
    let ladder = if bench.step.is_some() {
        tables.rotary = rows;
        osmc::rotary(&tables, SEED)
    } else {
        tables.linear = rows;
        osmc::linear(&tables, SEED)
    }?;
    let data = format!("our set points, {} motor", bench.name);
    let verdict = ladder.verdict.replace(&ladder.data, &data).replace("fitted to the printed tables", "simulated");
    Ok(Ladder { data, verdict, ..ladder })
}
