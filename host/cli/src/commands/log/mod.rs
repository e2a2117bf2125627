//! `r4 log`: records, inspects, exports and replays logs.

mod info;
mod record;
mod replay;

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

pub(super) use replay::seed;

use anyhow::{Context, bail};
use clap::Subcommand;
use serde::Serialize;

use crate::{
    args::Args,
    output::{self, OutputError},
};

#[derive(Clone, Debug, Subcommand)]
pub(crate) enum Log {
    /// Record channels of a board until Ctrl-C, or for a time
    Record(record::Record),
    /// Print the content of a log, and what is missing
    Info {
        /// Log to read, an MCAP file
        file: PathBuf,
    },
    /// Write a log as a CSV table: one row per time, one column per signal, an empty cell where nothing was recorded
    Export {
        /// Log to read, an MCAP file
        file: PathBuf,
        /// Table to write; `-` for stdout
        #[arg(long, value_name = "FILE")]
        csv: PathBuf,
    },
    /// Send the requests of a recorded run to a simulated board, at their times, and compare the two runs
    Replay(replay::Replay),
}

/// Runs a subcommand of `r4 log`.
pub(crate) fn run(args: &Args, log: &Log) -> anyhow::Result<bool> {
    match log {
        Log::Record(record) => record::run(args, record),
        Log::Info { file } => info::run(args, file),
        Log::Export { file, csv } => export(args, file, csv),
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

#[derive(Serialize)]
struct Exported<'a> {
    csv: &'a Path,
    columns: usize,
    warnings: Vec<String>,
}

fn export(args: &Args, file: &Path, csv: &Path) -> anyhow::Result<bool> {
    let log = read(file)?;
    if csv == Path::new("-") {
        anyhow::ensure!(!args.json, "the table and --json cannot both go to stdout: give --csv a file");
        let mut out = BufWriter::new(io::stdout().lock());
        log.write_csv(&mut out).and_then(|()| out.flush()).map_err(OutputError::from)?;
        return Ok(log.warnings.is_empty());
    }
    let out = File::create(csv).with_context(|| format!("cannot make the table {}", csv.display()))?;
    log.write_csv(BufWriter::new(out)).with_context(|| format!("cannot write {}", csv.display()))?;
    let columns = log.signals().len() + 1;
    if args.json {
        let warnings = log.warnings.iter().map(ToString::to_string).collect();
        output::json(&Exported { csv, columns, warnings })?;
    } else {
        output::line(format_args!("table  {} ({columns} columns)", csv.display()))?;
    }
    Ok(log.warnings.is_empty())
}
