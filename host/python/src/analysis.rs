//! Python functions for identification and studies.

use std::{collections::BTreeMap, path::PathBuf, time::Duration};

use pyo3::{exceptions::PyTypeError, prelude::*};
use r4_identify::{Identified, IdentifyError, Question, Recordings, Task, family::Loadable};
use r4_rig::Target;
use r4_systems::study::{Record, Shard, Study, merge as merged, rows};
use serde::Serialize;
use serde_json::Value;

use crate::error::{self, json};

/// Converts a value of the Rust libraries to JSON.
fn to_json(value: &impl Serialize) -> PyResult<Value> {
    serde_json::to_value(value).map_err(|error| PyTypeError::new_err(error.to_string()))
}

/// Searches recordings for effects that a model lacks. Returns the report, as in `report.json`, and the text of the
/// plant file where there is one.
#[pyfunction]
#[pyo3(signature = (train, holdout, model, columns, *, parameters, time, split, plant, seed, budget_s))]
#[expect(clippy::too_many_arguments, reason = "keywords in Python")]
pub(crate) fn identify<'py>(
    py: Python<'py>,
    train: Vec<PathBuf>,
    holdout: Vec<PathBuf>,
    model: String,
    columns: BTreeMap<String, String>,
    parameters: BTreeMap<String, f64>,
    time: Option<String>,
    split: Vec<String>,
    plant: Option<PathBuf>,
    seed: u64,
    budget_s: Option<f64>,
) -> PyResult<(Bound<'py, PyAny>, Option<String>)> {
    let budget = match budget_s.map(Duration::try_from_secs_f64).transpose() {
        Ok(budget) => budget,
        Err(_) => return Err(error::bad_value(format!("budget_s={budget_s:?}: give seconds from 0 on, or None"))),
    };
    let plant = match plant {
        Some(file) => Some(r4_rig::read_plant(&file).map_err(|error| error::plain(py, "BadFile", &error))?.1),
        None => None,
    };
    let columns = columns.into_iter().collect();
    let question = Question { train, holdout, model, columns, time, split, parameters };
    let found = py.detach(|| {
        let recordings = question.read()?;
        let notes = recordings.notes();
        let Recordings { train, holdout, parameters } = recordings;
        let task = Task { model: question.model.clone(), parameters, plant, seed, budget, ..Task::default() };
        r4_identify::identify(&task, &train.runs, &holdout.runs, notes, &|_| {})
    });
    let Identified { report, loadable, .. } =
        found.map_err(|error: IdentifyError| error::plain(py, "NotIdentified", &error))?;
    let text = match loadable {
        Loadable::Plant(text) => Some(text),
        Loadable::Body(_) => None,
    };
    Ok((json(py, &to_json(&report)?)?, text))
}

/// Base models: name, summary, roles, parameters, effects.
#[pyfunction]
pub(crate) fn models(py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
    let described = |model: r4_identify::ModelInfo| {
        serde_json::json!({
            "name": model.name,
            "summary": model.summary,
            "roles": model.roles.iter().map(|role| serde_json::json!({
                "name": role.name, "required": role.required, "driving": role.driving, "what": role.what,
            })).collect::<Vec<_>>(),
            "parameters": model.parameters.iter().map(|known| serde_json::json!({
                "name": known.name, "unit": known.unit, "what": known.what,
            })).collect::<Vec<_>>(),
            "effects": model.effects,
        })
    };
    json(py, &Value::Array(r4_identify::models().into_iter().map(described).collect()))
}

/// Names of the robot systems.
#[pyfunction]
pub(crate) fn systems() -> Vec<&'static str> {
    r4_systems::all().iter().map(|system| system.about().name).collect()
}

/// Runs a system's arms over seeds on all cores. Returns rows and records, as `r4 system study` prints and writes them.
#[pyfunction]
#[pyo3(signature = (system, *, arms, first_seed, seeds, board, shard))]
pub(crate) fn study<'py>(
    py: Python<'py>,
    system: &str,
    arms: Vec<String>,
    first_seed: Option<u64>,
    seeds: u64,
    board: Option<&str>,
    shard: Option<&str>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let failed = |error: r4_systems::Error| error::plain(py, "NotStudied", &error);
    let system = r4_systems::find(system).map_err(failed)?;
    let board: Target = match board {
        Some(board) => board.parse().map_err(|bad| error::plain(py, "BadAddress", &bad))?,
        None => Target::Sim(system.about().robot.to_owned()),
    };
    let shard: Shard = shard.map(str::parse).transpose().map_err(failed)?.unwrap_or_default();
    let first_seed = first_seed.unwrap_or(system.about().reported.start);
    let study = Study { arms, first_seed, seeds, board, shard };
    let is_whole = study.shard == Shard::default();
    let run = || {
        let records = study.run(system, |_| {})?;
        // The rows of a shard would have intervals of a shard: they need the records of all.
        Ok((if is_whole { rows(&records)? } else { Vec::new() }, records))
    };
    let (rows, records) = py.detach(run).map_err(failed)?;
    Ok((json(py, &to_json(&rows)?)?, json(py, &to_json(&records)?)?))
}

/// Merges the records of a study's shards, given as JSON. Returns rows and records.
#[pyfunction]
pub(crate) fn merge(py: Python<'_>, parts: Vec<String>) -> PyResult<(Bound<'_, PyAny>, Bound<'_, PyAny>)> {
    let read = |text: &String| serde_json::from_str::<Vec<Record>>(text);
    let parts = parts.iter().map(read).collect::<Result<Vec<_>, _>>();
    let parts = parts.map_err(|error| error::bad_value(format!("no records of a study: {error}")))?;
    let merged = merged(parts).and_then(|records| Ok((rows(&records)?, records)));
    let (rows, records) = merged.map_err(|error| error::plain(py, "NotStudied", &error))?;
    Ok((json(py, &to_json(&rows)?)?, json(py, &to_json(&records)?)?))
}
