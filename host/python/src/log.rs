//! Python function that reads recordings as arrays.

use std::path::PathBuf;

use numpy::{PyArray1, ToPyArray};
use pyo3::{IntoPyObjectExt, prelude::*, types::PyDict};
use r4_log::{Kind, Log, Signal};

use crate::error;

/// One signal: name, kind of interpolation, times in s, and values: numbers, or texts where a value is no number.
type Series<'py> = (String, &'static str, Bound<'py, PyArray1<f64>>, Py<PyAny>);

/// Reads a recording: facts about it, its signals, and warnings about content of the file that they lack.
#[pyfunction]
pub(crate) fn read_log(py: Python<'_>, path: PathBuf) -> PyResult<(Py<PyDict>, Vec<Series<'_>>, Vec<String>)> {
    let read = || Log::read(&path).map(|log| (log.signals(), log));
    let (signals, log) = py.detach(read).map_err(|error| error::plain(py, "BadFile", &error))?;
    let facts = PyDict::new(py);
    facts.set_item("robot", &log.header.robot)?;
    facts.set_item("board", &log.header.board)?;
    facts.set_item("firmware", &log.header.firmware)?;
    facts.set_item("seed", log.header.seed)?;
    facts.set_item("duration_s", log.duration_s())?;
    let series = signals.iter().map(|signal| series(py, signal)).collect::<PyResult<_>>()?;
    Ok((facts.unbind(), series, log.warnings.iter().map(ToString::to_string).collect()))
}

fn series<'py>(py: Python<'py>, signal: &Signal) -> PyResult<Series<'py>> {
    let kind = match signal.kind {
        Kind::Continuous => "continuous",
        Kind::Held => "held",
        Kind::Changes => "changes",
        Kind::Event => "event",
    };
    let times: Vec<f64> = signal.samples.iter().map(|(time_s, _)| *time_s).collect();
    let numbers: Option<Vec<f64>> = signal.samples.iter().map(|(_, value)| value.number()).collect();
    let values = match numbers {
        Some(numbers) => numbers.to_pyarray(py).into_py_any(py)?,
        None => signal.samples.iter().map(|(_, value)| value.to_string()).collect::<Vec<_>>().into_py_any(py)?,
    };
    Ok((signal.name.clone(), kind, times.to_pyarray(py), values))
}
