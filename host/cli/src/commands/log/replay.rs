//! `r4 log replay`: sends a recorded run's requests to a simulated board again and compares both runs.

use std::{path::PathBuf, str::FromStr};

use anyhow::{Context, bail, ensure};
use r4_log::{Difference, Log, compare};
use r4_protocol::Unit;
use r4_rig::{
    quantity::Quantity,
    replay::{Plan, play, shift_s},
};
use r4_sim::Pace;
use serde::Serialize;

use super::read;
use crate::{args::Args, output, session, table};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Replay {
    /// Log to replay, an MCAP file
    pub(crate) file: PathBuf,
    /// Largest difference of a signal; examples: osmc0.position_rad=0.02, osmc0.position=1deg, or duty=0.1 for every
    /// channel; may be given several times [default: no limit]
    #[arg(long, value_name = "SIGNAL=LIMIT")]
    pub(crate) within: Vec<Within>,
    /// Most samples of a signal with a limit that exist in only one of the runs, for each run [default: 0, or 2 where
    /// the clocks of the two differ]
    #[arg(long, value_name = "N")]
    pub(crate) one_sided: Option<usize>,
    /// Require every signal to be bit-identical, as it is for a log of the same simulated board and seed
    #[arg(long, conflicts_with = "within")]
    pub(crate) exact: bool,
}

/// Largest accepted difference of a signal.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Within {
    /// Signal name, or its part after the channel for all channels; with or without the unit suffix.
    signal: String,
    limit: f64,
    /// Unit given with the limit; `None` for the signal's own unit.
    unit: Option<Unit>,
}

impl FromStr for Within {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (signal, limit) = text.split_once('=').ok_or("a signal, = and a limit, as in osmc0.position_rad=0.02")?;
        let (limit, unit) = match limit.parse::<f64>() {
            Ok(limit) => (limit, None),
            Err(_) => limit.parse::<Quantity>().map(|limit| (limit.value, Some(limit.unit)))?,
        };
        if signal.is_empty() || !(limit >= 0.0 && limit.is_finite()) {
            return Err("a signal, = and a limit of 0 or more, as in osmc0.position_rad=0.02".into());
        }
        Ok(Self { signal: signal.to_owned(), limit, unit })
    }
}

/// Unit suffixes of signal names.
const SUFFIXES: [(&str, Unit); 6] = [
    ("_rad_s", Unit::RadPerS),
    ("_m_s", Unit::MPerS),
    ("_rad", Unit::Rad),
    ("_m", Unit::M),
    ("_v", Unit::V),
    ("_n", Unit::N),
];

impl Within {
    /// True if the limit applies to the signal of this name.
    fn covers(&self, name: &str) -> bool {
        let suffix = SUFFIXES.into_iter().find(|(suffix, _)| name.ends_with(suffix));
        let unit = suffix.map_or(Unit::Duty, |(_, unit)| unit);
        let field = |name: &str| name.split_once('.').is_some_and(|(_, field)| field == self.signal);
        let bare = name.strip_suffix(suffix.map_or("", |(suffix, _)| suffix)).unwrap_or(name);
        self.unit.is_none_or(|asked| asked == unit)
            && (name == self.signal || bare == self.signal || field(name) || field(bare))
    }
}

#[derive(Serialize)]
struct Report {
    log: PathBuf,
    board: String,
    seed: u64,
    /// True if the log has no arming, disarming or subscriptions, so that they were inferred from states and samples.
    inferred: bool,
    requests: usize,
    duration_s: f64,
    /// True if every signal is bit-identical.
    identical: bool,
    met: bool,
    signals: Vec<Row>,
}

#[derive(Serialize)]
struct Row {
    signal: String,
    samples: [usize; 2],
    one_sided: [usize; 2],
    compared: usize,
    unequal: usize,
    max: Option<f64>,
    rms: Option<f64>,
    limit: Option<f64>,
    met: Option<bool>,
}

pub(super) fn run(args: &Args, replay: &Replay) -> anyhow::Result<bool> {
    // Fails for a link, before anything is sent over it.
    args.board.robot()?;
    let log = read(&replay.file)?;
    let plan = Plan::of(&log).with_context(|| format!("{} cannot be replayed", replay.file.display()))?;
    let Sent { bytes, seed, played } = send(args, &log, &plan);
    played.with_context(|| format!("cannot replay {}", replay.file.display()))?;
    let again = Log::from_bytes(&bytes)?;
    let shift_s = shift_s(&log, &again);
    // With another clock, samples at both ends of the runs have no counterpart.
    let one_sided = replay.one_sided.unwrap_or(if shift_s == 0.0 { 0 } else { AT_THE_ENDS });
    let differences = compare(&log, &again, shift_s);
    let report = judge(replay, &log, &plan, differences, one_sided, (args.board.to_string(), seed))?;
    if args.json {
        output::json(&report)?;
    } else {
        print(&report)?;
    }
    Ok(report.met)
}

/// Run that was sent again.
struct Sent {
    /// Log of the replayed run, up to its end or failure.
    bytes: Vec<u8>,
    /// Seed of the simulated board's noise.
    seed: u64,
    played: anyhow::Result<()>,
}

/// Seed of the log's own noise, unless `--seed` gives another.
pub(in crate::commands) fn seed(args: &Args, log: &Log) -> u64 {
    if args.seed == 1 { log.header.seed.unwrap_or(args.seed) } else { args.seed }
}

/// Replays the run on the board that `args` name.
fn send(args: &Args, log: &Log, plan: &Plan) -> Sent {
    let seed = seed(args, log);
    let seeded = Args { seed, ..args.clone() };
    let (result, log) = session::in_memory(&seeded, Pace::Free, async |session| Ok(play(session, plan).await?));
    Sent { bytes: log, seed, played: result.map(|_| ()) }
}

/// Samples by which the runs may differ at either end where they are sampled at different times.
const AT_THE_ENDS: usize = 2;

fn judge(
    replay: &Replay,
    log: &Log,
    plan: &Plan,
    differences: Vec<Difference>,
    one_sided: usize,
    (board, seed): (String, u64),
) -> anyhow::Result<Report> {
    for within in &replay.within {
        ensure!(
            differences.iter().any(|difference| within.covers(&difference.name)),
            "neither run has a signal {} in that unit: `r4 log export` names those of a log",
            within.signal
        );
    }
    let identical = differences.iter().all(Difference::is_identical);
    let signals: Vec<Row> = differences
        .into_iter()
        .map(|difference| {
            let limits = replay.within.iter().filter(|within| within.covers(&difference.name));
            // The tightest limit applies where several cover a signal.
            let limit = limits.map(|within| within.limit).min_by(f64::total_cmp);
            let sides = difference.one_sided.iter().all(|&samples| samples <= one_sided);
            let near = |limit| difference.max.map_or(difference.unequal == 0, |max| max <= limit);
            let met = match limit {
                Some(limit) => Some(near(limit) && sides),
                None => replay.exact.then(|| difference.is_identical()),
            };
            let Difference { name, samples, one_sided, compared, max, rms, unequal } = difference;
            Row { signal: name, samples, one_sided, compared, unequal, max, rms, limit, met }
        })
        .collect();
    // No common sample would meet every limit.
    if signals.iter().all(|row| row.compared == 0) {
        bail!(
            "nothing was compared: no signal was recorded in both runs at the same moments; is {board} the recorded robot, \
             and does the log hold samples (`r4 log info`)?"
        );
    }
    Ok(Report {
        log: replay.file.clone(),
        board,
        seed,
        inferred: plan.inferred,
        requests: plan.steps.len(),
        duration_s: log.duration_s(),
        identical,
        met: signals.iter().all(|row| row.met != Some(false)),
        signals,
    })
}

/// Formats a number with four significant digits; `-` for none.
fn short(value: Option<f64>) -> String {
    match value {
        None => "-".into(),
        Some(0.0) => "0".into(),
        Some(value) if !(1e-3..1e5).contains(&value) => format!("{value:.3e}"),
        Some(value) => {
            let decimals = (3.0 - value.log10().floor()).clamp(0.0, 6.0) as usize;
            format!("{value:.decimals$}")
        }
    }
}

fn print(report: &Report) -> anyhow::Result<()> {
    let Report { board, seed, requests, duration_s, .. } = report;
    output::line(format_args!("{}", report.log.display()))?;
    output::line(format_args!("{requests} requests in {duration_s:.3} s, sent again to {board}, seed {seed}"))?;
    if report.inferred {
        output::line("the log has no arming and no subscriptions: taken from its states and samples")?;
    }
    let shown = |row: &&Row| row.unequal > 0 || row.one_sided != [0, 0] || row.limit.is_some();
    if report.signals.iter().any(|row| shown(&row)) {
        let mut table = table::new(&["signal", "max", "RMS", "one-sided", ""], 1..4);
        for row in report.signals.iter().filter(shown) {
            let verdict = match (row.met, row.limit) {
                (None, _) => "",
                (Some(true), _) => "ok",
                (Some(false), Some(limit)) if row.max.is_some_and(|max| max > limit) => "over",
                (Some(false), Some(_)) if row.max.is_some() => "missing",
                (Some(false), _) => "differs",
            };
            let words = || if row.unequal > 0 { format!("{} differ", row.unequal) } else { "-".into() };
            table.add_row([
                row.signal.clone(),
                row.max.map_or_else(words, |max| short(Some(max))),
                short(row.rms),
                format!("{} / {}", row.one_sided[0], row.one_sided[1]),
                verdict.into(),
            ]);
        }
        output::line(table)?;
        output::line("differences in the signals' units; one-sided: samples only in the log / only in the replay")?;
    }
    let same = report.signals.iter().filter(|row| row.unequal == 0 && row.one_sided == [0, 0]).count();
    let all = report.signals.len();
    if report.identical {
        return Ok(output::line(format_args!("all {all} signals are the same to the last bit"))?);
    }
    Ok(output::line(format_args!("{same} of {all} signals are the same to the last bit"))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_is_for_a_signal_or_for_all_of_its_kind() {
        let covers = |limit: &str, name: &str| limit.parse::<Within>().unwrap().covers(name);
        for limit in ["osmc0.position_rad=0.1", "osmc0.position=1deg", "position_rad=0", "position=0.1"] {
            assert!(covers(limit, "osmc0.position_rad"), "{limit}");
        }
        for limit in ["osmc1.position_rad=0.1", "osmc0.position=1mm", "speed=1", "osmc0=1", "rad=1"] {
            assert!(!covers(limit, "osmc0.position_rad"), "{limit}");
        }
        assert!(covers("duty=5%", "dhb3.duty") && covers("state=0", "state") && covers("quality=0", "range0.quality"));
        for bad in ["", "osmc0.position", "=1", "duty=", "duty=-1", "duty=nan", "duty=inf", "duty=fast"] {
            assert!(bad.parse::<Within>().is_err(), "{bad}");
        }
    }

    #[test]
    fn differences_are_told_in_four_digits() {
        let told = [0.0, 1.5e-7, 0.012_345, 1.0, 123.456].map(|value| short(Some(value)));
        assert_eq!(told, ["0", "1.500e-7", "0.01235", "1.000", "123.5"]);
    }
}
