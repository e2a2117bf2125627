//! Errors of systems and studies.

use std::{io, path::PathBuf};

use r4_maths::statistics::StatisticsError;

/// A system cannot be run, or its study cannot be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// There is no such system.
    #[error("there is no system `{name}`: `r4 system list` prints them")]
    UnknownSystem {
        /// Name as the caller gave it.
        name: String,
    },
    /// The system has no such arm.
    #[error("{system} has no arm `{arm}`: it has {}", .known.join(", "))]
    UnknownArm {
        /// Name of the system.
        system: &'static str,
        /// Name of the arm as the caller gave it.
        arm: String,
        /// Names of all arms of the system.
        known: Vec<&'static str>,
    },
    /// The board cannot be opened, or the session with it failed.
    #[error(transparent)]
    Rig(Box<r4_rig::Error>),
    /// A trial needs more of the board than it has.
    #[error("{board} cannot run {system}: {why}")]
    Unsuitable {
        /// Name of the system.
        system: &'static str,
        /// Board that was opened, in words.
        board: String,
        /// Missing channel or property of the board, in words.
        why: String,
    },
    /// A trial's result does not fit the system's metrics.
    #[error("{system}, arm {arm}, seed {seed}: {why}")]
    BadResult {
        /// Name of the system.
        system: String,
        /// Name of the arm.
        arm: String,
        /// Seed of the trial.
        seed: u64,
        /// Metric that does not fit, in words.
        why: String,
    },
    /// No trial of an arm could be run, so that it has no rows.
    #[error("{system}, arm {arm}: none of {trials} trials could be run; the first: {why}")]
    NothingRan {
        /// Name of the system.
        system: String,
        /// Name of the arm.
        arm: String,
        /// Number of trials that failed.
        trials: usize,
        /// Error of the first trial.
        why: String,
    },
    /// Two records of the same trial differ.
    #[error(
        "{system}, arm {arm}, seed {seed} is there twice, with different results: the shards are of different programs"
    )]
    Conflict {
        /// Name of the system.
        system: String,
        /// Name of the arm.
        arm: String,
        /// Seed of the trial.
        seed: u64,
    },
    /// A shard that is not of the form `part/of` with `part` in 1..=`of`.
    #[error("`{0}` is no shard: write which of how many, as in 3/8")]
    BadShard(String),
    /// A line of a file cannot be parsed as a record.
    #[error("{path}:{line}: not a record of a study: {why}")]
    BadRecord {
        /// Path of the file.
        path: PathBuf,
        /// Line number in the file, from 1 on.
        line: usize,
        /// Error of the JSON parser.
        why: String,
    },
    /// A Parquet file cannot be written, or a caller asked to read one.
    #[error("{path}: {why}")]
    Parquet {
        /// Path of the file.
        path: PathBuf,
        /// Reason in words, such as the writer's error.
        why: String,
    },
    /// A file cannot be read or written.
    #[error("{path}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A search for missing effects has too few recordings, or its base model cannot be fitted.
    #[error("no search for missing effects: {0}")]
    Effects(String),
    /// A statistic cannot be computed.
    #[error(transparent)]
    Statistics(#[from] StatisticsError),
}

/// Boxes the error: `r4_rig::Error` is large, and most results of this type are no such error.
impl From<r4_rig::Error> for Error {
    fn from(error: r4_rig::Error) -> Self {
        Self::Rig(Box::new(error))
    }
}
