//! `r4 report`: an HTML page of a log.

use std::{fs, path::PathBuf};

use anyhow::Context;
use serde::Serialize;

use super::log::read;
use crate::{args::Args, output, report};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Report {
    /// Log to plot, an MCAP file
    pub(crate) file: PathBuf,
    /// HTML page to write
    #[arg(long, default_value = "report.html", value_name = "FILE")]
    pub(crate) out: PathBuf,
    /// Heading of the page [default: the robot's name]
    #[arg(long)]
    pub(crate) title: Option<String>,
}

#[derive(Serialize)]
struct Written<'a> {
    report: &'a PathBuf,
    bytes: usize,
    warnings: Vec<String>,
}

pub(crate) fn run(args: &Args, Report { file, out, title }: &Report) -> anyhow::Result<bool> {
    let log = read(file)?;
    let page = report::html(&log, title.as_ref().unwrap_or(&log.header.robot), &[]);
    fs::write(out, &page).with_context(|| format!("cannot write {}", out.display()))?;
    if args.json {
        let warnings: Vec<_> = log.warnings.iter().map(ToString::to_string).collect();
        output::json(&Written { report: out, bytes: page.len(), warnings })?;
    } else {
        output::line(format_args!("report {}", out.display()))?;
    }
    Ok(log.warnings.is_empty())
}
