//! Conversion of the Rust libraries' errors to exceptions of `r4.errors`.

use std::error::Error as StdError;

use pyo3::{IntoPyObjectExt, exceptions::PyValueError, prelude::*, types::PyDict};
use r4_driver::Error as DriverError;
use r4_protocol::{Cause, Causes, Refusal};
use r4_rig::Error;
use serde_json::Value;

/// Names of causes, for the user.
pub(crate) fn causes(causes: Causes) -> Vec<String> {
    Cause::ALL.into_iter().filter(|cause| causes.contains(*cause)).map(|cause| cause.to_string()).collect()
}

/// Message of an error with its sources, on one line. Text that a source's message repeats appears once.
pub(crate) fn message(error: &(dyn StdError + 'static)) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(source) = next {
        let why = source.to_string();
        if !text.contains(&why) {
            text = format!("{text}: {why}");
        }
        next = source.source();
    }
    text
}

/// Creates the exception `kind` of `r4.errors` with `message` and attributes.
fn exception(py: Python<'_>, kind: &str, message: String, attributes: &[(&str, Py<PyAny>)]) -> PyErr {
    let made = || {
        let keywords = PyDict::new(py);
        for (name, value) in attributes {
            keywords.set_item(name, value)?;
        }
        PyResult::Ok(PyErr::from_value(py.import("r4.errors")?.getattr(kind)?.call((&message,), Some(&keywords))?))
    };
    // When the exception cannot be created, the error of its creation is raised instead.
    made().unwrap_or_else(|error| error)
}

/// Creates an exception without attributes.
pub(crate) fn plain(py: Python<'_>, kind: &str, error: &(dyn StdError + 'static)) -> PyErr {
    exception(py, kind, message(error), &[])
}

fn object<'py, T: IntoPyObject<'py>>(py: Python<'py>, value: T) -> Py<PyAny> {
    value.into_bound_py_any(py).map_or_else(|_| py.None(), Bound::unbind)
}

/// Converts a JSON value to Python.
pub(crate) fn json<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    py.import("json")?.call_method1("loads", (value.to_string(),))
}

/// Converts a variant's name to dashes: `WrongMode` to `wrong-mode`.
fn dashed(name: &str) -> String {
    let mut dashed = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !dashed.is_empty() {
            dashed.push('-');
        }
        dashed.extend(letter.to_lowercase());
    }
    dashed
}

fn refused(py: Python<'_>, refusal: &Refusal, message: String) -> PyErr {
    // serde gives the name of the variant, with its fields if it has any.
    let (reason, details) = match serde_json::to_value(refusal) {
        Ok(Value::String(name)) => (dashed(&name), Value::Object(serde_json::Map::new())),
        Ok(Value::Object(variant)) => {
            variant.into_iter().next().map(|(name, fields)| (dashed(&name), fields)).unwrap_or_default()
        }
        _ => (String::new(), Value::Null),
    };
    // Only these refusals have causes.
    let latched = match refusal {
        Refusal::CausesPresent { causes } | Refusal::Tripped { causes } => *causes,
        _ => Causes::NONE,
    };
    let details = json(py, &details).map_or_else(|_| py.None(), Bound::unbind);
    let attributes = [("reason", object(py, reason)), ("details", details), ("causes", object(py, causes(latched)))];
    exception(py, "Refused", message, &attributes)
}

/// Converts an error of the driver to an exception with `message`.
fn driver(py: Python<'_>, error: &DriverError, message: String) -> PyErr {
    match error {
        DriverError::Refused(refusal) => refused(py, refusal, message),
        DriverError::Stopped { causes: latched } => {
            exception(py, "Stopped", message, &[("causes", object(py, causes(*latched)))])
        }
        DriverError::TimedOut { .. } | DriverError::LinkLost { .. } | DriverError::LinkFailed { .. } => {
            exception(py, "LinkError", message, &[])
        }
        DriverError::NotSettled { channel, .. }
        | DriverError::NotHomed { channel, .. }
        | DriverError::NotFollowed { channel } => {
            exception(py, "NotReached", message, &[("channel", object(py, channel.to_string()))])
        }
        _ => exception(py, "R4Error", message, &[]),
    }
}

/// Converts an error of a session to an exception.
pub(crate) fn of_rig(py: Python<'_>, error: &Error) -> PyErr {
    let message = message(error);
    match error {
        Error::Board(source)
        | Error::Arm(source)
        | Error::Disarm(source)
        | Error::NotDisarmed(source)
        | Error::NotCommanded { source, .. }
        | Error::Connect { source, .. } => driver(py, source, message),
        Error::Open(_) => exception(py, "LinkError", message, &[]),
        Error::Unsuitable(unsuitable) => {
            exception(py, "Unsuitable", message, &[("channel", object(py, unsuitable.channel.to_string()))])
        }
        Error::NotReached(reached) => {
            exception(py, "NotReached", message, &[("channel", object(py, reached.channel.to_string()))])
        }
        Error::SessionEnded => exception(py, "SessionEnded", message, &[]),
        Error::Robot(_) | Error::NoBody { .. } | Error::PlantFile(_) | Error::NotVirtual(_) => {
            exception(py, "BadRobot", message, &[])
        }
        _ => exception(py, "R4Error", message, &[]),
    }
}

/// Exception for an invalid argument, before any request to a board.
pub(crate) fn bad_value(text: String) -> PyErr {
    PyValueError::new_err(text)
}
