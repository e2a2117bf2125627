//! Errors of reading and playing scenarios.

use std::{io, path::PathBuf};

use r4_driver::Error as DriverError;

/// Error of a scenario that cannot be read or played.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("cannot read {}", path.display())]
    NotReadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file is not TOML, or one of its steps is unknown or incomplete.
    #[error("{} is no scenario; docs/scenarios.md says how one is written", path.display())]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Line, field and expected content.
        source: Box<toml::de::Error>,
    },
    /// The file has an empty list of steps.
    #[error("{} has no steps", path.display())]
    NoSteps {
        /// Path of the file.
        path: PathBuf,
    },
    /// The link to the board failed during a step.
    #[error("at {at_s} s")]
    Step {
        /// Time of the step, s.
        at_s: f64,
        /// Error of the driver.
        source: DriverError,
    },
    /// The board does not send its history of trips.
    #[error("cannot read the history of trips")]
    Trips(#[source] DriverError),
}
