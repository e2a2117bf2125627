//! Failures of scenarios.

use std::{io, path::PathBuf};

use r4_driver::Error as DriverError;

/// A scenario cannot be read or played.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The system does not let the file be read.
    #[error("cannot read {}", path.display())]
    NotReadable {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The file is not TOML, or a step of it is unknown or incomplete.
    #[error("{} is no scenario; docs/scenarios.md says how one is written", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Line, field and what is expected there.
        source: Box<toml::de::Error>,
    },
    /// The file has an empty list of steps.
    #[error("{} has no steps", path.display())]
    NoSteps {
        /// The file.
        path: PathBuf,
    },
    /// The link to the board failed during a step.
    #[error("at {at_s} s")]
    Step {
        /// Time of the step, s.
        at_s: f64,
        /// The driver's error.
        source: DriverError,
    },
    /// The board does not send its history of trips.
    #[error("cannot read the history of trips")]
    Trips(#[source] DriverError),
}
