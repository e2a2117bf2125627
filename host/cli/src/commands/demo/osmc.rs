//! The set points of the OSMC evaluation on one board, beside the results of the paper.

use std::path::PathBuf;

use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use r4_log::Log;
use r4_protocol::{ChannelId, ChannelKind, Unit};
use r4_sim::Pace;
use serde::Serialize;

use super::{table_sha256, write};
use crate::{
    args::{Args, Demo},
    output,
    report::{self, Align, Cell, Column},
    session::{self, Elapsed, Session},
    table,
};
use r4_rig::quantity::human;

/// Set points and printed results of the rotary motor, °, and of the linear one, mm, each with its channel.
///
/// Alabi, Camara, Fox, "Evaluation of OSMC open source motor driver for reproducible robotics research", TAROS 2023,
/// Tables 1 and 2.
const ROTARY: ([(f64, f64); 4], ChannelId) =
    ([(90.0, 91.0), (180.0, 182.0), (270.0, 272.0), (360.0, 363.0)], ChannelId::new(ChannelKind::Osmc, 0));
const LINEAR: ([(f64, f64); 5], ChannelId) =
    ([(10.0, 7.0), (25.0, 23.0), (40.0, 39.0), (70.0, 68.0), (85.0, 83.0)], ChannelId::new(ChannelKind::Actuator, 1));
/// Limits of the final error for a passed set point, ° and mm.
const WITHIN_DEG: f64 = 1.0;
const WITHIN_MM: f64 = 0.2;
/// Time limit of each set point, s.
const TIMEOUT_S: f64 = 30.0;
/// Hold time before a set point is read off, s, as for a person with a ruler.
const HOLD_S: f64 = 0.5;
/// Telemetry period of the logged channels, ms.
const LOG_EVERY_MS: u16 = 10;

/// Result of one set point: commanded, paper, and ours.
#[derive(Clone, Debug, Serialize)]
struct Row {
    channel: String,
    set: f64,
    unit: &'static str,
    /// Result in the paper.
    paper: f64,
    /// True rest position of the simulated output, which corresponds to the paper's ruler and protractor.
    ours: f64,
    error_paper: f64,
    error_ours: f64,
    /// Time from the command until the board reports rest at the set point, s; `None` if it did not settle.
    settling_s: Option<f64>,
    /// Final position by the board's own sensor; `None` if the board stopped.
    measured: Option<f64>,
    within: f64,
    met: bool,
}

#[derive(Serialize)]
struct Report {
    board: String,
    rows: Vec<Row>,
    simulated_s: f64,
    real_time_factor: f64,
    table_sha256: String,
    log: PathBuf,
    report: PathBuf,
}

pub(super) fn run(args: &Args, demo: &Demo) -> anyhow::Result<bool> {
    let progress = ProgressBar::new((ROTARY.0.len() + LINEAR.0.len()) as u64).with_style(
        ProgressStyle::with_template("{bar:30} {pos}/{len} set points, {msg}").unwrap_or(ProgressStyle::default_bar()),
    );
    let (result, log) = session::in_memory(args, Pace::Free, async |session| drive(session, &progress).await);
    progress.finish_and_clear();
    let (rows, elapsed) = result?;

    let log_path = demo.out.join("log.mcap");
    let report_path = demo.out.join("report.html");
    write(&log_path, &log)?;
    let log = Log::from_bytes(&log)?;
    let page = report::html(&log, "OSMC evaluation", &[page_table(&rows, &args.board.to_string())]);
    write(&report_path, page.as_bytes())?;

    let met = rows.len() == ROTARY.0.len() + LINEAR.0.len() && rows.iter().all(|row| row.met);
    let report = Report {
        board: args.board.to_string(),
        rows,
        simulated_s: elapsed.simulated_s,
        real_time_factor: elapsed.real_time_factor(),
        table_sha256: table_sha256(&log)?,
        log: log_path,
        report: report_path,
    };
    if args.json {
        output::json(&report)?;
    } else {
        print(&report, elapsed)?;
    }
    if !met {
        eprintln!("r4: not every set point settled within {WITHIN_DEG} deg / {WITHIN_MM} mm");
    }
    Ok(met)
}

/// Drives all set points; returns a row for each one tried.
async fn drive(session: &Session<'_>, progress: &ProgressBar) -> anyhow::Result<Vec<Row>> {
    let board = session.board;
    for channel in [ROTARY.1, LINEAR.1] {
        board.channel(channel).context("the demo needs the channels of osmc-bench")?;
    }
    for channel in board.channels() {
        board.subscribe(channel.id, LOG_EVERY_MS).await?;
    }
    // The encoder's zero is the shaft's position at power-on; the potentiometer's is its calibration.
    let zero = session.true_position(ROTARY.1).unwrap_or(0.0);
    session
        .armed(async || {
            let mut rows = Vec::new();
            let rotary = ROTARY.0.iter().map(|point| (ROTARY.1, *point));
            for (channel, (set, paper)) in rotary.chain(LINEAR.0.iter().map(|point| (LINEAR.1, *point))) {
                progress.set_message(format!("{channel} to {set}"));
                let zero = if channel == ROTARY.1 { zero } else { 0.0 };
                let point = SetPoint { channel, set, paper, zero };
                let (row, stopped) = set_point(session, point).await?;
                rows.push(row);
                progress.inc(1);
                if let Some(error) = stopped {
                    progress.suspend(|| eprintln!("r4: {error}; the set points after {channel} {set} were not tried"));
                    break;
                }
            }
            Ok(rows)
        })
        .await
}

/// One set point with its reference.
#[derive(Clone, Copy)]
struct SetPoint {
    channel: ChannelId,
    /// Set point and the paper's result, ° or mm.
    set: f64,
    paper: f64,
    /// True position of the board's zero, rad or m.
    zero: f64,
}

async fn set_point(
    session: &Session<'_>,
    SetPoint { channel, set, paper, zero }: SetPoint,
) -> anyhow::Result<(Row, Option<r4_driver::Error>)> {
    let board = session.board;
    let info = board.channel(channel)?;
    let (per_si, unit, _) = human(info.unit);
    let within = if info.unit == Unit::M { WITHIN_MM } else { WITHIN_DEG };
    let target = set / per_si;
    let (settling_s, measured, stopped) = match board.move_to(channel, target, TIMEOUT_S).await {
        Ok(reached) => (Some(reached.after_s), Some(reached.position), None),
        // A set point that does not settle gets a row; the remaining set points follow.
        Err(r4_driver::Error::NotSettled { position, .. }) => (None, Some(position), None),
        Err(error @ r4_driver::Error::Stopped { .. }) => (None, None, Some(error)),
        Err(error) => return Err(error.into()),
    };
    board.sleep_s(HOLD_S).await;
    let measured = measured.map(|position| position * per_si);
    let ours =
        // Only simulated boards have a true position.
        session.true_position(channel).map(|position| (position - zero) * per_si).or(measured).unwrap_or(f64::NAN);
    let error_ours = ours - set;
    let row = Row {
        channel: channel.to_string(),
        set,
        unit,
        paper,
        ours,
        error_paper: paper - set,
        error_ours,
        settling_s,
        measured,
        within,
        met: settling_s.is_some() && error_ours.abs() <= within,
    };
    Ok((row, stopped))
}

fn print(report: &Report, elapsed: Elapsed) -> anyhow::Result<()> {
    let header = ["channel", "set", "paper", "ours", "error paper", "error ours", "settled after", ""];
    let mut table = table::new(&header, 1..7);
    for row in &report.rows {
        table.add_row([
            row.channel.clone(),
            format!("{} {}", row.set, row.unit),
            format!("{}", row.paper),
            format!("{:.2}", row.ours),
            format!("{:+}", row.error_paper),
            format!("{:+.2}", row.error_ours),
            row.settling_s.map_or("never".into(), |s| format!("{s:.2} s")),
            if row.met { "ok".into() } else { format!("over {} {}", row.within, row.unit) },
        ]);
    }
    let simulated = "simulated motors; paper: Alabi, Camara, Fox, TAROS 2023";
    output::line(format_args!("OSMC evaluation on {} ({simulated})", report.board))?;
    output::line(table)?;
    output::line(format_args!(
        "{:.1} s simulated in {:.2} s, {:.0} x real time",
        elapsed.simulated_s,
        elapsed.wall_s,
        elapsed.real_time_factor()
    ))?;
    output::line(format_args!("log    {} (table sha256 {})", report.log.display(), &report.table_sha256[..16]))?;
    Ok(output::line(format_args!("report {}", report.report.display()))?)
}

/// Table of the report page, with the columns of the printed one.
fn page_table(rows: &[Row], board: &str) -> report::Table {
    let column =
        |title: &str, unit: Option<&str>, align| Column { title: title.into(), unit: unit.map(Into::into), align };
    let number = |value: f64, decimals| Cell::Number { value, decimals };
    report::Table {
        caption: "Set points".into(),
        note: Some(format!(
            "Paper: Alabi, Camara, Fox, \u{201c}Evaluation of OSMC open source motor driver for reproducible robotics \
             research\u{201d}, TAROS 2023, Tables 1 and 2, real motors. Ours: {board}, simulated motors, true rest position of the \
             simulated output. Limits of the error: {WITHIN_DEG} deg and {WITHIN_MM} mm."
        )),
        columns: vec![
            column("Channel", None, Align::Left),
            column("Unit", None, Align::Left),
            column("Set", None, Align::Right),
            column("Paper", None, Align::Right),
            column("Ours", None, Align::Right),
            column("Error, paper", None, Align::Right),
            column("Error, ours", None, Align::Right),
            column("Settled after", Some("s"), Align::Right),
            column("Result", None, Align::Left),
        ],
        rows: rows
            .iter()
            .map(|row| {
                vec![
                    Cell::Text(row.channel.clone()),
                    Cell::Text(row.unit.into()),
                    number(row.set, 0),
                    number(row.paper, 0),
                    number(row.ours, 2),
                    number(row.error_paper, 0),
                    number(row.error_ours, 2),
                    row.settling_s.map_or(Cell::Text("never".into()), |settling_s| number(settling_s, 2)),
                    Cell::Verdict {
                        pass: row.met,
                        text: if row.met { "met".into() } else { format!("over {} {}", row.within, row.unit) },
                    },
                ]
            })
            .collect(),
    }
}
