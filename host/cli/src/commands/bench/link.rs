//! `r4 bench link`: throughput, latency and clock accuracy of a link to a board, measured over that link in real time.
//!
//! A simulated or emulated board is served on a pseudo-terminal by `r4 sim serve` in another process: its bytes travel
//! as to any other program.

use std::{
    env,
    fmt::Display,
    fs,
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::Duration,
};

use anyhow::{Context, anyhow};
use r4_links::{
    Address, RealClock,
    measure::{self, Measured, Settings, Stamp, measure},
    monotonic_ns,
};
use serde::{Deserialize, Serialize};

use super::DEFAULT;
use crate::{
    args::{self, Args},
    output,
    session::{self, Target},
    table,
};

/// Robot with four motors, the number that a cycle carries.
const FOUR_MOTORS: &str = "openscout";
/// Limit of the bytes of a cycle, both frames together.
const BYTES: usize = 66;
/// Limit of the median round trip over a pseudo-terminal, µs.
const ROUND_TRIP_US: f64 = 100.0;
/// Least rate of cycles without loss, 1/s.
const CYCLES_PER_S: f64 = 10_000.0;
/// Limit of the clock mapping's error, µs, for 99 % of the answers.
const CLOCK_ERROR_US: f64 = 200.0;

#[derive(Serialize)]
struct Report {
    link: String,
    /// Most bytes of a cycle on the wire, both frames together.
    cycle_bytes: usize,
    rtt_us_p50: f64,
    rtt_us_p99: f64,
    rtt_us_p999: f64,
    rtt_us_max: f64,
    /// Number of sequential round trips.
    round_trips: usize,
    cycles_per_s: f64,
    /// Cycles answered with `window` in flight.
    cycles: u64,
    window: usize,
    seconds: f64,
    /// Lost cycles of both measurements.
    lost: u64,
    /// True if set points were followed; otherwise the board refused them, and answered too.
    armed: bool,
    /// Answers that report a set point as not followed.
    not_followed: u64,
    /// Error of each answer's time, mapped to the host's clock, against the true time, µs; `None` where only the board
    /// knows the true time.
    clock_error_us_p99: Option<f64>,
    /// Largest uncertainty of the clock mapping that the driver reported, µs.
    clock_uncertainty_us: f64,
    /// Number of pauses of a served board's time because the machine was busy.
    clock_shifts: usize,
    machine: String,
    processors: usize,
    kernel: String,
    limits: Vec<Limit>,
    held: bool,
}

/// Measured value beside its limit.
#[derive(Serialize)]
struct Limit {
    what: &'static str,
    measured: String,
    promised: String,
    held: bool,
}

impl Limit {
    fn new(what: &'static str, measured: impl Display, promised: impl Display, held: bool) -> Self {
        Self { what, measured: measured.to_string(), promised: promised.to_string(), held }
    }
}

pub(super) fn run(args: &Args, bench: &args::BenchLink) -> anyhow::Result<bool> {
    session::catch_interrupts();
    let mut served = None;
    let (link, address) = match &args.board {
        Target::Link(address) => (address.to_string(), address.clone()),
        Target::Sim(name) | Target::Emu(name) => {
            let name = if name == DEFAULT { FOUR_MOTORS } else { name };
            let target = args.board.with_robot(name)?;
            let server = Served::start(&target, args.seed)?;
            let address = server.address.clone();
            served = Some(server);
            (format!("{target} over a pseudo-terminal"), address)
        }
    };
    // Do not arm a board on another link: a connected machine might move.
    let arm = bench.arm || served.is_some();
    let span = Duration::from_secs_f64(bench.seconds);
    let settings = Settings { span, window: bench.window, arm, is_interrupted: &session::is_interrupted };
    let key = session::key(args)?;
    let measured = r4_links::block_on(async {
        let link = r4_links::open(&address, key.as_ref()).await?;
        match measure(link, &settings).await {
            Err(measure::Error::Interrupted) => Err(session::Interrupted.into()),
            measured => measured.with_context(|| address.to_string()),
        }
    })?;
    // An emulated board's clock starts with its firmware, at a time unknown outside.
    let epochs = served.as_ref().filter(|_| matches!(args.board, Target::Sim(_))).map(|served| served.epochs());
    let report = report(measured, link, bench.window, epochs.as_deref());
    let held = report.held;
    if args.json {
        output::json(&report)?;
    } else {
        print(&report)?;
    }
    Ok(held)
}

/// Line of `r4 sim serve`: the first names the pseudo-terminal, later ones a changed epoch and its beginning.
#[derive(Deserialize)]
struct Line {
    pty: Option<String>,
    epoch_ns: u64,
    #[serde(default)]
    from_ns: u64,
}

/// Epoch of the board's clock: from `from_us` of that clock on, its time 0 was at `epoch_ns` of CLOCK_MONOTONIC.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Epoch {
    from_us: u64,
    epoch_ns: u64,
}

impl Epoch {
    fn of(line: &Line) -> Self {
        Self { from_us: line.from_ns / 1000, epoch_ns: line.epoch_ns }
    }
}

/// Board that another process serves until this value is dropped.
struct Served {
    child: Child,
    address: Address,
    epochs: Arc<Mutex<Vec<Epoch>>>,
}

impl Served {
    fn start(board: &Target, seed: u64) -> anyhow::Result<Self> {
        let name = match board {
            Target::Sim(name) => name.clone(),
            Target::Emu(_) | Target::Link(_) => board.to_string(),
        };
        let program = env::current_exe().context("cannot find this program to serve the board")?;
        let mut child = Command::new(program)
            .args(["sim", "serve", &name, "--pty", "--seed", &seed.to_string()])
            // The server must not use the board and the flash of this command.
            .env_remove("R4_BOARD")
            .env_remove("R4_FLASH")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .spawn()
            .context("cannot start `r4 sim serve`")?;
        let out = child.stdout.take();
        // From here on, dropping the value ends the server.
        let address = Address::Serial { path: None, baud: r4_links::DEFAULT_BAUD };
        let mut served = Self { child, address, epochs: Arc::default() };
        let mut lines = BufReader::new(out.context("no pipe to the server")?).lines();
        let first = lines.next().ok_or_else(|| anyhow!("`r4 sim serve {name}` ended at once"))??;
        let line: Line = serde_json::from_str(&first)
            .with_context(|| format!("unexpected first line of `r4 sim serve`: {first}"))?;
        let path = line.pty.as_ref().ok_or_else(|| anyhow!("`r4 sim serve` names no pseudo-terminal: {first}"))?;
        served.address = Address::Serial { path: Some(path.into()), baud: r4_links::DEFAULT_BAUD };
        let epochs = served.epochs.clone();
        lock(&epochs).push(Epoch::of(&line));
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                if let Ok(line) = serde_json::from_str(&line) {
                    lock(&epochs).push(Epoch::of(&line));
                }
            }
        });
        Ok(served)
    }

    fn epochs(&self) -> Vec<Epoch> {
        lock(&self.epochs).clone()
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Drop for Served {
    fn drop(&mut self) {
        // The process may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Report of a measurement beside its limits.
fn report(mut measured: Measured, link: String, window: usize, epochs: Option<&[Epoch]>) -> Report {
    measured.round_trips.sort_by(f64::total_cmp);
    let round_trip = |share| quantile(&measured.round_trips, share);
    let [p50, p99, p999, max] = [0.5, 0.99, 0.999, 1.0].map(round_trip);
    let cycles_per_s = measured.cycles as f64 / measured.seconds.max(1e-9);
    let clock_error = epochs.map(|epochs| {
        let mut errors: Vec<f64> = measured.stamps.iter().map(|stamp| error_us(*stamp, epochs)).collect();
        errors.sort_by(f64::total_cmp);
        quantile(&errors, 0.99)
    });
    let uncertainty = measured.clock_uncertainty_us;
    let clock = match clock_error {
        Some(error) => Limit::new(
            "clock error, p99",
            format!("{error:.0} us"),
            format!("<= {CLOCK_ERROR_US} us"),
            error <= CLOCK_ERROR_US,
        ),
        None => Limit::new(
            "clock error, as the driver thinks",
            format!("{uncertainty:.0} us"),
            format!("<= {CLOCK_ERROR_US} us"),
            uncertainty <= CLOCK_ERROR_US,
        ),
    };
    let limits = vec![
        Limit::new(
            "bytes of a cycle",
            measured.cycle_bytes,
            format!("<= {BYTES}"),
            (1..=BYTES).contains(&measured.cycle_bytes),
        ),
        Limit::new("round trip, p50", format!("{p50:.1} us"), format!("<= {ROUND_TRIP_US} us"), p50 <= ROUND_TRIP_US),
        Limit::new(
            "cycles a second",
            format!("{cycles_per_s:.0}"),
            format!(">= {CYCLES_PER_S}"),
            cycles_per_s >= CYCLES_PER_S,
        ),
        Limit::new("lost", measured.lost, 0, measured.lost == 0),
        clock,
    ];
    Report {
        link,
        cycle_bytes: measured.cycle_bytes,
        rtt_us_p50: p50,
        rtt_us_p99: p99,
        rtt_us_p999: p999,
        rtt_us_max: max,
        round_trips: measured.round_trips.len(),
        cycles_per_s,
        cycles: measured.cycles,
        window,
        seconds: measured.seconds,
        lost: measured.lost,
        armed: measured.armed,
        not_followed: measured.not_followed,
        clock_error_us_p99: clock_error,
        clock_uncertainty_us: uncertainty,
        clock_shifts: epochs.map_or(0, |epochs| epochs.len() - 1),
        machine: machine(),
        processors: thread::available_parallelism().map_or(1, Into::into),
        kernel: read("/proc/sys/kernel/osrelease"),
        held: limits.iter().all(|limit| limit.held),
        limits,
    }
}

/// Error of the mapped time of an answer against its true time, µs; infinite before the first epoch.
fn error_us(stamp: Stamp, epochs: &[Epoch]) -> f64 {
    let Some(epoch) = epochs.iter().rfind(|epoch| epoch.from_us <= stamp.device_us) else { return f64::INFINITY };
    let true_ns = epoch.epoch_ns + stamp.device_us * 1000;
    let told_ns = monotonic_ns(RealClock.instant(stamp.host_us));
    (told_ns as f64 - true_ns as f64).abs() * 1e-3
}

/// Quantile of sorted numbers; NaN of none.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    r4_maths::statistics::nearest_rank(sorted, share).unwrap_or(f64::NAN)
}

fn read(path: &str) -> String {
    fs::read_to_string(path).map_or_else(|_| "unknown".into(), |text| text.trim().to_owned())
}

/// Name of the processor.
fn machine() -> String {
    let told = read("/proc/cpuinfo");
    let name = told.lines().find_map(|line| line.strip_prefix("model name")?.split_once(':'));
    name.map_or_else(|| env::consts::ARCH.into(), |(_, name)| name.trim().to_owned())
}

fn print(report: &Report) -> anyhow::Result<()> {
    output::line(format_args!("{}, {}", report.link, if report.armed { "armed" } else { "disarmed" }))?;
    output::line(format_args!("{}, {} processors, Linux {}", report.machine, report.processors, report.kernel))?;
    let mut table = table::new(&["what", "measured", "limit", ""], 1..3);
    for limit in &report.limits {
        let verdict = if limit.held { "ok" } else { "not met" };
        table.add_row([limit.what, &limit.measured, &limit.promised, verdict]);
    }
    output::line(table)?;
    output::line(format_args!(
        "{} round trips, one after the other: p99 {:.1} us, p99.9 {:.1} us, longest {:.1} us",
        report.round_trips, report.rtt_us_p99, report.rtt_us_p999, report.rtt_us_max
    ))?;
    output::line(format_args!(
        "{} cycles in {:.1} s, {} in flight; set points not followed: {}",
        report.cycles, report.seconds, report.window, report.not_followed
    ))?;
    if report.clock_shifts > 0 {
        output::line(format_args!("the machine was busy: the board's time paused {} times", report.clock_shifts))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_of_what_was_measured() {
        let sorted: Vec<f64> = (1..=1000).map(f64::from).collect();
        let of = |share| quantile(&sorted, share);
        assert_eq!([of(0.5), of(0.99), of(0.999), of(1.0)], [500.0, 990.0, 999.0, 1000.0]);
        assert_eq!(quantile(&[7.0], 0.5), 7.0);
        assert!(quantile(&[], 0.5).is_nan());
    }

    #[test]
    fn an_error_is_told_by_the_epoch_of_its_time() {
        let host_us = 1_000_000;
        let zero_ns = monotonic_ns(RealClock.instant(0));
        // The board started 0.4 s after our clock, and its time stood still for 5 ms before 0.5 s of its clock.
        let epochs = [
            Epoch { from_us: 0, epoch_ns: zero_ns + 400_000_000 },
            Epoch { from_us: 500_000, epoch_ns: zero_ns + 405_000_000 },
        ];
        let error = |device_us| error_us(Stamp { device_us, host_us }, &epochs);
        // This thread may have been preempted between the two readings of the clock.
        assert!(error(595_000) < 100_000.0, "{}", error(595_000));
        assert!((error(495_000) - error(595_000)).abs() > 50_000.0);
        assert_eq!(error_us(Stamp { device_us: 1, host_us }, &epochs[1..]), f64::INFINITY);
    }
}
