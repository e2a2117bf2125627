//! `r4 log`: records, inspects, exports and replays logs.

mod export;
mod info;
mod record;
mod replay;

use std::path::{Path, PathBuf};

pub(super) use replay::seed;

use anyhow::{Context, bail};
use clap::Subcommand;

use crate::args::Args;

#[derive(Clone, Debug, Subcommand)]
pub(crate) enum Log {
    /// Record channels of a board until Ctrl-C, or for a time
    Record(record::Record),
    /// Print the content of a log, and what is missing
    Info {
        /// Log to read, an MCAP file
        file: PathBuf,
    },
    /// Write a log as a CSV table, or as a ROS 2 bag
    Export(export::Export),
    /// Send the requests of a recorded run to a simulated board, at their times, and compare the two runs
    Replay(replay::Replay),
}

/// Runs a subcommand of `r4 log`.
pub(crate) fn run(args: &Args, log: &Log) -> anyhow::Result<bool> {
    match log {
        Log::Record(record) => record::run(args, record),
        Log::Info { file } => info::run(args, file),
        Log::Export(export) => export::run(args, export),
        Log::Replay(replay) => replay::run(args, replay),
    }
}

/// Reads a log and warns on stderr of its unreadable parts.
pub(super) fn read(path: &Path) -> anyhow::Result<r4_log::Log> {
    let log = match r4_log::Log::read(path) {
        // This error already contains the file's name and its source.
        Err(error @ r4_log::LogError::Io { .. }) => bail!("{error}"),
        read => read.with_context(|| path.display().to_string())?,
    };
    for warning in &log.warnings {
        eprintln!("r4: {}: {warning}", path.display());
    }
    Ok(log)
}
