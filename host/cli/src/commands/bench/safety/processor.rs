//! Events in the processor itself, on the exact ELF file: hangs, faults, crystal, supply.
//!
//! For each injection a fresh board is powered up, outputs of every kind move, the running program is broken, and the
//! outputs are observed from outside. The behaviour of the next start matters: chips on the bus keep their settings
//! over a reset of the processor.

use std::{
    cell::{Cell, RefCell},
    convert::Infallible,
    fmt,
    future::poll_fn,
    rc::Rc,
    sync::Mutex,
    task::Poll,
};

use anyhow::{Context, anyhow, bail};
use futures::future::{Either, select};
use r4_boards::Robot;
use r4_emu::{
    EmuBoard, Image, Settings,
    fault::{Fault, Lasting},
};
use r4_protocol::{ChannelKind, Mode, config::BoardConfig};
use r4_sim::{
    Pace, Simulation, VirtualBoard,
    stop::{Outputs, RunOut, StopWatch},
};
use r4_thumb::ThumbCore;
use rand_pcg::{Pcg64, rand_core::Rng};

use super::{
    Bench, CONFIGURED, Limit, Line, MS, Moving, POWER_UP_MS, PROMISED, RETARGET_MS, Report, Row, WRITTEN_MS,
    check_moving,
    report::digits,
    run_out::{self, Group, GroupRan, RUN_OUT_NS, groups},
    side_by_side,
};
use crate::{
    args::{self, Args},
    commands::bench::with_every_output,
    output,
    session::Target,
};
use r4_rig::Rig;

/// Default number of injections of each event.
const INJECTIONS: u32 = 4;
/// Longest time from power-on until the board answers a host, ms: clocks, and setting up the chips.
const BOOT_MS: u64 = 100;
/// Least time for which all outputs move before an injection, ns, and the random time added to it.
const MOVING_NS: u64 = 100 * MS;
const MOVING_SPREAD_NS: u64 = 20 * MS;
/// Polling period of the outputs, ns.
const LOOK_NS: u64 = 20_000;
/// Time for which outputs must stay safe, ns: longer than a start, at whose end the tasks begin.
const QUIET_NS: u64 = 150 * MS;
/// Observation time of a reset loop, ns: three starts, each ended by the boot's watchdog after at most 512 ms.
const LOOP_NS: u64 = 2_000 * MS;
/// Time after which an output that is not safe counts as never safe, ns.
const PATIENCE_NS: u64 = 1_000 * MS;

/// End of the watchdog's window, and the supervisor's period, by which a hang is detected, ms (docs/safety.md).
const WATCHDOG_MS: f64 = 13.0;
const SUPERVISOR_MS: f64 = 1.0;
/// Longest boot before its watchdog resets the processor, ms (docs/safety.md).
const BOOT_WATCHDOG_MS: f64 = 256.0;
/// Time from a reset until the sweep has written the safe state to all chips, ms (docs/safety.md): clearing 100 KB of
/// memory, and 1.5 ms of transfers at 400 kHz.
const SWEPT_MS: f64 = 5.0;
/// Time from a fault that the control task executes in its next period to the handler's stop lines and its reset, ms.
const FAULT_MS: f64 = 2.0;
/// Time from detection by the chip's clock and supply detectors to the stop lines, ms: an interrupt of a few
/// microseconds, with a margin for other compilers.
const DETECTED_MS: f64 = 0.1;
/// Dips of the 3.3 V rail: below the voltage detector (2.75 V) but above the brown-out level set by docs/bring-up.md
/// (2.7 V); below that level; and below the chip's level without it (1.6 V).
const SAG_V: f64 = 2.72;
const BROWN_OUT_V: f64 = 2.5;
const COLLAPSE_V: f64 = 1.5;
/// Duration of a dip, ms.
const DIP_MS: f64 = 2.0;
/// Option bytes (OPTSR, RM0399 4.9.6) as the Giga is delivered, with BOR_LEV 3.
const OPTION_BYTES: u32 = 0x0B86_AAFC;

/// Event in the processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Case {
    SupervisorHangs,
    SupervisorHangsMasked,
    TimeDriverHangs,
    Panic,
    HardFault,
    StackOverflow,
    ResetLoop,
    CrystalMissing,
    CrystalStops,
    SupplySags,
    BrownOut,
    SupplyCollapses,
}

const CASES: [Case; 12] = [
    Case::SupervisorHangs,
    Case::SupervisorHangsMasked,
    Case::TimeDriverHangs,
    Case::Panic,
    Case::HardFault,
    Case::StackOverflow,
    Case::ResetLoop,
    Case::CrystalMissing,
    Case::CrystalStops,
    Case::SupplySags,
    Case::BrownOut,
    Case::SupplyCollapses,
];

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SupervisorHangs => f.write_str("supervisor hangs"),
            Self::SupervisorHangsMasked => f.write_str("supervisor hangs, interrupts masked"),
            Self::TimeDriverHangs => f.write_str("clock of the tasks hangs"),
            Self::Panic => f.write_str("panic"),
            Self::HardFault => f.write_str("hard fault: undefined instruction"),
            Self::StackOverflow => f.write_str("stack overflow"),
            Self::ResetLoop => f.write_str("reset loop: supervisor hangs at every start"),
            Self::CrystalMissing => f.write_str("supervisor hangs, crystal missing at the start"),
            Self::CrystalStops => f.write_str("crystal stops"),
            Self::SupplySags => write!(f, "3.3 V sag to {SAG_V} V for {DIP_MS} ms"),
            Self::BrownOut => write!(f, "brown-out: {BROWN_OUT_V} V for {DIP_MS} ms, level set"),
            Self::SupplyCollapses => write!(f, "brown-out: {COLLAPSE_V} V for {DIP_MS} ms, level not set"),
        }
    }
}

impl Case {
    /// Prepares the board before its first instruction.
    fn prepare(self, board: &EmuBoard<ThumbCore>) {
        if self == Self::BrownOut {
            board.machine().chip.set_option_bytes(OPTION_BYTES);
        }
    }

    /// Lowest voltage of the 3.3 V rail; `None` for events without a dip.
    const fn dips_to_v(self) -> Option<f64> {
        match self {
            Self::SupplySags => Some(SAG_V),
            Self::BrownOut => Some(BROWN_OUT_V),
            Self::SupplyCollapses => Some(COLLAPSE_V),
            _ => None,
        }
    }

    fn inject(self, board: &EmuBoard<ThumbCore>, now_ns: u64) -> anyhow::Result<()> {
        if let Some(volts) = self.dips_to_v() {
            board.dip_supply(now_ns, volts, (DIP_MS * 1e6) as u64);
            return Ok(());
        }
        let (fault, lasting) = match self {
            Self::SupervisorHangs => (Fault::SupervisorHangs, Lasting::UntilReset),
            Self::SupervisorHangsMasked => (Fault::SupervisorHangsMasked, Lasting::UntilReset),
            Self::TimeDriverHangs => (Fault::TimeDriverHangs, Lasting::UntilReset),
            Self::Panic => (Fault::Panic, Lasting::UntilReset),
            Self::HardFault => (Fault::UndefinedInstruction, Lasting::UntilReset),
            Self::StackOverflow => (Fault::StackOverflow, Lasting::UntilReset),
            Self::ResetLoop => (Fault::SupervisorHangs, Lasting::Always),
            Self::CrystalMissing => {
                board.lose_crystal_at_reset();
                (Fault::SupervisorHangs, Lasting::UntilReset)
            }
            // The other three events are dips, handled above.
            Self::CrystalStops | Self::SupplySags | Self::BrownOut | Self::SupplyCollapses => {
                board.stop_crystal_at(now_ns);
                return Ok(());
            }
        };
        board.inject(fault, lasting)?;
        Ok(())
    }

    /// Longest time from the event until the processor is reset or drives its stop lines, ms, with its origin.
    const fn stopped_ms(self) -> (f64, &'static str) {
        match self {
            Self::SupervisorHangs
            | Self::SupervisorHangsMasked
            | Self::TimeDriverHangs
            | Self::ResetLoop
            | Self::CrystalMissing => (SUPERVISOR_MS + WATCHDOG_MS, "watchdog's window"),
            Self::Panic | Self::HardFault | Self::StackOverflow => (FAULT_MS, "next control period, fault handler"),
            Self::CrystalStops => (DETECTED_MS, "clock security system"),
            Self::SupplySags => (DETECTED_MS, "voltage detector"),
            Self::BrownOut | Self::SupplyCollapses => (DETECTED_MS, "brown-out reset"),
        }
    }

    /// Limit from the event until `outputs` are safe.
    fn limit(self, outputs: Outputs, config: &BoardConfig) -> Limit {
        let (stopped_ms, stopped_by) = self.stopped_ms();
        // Two polls detect an output that no longer changes.
        let look_ms = 2.0 * LOOK_NS as f64 * 1e-6;
        match outputs {
            // In reset the processor's lines float, the carrier's resistors hold the bridges off, and its timers stop.
            Outputs::Bridges => Limit { ms: stopped_ms + look_ms, from: stopped_by },
            Outputs::Steppers if self != Self::SupplySags => Limit { ms: stopped_ms + look_ms, from: stopped_by },
            // The processor keeps running and stops as for any other cause.
            Outputs::MotorPower if self == Self::SupplySags => Limit { ms: stopped_ms + 1.0, from: PROMISED },
            Outputs::BridgeChips | Outputs::Bldcs if self == Self::SupplySags => {
                Limit { ms: stopped_ms + WRITTEN_MS, from: PROMISED }
            }
            Outputs::Steppers | Outputs::Servos | Outputs::Dacs if self == Self::SupplySags => {
                let period_ms = f64::from(config.control_period_us) / 1000.0;
                Limit { ms: stopped_ms + period_ms + look_ms, from: CONFIGURED }
            }
            // Each reset takes the processor's own outputs to 0 V until the sweep, here that of the third bad start.
            Outputs::Dacs if self == Self::ResetLoop => {
                let starts_ms = 2.0 * (BOOT_WATCHDOG_MS + stopped_ms);
                Limit { ms: stopped_ms + starts_ms + SWEPT_MS, from: "sweep of the third bad start" }
            }
            _ => {
                let dip_ms = if self.dips_to_v().is_some() { DIP_MS } else { 0.0 };
                Limit { ms: stopped_ms + dip_ms + SWEPT_MS, from: "sweep of the next start" }
            }
        }
    }
}

/// Result of one event.
#[derive(Clone, Debug, Default)]
struct Measured {
    injections: u32,
    /// Longest time by kind of output, ms; infinite if the output did not become safe.
    max_ms: [f64; Outputs::ALL.len()],
    groups: Vec<GroupRan>,
}

impl Measured {
    fn merge(&mut self, other: &Self) {
        self.injections += other.injections;
        self.max_ms.iter_mut().zip(other.max_ms).for_each(|(max, ms)| *max = max.max(ms));
        run_out::merge(&mut self.groups, &other.groups);
    }
}

pub(crate) fn run(args: &Args, asked: &args::Safety) -> anyhow::Result<bool> {
    let name = args.board.robot()?;
    let robot = with_every_output(name, "emu")?;
    let image = Image::find(name)?;
    let measured =
        measure(&robot, &image, args.seed, &CASES, asked.injections.unwrap_or(INJECTIONS), true, |_| Ok(()))?;
    let groups = groups(&robot);
    let report = report(args.board.to_string(), args.seed, &measured, &robot, &groups);
    if args.json {
        output::json(&report)?;
    } else {
        let line =
            |(case, of): &(Case, Measured)| Line { cause: case.to_string(), injections: of.injections, brakes: false };
        let lines: Vec<_> = measured.iter().map(line).collect();
        output::line(format_args!(
            "Longest time until outputs are safe / its limit, ms; {} (simulated), ELF with SHA-256 {}, {} injections, seed {}",
            report.board,
            image.digest(),
            report.injections,
            report.seed
        ))?;
        report.print_outputs(&lines, asked.markdown)?;
        output::line("*  guaranteed; the other limits follow from:")?;
        let mut said = Vec::new();
        for (stopped_ms, stopped_by) in CASES.map(Case::stopped_ms) {
            if !said.contains(&stopped_by) {
                said.push(stopped_by);
                output::line(format_args!("   {stopped_by}: {} ms", digits(stopped_ms)))?;
            }
        }
        output::line(format_args!("   what chips on the bus hold: the sweep of the next start, {SWEPT_MS} ms later"))?;
        output::line("times count from the injection, those of a dip too")?;
        report.print_plants(&lines, &groups, asked.markdown)?;
    }
    Ok(report.held())
}

fn report(board: String, seed: u64, measured: &[(Case, Measured)], robot: &Robot, groups: &[Group]) -> Report {
    let mut rows = Vec::new();
    for (case, of) in measured {
        for outputs in Outputs::ALL {
            let limit = case.limit(outputs, &robot.config);
            rows.push(Row::new(case, &outputs, of.max_ms[outputs as usize], limit, of.injections));
        }
        for (group, ran) in groups.iter().zip(&of.groups) {
            rows.push(Row::of_group(case, group, ran, case.limit(group.outputs(), &robot.config)));
        }
    }
    let injections = measured.iter().map(|(_, measured)| measured.injections).sum();
    Report { board, simulated: true, seed, injections, rows, out_of_reach: Vec::new() }
}

/// Measures `cases`, each after `prepare`, on as many boards in parallel as there are processors. The result depends on
/// the seed alone.
fn measure(
    robot: &Robot,
    image: &Image,
    seed: u64,
    cases: &[Case],
    injections: u32,
    run_out: bool,
    prepare: impl Fn(&EmuBoard<ThumbCore>) -> anyhow::Result<()> + Sync,
) -> anyhow::Result<Vec<(Case, Measured)>> {
    let jobs: Vec<_> = (0..cases.len()).flat_map(|place| (0..injections).map(move |number| (place, number))).collect();
    let results = Mutex::new(vec![Measured::default(); cases.len()]);
    side_by_side(&jobs, jobs.len() as u64, |job, (place, number), progress| {
        let case = cases[*place];
        progress.set_message(case.to_string());
        // The first injection of each event is followed until rest, if `run_out` asks for it.
        let once = inject_once(robot, image, seed.wrapping_add(job), case, run_out && *number == 0, &prepare);
        let once = once.with_context(|| format!("{case}, seed {seed}, injection {number}"))?;
        // The lock cannot be poisoned: nothing panics while holding it.
        results.lock().unwrap_or_else(std::sync::PoisonError::into_inner)[*place].merge(&once);
        progress.inc(1);
        Ok(())
    })?;
    let results = results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    Ok(cases.iter().copied().zip(results).collect())
}

/// Runs one board from power-on until all outputs are safe, and with `run_out` until all plants are at rest.
fn inject_once(
    robot: &Robot,
    image: &Image,
    seed: u64,
    case: Case,
    run_out: bool,
    prepare: impl Fn(&EmuBoard<ThumbCore>) -> anyhow::Result<()>,
) -> anyhow::Result<Measured> {
    let mut simulation = Simulation::new(Pace::Free);
    let core = ThumbCore::new();
    let board = Rc::new(EmuBoard::start(&mut simulation, robot, seed, image, core, None, Settings::default())?);
    case.prepare(&board);
    prepare(&board)?;
    let (clock, rig) = (simulation.clock(), Rig::new(Target::Emu(robot.file.clone())));
    let moving_ns = MOVING_NS + Pcg64::new(seed.into(), 1).next_u64() % MOVING_SPREAD_NS;
    let ready: RefCell<Option<anyhow::Result<()>>> = RefCell::new(None);
    // Keep the host running after the injection: a silent host would stop a board that noticed nothing else.
    let mut session = Box::pin(rig.attached(board.clone(), &clock, async |session| -> anyhow::Result<Infallible> {
        let bench = Bench::of(session, clock.clone())?;
        ready.replace(Some(set_in_motion(&bench, moving_ns).await));
        loop {
            bench.sleep_ms(RETARGET_MS).await;
            // The board refuses it once it has tripped.
            let _ = Moving::TwoOfEach.retarget_servos(&bench).await;
        }
    }));
    let moving = poll_fn(|context| match session.as_mut().poll(context) {
        Poll::Ready(ended) => Poll::Ready(Err(match ended {
            Ok(never) => match never {},
            Err(error) => error.context("no session"),
        })),
        Poll::Pending => ready.borrow_mut().take().map_or(Poll::Pending, Poll::Ready),
    });
    let failed = || board.failure().map(|failure| anyhow!("the emulated board stopped: {failure}"));
    let moving = simulation.block_on(moving);
    if let Some(failure) = failed() {
        return Err(failure);
    }
    moving.ok_or_else(|| anyhow!("the simulation came to a standstill"))??;

    let measured = Cell::new(None);
    let watched = async {
        let at_ns = clock.now_ns();
        case.inject(&board, at_ns)?;
        let (mut watch, mut plants) = (StopWatch::new(&board), RunOut::new(&board));
        let is_quiet = |watch: &StopWatch, now_ns: u64| {
            let safe = |outputs| watch.safe_since_ns(outputs).is_some_and(|safe_ns| now_ns >= safe_ns + QUIET_NS);
            Outputs::ALL.into_iter().all(safe)
        };
        // Outputs are safe between the starts of a reset loop: watch all three.
        let least_ns = if case == Case::ResetLoop { LOOP_NS } else { 0 };
        loop {
            clock.sleep(LOOK_NS).await;
            watch.look(&board);
            plants.look(&board);
            let now_ns = clock.now_ns();
            let enough = now_ns >= at_ns + least_ns && is_quiet(&watch, now_ns);
            if enough || now_ns >= at_ns + least_ns + PATIENCE_NS || board.failure().is_some() {
                break;
            }
        }
        let max_ms = Outputs::ALL.map(|outputs| run_out::ms(watch.safe_since_ns(outputs), at_ns));
        let mut groups = Vec::new();
        if run_out {
            while !plants.is_over(clock.now_ns()) && clock.now_ns() < at_ns + RUN_OUT_NS && board.failure().is_none() {
                clock.sleep(MS).await;
                plants.look(&board);
            }
            groups = run_out::by_group(robot, &plants.ran(&board, clock.now_ns()), at_ns);
        }
        measured.set(Some(Measured { injections: 1, max_ms, groups }));
        anyhow::Ok(())
    };
    let beside = async {
        match select(Box::pin(watched), session).await {
            Either::Left((result, _)) => result,
            // The driver gives up on a reset board; the observation goes on.
            Either::Right((_, watched)) => watched.await,
        }
    };
    let result = simulation.block_on(beside);
    if let Some(failure) = failed() {
        return Err(failure);
    }
    result.ok_or_else(|| anyhow!("the simulation came to a standstill"))??;
    measured.take().ok_or_else(|| anyhow!("nothing was measured"))
}

/// Waits for the board, arms it, and moves all outputs.
async fn set_in_motion(bench: &Bench<'_>, moving_ns: u64) -> anyhow::Result<()> {
    bench.sleep_ms(BOOT_MS).await;
    bench.host.arm().await?;
    bench.sleep_ms(POWER_UP_MS).await;
    let victim = bench.taking(ChannelKind::Osmc, Mode::Duty).next().map(|(id, _)| id);
    let Some(victim) = victim else { bail!("no OSMC") };
    Moving::TwoOfEach.begin(bench, victim, 1.0).await?;
    let retarget = async {
        loop {
            bench.sleep_ms(RETARGET_MS).await;
            let _ = Moving::TwoOfEach.retarget_servos(bench).await;
        }
    };
    let moving = async {
        bench.clock.sleep(moving_ns).await;
        check_moving(bench).await
    };
    match select(Box::pin(moving), Box::pin(retarget)).await {
        Either::Left((result, _)) => result,
        Either::Right((never, _)) => never,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROBOT: &str = "every-interface";

    fn report_of(cases: &[Case], prepare: impl Fn(&EmuBoard<ThumbCore>) -> anyhow::Result<()> + Sync) -> Report {
        let robot = r4_boards::load(ROBOT).unwrap();
        let image = Image::find(ROBOT).unwrap();
        let measured = measure(&robot, &image, 1, cases, 1, false, prepare).unwrap();
        report(format!("emu:{ROBOT}"), 1, &measured, &robot, &groups(&robot))
    }

    #[test]
    fn whatever_happens_to_the_processor_every_output_is_safe_in_time() {
        let report = report_of(&CASES, |_| Ok(()));
        assert_eq!(report.rows.len(), CASES.len() * Outputs::ALL.len());
        let over: Vec<_> = report.rows.iter().filter(|row| !row.held).collect();
        assert!(over.is_empty(), "{over:#?}");
    }

    /// Image without the start-up sweep: its tasks make outputs safe, but too late.
    #[test]
    fn an_image_without_the_sweep_misses_the_limits() {
        let report = report_of(&[Case::HardFault], |board| {
            board.inject(Fault::SweepLeftOut, Lasting::Always)?;
            Ok(())
        });
        let over: Vec<_> = report.rows.iter().filter(|row| !row.held).collect();
        assert!(!report.held() && over.len() == 4, "{over:#?}");
    }
}
