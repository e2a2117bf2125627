//! `r4 access log`: verification and print of an access log.

use std::{fs, path::PathBuf};

use anyhow::Context;
use r4_access::{
    Basis, Facts,
    chain::{Head, verify},
    log::{Entry, Event, Paths, key, read},
};
use serde::Serialize;

use crate::{args::Args, output, table};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Log {
    /// The log; its signed head is beside it, as FILE.head
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Public key of the log, kept elsewhere [default: that of FILE.pub]
    #[arg(long = "public-key", value_name = "KEY")]
    public_key: Option<String>,
    /// Older head of the same log, kept elsewhere: shows a log that was set back together with its head
    #[arg(long, value_name = "FILE")]
    anchor: Option<PathBuf>,
}

#[derive(Serialize)]
struct Shown<'s> {
    entries: &'s [Entry],
    is_complete: bool,
}

pub(super) fn run(args: &Args, log: &Log) -> anyhow::Result<()> {
    let paths = Paths::of(&log.file);
    let key = key(&paths, log.public_key.as_deref())?;
    // An entry behind the head is a defect here: a running guard is between both writes for less than a millisecond.
    let verified = read(&paths, &key)?.complete().with_context(|| log.file.display().to_string())?;
    if let Some(anchor) = &log.anchor {
        let place = || anchor.display().to_string();
        let head: Head = serde_json::from_str(&fs::read_to_string(anchor).with_context(place)?).with_context(place)?;
        verify(&fs::read_to_string(&log.file).with_context(place)?, &head, &key).with_context(place)?;
    }
    if args.json {
        return output::json(&Shown { entries: &verified.entries, is_complete: true });
    }
    let mut shown = table::new(&["entry", "time, UTC", "link", "event"], 0..1);
    for entry in &verified.entries {
        let (link, event) = words(&entry.event);
        let link = link.map_or_else(String::new, |link| link.to_string());
        shown.add_row([entry.number.to_string(), time(entry.at_ms), link, event]);
    }
    output::line(shown)?;
    output::line(format_args!("{} entries, unaltered and complete", verified.entries.len()))?;
    Ok(())
}

/// Date and time of a Unix time, to the second.
fn time(at_ms: u64) -> String {
    let at = std::time::UNIX_EPOCH + std::time::Duration::from_millis(at_ms);
    humantime::format_rfc3339_seconds(at).to_string()
}

/// Link of an event, and the event in words.
fn words(event: &Event) -> (Option<u64>, String) {
    match event {
        Event::Started { policy, unsigned: 0, .. } => (None, format!("started with the policy {policy}")),
        Event::Started { policy, unsigned, .. } => {
            (None, format!("started with the policy {policy}; {unsigned} entries before had no signed head"))
        }
        Event::Presented { link, subject, purpose, emergency, .. } => {
            let flag = if *emergency { ", EMERGENCY" } else { "" };
            (Some(*link), format!("token of {subject} for {purpose}{flag}"))
        }
        Event::Rejected { link, why } => (Some(*link), format!("token rejected: {why}")),
        Event::Decided { link, subject, action, resource, facts, basis, repeats } => {
            let who = if subject.is_empty() { "no token" } else { subject };
            let outcome = match basis {
                Some(Basis::Rule) => "granted".to_owned(),
                Some(Basis::BreakGlass) => "granted by BREAK-GLASS".to_owned(),
                None => format!("denied: {}", reason(facts)),
            };
            let times = if *repeats > 0 { format!(" ({repeats} more times)") } else { String::new() };
            (Some(*link), format!("{who}: {action} {resource}: {outcome}{times}"))
        }
        Event::Left { link } => (Some(*link), "left".to_owned()),
    }
}

/// Reason of the facts of a denied request, as an entry has them.
fn reason(facts: &str) -> String {
    let mut bits = [false; 8];
    for (bit, digit) in bits.iter_mut().zip(facts.bytes()) {
        *bit = digit == b'1';
    }
    Facts::from_bits(bits).reason().map_or_else(|| "log could not be written".to_owned(), |reason| reason.to_string())
}
