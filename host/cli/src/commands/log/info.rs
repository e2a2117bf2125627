//! `r4 log info`: content and gaps of a log.

use std::{collections::BTreeMap, path::Path};

use r4_log::{Coverage, Log, Recorded, request_name};
use serde::Serialize;

use super::read;
use crate::{args::Args, output, table};

/// Content of a log.
#[derive(Serialize)]
pub(super) struct Info<'a> {
    log: &'a Path,
    robot: &'a str,
    board: &'a str,
    firmware: &'a str,
    protocol: u16,
    /// Wall-clock time of the recording, RFC 3339.
    recorded_at: Option<String>,
    program: Option<&'a str>,
    command: Option<&'a str>,
    seed: Option<u64>,
    /// Board's clock at the first record, s.
    start_s: Option<f64>,
    duration_s: f64,
    samples: usize,
    /// Samples that were subscribed and are missing.
    missing: u64,
    channels: Vec<Channel>,
    states: Vec<State>,
    /// Number of requests of each kind.
    requests: BTreeMap<&'static str, usize>,
    refusals: Vec<Refusal<'a>>,
    /// Times without a link.
    gaps: Vec<Gap>,
    warnings: Vec<String>,
}

#[derive(Serialize)]
struct Channel {
    channel: String,
    unit: String,
    samples: usize,
    rate_hz: Option<f64>,
    longest_gap_s: Option<f64>,
    missing: Option<u64>,
}

#[derive(Serialize)]
struct State {
    time_s: f64,
    state: String,
    causes: Vec<String>,
}

#[derive(Serialize)]
struct Refusal<'a> {
    time_s: f64,
    request: &'a str,
    reason: &'a str,
}

#[derive(Serialize)]
struct Gap {
    /// Time at which the board was heard again, s.
    time_s: f64,
    without_link_s: f64,
    restarted: bool,
    #[serde(skip)]
    text: String,
}

pub(super) fn run(args: &Args, file: &Path) -> anyhow::Result<bool> {
    let log = read(file)?;
    Info::of(file, &log).print(args)?;
    // Fail as `r4 log export` does: unreadable parts are missing.
    Ok(log.warnings.is_empty())
}

impl<'a> Info<'a> {
    pub(super) fn of(path: &'a Path, log: &'a Log) -> Self {
        let unit = |coverage: &Coverage| log.header.channels.iter().find(|info| info.id == coverage.channel);
        let channels: Vec<Channel> = log
            .coverage()
            .into_iter()
            .map(|coverage| Channel {
                channel: coverage.channel.to_string(),
                unit: unit(&coverage).map_or_else(String::new, |info| info.unit.to_string()),
                samples: coverage.samples,
                rate_hz: coverage.rate_hz,
                longest_gap_s: coverage.longest_gap_s,
                missing: coverage.missing,
            })
            .collect();
        let mut requests = BTreeMap::new();
        for request in &log.requests {
            *requests.entry(request_name(&request.request)).or_default() += 1;
        }
        let states = log.states.iter().map(|change| State {
            time_s: change.time_s,
            state: change.state.to_string(),
            causes: change.causes.iter().map(|cause| cause.to_string()).collect(),
        });
        let refusals = log.refusals.iter().map(|refused| Refusal {
            time_s: refused.time_s,
            request: &refused.request,
            reason: &refused.reason,
        });
        let gaps = log.gaps.iter().map(|gap| Gap {
            time_s: gap.time_s,
            without_link_s: gap.without_link_s,
            restarted: gap.restarted,
            text: gap.to_string(),
        });
        let header = &log.header;
        Self {
            log: path,
            robot: &header.robot,
            board: &header.board,
            firmware: &header.firmware,
            protocol: header.protocol_version,
            recorded_at: header.recorded.as_ref().map(Recorded::at),
            program: header.recorded.as_ref().map(|recorded| recorded.program.as_str()),
            command: header.recorded.as_ref().map(|recorded| recorded.command.as_str()),
            seed: header.seed,
            start_s: log.time_span_s().map(|(start_s, _)| start_s),
            duration_s: log.duration_s(),
            samples: channels.iter().map(|channel| channel.samples).sum(),
            // `None` for a channel without a recorded subscription.
            missing: channels.iter().filter_map(|channel| channel.missing).sum(),
            states: states.collect(),
            requests,
            refusals: refusals.collect(),
            gaps: gaps.collect(),
            warnings: log.warnings.iter().map(ToString::to_string).collect(),
            channels,
        }
    }

    /// Number of subscribed samples that are missing.
    pub(super) fn missing(&self) -> u64 {
        self.missing
    }

    pub(super) fn print(&self, args: &Args) -> anyhow::Result<()> {
        if args.json {
            return output::json(self);
        }
        output::line(format_args!("log       {}", self.log.display()))?;
        output::line(format_args!("robot     {}", self.robot))?;
        let seed = self.seed.map_or_else(String::new, |seed| format!(", seed {seed}"));
        output::line(format_args!("board     {}{seed}", self.board))?;
        output::line(format_args!("firmware  {}, protocol {}", self.firmware, self.protocol))?;
        if let (Some(at), Some(program), Some(command)) = (&self.recorded_at, self.program, self.command) {
            output::line(format_args!("recorded  {at} by {program}"))?;
            output::line(format_args!("command   {command}"))?;
        }
        let start =
            self.start_s.map_or_else(String::new, |start_s| format!(", from {start_s:.3} s of the board's clock"));
        output::line(format_args!("time      {:.3} s{start}", self.duration_s))?;
        let requests: Vec<String> = self.requests.iter().map(|(name, count)| format!("{count} {name}")).collect();
        output::line(format_args!(
            "requests  {}",
            if requests.is_empty() { "none".into() } else { requests.join(", ") }
        ))?;
        for State { time_s, state, causes } in &self.states {
            output::line(format_args!("{:<10}{time_s:.3} s  {}", state, causes.join(", ")).to_string().trim_end())?;
        }
        for Refusal { time_s, request, reason } in &self.refusals {
            output::line(format_args!("refused   {time_s:.3} s  {request}: {reason}"))?;
        }
        for Gap { time_s, text, .. } in &self.gaps {
            output::line(format_args!("gap       {time_s:.3} s  {text}"))?;
        }
        let mut table = table::new(&["channel", "unit", "samples", "rate Hz", "longest gap", "missing"], 2..6);
        for channel in &self.channels {
            table.add_row([
                channel.channel.clone(),
                channel.unit.clone(),
                channel.samples.to_string(),
                channel.rate_hz.map_or("-".into(), |rate_hz| format!("{rate_hz:.1}")),
                channel.longest_gap_s.map_or("-".into(), |gap_s| format!("{:.0} ms", gap_s * 1e3)),
                channel.missing.map_or("-".into(), |missing| missing.to_string()),
            ]);
        }
        Ok(output::line(table)?)
    }
}
