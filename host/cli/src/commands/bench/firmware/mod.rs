//! `r4 bench firmware`: processor load of the firmware's ELF file, and jitter of its control loop.
//!
//! The program is executed instruction by instruction, so that stack depths and instruction counts are those of the
//! hardware. Time is not: instructions take a set time, without caches and wait states. Jitter is what interrupts,
//! critical sections and priorities cause at that speed.

mod inputs;

use std::rc::Rc;

use anyhow::{anyhow, bail};
use indicatif::{ProgressBar, ProgressStyle};
use r4_emu::{
    EmuBoard, Settings,
    measure::{Share, Spread, Stack, instructions, jitter_us},
};
use r4_image::Image;
use r4_protocol::message::CONTROL_SHARE;
use r4_sim::{Pace, Simulation, VirtualBoard as _};
use r4_thumb::ThumbCore;
use rand_pcg::Pcg64;
use serde::Serialize;

use super::DEFAULT;
use crate::{args::Args, output, session::Target, table};
use inputs::{Requests, Tormentor};
use r4_rig::Rig;

/// Limit of the stack in use, as a share of the reserved stack.
const STACK_SHARE: f64 = 0.5;
/// Limit of the stack if every interrupt level preempted the one below at its deepest, as a share. The thread level
/// reaches its deepest point during start-up, before the others run.
const STACK_BOUND: f64 = 1.0;
/// Limit of the control period's deviation under load, µs, for 99.9 % of the periods.
const JITTER_P999_US: f64 = 20.0;
/// Core clock, Hz, for processor shares.
const CORE_HZ: f64 = 480e6;

/// Names of the rows about all executors together.
const TOGETHER: &str = "together, seen";
const AT_WORST: &str = "together, each level at its deepest";

#[derive(Serialize)]
struct StackRow {
    executor: String,
    /// Interrupt priority level, of 16; `null` for the thread and for all together.
    level: Option<u8>,
    /// Size of the stack, which all executors share, bytes.
    reserved: u32,
    used: u32,
    /// Number of entries; 0 where entries are not counted.
    entries: u64,
    /// Instructions per second of virtual time.
    instructions_per_s: f64,
    held: bool,
}

#[derive(Serialize)]
struct TickInstructions {
    median: f64,
    max: f64,
    p999: f64,
    /// Share of a core that executes one instruction per cycle at 480 MHz: median; the next field is the maximum.
    share_of_480mhz: f64,
    max_share_of_480mhz: f64,
}

#[derive(Serialize)]
struct Jitter {
    p50: f64,
    p999: f64,
    max: f64,
    periods: usize,
}

/// Traffic on the links while jitter was measured.
#[derive(Serialize)]
struct LoadRow {
    requests_per_s: f64,
    refused: u64,
    timed_out: u64,
    late_ticks: u32,
    telemetry_dropped: u32,
    trips: u32,
}

#[derive(Serialize)]
struct Limits {
    stack_share: f64,
    stack_bound: f64,
    /// Limit of the instructions of 99.9 % of the control ticks.
    tick_p999: f64,
    jitter_p999_us: f64,
}

#[derive(Serialize)]
struct Report {
    board: String,
    elf_sha256: String,
    seed: u64,
    seconds: f64,
    limits: Limits,
    stacks: Vec<StackRow>,
    control_tick_instructions: TickInstructions,
    jitter_us: Jitter,
    /// Instructions per virtual second under load.
    instructions_per_s: f64,
    /// Instruction rate of the emulated processor, a setting; at this rate of work it would never sleep.
    executes_per_s: u64,
    load: LoadRow,
    held: bool,
}

/// Measurements of one board.
struct Measured {
    stack: Stack,
    whole_s: f64,
    period_us: u32,
    instructions: Spread,
    jitter: Spread,
    periods: usize,
    instructions_per_s: f64,
    load: LoadRow,
}

pub(crate) fn run(args: &Args, seconds: f64) -> anyhow::Result<bool> {
    let target = match &args.board {
        Target::Emu(_) => args.board.clone(),
        Target::Sim(name) if name == DEFAULT => Target::Emu(name.clone()),
        Target::Sim(_) | Target::Link(_) => {
            bail!("this measures emulated boards only: omit --board, or write emu:{DEFAULT}")
        }
    };
    let image = Image::find(target.robot()?)?;
    let measured = measure(args.seed, target.robot()?, &image, seconds)?;
    let report = report(args, &target, &image, seconds, measured);
    if args.json {
        output::json(&report)?;
    } else {
        print(&report)?;
    }
    Ok(report.held)
}

/// Returns the 99.9 % quantile of instructions per control tick of an emulated robot, and its limit.
pub(crate) fn tick(seed: u64, robot: &str, seconds: f64) -> anyhow::Result<(f64, f64)> {
    let measured = measure(seed, robot, &Image::find(robot)?, seconds)?;
    Ok((measured.instructions.p999, tick_limit(measured.period_us)))
}

/// Limit of the instructions of a control tick: [`CONTROL_SHARE`] of a period at one instruction a cycle.
fn tick_limit(period_us: u32) -> f64 {
    (f64::from(CONTROL_SHARE) * f64::from(period_us) * 1e-6 * CORE_HZ).round()
}

fn measure(seed: u64, name: &str, image: &Image, seconds: f64) -> anyhow::Result<Measured> {
    let robot = r4_boards::load(name)?;
    let mut simulation = Simulation::new(Pace::Free);
    let core = ThumbCore::new();
    let board = Rc::new(EmuBoard::start(&mut simulation, &robot, seed, image, core, None, Settings::default())?);
    board.start_measuring()?;
    let (clock, rig) = (simulation.clock(), Rig::new(Target::Emu(name.to_owned())));
    let progress = ProgressBar::new_spinner();
    progress.set_style(ProgressStyle::with_template("{spinner} {msg}").unwrap_or(ProgressStyle::default_spinner()));
    progress.enable_steady_tick(std::time::Duration::from_millis(100));
    let session = rig.attached(board.clone(), &clock, async |session| {
        let host = session.board;
        let tormentor = Tormentor::new(host, &board, clock.clone());
        progress.set_message("everything at random");
        tormentor.mix(&mut Pcg64::new(seed.into(), 1), seconds).await?;
        tormentor.prepare_load().await?;
        let mut all = board.take_periods()?;
        // Discard the counters of the random phase: the report is about the load.
        tormentor.take_requests();
        let before = host.stats().await?;
        // Jitter is of the load phase only; instruction counts of a tick are of both phases.
        let (begin_ns, executed) = (clock.now_ns(), board.machine().instructions());
        progress.set_message("as much as links carry");
        tormentor.load(seconds).await?;
        let span_s = (clock.now_ns() - begin_ns) as f64 * 1e-9;
        let executed = board.machine().instructions() - executed;
        let under_load = board.take_periods()?;
        let Requests { answered, refused, timed_out } = tormentor.take_requests();
        let after = host.stats().await?;
        let jitter = jitter_us(&under_load, robot.config.control_period_us);
        let periods = under_load.len();
        all.extend(under_load);
        anyhow::Ok(Measured {
            stack: board.stack()?,
            whole_s: clock.now_ns() as f64 * 1e-9,
            period_us: robot.config.control_period_us,
            instructions: instructions(&all),
            jitter,
            periods,
            instructions_per_s: executed as f64 / span_s,
            load: LoadRow {
                requests_per_s: answered as f64 / span_s,
                refused,
                timed_out,
                late_ticks: after.late_ticks.wrapping_sub(before.late_ticks),
                telemetry_dropped: after.telemetry_dropped.wrapping_sub(before.telemetry_dropped),
                trips: tormentor.trips(),
            },
        })
    });
    let result = simulation.block_on(session);
    progress.finish_and_clear();
    if let Some(failure) = board.failure() {
        bail!("the emulated board stopped: {failure}");
    }
    result.ok_or_else(|| anyhow!("the simulation came to a standstill"))?
}

/// Report of the measurements with their limits.
fn report(args: &Args, target: &Target, image: &Image, seconds: f64, measured: Measured) -> Report {
    let Measured { stack, whole_s, period_us, instructions, jitter, periods, instructions_per_s, load } = measured;
    let Stack { reserved, used, bound, shares } = stack;
    let entries = shares.iter().map(|share| share.entries).sum();
    let all: u64 = shares.iter().map(|share| share.instructions).sum();
    let within = |used: u32, share: f64| f64::from(used) <= share * f64::from(reserved);
    let row = |Share { who, level, stack, instructions, entries }| StackRow {
        executor: who,
        level,
        reserved,
        used: stack,
        entries,
        instructions_per_s: instructions as f64 / whole_s,
        held: within(stack, STACK_SHARE),
    };
    let mut stacks: Vec<_> = shares.into_iter().map(row).collect();
    let together = |name: &str, used, share| StackRow {
        executor: name.into(),
        level: None,
        reserved,
        used,
        entries,
        instructions_per_s: all as f64 / whole_s,
        held: within(used, share),
    };
    // The measured depth must leave half of the stack free; the bound, which assumes the worst nesting, may use all of
    // it.
    stacks.push(together(TOGETHER, used, STACK_SHARE));
    stacks.push(together(AT_WORST, bound, STACK_BOUND));
    let limits = Limits {
        stack_share: STACK_SHARE,
        stack_bound: STACK_BOUND,
        tick_p999: tick_limit(period_us),
        jitter_p999_us: JITTER_P999_US,
    };
    let tick_held = instructions.p999 <= limits.tick_p999;
    let share = |instructions: f64| instructions * 1e6 / f64::from(period_us) / CORE_HZ;
    let stack_held = stacks.iter().all(|row| row.held);
    Report {
        board: target.to_string(),
        elf_sha256: image.digest(),
        seed: args.seed,
        seconds,
        limits,
        stacks,
        control_tick_instructions: TickInstructions {
            median: instructions.median,
            max: instructions.max,
            p999: instructions.p999,
            share_of_480mhz: share(instructions.median),
            max_share_of_480mhz: share(instructions.max),
        },
        jitter_us: Jitter { p50: jitter.median, p999: jitter.p999, max: jitter.max, periods },
        instructions_per_s,
        executes_per_s: Settings::default().instructions_per_second,
        load,
        // Without a period under load, the jitter would be within its limit without a measurement.
        held: stack_held && tick_held && jitter.p999 <= JITTER_P999_US && periods > 0,
    }
}

fn print(report: &Report) -> anyhow::Result<()> {
    let mut table = table::new(&["executor", "level", "stack", "of", "share", "entries", "instructions/s", ""], 1..7);
    for row in &report.stacks {
        let share = f64::from(row.used) / f64::from(row.reserved);
        table.add_row([
            row.executor.clone(),
            row.level.map_or_else(String::new, |level| level.to_string()),
            row.used.to_string(),
            row.reserved.to_string(),
            format!("{:.1} %", 100.0 * share),
            row.entries.to_string(),
            format!("{:.0}", row.instructions_per_s),
            verdict(row.held),
        ]);
    }
    output::line(format_args!("{}, ELF {}, seed {}", report.board, report.elf_sha256, report.seed))?;
    output::line("stack, bytes: one for all, deepest use of each, frame of what it interrupts included")?;
    output::line(table)?;

    let mut table = table::new(&["control tick", "median", "99.9 %", "max", "limit", ""], 1..5);
    let TickInstructions { median, p999, max, share_of_480mhz, max_share_of_480mhz } =
        &report.control_tick_instructions;
    table.add_row([
        "instructions".to_owned(),
        format!("{median:.0}"),
        format!("{p999:.0}"),
        format!("{max:.0}"),
        format!("99.9 % <= {:.0}", report.limits.tick_p999),
        verdict(*p999 <= report.limits.tick_p999),
    ]);
    table.add_row([
        "as a share of 480 MHz, one a cycle".to_owned(),
        format!("{:.2} %", 100.0 * share_of_480mhz),
        String::new(),
        format!("{:.2} %", 100.0 * max_share_of_480mhz),
        String::new(),
        String::new(),
    ]);
    let Jitter { p50, p999, max, periods } = &report.jitter_us;
    table.add_row([
        "jitter under load, us".to_owned(),
        format!("{p50:.2}"),
        format!("{p999:.2}"),
        format!("{max:.2}"),
        format!("99.9 % <= {:.0}", report.limits.jitter_p999_us),
        verdict(*p999 <= report.limits.jitter_p999_us),
    ]);
    output::line(table)?;
    let LoadRow { requests_per_s, refused, timed_out, late_ticks, telemetry_dropped, trips } = &report.load;
    output::line(format_args!(
        "load: {requests_per_s:.0} requests/s ({refused} refused, {timed_out} timed out), telemetry of every channel \
         each ms ({telemetry_dropped} frames dropped), CAN at full load, raw transfers; {periods} periods, \
         {late_ticks} late; {trips} trips"
    ))?;
    Ok(output::line(format_args!(
        "{:.1} million instructions/s executed under load; the processor is set to execute {:.0} million/s",
        report.instructions_per_s * 1e-6,
        report.executes_per_s as f64 * 1e-6
    ))?)
}

fn verdict(held: bool) -> String {
    if held { "ok".into() } else { "not met".into() }
}
