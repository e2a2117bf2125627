//! Studies: trials over seeds, on all cores or as shards, and the rows computed from their records.
//!
//! A study's trials are independent. Their records are lines of JSON, sorted by system, arm, board and seed, so that the records of
//! all shards, merged, are those of one run, byte for byte; rows follow from records alone. With the feature `parquet` they can
//! be written as Parquet for other programs.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
    fs::File,
    io::{BufRead, BufReader, BufWriter, Write},
    path::Path,
    str::FromStr,
};

use r4_rig::Target as Board;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{Arm, Error, Row, Statistic, System, find, parquet};

/// Values of a trial's metrics, by their names.
pub type Values = BTreeMap<String, f64>;

/// One arm, one seed and one board: the unit that a study repeats.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Name of the arm.
    pub arm: &'static str,
    /// Seed of everything random in the trial.
    pub seed: u64,
    /// Board that the trial runs on.
    pub board: Board,
}

/// Arms, seeds and board of a study.
#[derive(Clone, Debug)]
pub struct Study {
    /// Names of the arms; empty selects all.
    pub arms: Vec<String>,
    /// First seed of the study; the others follow it without gaps.
    pub first_seed: u64,
    /// Number of seeds for each arm.
    pub seeds: u64,
    /// Board that all trials run on.
    pub board: Board,
    /// Part of the trials that this process runs.
    pub shard: Shard,
}

/// One of several equal parts of a study.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Number of the part, from 1 on.
    part: u64,
    /// Number of parts that the study has.
    of: u64,
}

/// Result of a trial: a line of a study's file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Name of the system.
    pub system: String,
    /// Name of the arm.
    pub arm: String,
    /// Kind of the board: sim, emu, kinematic or link.
    pub board: String,
    /// Seed of the trial.
    pub seed: u64,
    /// Values of the metrics; empty where the trial failed.
    pub values: Values,
    /// Error of a trial that could not be run.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub failed: Option<String>,
}

impl Default for Shard {
    fn default() -> Self {
        Self { part: 1, of: 1 }
    }
}

impl FromStr for Shard {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let parts = text.split_once('/').and_then(|(part, of)| Some((part.parse().ok()?, of.parse().ok()?)));
        match parts {
            Some((part, of)) if (1..=of).contains(&part) => Ok(Self { part, of }),
            _ => Err(Error::BadShard(text.to_owned())),
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.part, self.of)
    }
}

impl Study {
    /// Returns the trials of the study's shard, in the order of their records.
    ///
    /// # Errors
    /// [`Error::UnknownArm`] for a name in [`Study::arms`] that the system does not have.
    pub fn trials(&self, system: &dyn System) -> Result<Vec<Trial>, Error> {
        let about = system.about();
        let known = || about.arms.iter().map(|arm| arm.name).collect::<Vec<_>>();
        let arm = |name: &String| match about.arm(name) {
            Some(arm) => Ok(arm.name),
            None => Err(Error::UnknownArm { system: about.name, arm: name.clone(), known: known() }),
        };
        let mut arms =
            if self.arms.is_empty() { known() } else { self.arms.iter().map(arm).collect::<Result<_, _>>()? };
        arms.sort_unstable();
        arms.dedup();
        let seeds = self.first_seed..self.first_seed.saturating_add(self.seeds);
        let trials = arms
            .into_iter()
            .flat_map(|arm| seeds.clone().map(move |seed| Trial { arm, seed, board: self.board.clone() }));
        // Round robin: neighbouring trials are of the same arm and take about as long, so that shards end together.
        let is_ours = |index: &u64| index % self.shard.of == self.shard.part - 1;
        Ok((0u64..).zip(trials).filter(|(index, _)| is_ours(index)).map(|(_, trial)| trial).collect())
    }

    /// Runs the study's trials on all cores and calls `tell` after each.
    ///
    /// # Errors
    /// [`Error::UnknownArm`], or [`Error::BadResult`] for a trial whose values do not fit the system's metrics. A trial
    /// that cannot be run gives a record with [`Record::failed`].
    pub fn run(&self, system: &dyn System, tell: impl Fn(&Record) + Sync) -> Result<Vec<Record>, Error> {
        self.resume(system, &[], tell)
    }

    /// Continues an interrupted study: runs the trials of which `done` has no record, or one of a failure, and returns
    /// the records of all trials, in the order in which [`Study::run`] returns them.
    ///
    /// # Errors
    /// The same as those of [`Study::run`], for the trials that are run.
    pub fn resume(
        &self,
        system: &dyn System,
        done: &[Record],
        tell: impl Fn(&Record) + Sync,
    ) -> Result<Vec<Record>, Error> {
        let done: BTreeMap<_, _> = done
            .iter()
            .filter(|record| record.system == system.about().name && record.failed.is_none())
            .map(|record| ((record.arm.as_str(), record.board.as_str(), record.seed), record))
            .collect();
        let run = |trial: &Trial| {
            let board = kind(system.about().arm(trial.arm), &trial.board);
            if let Some(record) = done.get(&(trial.arm, board, trial.seed)) {
                return Ok((*record).clone());
            }
            let record = record(system, trial)?;
            tell(&record);
            Ok(record)
        };
        self.trials(system)?.par_iter().map(run).collect()
    }
}

/// Kind of the board that an arm runs on, as records and rows name it.
fn kind(arm: Option<&Arm>, board: &Board) -> &'static str {
    if arm.is_some_and(|arm| arm.is_kinematic) {
        return "kinematic";
    }
    match board {
        Board::Sim(_) => "sim",
        Board::Emu(_) => "emu",
        Board::Link(_) => "link",
    }
}

fn record(system: &dyn System, trial: &Trial) -> Result<Record, Error> {
    let about = system.about();
    let record = |values, failed| Record {
        system: about.name.to_owned(),
        arm: trial.arm.to_owned(),
        board: kind(about.arm(trial.arm), &trial.board).to_owned(),
        seed: trial.seed,
        values,
        failed,
    };
    let values = match system.run(trial) {
        Ok(values) => values,
        Err(error) => return Ok(record(Values::new(), Some(error.to_string()))),
    };
    let bad = |why: String| {
        let (system, arm, seed) = (about.name.to_owned(), trial.arm.to_owned(), trial.seed);
        Err(Error::BadResult { system, arm, seed, why })
    };
    for (name, value) in &values {
        let Some(metric) = about.metrics.iter().find(|metric| metric.name == name) else {
            return bad(format!("`{name}` is no metric of the system"));
        };
        if !value.is_finite() || metric.statistic == Statistic::Share && *value != 0.0 && *value != 1.0 {
            return bad(format!("{name} is {value}"));
        }
    }
    Ok(record(values, None))
}

/// Computes rows from records, one for each metric of each arm on each kind of board. A metric without a target and
/// with fewer than two values has no row.
///
/// # Errors
/// [`Error::UnknownSystem`]; [`Error::NothingRan`] for an arm of which no trial could be run; [`Error::Statistics`] for
/// values without a statistic.
pub fn rows(records: &[Record]) -> Result<Vec<Row>, Error> {
    let mut rows = Vec::new();
    let groups: BTreeSet<_> = records.iter().map(|record| (&record.system, &record.board, &record.arm)).collect();
    for (name, board, arm) in groups {
        let about = find(name)?.about();
        let of = |arm: &str| {
            let records = records.iter();
            records.filter(|record| &record.system == name && &record.board == board && record.arm == arm).collect()
        };
        let (ours, papers): (Vec<&Record>, Vec<&Record>) = (of(arm), of("paper"));
        let failed = ours.iter().filter(|record| record.failed.is_some()).count();
        if failed == ours.len() {
            let why = ours.iter().find_map(|record| record.failed.clone()).unwrap_or_default();
            return Err(Error::NothingRan { system: name.clone(), arm: arm.clone(), trials: failed, why });
        }
        let seeds = || ours.iter().map(|record| record.seed);
        let seeds = [seeds().min().unwrap_or(0), seeds().max().unwrap_or(0)];
        for metric in about.metrics {
            let values: Vec<f64> = ours.iter().filter_map(|record| record.values.get(metric.name).copied()).collect();
            // One value has no interval. A metric that few trials have, such as the time to a rare event, has no row
            // then, instead of an error that loses all others.
            if values.is_empty() || values.len() < 2 && metric.target(arm).is_none() {
                continue;
            }
            let summary = metric.statistic.of(&values)?;
            let paired = (arm != "paper").then(|| paired(&ours, &papers, metric.name));
            let paired_p = paired.and_then(|(ours, papers)| metric.statistic.paired_p(&ours, &papers));
            let target = metric.target(arm).map(|target| target.limit);
            rows.push(Row {
                system: name.clone(),
                arm: arm.clone(),
                metric: metric.name.to_owned(),
                unit: metric.unit.to_owned(),
                n: values.len(),
                failed,
                value: summary.value,
                lo: summary.interval.low,
                hi: summary.interval.high,
                method: summary.method.to_owned(),
                paired_p,
                source: metric.source,
                board: board.clone(),
                seeds,
                target,
                met: target.map(|limit| failed == 0 && limit.is_held_by(summary.value)),
            });
        }
    }
    Ok(rows)
}

/// Pairs the values of a metric in both arms, for the seeds that both have.
fn paired(first: &[&Record], second: &[&Record], metric: &str) -> (Vec<f64>, Vec<f64>) {
    let second: BTreeMap<u64, f64> =
        second.iter().filter_map(|record| Some((record.seed, *record.values.get(metric)?))).collect();
    let both = first.iter().filter_map(|record| Some((*record.values.get(metric)?, *second.get(&record.seed)?)));
    both.unzip()
}

/// Merges records of several shards into those of one study, sorted.
///
/// # Errors
/// [`Error::Conflict`] where two records of the same trial differ.
pub fn merge(shards: impl IntoIterator<Item = Vec<Record>>) -> Result<Vec<Record>, Error> {
    let mut merged = BTreeMap::new();
    for record in shards.into_iter().flatten() {
        let key = (record.system.clone(), record.arm.clone(), record.board.clone(), record.seed);
        let (system, arm, seed) = (record.system.clone(), record.arm.clone(), record.seed);
        if let Some(before) = merged.insert(key, record.clone())
            && before != record
        {
            return Err(Error::Conflict { system, arm, seed });
        }
    }
    Ok(merged.into_values().collect())
}

/// Returns true when the file's name ends in `.parquet`, in any case.
fn is_parquet(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("parquet"))
}

/// Writes records into a new file: Parquet if its name ends in .parquet, JSON lines otherwise.
///
/// # Errors
/// [`Error::File`] when it cannot be written; [`Error::Parquet`] for a Parquet file in a program without the feature.
pub fn save(path: &Path, records: &[Record]) -> Result<(), Error> {
    if is_parquet(path) {
        return parquet::write(path, records);
    }
    let failed = |source| Error::File { path: path.to_owned(), source };
    write(records, BufWriter::new(File::create(path).map_err(failed)?)).map_err(failed)
}

/// Reads the records of a file of JSON lines.
///
/// # Errors
/// [`Error::File`] when it cannot be read; [`Error::BadRecord`] for a line that is no record; [`Error::Parquet`] when
/// its name ends in .parquet.
pub fn read(path: &Path) -> Result<Vec<Record>, Error> {
    if is_parquet(path) {
        // The Parquet reader panics on damaged files.
        let why = "records are read from JSON lines; Parquet is for other programs".to_owned();
        return Err(Error::Parquet { path: path.to_owned(), why });
    }
    let failed = |source| Error::File { path: path.to_owned(), source };
    let lines = BufReader::new(File::open(path).map_err(failed)?).lines();
    let record = |(index, line): (usize, std::io::Result<String>)| {
        let line = line.map_err(failed)?;
        let bad = |error: serde_json::Error| Error::BadRecord {
            path: path.to_owned(),
            line: index + 1,
            why: error.to_string(),
        };
        serde_json::from_str(&line).map_err(bad)
    };
    lines.enumerate().map(record).collect()
}

/// Writes records as JSON lines.
///
/// # Errors
/// The error of `out`, when it cannot be written.
pub fn write(records: &[Record], mut out: impl Write) -> std::io::Result<()> {
    for record in records {
        serde_json::to_writer(&mut out, record)?;
        out.write_all(b"\n")?;
    }
    out.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(arm: &str, seed: u64, value: f64) -> Record {
        let values = Values::from([("m".to_owned(), value)]);
        Record { system: "s".into(), arm: arm.into(), board: "sim".into(), seed, values, failed: None }
    }

    #[test]
    fn shards_merge_into_the_records_of_one_run() {
        // Sorted as in a study's file: arms in order, with a kinematic arm between two arms on a board.
        let arm = |arm, board: &str, seed| Record { board: board.into(), ..record(arm, seed, 0.1 * seed as f64) };
        let arms = [("ablation:a", "sim"), ("baseline:b", "kinematic"), ("ours", "sim")];
        let all: Vec<_> = arms.iter().flat_map(|(name, board)| (0..7).map(|seed| arm(name, board, seed))).collect();
        let part = |rest| all.iter().filter(|record| record.seed % 3 == rest).cloned().collect::<Vec<_>>();
        let merged = merge([part(2), part(0), part(1), part(0)]).expect("no conflict");
        let bytes = |records: &[Record]| {
            let mut bytes = Vec::new();
            write(records, &mut bytes).expect("memory");
            bytes
        };
        assert_eq!(bytes(&merged), bytes(&all));
        let conflict = merge([part(0), vec![record("ours", 0, 9.0)]]).expect_err("two results");
        assert!(matches!(conflict, Error::Conflict { seed: 0, .. }), "{conflict}");
    }

    #[test]
    fn a_resumed_study_runs_the_other_trials_and_the_failed_ones() {
        let system = find("xrhmi").expect("a system");
        let arms = vec!["ours".to_owned()];
        let board = Board::Sim(system.about().robot.to_owned());
        let study = Study { arms, first_seed: 1, seeds: 3, board, shard: Shard::default() };
        let all = study.run(system, |_| ()).expect("a study");
        let mut done = all.clone();
        done[0].failed = Some("no memory".to_owned());
        done[1].values = Values::from([("kept".to_owned(), 1.0)]);
        done.truncate(2);
        let run = std::sync::Mutex::new(BTreeSet::new());
        let resumed = study.resume(system, &done, |record| {
            run.lock().expect("no panic").insert(record.seed);
        });
        assert_eq!(resumed.expect("a study"), [all[0].clone(), done[1].clone(), all[2].clone()]);
        assert_eq!(run.into_inner().expect("no panic"), BTreeSet::from([1, 3]));
    }

    #[test]
    fn an_arm_of_which_nothing_ran_is_an_error() {
        let failed = |seed| Record {
            system: "skidcal".into(),
            values: Values::new(),
            failed: Some("no [body]".into()),
            ..record("ours", seed, 0.0)
        };
        let error = rows(&[failed(1), failed(2)]).expect_err("nothing ran").to_string();
        assert!(error.contains("none of 2 trials") && error.contains("no [body]"), "{error}");
    }

    /// A metric that one trial of three has, as the diameter of a vial that was gripped once: it has no interval and no
    /// row, and the other rows stay.
    #[test]
    fn a_metric_with_one_value_is_no_row() {
        let of = |seed, values: &[(&str, f64)]| Record {
            system: "cloop".into(),
            values: values.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
            ..record("paper", seed, 0.0)
        };
        let records = [of(1, &[("failed", 0.0), ("diameter_error_m", 1e-4)]), of(2, &[("failed", 1.0)])];
        let named: Vec<String> = rows(&records).expect("rows").into_iter().map(|row| row.metric).collect();
        assert_eq!(named, ["failed"]);
        // A metric with a target is not skipped: too few values are an error then.
        let with_target = records.map(|record| Record { arm: "ours".into(), ..record });
        assert!(rows(&with_target).is_err());
    }

    #[test]
    fn a_shard_is_one_of_several() {
        for good in ["1/1", "3/8", "8/8"] {
            assert_eq!(good.parse::<Shard>().expect(good).to_string(), good);
        }
        for bad in ["", "0/8", "9/8", "1", "1/0", "-1/2", "a/b", "1/2/3"] {
            assert!(bad.parse::<Shard>().is_err(), "{bad}");
        }
    }
}
