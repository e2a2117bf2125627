//! Times of the guard on this computer: how long a decision takes, and whether its time says what exists.

use std::{hint::black_box, io, path::PathBuf, process, time::Instant};

use r4_access::{
    Action, Class, Credential, Guard, Policy, Request, Resource,
    chain::{Head, Verified},
    log::{Files, Store},
    signing_key,
};
use r4_maths::statistics::{Alternative, Interval, QuantileRule, quantile, welch_t};

use super::{LOG_KEY, NAME, OURS, day::BEGIN_MS, refused};
use crate::{Error, Limit, Row, Sampler, Statistic, Summary};

/// Decisions whose time is measured, and in a quick benchmark.
const DECISIONS: usize = 5_000;
const QUICK_DECISIONS: usize = 500;
/// Pairs of denials whose times are compared, and in a quick benchmark.
const PAIRS: usize = 50_000;
const QUICK_PAIRS: usize = 5_000;
/// Names in each class of the comparison: enough that caches hold no single one.
const NAMES: usize = 64;
/// Limit of Welch's t beyond which times count as a leak: Goodwill, Jun, Jaffe, Rohatgi, "A testing methodology for
/// side-channel resistance validation", NIST NIAT 2011; by chance 7 in a million tests are beyond.
const LEAK_T: f64 = 4.5;
/// Share of the longest times that are left out: interrupts of the computer, as in Reparaz, Balasch, Verbauwhede, "Dude, is
/// my code constant time?", DATE 2017.
const CROPPED: f64 = 0.99;
/// Limit of the 99 % quantile of a decision, s.
const P99_S: f64 = 1e-3;

/// Log that is signed and not kept, so that the comparison has no file system in it.
struct Nowhere;

impl Store for Nowhere {
    fn put(&mut self, line: &str, head: &Head) -> io::Result<()> {
        black_box((line, head));
        Ok(())
    }
}

/// Folder that is removed with its files.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        // A folder that stays is only a folder of the system's temporary files.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn credential() -> Result<Credential, Error> {
    Credential::with_key("alice", "timing", "care", 3600, signing_key([1; 32]))
        .map_err(|error| refused(&error.to_string()))
}

/// Name of a recording: of one length, so that only existence differs.
fn name(number: usize, exists: bool) -> String {
    format!("{}{number:04}", if exists { "kept" } else { "none" })
}

/// Policy with many recordings that the subject may not read, and a channel that it may.
fn policy() -> Result<Policy, Error> {
    let key = credential()?.public_key();
    let mut text = format!(
        "name = \"timing\"\n[token]\nlife_s = 3600\n[[subject]]\nname = \"alice\"\nkey = \"{key}\"\nroles = [\"operator\"]\n\
         [[item]]\nresource = \"channel\"\npurposes = [\"care\"]\n\
         [[rule]]\nroles = [\"operator\"]\nactions = [\"set\"]\nresources = [\"channel\"]\n"
    );
    for number in 0..NAMES {
        text += &format!("[[item]]\nresource = \"recording/{}\"\npurposes = [\"care\"]\n", name(number, true));
    }
    Policy::parse(&text).map_err(|error| refused(&error.to_string()))
}

fn guard(store: Box<dyn Store>, history: &Verified) -> Result<Guard, Error> {
    let mut guard = Guard::new(policy()?, store, signing_key(LOG_KEY), history, BEGIN_MS);
    let token = credential()?.token(false, BEGIN_MS).map_err(|error| refused(&error.to_string()))?;
    guard.present(1, &token, BEGIN_MS).map_err(|error| refused(&error.to_string()))?;
    Ok(guard)
}

fn reading(number: usize, exists: bool) -> Request {
    Request { action: Action::Read, resource: Resource::new(Class::Recording, name(number, exists)) }
}

fn seconds_of<T>(work: impl FnOnce() -> T) -> f64 {
    let begin = Instant::now();
    black_box(work());
    begin.elapsed().as_secs_f64()
}

/// Rows about the times of decisions and tokens, and about the leak of existence.
pub(super) fn rows(is_quick: bool) -> Result<Vec<Row>, Error> {
    let (decisions, pairs) = if is_quick { (QUICK_DECISIONS, QUICK_PAIRS) } else { (DECISIONS, PAIRS) };
    let mut rows = latencies(decisions)?;
    let mut of_guard = guard(Box::new(Nowhere), &Verified::default())?;
    let mut now_ms = BEGIN_MS;
    let ours = times(pairs, |request| {
        // The next entry of the log, and none that counts repeats.
        now_ms += 20;
        of_guard.decide(1, request, now_ms)
    });
    rows.push(leak(OURS, &ours, Limit::AtMost(LEAK_T))?);
    // Positive control of the test: a guard that looks the item up first, and denies at once where there is none.
    let mut of_guard = guard(Box::new(Nowhere), &Verified::default())?;
    let known: Vec<String> = (0..NAMES).map(|number| reading(number, true).resource.to_string()).collect();
    let mut now_ms = BEGIN_MS;
    let early = times(pairs, |request| {
        now_ms += 20;
        let name = request.resource.to_string();
        known.contains(&name).then(|| of_guard.decide(1, request, now_ms))
    });
    rows.push(leak("baseline:early-end", &early, Limit::AtLeast(LEAK_T))?);
    Ok(rows)
}

/// 99 % quantiles of a decision and of a presented token, with the log in files.
fn latencies(decisions: usize) -> Result<Vec<Row>, Error> {
    let folder = Folder(std::env::temp_dir().join(format!("r4-access-{}", process::id())));
    let failed = |source| Error::File { path: folder.0.clone(), source };
    std::fs::create_dir_all(&folder.0).map_err(failed)?;
    let opened = Files::open(&folder.0.join("log")).map_err(|error| refused(&error.to_string()))?;
    let mut guard = guard(Box::new(opened.files), &opened.verified)?;
    let set = |number: usize| Request {
        action: Action::Set,
        resource: Resource::new(Class::Channel, format!("osmc{}", number % NAMES)),
    };
    let mut now_ms = BEGIN_MS;
    let mut decided = Vec::new();
    for number in 0..decisions {
        // Each has an entry of its own: names come again after more than the time in which decisions share one.
        now_ms += 20;
        let request = set(number);
        decided.push(seconds_of(|| guard.decide(1, &request, now_ms)));
    }
    let mut presented = Vec::new();
    for _ in 0..decisions.min(200) {
        let token = credential()?.token(false, now_ms).map_err(|error| refused(&error.to_string()))?;
        presented.push(seconds_of(|| guard.present(1, &token, now_ms)));
    }
    if guard.has_failed() {
        return Err(refused("the log's folder"));
    }
    let row = |metric: &str, values: &[f64]| {
        let summary = Statistic::Quantile(0.99).of(values)?;
        Ok::<Row, Error>(Row::timed([NAME, OURS], [metric, "s"], values.len(), [0, 0], summary, Limit::AtMost(P99_S)))
    };
    Ok(vec![row("decision_p99_s", &decided)?, row("token_p99_s", &presented)?])
}

/// Times of denials of recordings that exist and that do not, s, in a random order.
fn times<T>(pairs: usize, mut decide: impl FnMut(&Request) -> T) -> [Vec<f64>; 2] {
    let requests = [true, false].map(|exists| (0..NAMES).map(|number| reading(number, exists)).collect::<Vec<_>>());
    let mut sampler = Sampler::new(1, 4);
    let mut times = [Vec::new(), Vec::new()];
    for number in 0..2 * pairs {
        // A random order: neither class follows the other in a pattern that caches or clocks could learn.
        let class = usize::from(sampler.uniform(0.0, 1.0) < 0.5);
        let request = &requests[class][number % NAMES];
        times[class].push(seconds_of(|| decide(request)));
    }
    times
}

/// Row of Welch's t between both classes.
fn leak(arm: &str, [exists, none]: &[Vec<f64>; 2], target: Limit) -> Result<Row, Error> {
    let all: Vec<f64> = exists.iter().chain(none).copied().collect();
    let longest = quantile(&all, CROPPED, QuantileRule::Linear)?;
    let cropped = |times: &[f64]| times.iter().copied().filter(|time| *time <= longest).collect::<Vec<f64>>();
    let test = welch_t(&cropped(exists), &cropped(none), Alternative::TwoSided)?;
    let t = test.t.abs();
    // At these sizes t has the standard deviation 1.
    let interval = Interval { low: (t - 1.96).max(0.0), high: t + 1.96 };
    let summary = Summary { value: t, interval, method: "Welch's t of times cropped at 99 %, 95 %" };
    Ok(Row::timed([NAME, arm], ["timing_leak_t", "1"], all.len(), [0, 0], summary, target))
}
