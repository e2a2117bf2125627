//! `r4 evaluate xrhmi`: a session with a person as CSV files, and the comparison of many.

use std::{
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
};

use anyhow::{Context, ensure};
use r4_systems::{
    Trial,
    xrhmi::{
        self, Xrhmi,
        analysis::{self, Measure},
        cue::Modality,
        log::read_trials,
        protocol,
    },
};
use serde::Serialize;

use super::system;
use crate::{args::Args, output, report, table};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct XrhmiArgs {
    /// Tables of trials to compare, one or more of each person: what --session wrote, with the answers filled in
    #[arg(required_unless_present = "session", conflicts_with = "session", value_name = "TRIALS.csv")]
    tables: Vec<PathBuf>,
    /// Record the session of this participant, whose number also decides the order of the modalities
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u64).range(0..=999_999))]
    session: Option<u64>,
    /// Folder for the recorded files
    #[arg(long, default_value = ".", value_name = "FOLDER")]
    out: PathBuf,
}

/// Recorded session.
#[derive(Serialize)]
struct Recorded {
    participant: String,
    events: PathBuf,
    trials: PathBuf,
    complete_trials: usize,
    stopped: Option<String>,
}

/// One comparison of two modalities.
#[derive(Serialize)]
struct Row {
    measure: &'static str,
    first: &'static str,
    second: &'static str,
    people: usize,
    difference: f64,
    lo: f64,
    hi: f64,
    holm_p: f64,
    wilcoxon_p: f64,
    per_place: f64,
    /// The paper's test, which takes pairs for other people.
    welch_p: Option<f64>,
}

#[derive(Serialize)]
struct Report {
    rows: Vec<Row>,
}

/// Records a session or compares tables; false where a session was stopped.
pub(super) fn run(args: &Args, asked: &XrhmiArgs) -> anyhow::Result<bool> {
    match asked.session {
        Some(number) => record(args, number, &asked.out),
        None => compare(args, &asked.tables),
    }
}

fn record(args: &Args, number: u64, out: &Path) -> anyhow::Result<bool> {
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    // Created before the session: a recording must neither replace another, nor end without a file.
    let create = |kind: &str| {
        let path = out.join(format!("P{number:03}-{kind}.csv"));
        let file = File::create_new(&path).with_context(|| format!("cannot create {}", path.display()))?;
        Ok::<_, anyhow::Error>((path, file))
    };
    let ((events, mut events_file), (trials, mut trials_file)) = (create("events")?, create("trials")?);
    let order: Vec<&str> = protocol::order(number).into_iter().map(Modality::name).collect();
    eprintln!("r4: P{number:03}: {}; a hand over the centre zone begins each trial", order.join(", "));
    let trial = Trial { arm: "ours", seed: number, board: system::board(args, &Xrhmi) };
    let session = xrhmi::session(&trial);
    if session.is_err() {
        // Files without a session would only be in the way of the next attempt.
        let _ = fs::remove_file(&events);
        let _ = fs::remove_file(&trials);
    }
    let outcome = session?;
    events_file.write_all(outcome.log.events_csv().as_bytes()).with_context(|| events.display().to_string())?;
    trials_file.write_all(outcome.log.trials_csv().as_bytes()).with_context(|| trials.display().to_string())?;
    let complete_trials = outcome.log.trials.iter().filter(|trial| trial.is_complete).count();
    let is_whole = outcome.stopped.is_none();
    let recorded =
        Recorded { participant: outcome.log.participant, events, trials, complete_trials, stopped: outcome.stopped };
    if args.json {
        output::json(&recorded)?;
    } else {
        output::line(format_args!(
            "{}: {complete_trials} complete trials in {} and {}",
            recorded.participant,
            recorded.events.display(),
            recorded.trials.display()
        ))?;
    }
    if let Some(why) = &recorded.stopped {
        eprintln!("r4: the session was stopped: {why}; the trial that it interrupted does not count");
    }
    Ok(is_whole)
}

fn compare(args: &Args, tables: &[PathBuf]) -> anyhow::Result<bool> {
    let mut trials = Vec::new();
    for path in tables {
        let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        trials.extend(read_trials(&text).with_context(|| path.display().to_string())?);
    }
    ensure!(!trials.is_empty(), "the tables have no complete trial");
    let rows: Vec<Row> = analysis::measures(&trials)?.iter().flat_map(rows).collect();
    if args.json {
        output::json(&Report { rows })?;
        return Ok(true);
    }
    let head = [
        "measure",
        "comparison",
        "people",
        "difference",
        "95 % interval",
        "p (Holm)",
        "p (Wilcoxon)",
        "per place",
        "p (Welch)",
    ];
    let mut shown = table::new(&head, 2..9);
    for row in &rows {
        let number = |value: f64| report::significant(value);
        shown.add_row([
            row.measure.to_owned(),
            format!("{} - {}", row.first, row.second),
            row.people.to_string(),
            number(row.difference),
            format!("{} .. {}", number(row.lo), number(row.hi)),
            number(row.holm_p),
            number(row.wilcoxon_p),
            number(row.per_place),
            row.welch_p.map_or(String::new(), number),
        ]);
    }
    output::line(shown)?;
    Ok(true)
}

fn rows(measure: &Measure) -> impl Iterator<Item = Row> {
    measure.comparisons.iter().map(|comparison| Row {
        measure: measure.name,
        first: comparison.pair[0].name(),
        second: comparison.pair[1].name(),
        people: measure.people,
        difference: comparison.paired.difference,
        lo: comparison.paired.interval.low,
        hi: comparison.paired.interval.high,
        holm_p: comparison.holm_p,
        wilcoxon_p: comparison.wilcoxon_p,
        per_place: comparison.paired.per_place,
        welch_p: comparison.welch.map(|welch| welch.p_value),
    })
}
