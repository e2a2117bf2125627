//! `r4 log`

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
    /// What is in a log, and what is missing
    Info {
        /// The log
        file: PathBuf,
    },
    /// Write a log as a table: a row per moment, a column per signal, an empty cell where nothing was recorded
    Export {
        /// The log
        file: PathBuf,
        /// The table; `-` is stdout
        #[arg(long, value_name = "FILE")]
        csv: PathBuf,
    },
    /// Send a recorded run's requests to a simulated board, at their times, and compare what comes of it
    Replay(replay::Replay),
}

/// `r4 log`
pub(crate) fn run(args: &Args, log: &Log) -> anyhow::Result<bool> {
    match log {
        Log::Record(record) => record::run(args, record),
        Log::Info { file } => info::run(args, file),
        Log::Export { file, csv } => export(args, file, csv),
        Log::Replay(replay) => replay::run(args, replay),
    }
}

/// Reads a log and tells on stderr what of it could not be read.
pub(super) fn read(path: &Path) -> anyhow::Result<r4_log::Log> {
    let log = match r4_log::Log::read(path) {
        // This one names the file, and its source with it.
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
