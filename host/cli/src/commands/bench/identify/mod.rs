//! `r4 bench identify`: results of `r4 identify` on recordings of real machines, on printed tables, and on simulated
//! plants with hidden effects. Errors are those of free-run simulation (simulation error, as against one-step
//! prediction error) on held-out data.

mod blind;
mod boards;
mod coverage;
mod recorded;
mod tables;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    time::Instant,
};

use anyhow::{Context, bail};
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use r4_identify::{
    Identified, IdentifyError, Progress, Task,
    data::{self, Options, Run},
};
use r4_maths::statistics;
use serde::Serialize;

use crate::{
    args::{Args, BenchIdentify, IdentifyRows},
    output, table,
};

/// Side of the limit on which a number must lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Bound {
    AtMost,
    AtLeast,
    /// From `at_least` to `at_most`.
    Between,
    /// No limit: the number is for comparison only.
    Free,
}

#[derive(Debug, Serialize)]
struct Row {
    data: String,
    metric: String,
    unit: &'static str,
    /// Value of the base model; `null` where the metric has none.
    baseline: Option<f64>,
    /// Value of the final model; `null` without a result.
    after: f64,
    /// Limit, on the side that `bound` names; `null` for none.
    at_least: f64,
    /// Upper limit where there are two.
    #[serde(skip_serializing_if = "Option::is_none")]
    at_most: Option<f64>,
    bound: Bound,
    met: bool,
    /// True if no part of the data was measured on a machine.
    simulated: bool,
    /// 95 % confidence interval of a share, by Wilson.
    #[serde(skip_serializing_if = "Option::is_none")]
    interval: Option<[f64; 2]>,
    /// Details, such as the effects found.
    detail: String,
}

impl Row {
    /// Row of an error with an upper limit.
    fn error(data: &str, metric: &str, unit: &'static str, [baseline, after, at_most]: [f64; 3]) -> Self {
        Self {
            data: data.to_owned(),
            metric: metric.to_owned(),
            unit,
            baseline: baseline.is_finite().then_some(baseline),
            after,
            at_least: at_most,
            at_most: None,
            bound: Bound::AtMost,
            met: after <= at_most,
            simulated: false,
            interval: None,
            detail: String::new(),
        }
    }

    /// Row of a number without a limit.
    fn told(data: &str, metric: &str, unit: &'static str, [baseline, after]: [f64; 2]) -> Self {
        Self {
            bound: Bound::Free,
            met: after.is_finite(),
            ..Self::error(data, metric, unit, [baseline, after, f64::INFINITY])
        }
    }

    /// Row of a claim that must hold: 1 if it does.
    fn claim(data: &str, metric: &str, holds: bool) -> Self {
        let after = f64::from(u8::from(holds));
        Self {
            bound: Bound::AtLeast,
            met: holds,
            at_least: 1.0,
            ..Self::error(data, metric, "yes", [f64::NAN, after, 1.0])
        }
    }

    /// Row of a share with a lower limit.
    fn share(data: &str, metric: &str, [good, all]: [usize; 2], at_least: f64) -> Self {
        let share = good as f64 / all as f64;
        Self {
            bound: Bound::AtLeast,
            met: share >= at_least,
            interval: Some(wilson(good, all)),
            ..Self::error(data, metric, "1", [f64::NAN, share, at_least])
        }
    }

    /// Row of a share with an upper limit.
    fn rare(data: &str, metric: &str, [bad, all]: [usize; 2], at_most: f64) -> Self {
        let share = bad as f64 / all as f64;
        Self { interval: Some(wilson(bad, all)), ..Self::error(data, metric, "1", [f64::NAN, share, at_most]) }
    }

    /// Row of a share with a lower and an upper limit.
    fn between(data: &str, metric: &str, [good, all]: [usize; 2], [at_least, at_most]: [f64; 2]) -> Self {
        let row = Self::share(data, metric, [good, all], at_least);
        Self { bound: Bound::Between, at_most: Some(at_most), met: row.met && row.after <= at_most, ..row }
    }

    fn with(self, detail: impl Into<String>) -> Self {
        Self { detail: detail.into(), ..self }
    }

    fn simulated(self) -> Self {
        Self { simulated: true, ..self }
    }
}

/// 95 % confidence interval of a share, by Wilson.
fn wilson(good: usize, all: usize) -> [f64; 2] {
    statistics::wilson(good as u64, all as u64, 0.95).map_or([0.0, 1.0], |interval| [interval.low, interval.high])
}

/// First seed of the simulated plants that a release is measured on: new with each release and never used for tuning.
/// It is the date of its choice and three digits, so that no plant of another date is among those that follow.
const REPORT_BASE: u64 = 20_261_128_500;
/// End of the first seeds for tuning.
const TUNING_END: u64 = 1_000_000;
/// Distance between the first seeds of two kinds of simulated plants: more than there are plants of a kind.
const APART: u64 = 10_000_000;

/// Purpose of the simulated plants from first seed `base`.
const fn purpose(base: u64) -> &'static str {
    match base {
        REPORT_BASE => "report",
        0..TUNING_END => "tuning",
        _ => "neither report nor tuning",
    }
}

#[derive(Serialize)]
struct Report {
    seed: u64,
    seeds: u32,
    /// First seed of the simulated plants.
    base: u64,
    /// [`purpose`] of the base.
    seeds_are_for: &'static str,
    rows: Vec<Row>,
    met: bool,
    seconds: f64,
}

/// Sets of recordings and their measurements.
impl IdentifyRows {
    /// Folder within that of the recordings; `None` for sets without recordings.
    const fn folder(self) -> Option<&'static str> {
        match self {
            Self::Emps => Some("emps"),
            Self::Husky => Some("husky_skidsteer"),
            Self::Pendulum => Some("bam_xl330_pendulum"),
            Self::Micromouse => Some("micromouse_drv8833"),
            Self::Backlash => Some("sts_servo_backlash"),
            Self::Osmc
            | Self::Speed
            | Self::Blind
            | Self::Pairs
            | Self::Clean
            | Self::Unlisted
            | Self::Broken
            | Self::Close => None,
        }
    }

    fn measure(self, bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
        match self {
            Self::Emps => recorded::emps(bench),
            Self::Husky => recorded::husky(bench),
            Self::Pendulum => recorded::pendulum(bench),
            Self::Micromouse => recorded::micromouse(bench),
            Self::Backlash => recorded::backlash(bench),
            Self::Osmc => tables::osmc(bench),
            Self::Speed => blind::speed(bench),
            Self::Blind => blind::listed(bench),
            Self::Pairs => blind::pairs(bench),
            Self::Clean => blind::clean(bench),
            Self::Unlisted => blind::unlisted(bench),
            Self::Broken => blind::broken(bench),
            Self::Close => boards::close(bench),
        }
    }

    /// Number of simulated plants of this kind where the kind with one effect has `seeds`.
    const fn plants(self, seeds: u32) -> u32 {
        match self {
            Self::Blind => seeds,
            Self::Clean => (2 * seeds).div_ceil(3),
            Self::Unlisted => seeds.div_ceil(2),
            Self::Pairs | Self::Broken => seeds.div_ceil(3),
            Self::Close => seeds.div_ceil(6),
            _ => 0,
        }
    }

    /// First seed of the simulated plants; no two kinds have a seed in common.
    const fn first_seed(self, base: u64) -> u64 {
        let place = match self {
            Self::Pairs => 1,
            Self::Clean => 2,
            Self::Unlisted => 3,
            Self::Broken => 4,
            Self::Speed => 5,
            Self::Close => 6,
            _ => 0,
        };
        base.wrapping_add(place * APART)
    }

    /// Weight in the progress bar, where a simulated plant is 1.
    const fn weight(self, seeds: u32) -> u64 {
        match self {
            Self::Blind | Self::Pairs | Self::Clean | Self::Unlisted | Self::Broken | Self::Close => {
                self.plants(seeds) as u64
            }
            Self::Speed => blind::TIMED_WEIGHT,
            _ => 2,
        }
    }

    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }
}

/// Options that the measurements share.
struct Bench<'b> {
    args: &'b Args,
    data: &'b Path,
    seed: u64,
    /// First seed of the simulated plants.
    base: u64,
    seeds: u32,
    from: u32,
    /// Print a line for each simulated plant.
    each: bool,
    progress: &'b ProgressBar,
}

impl Bench<'_> {
    fn folder(&self, rows: IdentifyRows) -> PathBuf {
        self.data.join(rows.folder().unwrap_or_default())
    }

    fn read(&self, rows: IdentifyRows, names: &[&str], options: &Options) -> anyhow::Result<Vec<Run>> {
        let files: Vec<PathBuf> = names.iter().map(|name| self.folder(rows).join(name)).collect();
        Ok(data::read(&files, options)?.runs)
    }

    /// Numbers of the simulated plants of a kind.
    fn numbers(&self, rows: IdentifyRows) -> std::ops::Range<u32> {
        self.from..self.from.saturating_add(rows.plants(self.seeds))
    }

    /// Prints a line on stderr above the progress bar.
    fn say(&self, line: &str) {
        self.progress.suspend(|| eprintln!("{line}"));
    }

    /// Identifies as `r4 identify` does.
    fn identify(
        &self,
        model: &str,
        parameters: &[(&str, f64)],
        train: &[Run],
        holdout: &[Run],
    ) -> Result<Identified, IdentifyError> {
        let parameters: BTreeMap<_, _> = parameters.iter().map(|&(name, value)| (name.to_owned(), value)).collect();
        self.answer(&Task { model: model.to_owned(), parameters, ..self.task() }, train, holdout)
    }

    /// Task without a model and parameters.
    fn task(&self) -> Task {
        Task { seed: self.seed, ..Task::default() }
    }

    fn answer(&self, task: &Task, train: &[Run], holdout: &[Run]) -> Result<Identified, IdentifyError> {
        r4_identify::identify(task, train, holdout, vec![], &|Progress { step, .. }| self.progress.set_message(step))
    }
}

pub(super) fn run(args: &Args, question: &BenchIdentify) -> anyhow::Result<bool> {
    let started = Instant::now();
    let wanted = |rows: &IdentifyRows| question.only.is_empty() || question.only.contains(rows);
    let wanted: Vec<IdentifyRows> = IdentifyRows::value_variants().iter().copied().filter(wanted).collect();
    for rows in &wanted {
        // Check all folders before the first measurement.
        if let Some(missing) = rows.folder().map(|folder| question.data.join(folder)).filter(|path| !path.is_dir()) {
            bail!(
                "there are no recordings in {}: start this in the project's folder, or name its `data` with --data DIR",
                missing.display()
            );
        }
    }
    let all = wanted.iter().map(|rows| rows.weight(question.seeds)).sum();
    let style = ProgressStyle::with_template("{bar:30} {percent:>3} %, {elapsed}, {prefix}: {msg}");
    let progress = ProgressBar::new(all).with_style(style.unwrap_or(ProgressStyle::default_bar()));
    // Without `--seed`, the seeds are those of the release's report.
    let base = if args.is_seed_given { args.seed } else { REPORT_BASE };
    let bench = Bench {
        args,
        data: &question.data,
        seed: args.seed,
        base,
        seeds: question.seeds,
        from: question.from,
        each: question.each,
        progress: &progress,
    };
    let mut rows = Vec::new();
    let mut done = 0;
    for which in wanted {
        progress.set_prefix(which.name());
        let measured = which.measure(&bench).with_context(|| format!("no result of {}", which.name()));
        // A failed measurement becomes a row; the others still run.
        rows.extend(
            measured.unwrap_or_else(|why| vec![Row::claim(&which.name(), "measured", false).with(format!("{why:#}"))]),
        );
        done += which.weight(question.seeds);
        progress.set_position(done);
    }
    progress.finish_and_clear();
    let met = rows.iter().all(|row| row.met);
    let report = Report {
        seed: args.seed,
        seeds: question.seeds,
        base,
        seeds_are_for: purpose(base),
        rows,
        met,
        seconds: started.elapsed().as_secs_f64(),
    };
    if args.json {
        output::json(&report)?;
    } else {
        print(&report)?;
    }
    Ok(met)
}

/// Formats three significant digits, or all digits of a whole number.
fn digits(value: f64) -> String {
    if !value.is_finite() {
        return "-".to_owned();
    }
    let places = if value == value.trunc() { 0 } else { (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize };
    format!("{value:.places$}")
}

fn print(report: &Report) -> anyhow::Result<()> {
    let mut table = table::new(&["data", "metric", "before", "after", "limit", "", "found"], 2..4);
    for row in &report.rows {
        let unit = if matches!(row.unit, "1" | "yes") { String::new() } else { format!(" {}", row.unit) };
        let said = |value: f64| match (row.unit, value) {
            ("yes", 0.0) => "no".to_owned(),
            ("yes", _) => "yes".to_owned(),
            _ => digits(value) + &unit,
        };
        let between = row.interval.map(|[low, high]| format!(" ({} to {})", digits(low), digits(high)));
        let promised = match (row.unit, row.bound) {
            ("yes", _) => said(row.at_least),
            (_, Bound::Free) => String::new(),
            (_, Bound::AtMost) => format!("at most {}", said(row.at_least)),
            (_, Bound::AtLeast | Bound::Between) => format!("at least {}", said(row.at_least)),
        };
        let most = row.at_most.map_or_else(String::new, |at_most| format!(", at most {}", said(at_most)));
        table.add_row([
            if row.simulated { format!("{} (simulated)", row.data) } else { row.data.clone() },
            row.metric.clone(),
            row.baseline.map_or_else(String::new, said),
            said(row.after) + &between.unwrap_or_default(),
            promised + &most,
            if row.met { "ok" } else { "not met" }.to_owned(),
            row.detail.clone(),
        ]);
    }
    output::line("Errors of free-run simulation on held-out data; before: the base model alone")?;
    output::line(format_args!(
        "Simulated plants: {} with one effect, from seed {} (seeds for: {})",
        report.seeds, report.base, report.seeds_are_for
    ))?;
    output::line(table)?;
    let met = report.rows.iter().filter(|row| row.met).count();
    Ok(output::line(format_args!(
        "{met} of {} met, in {:.0} s; seed {}",
        report.rows.len(),
        report.seconds,
        report.seed
    ))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_know_how_few_they_are_of() {
        // Values as in any table of Wilson's interval (1927).
        for (good, all, expected) in [(9, 10, [0.596, 0.982]), (0, 10, [0.0, 0.278]), (190, 200, [0.910, 0.973])] {
            let found = wilson(good, all);
            assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 0.001), "{good} of {all}: {found:?}");
        }
        assert_eq!(wilson(0, 0), [0.0, 1.0]);
        assert!(!Row::share("", "", [0, 0], 0.9).met);
    }

    #[test]
    fn rare_and_between_have_upper_limits() {
        assert!(Row::rare("", "", [5, 100], 0.05).met && !Row::rare("", "", [6, 100], 0.05).met);
        assert!(!Row::rare("", "", [0, 0], 0.05).met);
        for (inside, met) in [(92, false), (93, true), (97, true), (98, false)] {
            let row = Row::between("", "", [inside, 100], [0.93, 0.97]);
            assert_eq!((row.met, row.at_least, row.at_most), (met, 0.93, Some(0.97)), "{inside}");
        }
        assert!(!Row::between("", "", [0, 0], [0.93, 0.97]).met);
    }

    #[test]
    fn seeds_of_two_kinds_and_of_two_purposes_are_apart() {
        use IdentifyRows::{Blind, Broken, Clean, Close, Pairs, Speed, Unlisted};
        let mut ranges: Vec<[u64; 2]> = Vec::new();
        for base in [0, TUNING_END - 1, REPORT_BASE] {
            for rows in [Blind, Pairs, Clean, Unlisted, Broken, Speed, Close] {
                let first = rows.first_seed(base);
                ranges.push([first, first + u64::from(rows.plants(100_000))]);
            }
        }
        ranges.sort_unstable();
        assert!(ranges.windows(2).all(|pair| pair[0][1] < pair[1][0]), "{ranges:?}");
        assert_eq!([0, TUNING_END - 1, REPORT_BASE].map(purpose), ["tuning", "tuning", "report"]);
        assert_eq!([Blind, Pairs, Clean, Unlisted, Broken].map(|rows| rows.plants(300)), [300, 100, 200, 150, 100]);
    }

    #[test]
    fn no_result_meets_nothing() {
        assert!(!Row::error("", "", "m", [1.0, f64::NAN, 1.0]).met);
        assert!(Row::error("", "", "m", [1.0, 1.0, 1.0]).met && !Row::claim("", "", false).met);
    }

    #[test]
    fn numbers_have_three_digits() {
        let shown = [0.0, 1.0, 0.025_417, 4.7, 97.44, 1234.5, f64::NAN].map(digits);
        assert_eq!(shown, ["0", "1", "0.0254", "4.70", "97.4", "1234", "-"]);
    }
}
