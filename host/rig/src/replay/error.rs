//! Errors of replaying a log.

use r4_log::LogError;

use crate::recording::RecordingError;

/// Error of a log that cannot be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The log has no requests, nor samples to infer them from.
    #[error("it holds neither requests nor samples: record again, with `r4 log record` or `--record`")]
    Empty,
    /// The requests of the log cannot be determined.
    #[error("the log cannot be replayed")]
    Unsuitable(#[source] Box<Self>),
    /// The replay was not recorded as a whole.
    #[error(transparent)]
    NotRecorded(RecordingError),
    /// The replay's own log cannot be read.
    #[error(transparent)]
    NotRead(LogError),
}
