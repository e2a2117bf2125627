//! `r4 bench sim`: speed of virtual boards on one core relative to real time, and their memory.

use std::{fs, rc::Rc};

use anyhow::{Context, anyhow, bail};
use futures::future::join_all;
use r4_boards::Robot;
use r4_driver::Board;
use r4_protocol::{Mode, Range, SafetyState, Setpoint};
use r4_rig::Rig;
use r4_sim::{Pace, SimBoard, Simulation, VirtualBoard};
use serde::Serialize;

use crate::{
    args::Args,
    emulated, output,
    session::{HostClock, Target},
    table,
};

/// Robots to measure: a bench of two motors, and a vehicle with four driven wheels.
const BENCH: &str = "osmc-bench";
const FOUR_WHEELS: &str = "openscout";
/// Least real-time factor of a simulated board with four wheels, firmware and physics, on one core.
const SIM_FACTOR: f64 = 200.0;
/// Least real-time factor of an emulated board on one core.
const EMU_FACTOR: f64 = 5.0;
/// Limit of the memory of a simulated board, MiB (2 MB).
const MEMORY_MIB: f64 = 2e6 / 1024.0 / 1024.0;
/// Numbers of boards in one process.
const FLEET: [usize; 3] = [1, 10, 100];
/// Period of new set points for all outputs, s.
const COMMAND_S: f64 = 0.1;
/// Telemetry period of all channels, ms.
const TELEMETRY_MS: u16 = 10;
/// Time from arming until outputs follow, s.
const POWER_UP_S: f64 = 0.1;
/// Least processor time of a measurement, s, so that start-up and noise do not dominate.
const LONG_ENOUGH_S: f64 = 2.0;
/// Virtual time of one round, s.
const ROUND_S: f64 = 0.5;

#[derive(Serialize)]
struct Row {
    what: String,
    robots: usize,
    /// Control period, s: the step of firmware and world.
    step_s: f64,
    /// Virtual seconds of each board per second of processor time.
    real_time_factor: f64,
    /// Sum of the real-time factors of all boards.
    boards_real_time_factor: f64,
    /// Memory per board with its host's session, MiB, without the program itself.
    memory_mib: f64,
    limits: Vec<Limit>,
    held: bool,
}

/// Limit of a row.
#[derive(Serialize)]
struct Limit {
    what: &'static str,
    limit: f64,
    held: bool,
}

#[derive(Serialize)]
struct Report {
    rows: Vec<Row>,
    held: bool,
}

pub(super) fn run(args: &Args) -> anyhow::Result<bool> {
    let mut rows = Vec::new();
    for robot in [BENCH, FOUR_WHEELS] {
        for boards in FLEET {
            rows.push(simulated(args.seed, robot, boards)?);
        }
    }
    for robot in [BENCH, FOUR_WHEELS] {
        rows.extend(with_image(args.seed, robot)?);
    }
    let held = rows.iter().all(|row| row.held);
    let report = Report { rows, held };
    if args.json {
        output::json(&report)?;
    } else {
        print(&report)?;
    }
    Ok(held)
}

fn simulated(seed: u64, name: &str, boards: usize) -> anyhow::Result<Row> {
    let robot = r4_boards::load(name)?;
    let start = |simulation: &mut Simulation, number: usize| -> anyhow::Result<Rc<dyn VirtualBoard>> {
        Ok(Rc::new(SimBoard::start(simulation, &robot, seed.wrapping_add(number as u64))?))
    };
    let Measured { factor, memory_mib } = measure(Target::Sim(name.to_owned()), boards, start)?;
    let mut limits = Vec::new();
    if name == FOUR_WHEELS && boards == 1 {
        limits.push(Limit { what: "x real time, at least", limit: SIM_FACTOR, held: factor >= SIM_FACTOR });
    }
    // The memory of a single board is within the noise of the allocator.
    if boards == FLEET[FLEET.len() - 1] {
        limits.push(Limit { what: "MiB a board, at most", limit: MEMORY_MIB, held: memory_mib <= MEMORY_MIB });
    }
    Ok(row(format!("sim:{name}"), &robot, boards, factor, memory_mib, limits))
}

/// Row of an emulated board; `None` without an image for the robot.
fn with_image(seed: u64, name: &str) -> anyhow::Result<Option<Row>> {
    let image = match emulated::image(name) {
        Ok(image) => image,
        Err(error) => {
            eprintln!("r4: emu:{name} is skipped: {error:#}");
            return Ok(None);
        }
    };
    let robot = r4_boards::load(name)?;
    let start = |simulation: &mut Simulation, _: usize| -> anyhow::Result<Rc<dyn VirtualBoard>> {
        emulated::start_image(simulation, &robot, seed, &image)
    };
    let Measured { factor, memory_mib } = measure(Target::Emu(name.to_owned()), 1, start)?;
    let limit = Limit { what: "x real time, at least", limit: EMU_FACTOR, held: factor >= EMU_FACTOR };
    Ok(Some(row(format!("emu:{name}"), &robot, 1, factor, memory_mib, vec![limit])))
}

fn row(what: String, robot: &Robot, boards: usize, factor: f64, memory_mib: f64, limits: Vec<Limit>) -> Row {
    let held = limits.iter().all(|limit| limit.held);
    Row {
        what,
        robots: boards,
        step_s: f64::from(robot.config.control_period_us) * 1e-6,
        real_time_factor: factor,
        boards_real_time_factor: factor * boards as f64,
        memory_mib,
        limits,
        held,
    }
}

struct Measured {
    /// Real-time factor of the simulation with all its boards.
    factor: f64,
    memory_mib: f64,
}

/// Runs boards in one simulation, each armed and moved by a host of its own.
fn measure(
    target: Target,
    boards: usize,
    start: impl Fn(&mut Simulation, usize) -> anyhow::Result<Rc<dyn VirtualBoard>>,
) -> anyhow::Result<Measured> {
    let mut simulation = Simulation::new(Pace::Free);
    let before_kib = resident_kib()?;
    let started = (0..boards).map(|number| start(&mut simulation, number)).collect::<anyhow::Result<Vec<_>>>()?;
    let (clock, rig) = (simulation.clock(), Rig::new(target));
    let sessions =
        join_all(started.iter().map(async |board| {
            rig.attached(board.clone(), &clock, async |session| measured(session.board).await).await
        }));
    let sessions = simulation.block_on(sessions);
    if let Some(failure) = started.iter().find_map(|board| board.failure()) {
        bail!("a board stopped: {failure}");
    }
    let measured = sessions.ok_or_else(|| anyhow!("the simulation came to a standstill"))?;
    let measured = measured.into_iter().collect::<anyhow::Result<Vec<_>>>()?;
    let memory_kib = resident_kib()?.saturating_sub(before_kib);
    // Freed memory would be reused by the next measurement without becoming resident again.
    std::mem::forget((simulation, started));
    // All boards run at the same pace; the last one to end has run beside all others.
    let factor = measured.into_iter().fold(f64::INFINITY, f64::min);
    Ok(Measured { factor, memory_mib: memory_kib as f64 / 1024.0 / boards as f64 })
}

/// Arms, moves all outputs, and returns the real-time factor.
async fn measured(host: &Board<HostClock>) -> anyhow::Result<f64> {
    host.arm().await?;
    for channel in host.channels() {
        host.subscribe(channel.id, TELEMETRY_MS).await?;
    }
    host.sleep_s(POWER_UP_S).await;
    let moving: Vec<_> = host
        .channels()
        .iter()
        .filter_map(|channel| channel.mode(Mode::Duty).map(|mode| (channel.id, mode.range)))
        .collect();
    let (begin, begin_s) = (processor_s()?, host.now_s());
    let mut forth = true;
    while processor_s()? - begin < LONG_ENOUGH_S {
        let until_s = host.now_s() + ROUND_S;
        while host.now_s() < until_s {
            forth = !forth;
            // Reversing this often keeps everything away from its end stops.
            for (channel, Range { min, max }) in &moving {
                let value = min + (max - min) * if forth { 0.6 } else { 0.4 };
                host.set(*channel, Setpoint { mode: Mode::Duty, value }).await?;
            }
            host.sleep_s(COMMAND_S).await;
        }
    }
    let (state, causes) = host.safety();
    anyhow::ensure!(state == SafetyState::Armed, "the board is {state} ({causes}) before the end of the measurement");
    Ok((host.now_s() - begin_s) / (processor_s()? - begin))
}

/// Processor time of this thread, s; other processes do not count.
fn processor_s() -> anyhow::Result<f64> {
    let statistics =
        fs::read_to_string("/proc/thread-self/schedstat").context("processor time is measured on Linux only")?;
    let ns = statistics.split(' ').next().and_then(|first| first.parse::<u64>().ok());
    Ok(ns.ok_or_else(|| anyhow!("no time in schedstat"))? as f64 * 1e-9)
}

/// Resident memory of this process, KiB.
fn resident_kib() -> anyhow::Result<u64> {
    let status = fs::read_to_string("/proc/self/status").context("memory is measured on Linux only")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    line.and_then(|rest| rest.trim().strip_suffix("kB")?.trim().parse().ok()).ok_or_else(|| anyhow!("no VmRSS"))
}

fn print(report: &Report) -> anyhow::Result<()> {
    let header = ["board", "boards", "step", "x real time", "all boards", "MiB a board", "limit", ""];
    let mut table = table::new(&header, 1..6);
    for row in &report.rows {
        let limits: Vec<_> = row.limits.iter().map(|limit| format!("{} {:.2}", limit.what, limit.limit)).collect();
        let verdict = match (row.limits.is_empty(), row.held) {
            (true, _) => "",
            (false, true) => "ok",
            (false, false) => "not met",
        };
        table.add_row([
            row.what.clone(),
            row.robots.to_string(),
            format!("{:.0} us", row.step_s * 1e6),
            format!("{:.1}", row.real_time_factor),
            format!("{:.0}", row.boards_real_time_factor),
            format!("{:.2}", row.memory_mib),
            limits.join(", "),
            verdict.into(),
        ]);
    }
    output::line("boards armed, all bridges reversing every 100 ms, telemetry at 100 Hz; one thread")?;
    Ok(output::line(table)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_known() {
        let before = resident_kib().unwrap();
        let much = vec![1_u8; 64 << 20];
        assert!(resident_kib().unwrap() > before + 60 * 1024, "{}", much.len());
    }
}
