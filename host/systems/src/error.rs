//! Failures of studies.

use std::{io, path::PathBuf};

use r4_maths::statistics::StatisticsError;

/// A system cannot be run, or its study cannot be evaluated.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// There is no such system.
    #[error("there is no system `{name}`: `r4 system list` prints them")]
    UnknownSystem {
        /// As it was given.
        name: String,
    },
    /// The system has no such arm.
    #[error("{system} has no arm `{arm}`: it has {}", .known.join(", "))]
    UnknownArm {
        /// The system.
        system: &'static str,
        /// As it was given.
        arm: String,
        /// All of its arms.
        known: Vec<&'static str>,
    },
    /// The board cannot be opened, or the session with it failed.
    #[error(transparent)]
    Rig(Box<r4_rig::Error>),
    /// A trial needs more of the board than it has.
    #[error("{board} cannot run {system}: {why}")]
    Unsuitable {
        /// The system.
        system: &'static str,
        /// The board.
        board: String,
        /// What is missing.
        why: String,
    },
    /// A trial's result does not fit the system's metrics.
    #[error("{system}, arm {arm}, seed {seed}: {why}")]
    BadResult {
        /// The system.
        system: String,
        /// The arm.
        arm: String,
        /// The seed.
        seed: u64,
        /// What is wrong.
        why: String,
    },
    /// No trial of an arm could be run, so that it has no rows.
    #[error("{system}, arm {arm}: none of {trials} trials could be run; the first: {why}")]
    NothingRan {
        /// The system.
        system: String,
        /// The arm.
        arm: String,
        /// Trials.
        trials: usize,
        /// Why the first could not.
        why: String,
    },
    /// Records of two studies that cannot be one.
    #[error(
        "{system}, arm {arm}, seed {seed} is there twice, with different results: the shards are of different programs"
    )]
    Conflict {
        /// The system.
        system: String,
        /// The arm.
        arm: String,
        /// The seed.
        seed: u64,
    },
    /// A shard that does not exist.
    #[error("`{0}` is no shard: write which of how many, as in 3/8")]
    BadShard(String),
    /// A line of a file is no record.
    #[error("{path}:{line}: not a record of a study: {why}")]
    BadRecord {
        /// The file.
        path: PathBuf,
        /// Its line, from 1 on.
        line: usize,
        /// What is wrong.
        why: String,
    },
    /// A Parquet file cannot be written, or was given to be read.
    #[error("{path}: {why}")]
    Parquet {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// A file cannot be read or written.
    #[error("{path}")]
    File {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// A search for missing effects has nothing to go by.
    #[error("no search for missing effects: {0}")]
    Effects(String),
    /// A statistic cannot be computed.
    #[error(transparent)]
    Statistics(#[from] StatisticsError),
}

/// Boxed, so that results of which most are no such error stay small.
impl From<r4_rig::Error> for Error {
    fn from(error: r4_rig::Error) -> Self {
        Self::Rig(Box::new(error))
    }
}
