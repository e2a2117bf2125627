//! `r4 bench bus`: occupancy of the I2C bus under load, and control periods that end late.

use std::collections::{BTreeMap, HashMap};

use indicatif::{ProgressBar, ProgressStyle};
use r4_boards::Robot;
use r4_protocol::{
    ChannelKind, Mode, SafetyState,
    config::{BoardConfig, BridgeConfig},
};
use r4_sim::i2c::WireRecord;
use serde::Serialize;

use super::{Bench, MS, on_board, robot};
use crate::{args::Args, output, table};

/// Limit of the longest transfer, µs: a stop waits for the transfer under way.
const LONGEST_TRANSFER_US: f64 = 450.0;
/// Update period of a servo, ns: its pulse repeats every 20 ms.
const SERVO_PERIOD_NS: u64 = 20 * MS;
/// Period of new commands to the bridges and relays, ms.
const STEP_MS: u64 = 5;
/// Period of a servo's reversals, ms: short enough that servos reverse before they arrive and so move all the time.
const SERVO_TURN_MS: u64 = 150;
/// Time from arming until every output is at the middle of its sweep, ms.
const WARM_UP_MS: u64 = 800;
/// Capacity of the wire trace, transfers: more than a full bus carries in 20 s.
const TRACE: usize = 400_000;
/// Longest run, s: after a longer sweep, motors would reach their end stops.
const LONGEST_S: f64 = 20.0;

/// Load on the bus: the outputs that move.
struct Load {
    name: &'static str,
    osmc: bool,
    dhb_and_bldc: bool,
    servos_and_relays: bool,
    /// All bridges reverse at once, repeatedly; otherwise only their duty changes.
    reversals: bool,
}

const LOADS: [Load; 5] = {
    let idle = Load {
        name: "armed, nothing moves",
        osmc: false,
        dhb_and_bldc: false,
        servos_and_relays: false,
        reversals: false,
    };
    [
        Load { ..idle },
        Load { name: "OSMC duties sweep", osmc: true, ..idle },
        Load { name: "and DHB and brushless", osmc: true, dhb_and_bldc: true, ..idle },
        Load { name: "and servos and relays", osmc: true, dhb_and_bldc: true, servos_and_relays: true, ..idle },
        Load {
            name: "and all bridges reverse",
            osmc: true,
            dhb_and_bldc: true,
            servos_and_relays: true,
            reversals: true,
        },
    ]
};

/// Group of outputs that the firmware writes together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
enum Group {
    Osmc,
    Dhb,
    Bldc,
    Servo,
}

impl std::fmt::Display for Group {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Osmc => "osmc",
            Self::Dhb => "dhb",
            Self::Bldc => "bldc",
            Self::Servo => "servo",
        })
    }
}

#[derive(Serialize)]
struct Row {
    load: &'static str,
    /// Share of the time for which the bus is occupied, 0 to 1.
    occupancy: f64,
    /// Longest control period on the bus, from its first START to its last STOP, µs.
    worst_tick_us: f64,
    /// Late control periods, counted by the firmware.
    late_ticks: u32,
    longest_transfer_us: f64,
    /// Most control periods between two writes of the same output, by group.
    worst_ticks_between_updates: BTreeMap<Group, u64>,
    transfers: u64,
    held: bool,
}

#[derive(Serialize)]
struct Report {
    board: String,
    simulated: bool,
    seconds: f64,
    limits: Limits,
    rows: Vec<Row>,
}

#[derive(Serialize)]
struct Limits {
    tick_us: u32,
    longest_transfer_us: f64,
}

pub(super) fn run(args: &Args, seconds: f64) -> anyhow::Result<bool> {
    anyhow::ensure!(seconds <= LONGEST_S, "at most {LONGEST_S} s: motors would come to their end stops");
    let (board, robot) = robot(args)?;
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} loads, {msg}");
    let progress = ProgressBar::new(LOADS.len() as u64).with_style(style.unwrap_or(ProgressStyle::default_bar()));
    let mut rows = Vec::new();
    for load in &LOADS {
        progress.set_message(load.name);
        rows.push(measure(&robot, args.seed, load, seconds)?);
        progress.inc(1);
    }
    progress.finish_and_clear();
    let limits = Limits { tick_us: robot.config.control_period_us, longest_transfer_us: LONGEST_TRANSFER_US };
    let report = Report { board: board.to_string(), simulated: true, seconds, limits, rows };
    if args.json {
        output::json(&report)?;
    } else {
        print(&report)?;
    }
    Ok(report.rows.iter().all(|row| row.held))
}

fn measure(robot: &Robot, seed: u64, load: &Load, seconds: f64) -> anyhow::Result<Row> {
    on_board(robot, seed, async |bench| {
        bench.host.arm().await?;
        bench.sleep_ms(100).await;
        warm_up(bench, load).await?;
        let before = bench.host.stats().await?;
        // Measure from here on: the warm-up has other set points.
        bench.board.world().bus.set_trace(TRACE);
        bench.board.world().bus.reset_statistics();
        let begin_ns = bench.clock.now_ns();
        let turns = sweep(bench, load, begin_ns + (seconds * 1e9) as u64).await?;
        let span_ns = bench.clock.now_ns() - begin_ns;
        let statistics = *bench.board.world().bus.statistics();
        let wire: Vec<_> = bench.board.world().bus.trace().cloned().collect();
        let after = bench.host.stats().await?;
        let (state, causes) = bench.host.safety();
        anyhow::ensure!(
            state == SafetyState::Armed,
            "{}: the board is {state} ({causes}) before the end of the measurement",
            load.name
        );
        anyhow::ensure!(wire.iter().all(|record| record.fault.is_none()), "{}: transfers failed", load.name);

        let us = |ns: u64| ns as f64 / 1000.0;
        let longest_ns = wire.iter().map(|record| record.end_ns - record.start_ns).max().unwrap_or(0);
        // The firmware counts from its start, modulo 2^32.
        let late_ticks = after.late_ticks.wrapping_sub(before.late_ticks);
        let between = ticks_between_updates(&robot.config, &wire, &turns);
        let in_turn = between.iter().all(|(group, ticks)| *ticks <= most_ticks(*group, load, &robot.config));
        let longest_transfer_us = us(longest_ns);
        Ok(Row {
            load: load.name,
            occupancy: statistics.occupancy(span_ns),
            worst_tick_us: us(worst_tick_ns(&wire)),
            late_ticks,
            longest_transfer_us,
            worst_ticks_between_updates: between,
            transfers: statistics.transfers,
            held: late_ticks == 0 && longest_transfer_us <= LONGEST_TRANSFER_US && in_turn,
        })
    })
}

/// Times at which outputs were commanded to reverse, ns. An output that returns to its last written value needs no
/// write.
#[derive(Default)]
struct Turns {
    servos_ns: Vec<u64>,
    others_ns: Vec<u64>,
}

impl Turns {
    /// True where outputs of `group` reversed, or were still near a reversal, between the two times.
    fn between(&self, group: Group, from_ns: u64, to_ns: u64) -> bool {
        // After a reversal, an output returns to its last written value only after as long as that write lay before
        // the reversal. Until then it needs no write; `last_ns` includes the arrival of the commands.
        let (turns_ns, last_ns) =
            if group == Group::Servo { (&self.servos_ns, 50 * MS) } else { (&self.others_ns, 15 * MS) };
        turns_ns.iter().any(|turn_ns| *turn_ns < to_ns && from_ns < turn_ns + last_ns)
    }
}

/// Moves all outputs of the load to the middle of their sweeps.
async fn warm_up(bench: &Bench<'_>, load: &Load) -> anyhow::Result<()> {
    let middle = if load.reversals { 0.0 } else { 0.5 };
    let mut commands = Vec::new();
    let mut all = |kind, mode, value| commands.extend(bench.taking(kind, mode).map(|(id, _)| (id, mode, value)));
    if load.osmc {
        all(ChannelKind::Osmc, Mode::Duty, middle);
    }
    if load.dhb_and_bldc {
        all(ChannelKind::Dhb, Mode::Duty, middle);
        all(ChannelKind::Bldc, Mode::Duty, 0.5);
    }
    if load.servos_and_relays {
        all(ChannelKind::Servo, Mode::Position, 0.0);
    }
    bench.set_all(commands).await?;
    bench.sleep_ms(WARM_UP_MS).await;
    Ok(())
}

/// Sends all outputs towards one end and then the other, reversing before they arrive, so that every output changes in
/// every period by its slew limit. Returns the times of the reversals.
async fn sweep(bench: &Bench<'_>, load: &Load, until_ns: u64) -> anyhow::Result<Turns> {
    // Steps from end to end. The first sweep starts in the middle and takes half of them.
    let steps = if load.reversals { 12 } else { 6 };
    let relays: Vec<_> = bench.taking(ChannelKind::Relay, Mode::Switch).collect();
    let begin_ns = bench.clock.now_ns();
    let mut turns = Turns::default();
    for step in 0.. {
        bench.clock.sleep_until((begin_ns + step * STEP_MS * MS).min(until_ns)).await;
        if bench.clock.now_ns() >= until_ns {
            break;
        }
        let mut commands = Vec::new();
        if step == 0 || (step + steps / 2) % steps == 0 {
            turns.others_ns.push(bench.clock.now_ns());
            let up = (step + steps / 2) / steps % 2 == 0;
            let bridge = match (load.reversals, up) {
                (_, true) => 0.9,
                (true, false) => -0.9,
                (false, false) => 0.1,
            };
            let mut all =
                |kind, mode, value| commands.extend(bench.taking(kind, mode).map(|(id, _)| (id, mode, value)));
            if load.osmc {
                all(ChannelKind::Osmc, Mode::Duty, bridge);
            }
            if load.dhb_and_bldc {
                all(ChannelKind::Dhb, Mode::Duty, bridge);
                all(ChannelKind::Bldc, Mode::Duty, if up { 0.9 } else { 0.1 });
            }
        }
        if load.servos_and_relays && (step * STEP_MS).is_multiple_of(SERVO_TURN_MS) {
            turns.servos_ns.push(bench.clock.now_ns());
            let there = if turns.servos_ns.len() % 2 == 0 { 0.75 } else { -0.75 };
            commands
                .extend(bench.taking(ChannelKind::Servo, Mode::Position).map(|(id, _)| (id, Mode::Position, there)));
        }
        if load.servos_and_relays && !relays.is_empty() {
            let (turn, count) = (step as usize, relays.len());
            let closed = turn / count % 2 == 0;
            commands.push((relays[turn % count].0, Mode::Switch, closed.into()));
        }
        bench.set_all(commands).await?;
    }
    Ok(turns)
}

/// Groups of transfers without a pause between them: one group per control period.
fn periods(wire: &[WireRecord]) -> impl Iterator<Item = &[WireRecord]> {
    // Fast-mode requires 1.3 us of free bus between two transfers; a pause between periods is longer.
    const PAUSE_NS: u64 = 2_000;
    wire.chunk_by(|one, next| next.start_ns <= one.end_ns + PAUSE_NS)
}

/// Duration of the longest control period on the bus, ns, from its first START to its last STOP.
fn worst_tick_ns(wire: &[WireRecord]) -> u64 {
    let spans = periods(wire).filter_map(|period| Some(period.last()?.end_ns - period.first()?.start_ns));
    spans.max().unwrap_or(0)
}

/// Most control periods between two writes of the same output, by group, while all outputs change continuously.
fn ticks_between_updates(config: &BoardConfig, wire: &[WireRecord], turns: &Turns) -> BTreeMap<Group, u64> {
    let period_ns = u64::from(config.control_period_us) * 1000;
    let mut last_ns = HashMap::new();
    let mut most = BTreeMap::new();
    for period in periods(wire) {
        let begin_ns = period[0].start_ns;
        for (group, output) in period.iter().filter_map(|record| written(config, record)) {
            let before_ns = last_ns.insert((group, output), begin_ns).unwrap_or(begin_ns);
            if turns.between(group, before_ns, begin_ns) {
                continue;
            }
            // Round to the nearest period: the first transfer may have waited for a free bus.
            let ticks = (begin_ns - before_ns + period_ns / 2) / period_ns;
            let most = most.entry(group).or_insert(0);
            *most = ticks.max(*most);
        }
    }
    most
}

/// Output that a transfer writes: the index of the bridge, or of the servo's PWM output. All brushless outputs share
/// the DAC and count as one.
fn written(config: &BoardConfig, record: &WireRecord) -> Option<(Group, usize)> {
    /// Register LED0_ON_L of a PCA9685 (datasheet, table 4); each output has four registers.
    const LED0: u8 = 0x06;
    if !record.read.is_empty() {
        return None;
    }
    let address = Some(record.address);
    if address == config.bldc_dac.map(|chip| chip.address) {
        return Some((Group::Bldc, 0));
    }
    let output = record.written.first()?.checked_sub(LED0)? / 4;
    if address == config.servo_pwm.map(|chip| chip.address) {
        return Some((Group::Servo, output.into()));
    }
    let bridge = config.motors.iter().position(|motor| match motor.bridge {
        BridgeConfig::Osmc(lines) => {
            address == config.osmc_pwm.map(|chip| chip.address) && lines.all().contains(&output)
        }
        BridgeConfig::Dhb(lines) => address == config.dhb_pwm.map(|chip| chip.address) && lines.all().contains(&output),
    })?;
    let group = if let BridgeConfig::Osmc(_) = config.motors[bridge].bridge { Group::Osmc } else { Group::Dhb };
    Some((group, bridge))
}

/// Most control periods allowed between two updates of an output that changes continuously.
fn most_ticks(group: Group, load: &Load, config: &BoardConfig) -> u64 {
    let period_ns = u64::from(config.control_period_us) * 1000;
    let bridges =
        |osmc: bool| config.motors.iter().filter(move |motor| matches!(motor.bridge, BridgeConfig::Osmc(_)) == osmc);
    // A bridge rests for two PWM periods between directions.
    let pwm_hz = config.osmc_pwm.map_or(1.0, |chip| f64::from(chip.frequency_hz));
    let rest = (2e9 / pwm_hz / period_ns as f64).ceil() as u64;
    match (group, load.reversals) {
        (Group::Osmc, false) => 1,
        (Group::Dhb | Group::Bldc, false) => 2,
        // Two writes of 18 bytes fit a period; the remaining time carries a DHB bridge or the DAC every second period.
        (Group::Osmc, true) => rest + (bridges(true).count() as u64).div_ceil(2),
        (Group::Dhb, true) => rest + 2 * bridges(false).count() as u64,
        (Group::Bldc, true) => 4,
        (Group::Servo, _) => SERVO_PERIOD_NS / period_ns,
    }
}

fn print(report: &Report) -> anyhow::Result<()> {
    let header = ["load", "occupancy", "worst tick", "late", "longest transfer", "most ticks between updates", ""];
    let mut table = table::new(&header, 1..5);
    for row in &report.rows {
        let between: Vec<_> =
            row.worst_ticks_between_updates.iter().map(|(group, ticks)| format!("{group} {ticks}")).collect();
        table.add_row([
            row.load.to_owned(),
            format!("{:.1} %", 100.0 * row.occupancy),
            format!("{:.0} us", row.worst_tick_us),
            row.late_ticks.to_string(),
            format!("{:.1} us", row.longest_transfer_us),
            between.join(", "),
            if row.held { "ok".into() } else { "not met".into() },
        ]);
    }
    output::line(format_args!("I2C bus of {} (simulated, processor time not counted)", report.board))?;
    output::line(table)?;
    Ok(output::line(format_args!(
        "each load for {} s; limits: no late tick (over {} us), no transfer over {} us, OSMC every tick, DHB and \
         brushless every second (more only while all bridges reverse), servos every 20 ms",
        report.seconds, report.limits.tick_us, report.limits.longest_transfer_us
    ))?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_load_leaves_every_period_in_time() {
        let robot = r4_boards::load("every-interface").unwrap();
        for load in &LOADS {
            let row = measure(&robot, 1, load, 0.5).unwrap();
            assert!(row.held, "{}: {:?}, late {}", load.name, row.worst_ticks_between_updates, row.late_ticks);
            assert_eq!(row.worst_ticks_between_updates.contains_key(&Group::Osmc), load.osmc);
        }
    }

    #[test]
    fn a_bus_too_slow_for_the_load_is_noticed() {
        let mut robot = r4_boards::load("every-interface").unwrap();
        robot.carrier.i2c.rate_hz = 200_000;
        assert!(!measure(&robot, 1, &LOADS[3], 0.2).is_ok_and(|row| row.held));
    }
}
