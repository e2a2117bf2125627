//! `r4 system` and `r4 bench systems`: the robot systems of `r4-systems`, their trials and studies.

mod part;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail, ensure};
use indicatif::{ProgressBar, ProgressStyle};
use r4_systems::{
    Figure, Limit, Row, System, Trial,
    study::{self, Record, Shard, Study},
};
use rayon::prelude::*;
use serde::Serialize;

use super::evaluate;
use crate::{
    args::{Args, BenchSystems},
    output,
    session::Target,
    table,
};

/// Number of seeds of a quick benchmark.
const QUICK_SEEDS: u64 = 8;

#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Systems {
    /// List all systems with their papers
    List,
    /// Print a system's question, arms, metrics and targets
    Show {
        /// Name of the system, from `list`
        name: String,
    },
    /// Run one trial of a system and print its metrics
    Run {
        /// Name of the system, from `list`
        name: String,
        /// Arm to run [default: ours; for osmc its whole evaluation, as `r4 evaluate osmc`]
        #[arg(long)]
        arm: Option<String>,
        /// Draw the arms' curves for this seed into an SVG file
        #[arg(long, value_name = "FILE")]
        figure: Option<PathBuf>,
        /// Write the trial's results as files into this folder, for `--body` and other simulators
        #[arg(long, value_name = "FOLDER")]
        files: Option<PathBuf>,
    },
    /// Run a system's arms over seeds and print a row for each metric
    Study(StudyArgs),
    /// Merge the records of shards and print their rows
    Merge {
        /// Files written by `study --out`
        #[arg(required = true, value_name = "FILE")]
        files: Vec<PathBuf>,
        /// Write all records to this file, in order
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct StudyArgs {
    /// Name of the system, from `list`
    name: String,
    /// Number of consecutive seeds
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u64).range(2..=1_000_000))]
    seeds: u64,
    /// First of the consecutive seeds [default: the first of the seeds on which the system's results are reported]
    #[arg(long, value_name = "SEED")]
    from: Option<u64>,
    /// Run only these arms; example: paper,ours
    #[arg(long, value_delimiter = ',', value_name = "ARMS")]
    arms: Vec<String>,
    /// Run only this part of the trials; `system merge` merges the parts; example: 3/8
    #[arg(long, default_value_t = Shard::default(), value_name = "PART/OF")]
    shard: Shard,
    /// Write the records to this file: JSON lines, or a table if it ends in .parquet [Parquet: feature `parquet`]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

#[derive(Serialize)]
struct Listed {
    name: &'static str,
    paper: &'static str,
    published: &'static str,
    question: &'static str,
    robot: &'static str,
    arms: Vec<&'static str>,
}

#[derive(Serialize)]
struct Rows {
    rows: Vec<Row>,
}

pub(crate) fn run(args: &Args, what: &Systems) -> anyhow::Result<bool> {
    match what {
        Systems::List => list(args),
        Systems::Show { name } => show(args, r4_systems::find(name)?),
        Systems::Run { name, arm: None, figure: None, files: None } if name == r4_systems::osmc::NAME => {
            evaluate::run_osmc(args, &evaluate::OsmcArgs::default())
        }
        Systems::Run { name, arm, figure, files } => {
            let arm = arm.as_deref().unwrap_or("ours");
            trial(args, r4_systems::find(name)?, arm, figure.as_deref(), files.as_deref())
        }
        Systems::Study(study) => run_study(args, study),
        Systems::Merge { files, out } => merge(args, files, out.as_deref()),
    }
}

/// Runs `r4 bench systems`: every system's study, on seeds that decided no constant.
pub(crate) fn bench(args: &Args, bench: &BenchSystems) -> anyhow::Result<bool> {
    let mut rows: Vec<Row> = Vec::new();
    let mut is_complete = true;
    let only = bench.only.as_deref().map(r4_systems::find).transpose()?;
    let chosen = only.map_or_else(|| r4_systems::all().to_vec(), |system| vec![system]);
    let kept = bench.out.as_ref().map(|folder| {
        fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        Ok::<_, anyhow::Error>((part::program()?, folder))
    });
    let kept = kept.transpose()?;
    for system in &chosen {
        let reported = &system.about().reported;
        let study = Study {
            arms: Vec::new(),
            first_seed: reported.start,
            seeds: bench.seeds.unwrap_or(if bench.quick { QUICK_SEEDS } else { reported.end - reported.start }),
            board: board(args, *system),
            shard: Shard::default(),
        };
        let run = |trials: Option<&part::Trials>| -> anyhow::Result<part::Found> {
            let rows = rows_of(&resumed(*system, &study, trials)?)?;
            Ok(part::Found { rows, timings: system.timings(bench.quick)? })
        };
        let part::Found { rows: found, timings } = match &kept {
            Some((program, folder)) => {
                let made = part::Made {
                    program: program.clone(),
                    board: study.board.to_string(),
                    first_seed: study.first_seed,
                    seeds: study.seeds,
                    is_quick: bench.quick,
                };
                part::kept(folder, system.about().name, made, |trials| run(Some(trials)))?
            }
            None => run(None)?,
        };
        // A target without a row would otherwise count as met.
        is_complete &= has_all_targets(*system, &found);
        rows.extend(found);
        rows.extend(timings);
    }
    let targets = rows.iter().filter(|row| row.target.is_some()).count();
    let missed: Vec<&Row> = rows.iter().filter(|row| row.met == Some(false)).collect();
    eprintln!("r4: {} of {targets} targets met", targets - missed.len());
    for row in missed {
        let Row { system, arm, metric, unit, value, lo, hi, n, failed, .. } = row;
        let limit = row.target.map_or(String::new(), limit);
        eprintln!(
            "r4: not met: {system}, arm {arm}: {metric} is {value} {unit} [{lo}, {hi}] in {n} trials, {failed} could not be run; it must be {limit}"
        );
    }
    Ok(print(args, rows)? && is_complete)
}

/// True if each of a system's targets has a row; prints those without.
fn has_all_targets(system: &dyn System, rows: &[Row]) -> bool {
    let about = system.about();
    let targets = about.metrics.iter().flat_map(|metric| metric.targets.iter().map(move |target| (metric, target)));
    let without: Vec<_> = targets
        .filter(|(metric, target)| !rows.iter().any(|row| row.arm == target.arm && row.metric == metric.name))
        .collect();
    for (metric, target) in &without {
        eprintln!("r4: not met: {}, arm {}: no trial has a {}", about.name, target.arm, metric.name);
    }
    without.is_empty()
}

/// Board of `--board`, or a simulated one of the system's robot.
pub(super) fn board(args: &Args, system: &dyn System) -> Target {
    if args.is_board_named { args.board.clone() } else { Target::Sim(system.about().robot.to_owned()) }
}

fn listed(system: &dyn System) -> Listed {
    let about = system.about();
    Listed {
        name: about.name,
        paper: about.paper.title,
        published: about.paper.published,
        question: about.question,
        robot: about.robot,
        arms: about.arms.iter().map(|arm| arm.name).collect(),
    }
}

fn list(args: &Args) -> anyhow::Result<bool> {
    let systems: Vec<Listed> = r4_systems::all().iter().map(|system| listed(*system)).collect();
    if args.json {
        output::json(&systems)?;
        return Ok(true);
    }
    let mut shown = table::new(&["system", "robot", "paper"], 0..0);
    for system in systems {
        shown.add_row([system.name, system.robot, system.paper]);
    }
    output::line(shown)?;
    Ok(true)
}

fn show(args: &Args, system: &dyn System) -> anyhow::Result<bool> {
    let about = system.about();
    if args.json {
        output::json(&listed(system))?;
        return Ok(true);
    }
    output::line(format_args!("{}: {} ({})", about.name, about.paper.title, about.paper.published))?;
    output::line(format_args!("{}\nrobot: {}", about.question, about.robot))?;
    output::line(format_args!("reported seeds: {} to {}", about.reported.start, about.reported.end - 1))?;
    let mut arms = table::new(&["arm", "does"], 0..0);
    for arm in about.arms {
        arms.add_row([arm.name, arm.does]);
    }
    output::line(arms)?;
    let mut metrics = table::new(&["metric", "unit", "arm", "must be", "because"], 0..0);
    for metric in about.metrics {
        if metric.targets.is_empty() {
            metrics.add_row([metric.name, metric.unit, "", "", ""]);
        }
        for target in metric.targets {
            let limit = limit(target.limit);
            metrics.add_row([metric.name, metric.unit, target.arm, &limit, target.from]);
        }
    }
    output::line(metrics)?;
    output::line("sampled by the seed:")?;
    for sampled in about.sampled {
        output::line(format_args!("  {sampled}"))?;
    }
    Ok(true)
}

fn limit(limit: Limit) -> String {
    match limit {
        Limit::AtMost(value) => format!("at most {value}"),
        Limit::AtLeast(value) => format!("at least {value}"),
    }
}

fn trial(
    args: &Args,
    system: &dyn System,
    arm: &str,
    figure: Option<&Path>,
    files: Option<&Path>,
) -> anyhow::Result<bool> {
    let study = Study {
        arms: vec![arm.to_owned()],
        first_seed: args.seed,
        seeds: 1,
        board: board(args, system),
        shard: Shard::default(),
    };
    // A study of one arm and one seed is one trial.
    let [trial] = &study.trials(system)?[..] else { bail!("one trial has one arm") };
    let described = trial.board.described();
    if let Some(path) = figure {
        draw(system, trial, path)?;
    }
    if let Some(folder) = files {
        write_files(system, trial, folder)?;
    }
    let record = records(system, &study)?.pop().context("one trial has one record")?;
    if let Some(why) = record.failed {
        bail!("{why}");
    }
    if args.json {
        output::json(&record)?;
        return Ok(true);
    }
    let about = system.about();
    output::line(format_args!("{}, arm {arm}, seed {}, on {described}", about.name, args.seed))?;
    let mut shown = table::new(&["metric", "value", "unit"], 1..2);
    for (name, value) in &record.values {
        let unit = about.metrics.iter().find(|metric| metric.name == name).map_or("", |metric| metric.unit);
        shown.add_row([name.as_str(), &crate::report::significant(*value), unit]);
    }
    output::line(shown)?;
    Ok(true)
}

fn draw(system: &dyn System, trial: &Trial, path: &Path) -> anyhow::Result<()> {
    let name = system.about().name;
    let figure = system.figure(trial)?.with_context(|| format!("{name} has no figure: omit --figure"))?;
    let views = system.views(trial)?;
    fs::write(path, crate::report::system(&figure, &views))
        .with_context(|| format!("cannot write {}", path.display()))?;
    eprintln!("r4: {}: {}", path.display(), figure.description);
    Ok(())
}

fn write_files(system: &dyn System, trial: &Trial, folder: &Path) -> anyhow::Result<()> {
    let files = system.files(trial)?;
    ensure!(!files.is_empty(), "{} writes no files: omit --files", system.about().name);
    fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    for file in files {
        let path = folder.join(file.name);
        fs::write(&path, file.text).with_context(|| format!("cannot write {}", path.display()))?;
        eprintln!("r4: wrote {}", path.display());
    }
    Ok(())
}

/// Runs a study with a progress bar.
pub(super) fn records(system: &dyn System, study: &Study) -> anyhow::Result<Vec<Record>> {
    resumed(system, study, None)
}

/// Runs the trials of a study that `trials` does not have yet, and adds each to it.
fn resumed(system: &dyn System, study: &Study, trials: Option<&part::Trials>) -> anyhow::Result<Vec<Record>> {
    let style = ProgressStyle::with_template("{msg} {bar:30} {pos}/{len}").unwrap_or(ProgressStyle::default_bar());
    let done = trials.map_or(&[][..], |trials| &trials.done);
    let bar = ProgressBar::new(study.trials(system)?.len() as u64).with_style(style);
    bar.set_message(system.about().name);
    bar.inc(done.len() as u64);
    let records = study.resume(system, done, |record| {
        if let Some(trials) = trials {
            trials.add(record);
        }
        bar.inc(1);
    });
    bar.finish_and_clear();
    Ok(records?)
}

/// Rows of a study's records; prints the error of each trial that could not be run.
fn rows_of(records: &[Record]) -> anyhow::Result<Vec<Row>> {
    for Record { system, arm, seed, failed, .. } in records {
        if let Some(why) = failed {
            eprintln!("r4: {system}, arm {arm}, seed {seed} could not be run: {why}");
        }
    }
    Ok(study::rows(records)?)
}

/// Figures of a study's seeds with their headings, drawn on all cores.
pub(super) fn figures(system: &dyn System, study: &Study) -> anyhow::Result<Vec<(String, Figure)>> {
    let one_arm = Study { arms: vec!["ours".to_owned()], ..study.clone() };
    let figure = |trial: &Trial| -> anyhow::Result<Option<(String, Figure)>> {
        Ok(system.figure(trial)?.map(|figure| (format!("Seed {}", trial.seed), figure)))
    };
    one_arm.trials(system)?.par_iter().filter_map(|trial| figure(trial).transpose()).collect()
}

fn run_study(args: &Args, asked: &StudyArgs) -> anyhow::Result<bool> {
    let system = r4_systems::find(&asked.name)?;
    let study = Study {
        arms: asked.arms.clone(),
        first_seed: asked.from.unwrap_or(system.about().reported.start),
        seeds: asked.seeds,
        board: board(args, system),
        shard: asked.shard,
    };
    // Rows of one shard would not be those of the study.
    let is_whole = asked.shard == Shard::default();
    ensure!(is_whole || asked.out.is_some(), "a shard's records go to a file: name it with --out");
    let records = records(system, &study)?;
    ensure!(!records.is_empty(), "shard {} of this study is empty: it has too few trials", asked.shard);
    if let Some(path) = &asked.out {
        study::save(path, &records)?;
    }
    if is_whole { print(args, rows_of(&records)?) } else { Ok(true) }
}

fn merge(args: &Args, files: &[PathBuf], out: Option<&Path>) -> anyhow::Result<bool> {
    let shards = files.iter().map(|file| study::read(file)).collect::<Result<Vec<_>, _>>()?;
    let records = study::merge(shards)?;
    if let Some(path) = out {
        study::save(path, &records)?;
    }
    print(args, rows_of(&records)?)
}

/// Prints rows; false where a target is missed or a trial failed to run.
fn print(args: &Args, rows: Vec<Row>) -> anyhow::Result<bool> {
    let met = rows.iter().all(|row| row.met != Some(false) && row.failed == 0);
    if args.json {
        output::json(&Rows { rows })?;
        return Ok(met);
    }
    let mut shown = table::new(
        &["system", "arm", "metric", "unit", "n", "value", "95 % interval", "target", "met", "p", "board"],
        4..7,
    );
    for row in &rows {
        let number = |value: f64| crate::report::significant(value);
        shown.add_row([
            row.system.clone(),
            row.arm.clone(),
            row.metric.clone(),
            row.unit.clone(),
            row.n.to_string(),
            number(row.value),
            format!("{} .. {}", number(row.lo), number(row.hi)),
            row.target.map_or(String::new(), limit),
            row.met.map_or("", |met| if met { "yes" } else { "no" }).to_owned(),
            row.paired_p.map_or(String::new(), |p| format!("{p:.2e}")),
            row.board.clone(),
        ]);
    }
    output::line(shown)?;
    // Print failures once per arm rather than per metric.
    let failed: BTreeSet<_> =
        rows.iter().filter(|row| row.failed > 0).map(|row| (&row.system, &row.arm, row.failed)).collect();
    for (system, arm, trials) in failed {
        eprintln!("r4: {system}, arm {arm}: {trials} trials could not be run");
    }
    Ok(met)
}
