//! Environments for learning, with arrays of numpy.

use std::sync::{Mutex, PoisonError};

use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, ToPyArray};
use pyo3::prelude::*;
use r4_learn::{ACTIONS, Action, BOUNDS, EPISODE_STEPS, Environments, Error, Fidelity, OBSERVATIONS, STEP_S, Step};

use crate::error;

/// Results of a step of all environments: observations, rewards, terminated, truncated, goal reached, distance to the
/// goal in m.
type Steps<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f64>>,
);

/// Environments `openscout-goto` that are reset and stepped together, without the interpreter's lock, on all cores.
#[pyclass(frozen, module = "r4._native")]
pub(crate) struct GoTo(Mutex<Environments>);

/// Converts an error of the environments to an exception.
fn failed(py: Python<'_>, error: &Error) -> PyErr {
    match error {
        Error::Rig(error) => error::of_rig(py, error),
        Error::BadAction { .. } | Error::WrongCount { .. } => error::bad_value(error.to_string()),
        Error::NotReset { .. } => error::plain(py, "SessionEnded", error),
        _ => error::plain(py, "R4Error", error),
    }
}

#[pymethods]
impl GoTo {
    #[new]
    fn new(py: Python<'_>, count: usize, kinematic: bool) -> PyResult<Self> {
        let fidelity = if kinematic { Fidelity::Kinematic } else { Fidelity::Full };
        let environments = Environments::new(count, fidelity).map_err(|error| failed(py, &error))?;
        Ok(Self(Mutex::new(environments)))
    }

    /// Begins an episode in each environment with a seed; returns the observations of those.
    fn reset<'py>(&self, py: Python<'py>, seeds: Vec<Option<u64>>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let seen = py.detach(|| self.0.lock().unwrap_or_else(PoisonError::into_inner).reset_some(&seeds));
        let seen: Vec<f32> = seen.map_err(|error| failed(py, &error))?.into_iter().flatten().flatten().collect();
        seen.to_pyarray(py).reshape([seen.len() / OBSERVATIONS, OBSERVATIONS])
    }

    /// Steps each environment, or begins an episode where there is a seed.
    fn step<'py>(
        &self,
        py: Python<'py>,
        actions: PyReadonlyArray2<'py, f64>,
        seeds: Vec<Option<u64>>,
    ) -> PyResult<Steps<'py>> {
        let actions = actions.as_array();
        if actions.ncols() != ACTIONS {
            return Err(error::bad_value(format!("actions of {} numbers: give {ACTIONS}", actions.ncols())));
        }
        let actions: Vec<Action> = actions.rows().into_iter().map(|row| [row[0], row[1]]).collect();
        let steps = py.detach(|| self.0.lock().unwrap_or_else(PoisonError::into_inner).step_or_reset(&actions, &seeds));
        let steps = steps.map_err(|error| failed(py, &error))?;
        let seen: Vec<f32> = steps.iter().flat_map(|step| step.observation).collect();
        let numbers = |of: fn(&Step) -> f64| steps.iter().map(of).collect::<Vec<_>>().to_pyarray(py);
        let flags = |of: fn(&Step) -> bool| steps.iter().map(of).collect::<Vec<_>>().to_pyarray(py);
        Ok((
            seen.to_pyarray(py).reshape([steps.len(), OBSERVATIONS])?,
            numbers(|step| step.reward),
            flags(|step| step.terminated),
            flags(|step| step.truncated),
            flags(Step::reached),
            numbers(|step| step.truth.distance_m),
        ))
    }

    /// Lowest and highest value of each number of an observation.
    #[staticmethod]
    fn bounds() -> Vec<(f32, f32)> {
        BOUNDS.to_vec()
    }

    /// Number of steps after which an episode is truncated.
    #[staticmethod]
    fn episode_steps() -> u32 {
        EPISODE_STEPS
    }

    /// Duration of a step, s.
    #[staticmethod]
    fn step_s() -> f64 {
        STEP_S
    }
}
