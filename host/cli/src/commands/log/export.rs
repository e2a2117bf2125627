//! Command `r4 log export`: converts a log to a table or to a bag of ROS 2.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::{Path, PathBuf},
};

use anyhow::Context;
use r4_log::Log;
use r4_rig::{GroundDrive, Target};
use r4_ros2::bag::{self, Bag, BagTopic};
use serde::Serialize;

use super::read;
use crate::{
    args::Args,
    output::{self, OutputError},
    table,
};

/// A table has a row for each time with a record and a column for each signal; cells without a value are empty. A bag is a folder with an
/// MCAP file and `metadata.yaml`, for `ros2 bag play`: the messages that `r4 ros2` publishes, at the log's times.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Export {
    /// Log to export, an MCAP file
    file: PathBuf,
    #[command(flatten)]
    to: Destinations,
}

#[derive(Clone, Debug, clap::Args)]
#[group(required = true, multiple = true)]
struct Destinations {
    /// Write a table in CSV to this file; `-` is stdout
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write a bag of ROS 2 to this folder, which must not exist yet
    #[arg(long, value_name = "FOLDER")]
    ros2: Option<PathBuf>,
}

/// Result of an export, in JSON.
#[derive(Serialize)]
struct Exported<'a> {
    #[serde(skip_serializing_if = "Option::is_none")]
    csv: Option<&'a Path>,
    #[serde(skip_serializing_if = "Option::is_none")]
    columns: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ros2: Option<Ros2Bag>,
    warnings: Vec<String>,
}

/// Summary of a written bag, in JSON.
#[derive(Serialize)]
struct Ros2Bag {
    folder: PathBuf,
    duration_s: f64,
    topics: Vec<Topic>,
}

/// Topic of a bag, in JSON.
#[derive(Serialize)]
struct Topic {
    topic: String,
    #[serde(rename = "type")]
    kind: String,
    messages: u64,
}

pub(super) fn run(args: &Args, Export { file, to }: &Export) -> anyhow::Result<bool> {
    let is_stdout = |csv: &PathBuf| csv == Path::new("-");
    let csv = to.csv.as_ref();
    anyhow::ensure!(
        !(csv.is_some_and(is_stdout) && (args.json || to.ros2.is_some())),
        "the table cannot go to stdout beside --json or a bag's topics: give --csv a file"
    );
    let log = read(file)?;
    if let Some(csv) = csv {
        write_table(&log, csv)?;
    }
    let bag = to.ros2.as_ref().map(|folder| write_bag(&log, folder)).transpose()?;
    let csv = csv.filter(|csv| !is_stdout(csv));
    let columns = csv.map(|_| log.signals().len() + 1);
    if args.json {
        let topic = |BagTopic { name, kind, messages, .. }: BagTopic| Topic { topic: name, kind, messages };
        let ros2 = bag.map(|Bag { folder, topics, duration_s }| {
            let topics = topics.into_iter().map(topic).collect();
            Ros2Bag { folder, duration_s, topics }
        });
        let warnings = log.warnings.iter().map(ToString::to_string).collect();
        output::json(&Exported { csv: csv.map(PathBuf::as_path), columns, ros2, warnings })?;
        return Ok(log.warnings.is_empty());
    }
    if let (Some(csv), Some(columns)) = (csv, columns) {
        output::line(format_args!("table  {} ({columns} columns)", csv.display()))?;
    }
    if let Some(Bag { folder, topics, duration_s }) = bag {
        output::line(format_args!("bag    {} ({duration_s:.3} s)", folder.display()))?;
        let mut rows = table::new(&["topic", "type", "messages"], 2..3);
        for BagTopic { name, kind, messages, .. } in topics {
            rows.add_row([name, kind, messages.to_string()]);
        }
        output::line(rows)?;
    }
    Ok(log.warnings.is_empty())
}

fn write_table(log: &Log, csv: &Path) -> anyhow::Result<()> {
    if csv == Path::new("-") {
        // Flushed by hand: an error in the writer's drop would be lost.
        let mut out = BufWriter::new(io::stdout().lock());
        return Ok(log.write_csv(&mut out).and_then(|()| out.flush()).map_err(OutputError::from)?);
    }
    let out = File::create(csv).with_context(|| format!("cannot make the table {}", csv.display()))?;
    log.write_csv(BufWriter::new(out)).with_context(|| format!("cannot write {}", csv.display()))
}

fn write_bag(log: &Log, folder: &Path) -> anyhow::Result<Bag> {
    // A log may come from a board whose file is not on this machine; then only the odometry is missing from the bag.
    let target: Option<Target> = log.header.board.parse().ok();
    let drive = target.and_then(|target| GroundDrive::of_board(&target, &log.header.robot));
    if drive.is_none() {
        eprintln!("r4: no file says how {} drives: the bag has no odom and no /tf", log.header.robot);
    }
    Ok(bag::write_bag(log, drive.as_ref(), folder)?)
}
