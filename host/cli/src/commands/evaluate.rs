//! `r4 evaluate`: the whole evaluation of a paper, beside the paper's results; and studies with people.

mod xrhmi;

use std::{fs, path::PathBuf};

use anyhow::{Context, ensure};
use r4_identify::statics::table::Ladder;
use r4_systems::{
    Limit, Record, Trial,
    osmc::{
        self, Osmc,
        comparison::{self, Comparison},
    },
    study::{Shard, Study},
};
use serde::Serialize;

use super::system;
use crate::{
    args::Args,
    output,
    report::{self, Align, Cell, Column, Table},
    table,
};

#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Evaluations {
    /// Run set points and steps of the OSMC evaluation on blind plants: the paper's results, its plain PID, and the
    /// board's loops
    Osmc(OsmcArgs),
    /// Record a person's session of picking and placing by cues, or compare the modalities of recorded sessions
    Xrhmi(xrhmi::XrhmiArgs),
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct OsmcArgs {
    /// Number of seeds: each hides an effect, or none, in each of the three motors
    #[arg(long, default_value_t = OsmcArgs::default().seeds, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    seeds: u64,
    /// First of the consecutive seeds
    #[arg(long, default_value_t = OsmcArgs::default().first_seed, value_name = "SEED")]
    first_seed: u64,
    /// Number of these seeds whose hidden effect is identified and named, half a minute each
    #[arg(long, default_value_t = OsmcArgs::default().naming, value_name = "SEEDS")]
    naming: u64,
    /// Write a page with every response to this file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
}

impl Default for OsmcArgs {
    fn default() -> Self {
        Self { seeds: 200, first_seed: r4_systems::REPORTED.start, naming: 30, report: None }
    }
}

/// Motor of a seed that misses a target.
#[derive(Clone, Debug, Serialize)]
struct Failing {
    seed: u64,
    motor: &'static str,
    /// Name of the hidden effect; `nothing` for none.
    hidden: &'static str,
    /// Magnitude of the hidden effect, in the unit of its first parameter.
    size: Option<f64>,
    /// Metrics that miss their targets, with their values.
    missed: Vec<(String, f64)>,
}

#[derive(Serialize)]
struct Report {
    board: String,
    seeds: [u64; 2],
    rows: Vec<Comparison>,
    failing: Vec<Failing>,
    failed_trials: usize,
    ladders: Vec<Ladder>,
}

pub(crate) fn run(args: &Args, what: &Evaluations) -> anyhow::Result<bool> {
    match what {
        Evaluations::Osmc(osmc) => run_osmc(args, osmc),
        Evaluations::Xrhmi(xrhmi) => xrhmi::run(args, xrhmi),
    }
}

/// Runs the evaluation of the OSMC paper; false where a target is missed or a trial failed to run.
pub(crate) fn run_osmc(args: &Args, asked: &OsmcArgs) -> anyhow::Result<bool> {
    let study = |arms: &[&str], seeds| Study {
        arms: arms.iter().map(|arm| (*arm).to_owned()).collect(),
        first_seed: asked.first_seed,
        seeds,
        board: system::board(args, &Osmc),
        shard: Shard::default(),
    };
    // Identification takes half a minute per seed, so that its arm runs on fewer seeds than the others.
    let driven = study(&[osmc::PAPER, osmc::OURS], asked.seeds);
    let mut records = system::records(&Osmc, &driven)?;
    let naming = asked.naming.min(asked.seeds);
    if naming > 0 {
        records.extend(system::records(&Osmc, &study(&[osmc::BLIND], naming))?);
    }
    let study = driven;
    let failed: Vec<&Record> = records.iter().filter(|record| record.failed.is_some()).collect();
    // Some failed trials still give rows, but no metric can be computed if all failed.
    if let Some(first) = failed.first() {
        let why = first.failed.as_deref().unwrap_or_default();
        ensure!(failed.len() < records.len(), "none of {} trials could be run; the first: {why}", records.len());
        eprintln!(
            "r4: {} trials could not be run; the first, arm {}, seed {}: {why}",
            failed.len(),
            first.arm,
            first.seed
        );
    }
    let trial = |seed| Trial { arm: osmc::OURS, seed, board: study.board.clone() };
    let rows = comparison::rows(&records);
    let report = Report {
        board: study.board.to_string(),
        seeds: [asked.first_seed, asked.first_seed.saturating_add(asked.seeds - 1)],
        failing: failing(&records, trial)?,
        failed_trials: failed.len(),
        ladders: osmc::ladder::all(&trial(asked.first_seed))?,
        rows,
    };
    if let Some(path) = &asked.report {
        let page = page(&report, &study)?;
        fs::write(path, page).with_context(|| format!("cannot write {}", path.display()))?;
        eprintln!("r4: wrote {}", path.display());
    }
    let met = report.failed_trials == 0 && report.rows.iter().all(|row| row.met != Some(false));
    if args.json {
        output::json(&report)?;
    } else {
        print(&report)?;
    }
    Ok(met)
}

/// Motors that miss a target, by seed.
fn failing(records: &[Record], trial: impl Fn(u64) -> Trial) -> anyhow::Result<Vec<Failing>> {
    let mut failing = Vec::new();
    // Targets apply to the board's loops, not to the paper's PID.
    for record in records.iter().filter(|record| record.arm != osmc::PAPER) {
        let missed = osmc::missed(record);
        if missed.is_empty() {
            continue;
        }
        for motor in osmc::scene(&trial(record.seed))?.motors {
            let own = |(metric, _): &&(String, f64)| metric.starts_with(motor.bench.name);
            let missed: Vec<_> = missed.iter().filter(own).cloned().collect();
            if !missed.is_empty() {
                failing.push(Failing {
                    seed: record.seed,
                    motor: motor.bench.name,
                    hidden: motor.truth.as_ref().map_or("nothing", |truth| truth.name),
                    size: motor.truth.as_ref().map(osmc::scene::size),
                    missed,
                });
            }
        }
    }
    // Sort by motor and effect, so that effects which fail repeatedly stand together.
    failing.sort_by_key(|failing| (failing.motor, failing.hidden, failing.seed));
    Ok(failing)
}

const SOURCE: &str = "simulated motors; paper: Alabi, Camara, Fox, TAROS 2023, real motors";

fn print(report: &Report) -> anyhow::Result<()> {
    let [first, last] = report.seeds;
    output::line(format_args!("OSMC evaluation on {}, seeds {first} to {last} ({SOURCE})", report.board))?;
    let header = [
        "case",
        "metric",
        "unit",
        "paper",
        "plain PID",
        "its worst",
        "ours",
        "its worst",
        "plants",
        "must be",
        "met",
        "failing",
    ];
    let mut shown = table::new(&header, 3..9);
    for row in &report.rows {
        shown.add_row(cells(row));
    }
    output::line(shown)?;
    if !report.failing.is_empty() {
        output::line("Targets missed, by what is hidden:")?;
        let mut shown = table::new(&["motor", "hidden", "size", "seed", "missed"], 2..4);
        for Failing { seed, motor, hidden, size, missed } in &report.failing {
            let missed = missed.iter().map(|(metric, value)| format!("{metric} {}", report::significant(*value)));
            shown.add_row([
                (*motor).to_owned(),
                (*hidden).to_owned(),
                size.map_or(String::new(), report::significant),
                seed.to_string(),
                missed.collect::<Vec<_>>().join(", "),
            ]);
        }
        output::line(shown)?;
    }
    for ladder in &report.ladders {
        output::line(&ladder.verdict)?;
    }
    Ok(())
}

fn cells(row: &Comparison) -> [String; 12] {
    let number = |value: Option<f64>| value.map_or(String::new(), report::significant);
    let limit = |limit: Limit| match limit {
        Limit::AtMost(value) => format!("at most {value}"),
        Limit::AtLeast(value) => format!("at least {value}"),
    };
    [
        row.case.clone(),
        row.metric.to_owned(),
        row.unit.to_owned(),
        number(row.paper),
        number(row.plain_pid),
        number(row.plain_pid_worst),
        number(row.ours_median),
        number(row.ours_worst),
        row.plants.to_string(),
        row.target.map_or(String::new(), limit),
        row.met.map_or("", |met| if met { "yes" } else { "no" }).to_owned(),
        if row.failing.is_empty() { String::new() } else { row.failing.len().to_string() },
    ]
}

/// Report page: comparison, missed targets, fitted laws, and every response.
fn page(report: &Report, study: &Study) -> anyhow::Result<String> {
    let column = |title: &str, align| Column { title: title.into(), unit: None, align };
    let titles =
        ["Case", "Metric", "Unit", "Paper", "Plain PID", "Its worst", "Ours", "Its worst", "Plants", "Must be"];
    let mut columns: Vec<Column> = titles
        .iter()
        .enumerate()
        .map(|(at, title)| column(title, if (3..9).contains(&at) { Align::Right } else { Align::Left }))
        .collect();
    columns.push(column("Result", Align::Left));
    let rows = report.rows.iter().map(|row| {
        let mut texts: Vec<Cell> = cells(row).into_iter().take(10).map(Cell::Text).collect();
        texts.push(match row.met {
            None => Cell::Text(String::new()),
            Some(true) => Cell::Verdict { pass: true, text: "met".into() },
            Some(false) => Cell::Verdict { pass: false, text: format!("not in {} plants", row.failing.len()) },
        });
        texts
    });
    let comparison = Table {
        caption: "Comparison".into(),
        note: Some(format!(
            "{SOURCE}. Median and worst over the plants; a share where the metric is one. Definitions of the metrics and units are \
             ours, as the paper prints none: the final value is the mean of the last 0.3 s of a set point, the rise goes from the \
             command to 99 % of the step, overshoot is the share of the step beyond the set point, a limit cycle is two \
             reversals of more than one count while the last set point is held for 60 s."
        )),
        columns,
        rows: rows.collect(),
    };
    let laws = report.ladders.iter().map(|ladder| {
        let best = ladder.best();
        let number = |value: Option<f64>| value.map_or(String::new(), report::significant);
        let texts = [
            ladder.data.clone(),
            ladder.quantity.clone(),
            ladder.unit.clone(),
            number(ladder.steps.first().map(|step| step.rmse)),
            ladder.chosen.clone(),
            number(best.map(|step| step.rmse)),
            number(best.map(|step| step.left_out_rmse)),
        ];
        texts.into_iter().map(Cell::Text).collect()
    });
    let ladders = Table {
        caption: "Laws of the printed rows, and of ours".into(),
        note: Some(
            "The law with the fewest parameters among those that predict held-out rows as well as the best.".into(),
        ),
        columns: ["Data", "Quantity", "Unit", "Error without a law", "Law", "Error with it", "On held-out rows"]
            .iter()
            .enumerate()
            .map(|(at, title)| column(title, if matches!(at, 3 | 5 | 6) { Align::Right } else { Align::Left }))
            .collect(),
        rows: laws.collect(),
    };
    let figures = system::figures(&Osmc, study)?;
    Ok(report::evaluation(&format!("OSMC evaluation on {}", report.board), &[comparison, ladders], &figures))
}
