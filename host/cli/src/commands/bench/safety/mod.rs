//! `r4 bench safety`: for every cause of a stop, the longest time until each kind of output is safe.
//!
//! Causes are injected repeatedly at random times into a board with all outputs moving. Times are virtual and measured
//! by [`StopWatch`]; limits are guaranteed by the project or follow from the board's configuration. On further boards,
//! where half of the channels brake before they are switched off, [`RunOut`] follows the plants until they are at rest.
//!
//! A simulated board covers events around its processor; events in the processor itself are injected into the exact ELF
//! file on an emulated one: `processor`.

#[cfg(feature = "emu")]
pub(crate) mod processor;
mod report;
mod run_out;

use std::{
    cell::Cell,
    fmt,
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use anyhow::{Context, bail};
use futures::future::{Either, join, select};
use indicatif::{ProgressBar, ProgressStyle};
use r4_boards::Robot;
use r4_driver::Error;
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, Mode, Range, Refusal,
    config::{BoardConfig, BridgeConfig},
};
use r4_sim::{
    i2c::{Disturbance, Injection, Span},
    sensors::{hc_sr04::HcSr04Fault, quadrature::EdgeNoise},
    stop::{Outputs, RunOut, StopWatch},
};
use rand_pcg::{Pcg64, rand_core::Rng};

use super::{Bench, MS, on_board, robot};
use crate::{
    args::{self, Args},
    emulated, output,
    session::Target,
};
use report::{CONFIGURED, Limit, Line, OutOfReach, PROMISED, Report, Row};
use run_out::{Group, GroupRan, RUN_OUT_NS, groups};

/// Default number of injections into a simulated board.
const INJECTIONS: u32 = 10_000;
/// Time from arming until motors may move, ms (the supply's relay bounces).
const POWER_UP_MS: u64 = 52;
/// Range of the time for which all outputs move before an injection, ns.
const MOVING_NS: std::ops::Range<u64> = 100 * MS..200 * MS;
/// Period of new servo positions, ms, so that they never arrive.
const RETARGET_MS: u64 = 100;
/// Boards per cause that are followed until every plant is at rest.
const RUN_OUTS: u32 = 4;
/// Least polling period of the outputs while a stop brakes, ns.
const LOOK_BRAKING_NS: u64 = 100_000;
/// Time for which all outputs must stay safe after the last one became so, ns.
const QUIET_NS: u64 = 3 * MS;
/// Time after removal of the cause until which clearing must succeed, ms.
const CLEARED_WITHIN_MS: u64 = 5_000;
/// Period of pings to successive range sensors, ms (HC-SR04 datasheet).
const TURN_MS: f64 = 60.0;

/// Chip on the board's I2C bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Chip {
    OsmcPwm,
    DhbPwm,
    ServoPwm,
    BldcDac,
    Expander,
}

/// Event that is injected into the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Event {
    DeadMan,
    AuxiliaryStop,
    HostStop,
    LinkLost,
    Proximity,
    ProximityLost,
    NoAnswer(Chip),
    BusHeldLow,
    LostSettings(Chip),
    SupplyLow,
    SupplyHigh,
    EncoderJumps,
    EncoderDead,
    MotorBlocked,
}

const EVENTS: [Event; 20] = [
    Event::DeadMan,
    Event::AuxiliaryStop,
    Event::HostStop,
    Event::LinkLost,
    Event::Proximity,
    Event::ProximityLost,
    Event::NoAnswer(Chip::OsmcPwm),
    Event::NoAnswer(Chip::DhbPwm),
    Event::NoAnswer(Chip::ServoPwm),
    Event::NoAnswer(Chip::BldcDac),
    Event::NoAnswer(Chip::Expander),
    Event::BusHeldLow,
    Event::LostSettings(Chip::OsmcPwm),
    Event::LostSettings(Chip::DhbPwm),
    Event::LostSettings(Chip::ServoPwm),
    Event::SupplyLow,
    Event::SupplyHigh,
    Event::EncoderJumps,
    Event::EncoderDead,
    Event::MotorBlocked,
];

impl fmt::Display for Chip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::OsmcPwm => "OSMC PWM chip",
            Self::DhbPwm => "DHB PWM chip",
            Self::ServoPwm => "servo PWM chip",
            Self::BldcDac => "brushless DAC",
            Self::Expander => "port expander",
        })
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DeadMan => f.write_str("dead-man released"),
            Self::AuxiliaryStop => f.write_str("auxiliary stop pressed"),
            Self::HostStop => f.write_str("host stop"),
            Self::LinkLost => f.write_str("host silent"),
            Self::Proximity => f.write_str("object near, from its echo"),
            Self::ProximityLost => f.write_str("range sensor dead"),
            Self::NoAnswer(chip) => write!(f, "no answer: {chip}"),
            Self::BusHeldLow => f.write_str("I2C bus held low"),
            Self::LostSettings(chip) => write!(f, "lost settings: {chip}"),
            Self::SupplyLow => f.write_str("supply under range"),
            Self::SupplyHigh => f.write_str("supply over range"),
            Self::EncoderJumps => f.write_str("encoder jumps"),
            Self::EncoderDead => f.write_str("encoder dead"),
            Self::MotorBlocked => f.write_str("motor blocked"),
        }
    }
}

impl Event {
    /// Cause that the board must report.
    const fn cause(self) -> Cause {
        match self {
            Self::DeadMan => Cause::DeadMan,
            Self::AuxiliaryStop => Cause::AuxiliaryStop,
            Self::HostStop => Cause::HostStop,
            Self::LinkLost => Cause::LinkLost,
            Self::Proximity | Self::ProximityLost => Cause::Proximity,
            Self::NoAnswer(_) | Self::BusHeldLow => Cause::I2cFault,
            Self::LostSettings(_) => Cause::ReadBackMismatch,
            Self::SupplyLow | Self::SupplyHigh => Cause::SupplyOutOfRange,
            Self::EncoderJumps => Cause::EncoderImplausible,
            Self::EncoderDead | Self::MotorBlocked => Cause::Stalled,
        }
    }

    /// Relative number of injections: events that take long in virtual time are injected less often.
    const fn weight(self) -> f64 {
        match self {
            Self::Proximity | Self::ProximityLost | Self::EncoderDead | Self::MotorBlocked => 0.25,
            _ => 1.0,
        }
    }

    /// Injections per simulated board. A motor that stands under duty heats its winding, which starts at 80 %, by 3 to
    /// 4 % each time: few enough that the board does not trip by overload first.
    const fn chunk(self) -> u32 {
        match self {
            Self::EncoderDead | Self::MotorBlocked => 5,
            _ => 25,
        }
    }

    /// Polling period of the outputs during the event, ns.
    const fn look_every_ns(self) -> u64 {
        match self {
            Self::ProximityLost | Self::EncoderDead | Self::MotorBlocked => 100_000,
            _ => 10_000,
        }
    }

    /// Polling period of the outputs, ns, longer while a stop may brake.
    fn look_ns(self, braking: bool) -> u64 {
        self.look_every_ns().max(if braking { LOOK_BRAKING_NS } else { 0 })
    }

    /// Longest time from the event until the board detects it, ms.
    fn noticed_ms(self, config: &BoardConfig) -> f64 {
        let period_ms = f64::from(config.control_period_us) / 1000.0;
        /// Period of the supervisor, ms.
        const SUPERVISOR_MS: f64 = 1.0;
        match self {
            // An edge interrupt wakes the supervisor.
            Self::DeadMan => 0.0,
            Self::AuxiliaryStop => SUPERVISOR_MS,
            // Transmission of a frame of at most 64 bytes at 1 Mbit/s behind another one, and behind the requests that
            // this host has just sent: a new angle for each servo, 30 bytes each.
            Self::HostStop => 1.3 + 0.3 * config.servos.len() as f64,
            // A guaranteed limit.
            Self::LinkLost => f64::from(config.link_timeout_ms) + 2.0,
            // Guaranteed as one ranging cycle; this is the shortest one, of a single sensor.
            Self::Proximity => TURN_MS,
            // Three pings without an answer; the last one waits for the longest possible echo.
            Self::ProximityLost => 3.0 * TURN_MS * config.ranges.len() as f64 + 42.0,
            // The DAC is written every second period while voltages change; three tries of three bytes.
            Self::NoAnswer(Chip::BldcDac) => 2.0 * period_ms + 1.0,
            Self::NoAnswer(_) | Self::LostSettings(_) => read_back_ms(config) + period_ms,
            // The next transfer, with three tries that time out after 1 ms each.
            Self::BusHeldLow => period_ms + 3.2,
            Self::SupplyLow | Self::SupplyHigh => {
                let slowest = config.supplies.iter().map(|supply| {
                    let range = supply.range_v;
                    let (from_v, to_v, limit_v) = match self {
                        Self::SupplyLow => (range.max, far_below(range.min), range.min),
                        _ => (range.min, far_above(range.max), range.max),
                    };
                    // First-order filter of the supply voltage, 10 ms.
                    10.0 * f64::from((from_v - to_v) / (limit_v - to_v)).ln()
                });
                slowest.fold(0.0, f64::max) + 2.0 * period_ms
            }
            Self::EncoderJumps => 2.0 * period_ms,
            // A motor that stops within a window may have moved enough before; the next window detects it.
            Self::EncoderDead | Self::MotorBlocked => {
                let windows =
                    config.motors.iter().filter_map(|motor| motor.control.map(|control| control.stall.time_ms));
                2.0 * f64::from(windows.max().unwrap_or(0)) + 2.0 * period_ms + SUPERVISOR_MS
            }
        }
    }

    /// Braking time of the event's stop before outputs are switched off, ms; 0 for a stop that switches off at once.
    fn braked_ms(self, config: &BoardConfig) -> f64 {
        if Causes::only(self.cause()).allow_braking() { f64::from(config.stop_brake_ms()) } else { 0.0 }
    }

    /// Limit until nothing drives or brakes a group's plants any more; `None` for outputs out of reach.
    fn group_limit(self, group: &Group, config: &BoardConfig) -> Option<Limit> {
        let outputs = group.outputs();
        let limit = self.limit(outputs, config)?;
        let beside_others = self.braked_ms(config) > 0.0 && !group.brakes;
        let ms = match outputs {
            // Beside braking channels, the others are switched off over the bus, in the time that writing all of them
            // takes.
            Outputs::Bridges if beside_others => self.noticed_ms(config) + WRITTEN_MS + LOOK_BRAKING_NS as f64 * 1e-6,
            Outputs::Steppers if beside_others => {
                let period_ms = f64::from(config.control_period_us) / 1000.0;
                self.noticed_ms(config) + period_ms + 2.0 * LOOK_BRAKING_NS as f64 * 1e-6
            }
            _ => limit.ms,
        };
        Some(Limit { ms, from: CONFIGURED })
    }

    /// Limit until `outputs` are safe; `None` for outputs out of reach.
    fn limit(self, outputs: Outputs, config: &BoardConfig) -> Option<Limit> {
        let out_of_reach = match self {
            Self::BusHeldLow => matches!(outputs, Outputs::MotorPower | Outputs::BridgeChips | Outputs::Bldcs),
            Self::NoAnswer(Chip::OsmcPwm | Chip::DhbPwm) => outputs == Outputs::BridgeChips,
            Self::NoAnswer(Chip::BldcDac) => outputs == Outputs::Bldcs,
            Self::NoAnswer(Chip::Expander) => outputs == Outputs::MotorPower,
            _ => false,
        };
        let period_ms = f64::from(config.control_period_us) / 1000.0;
        let braked_ms = self.braked_ms(config);
        let look_ms = self.look_ns(braked_ms > 0.0) as f64 * 1e-6;
        // The supervisor, which runs each millisecond, checks the deadline of a braking stop.
        let braked_ms = if braked_ms > 0.0 { braked_ms + 1.0 } else { 0.0 };
        let after_ms = match outputs {
            // Lines switch the bridges without the bus: detected at the next poll.
            Outputs::Bridges => braked_ms + look_ms,
            // Guaranteed for the dead-man's edge.
            Outputs::MotorPower => braked_ms + 1.0,
            Outputs::BridgeChips => braked_ms + WRITTEN_MS,
            Outputs::Bldcs => WRITTEN_MS,
            Outputs::Steppers if braked_ms > 0.0 => braked_ms + period_ms + 2.0 * look_ms,
            // The control loop stops them after its present write; two polls detect that nothing changes any more.
            Outputs::Steppers | Outputs::Servos | Outputs::Dacs => period_ms + 2.0 * look_ms,
        };
        let promised = match (self, outputs) {
            (Self::DeadMan, Outputs::MotorPower | Outputs::BridgeChips | Outputs::Bldcs) => true,
            // On a trip the lines of the bridges switch at once if nothing brakes first.
            (Self::LinkLost | Self::Proximity, Outputs::Bridges) => braked_ms == 0.0,
            _ => false,
        };
        let from = if promised { PROMISED } else { CONFIGURED };
        (!out_of_reach).then(|| Limit { ms: self.noticed_ms(config) + after_ms, from })
    }
}

/// Guaranteed time after a stop until all motor channels are written, ms.
const WRITTEN_MS: f64 = 5.0;

/// Voltages well below and well above a supply's range, V.
fn far_below(min_v: f32) -> f32 {
    0.6 * min_v
}
fn far_above(max_v: f32) -> f32 {
    1.35 * max_v
}

/// Period in which the firmware reads back every setting once while armed, ms: one setting every fourth control period.
fn read_back_ms(config: &BoardConfig) -> f64 {
    let lines = config.motors.iter().map(|motor| if let BridgeConfig::Osmc(_) = motor.bridge { 4 } else { 3 });
    let modes = [config.osmc_pwm.is_some(), config.dhb_pwm.is_some(), config.servo_pwm.is_some()];
    let modes = modes.into_iter().filter(|there| *there).count();
    let things = 1 + modes + lines.sum::<usize>() + config.servos.len();
    (4 * things) as f64 * f64::from(config.control_period_us) / 1000.0
}

/// Result of one event.
#[derive(Clone, Debug, Default)]
struct Measured {
    injections: u32,
    /// Longest time by kind of output, ms; infinite if the output did not become safe.
    max_ms: [f64; Outputs::ALL.len()],
    /// Results by group of plants, of the boards that were followed until rest.
    groups: Vec<GroupRan>,
    /// Injections after which the board reported other causes, and the first of those.
    wrong: u32,
    wrong_causes: Option<Causes>,
}

impl Measured {
    fn merge(&mut self, other: &Self) {
        self.injections += other.injections;
        self.max_ms.iter_mut().zip(other.max_ms).for_each(|(max, ms)| *max = max.max(ms));
        run_out::merge(&mut self.groups, &other.groups);
        self.wrong += other.wrong;
        self.wrong_causes = self.wrong_causes.or(other.wrong_causes);
    }
}

pub(super) fn run(args: &Args, asked: &args::Safety) -> anyhow::Result<bool> {
    if let Target::Emu(_) = &args.board {
        return emulated::bench_safety(args, asked);
    }
    let (board, robot) = robot(args)?;
    let measured = measure(&robot, args.seed, asked.injections.unwrap_or(INJECTIONS), RUN_OUTS)?;
    let mut report = Report {
        board: board.to_string(),
        simulated: true,
        seed: args.seed,
        injections: measured.iter().map(|(_, measured)| measured.injections).sum(),
        rows: Vec::new(),
        out_of_reach: Vec::new(),
    };
    let as_configured = robot.config.clone();
    let robot = run_out::robot(robot);
    let groups = groups(&robot);
    for (event, of) in &measured {
        for outputs in Outputs::ALL {
            match event.limit(outputs, &as_configured) {
                Some(limit) => {
                    let max_ms = of.max_ms[outputs as usize];
                    report.rows.push(Row::new(event, &outputs, max_ms, limit, of.injections));
                }
                None => report.out_of_reach.push(OutOfReach { cause: event.to_string(), outputs: outputs.to_string() }),
            }
        }
        for (group, ran) in groups.iter().zip(&of.groups) {
            match event.group_limit(group, &robot.config) {
                Some(limit) => report.rows.push(Row::of_group(event, group, ran, limit)),
                None => report.out_of_reach.push(OutOfReach { cause: event.to_string(), outputs: group.to_string() }),
            }
        }
    }
    if args.json {
        output::json(&report)?;
    } else {
        print(&report, &measured, &robot, &groups, asked.markdown)?;
    }
    let mut right = true;
    for (event, of) in measured.iter().filter(|(_, of)| of.wrong > 0) {
        right = false;
        let causes = of.wrong_causes.unwrap_or(Causes::NONE);
        eprintln!("r4: {event}: the board reported other causes {} times, first `{causes}`", of.wrong);
    }
    Ok(right && report.held())
}

/// Measures all events, on as many boards in parallel as there are processors. The result depends on the seed alone.
fn measure(robot: &Robot, seed: u64, injections: u32, run_outs: u32) -> anyhow::Result<Vec<(Event, Measured)>> {
    let weights: f64 = EVENTS.iter().map(|event| event.weight()).sum();
    let mut chunks = Vec::new();
    for (place, event) in EVENTS.into_iter().enumerate() {
        // At least one injection of each event, also for few in all.
        let mut left = (f64::from(injections) * event.weight() / weights).ceil() as u32;
        while left > 0 {
            let count = left.min(event.chunk());
            left -= count;
            chunks.push(Chunk { place, event, count, run_out: false });
        }
    }
    for (place, event) in EVENTS.into_iter().enumerate() {
        chunks.extend((0..run_outs).map(|_| Chunk { place, event, count: 1, run_out: true }));
    }
    let braking = run_out::robot(robot.clone());
    let all = chunks.iter().map(|chunk| u64::from(chunk.count)).sum();
    let results = Mutex::new(vec![Measured::default(); EVENTS.len()]);
    side_by_side(&chunks, all, |number, chunk, progress| {
        let Chunk { place, event, count, run_out } = *chunk;
        progress.set_message(event.to_string());
        let robot = if run_out { &braking } else { robot };
        let measured = on_board(robot, seed.wrapping_add(number), async |bench| {
            let random = Pcg64::new(seed.into(), number.into());
            Injections { bench, event, random, run_out, progress }.run(count).await
        });
        let measured = measured.with_context(|| format!("{event}, seed {seed}, board {number}"))?;
        // The lock cannot be poisoned: nothing panics while holding it.
        results.lock().unwrap_or_else(std::sync::PoisonError::into_inner)[place].merge(&measured);
        Ok(())
    })?;
    let results = results.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    Ok(EVENTS.into_iter().zip(results).filter(|(_, of)| of.injections > 0).collect())
}

/// Runs `work` for each job and its number, as many in parallel as there are processors, with a progress bar.
fn side_by_side<J: Sync>(
    jobs: &[J],
    injections: u64,
    work: impl Fn(u64, &J, &ProgressBar) -> anyhow::Result<()> + Sync,
) -> anyhow::Result<()> {
    let style = ProgressStyle::with_template("{bar:30} {pos}/{len} injections, {msg}, {eta} left");
    let progress = ProgressBar::new(injections).with_style(style.unwrap_or(ProgressStyle::default_bar()));
    let next = AtomicUsize::new(0);
    let some = || {
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            let Some(job) = jobs.get(number) else { return Ok(()) };
            work(number as u64, job, &progress)?;
        }
    };
    let threads = thread::available_parallelism().map_or(1, usize::from);
    thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(some)).collect();
        let joined =
            workers.into_iter().map(|worker| worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        joined.collect::<anyhow::Result<()>>()
    })?;
    progress.finish_and_clear();
    Ok(())
}

/// Injections into one board.
#[derive(Clone, Copy)]
struct Chunk {
    /// Index of the event in [`EVENTS`].
    place: usize,
    event: Event,
    count: u32,
    /// Follow a board with braking channels until all plants are at rest.
    run_out: bool,
}

/// Repeated injection of one event into one board.
struct Injections<'b> {
    bench: &'b Bench<'b>,
    event: Event,
    random: Pcg64,
    /// Follow each injection until all plants are at rest, and measure nothing else.
    run_out: bool,
    progress: &'b ProgressBar,
}

impl Injections<'_> {
    async fn run(mut self, count: u32) -> anyhow::Result<Measured> {
        let mut measured = Measured::default();
        for number in 0..count {
            let (once, causes) = self.inject_once(number).await.with_context(|| format!("injection {number}"))?;
            let wrong = !causes.contains(self.event.cause());
            measured.merge(&Measured { wrong: wrong.into(), wrong_causes: wrong.then_some(causes), ..once });
            self.progress.inc(1);
        }
        Ok(measured)
    }

    /// Arms, moves all outputs, injects the event, waits until all outputs are safe, and removes the cause.
    async fn inject_once(&mut self, number: u32) -> anyhow::Result<(Measured, Causes)> {
        let bench = self.bench;
        bench.host.arm().await?;
        bench.sleep_ms(POWER_UP_MS).await;
        // Alternate the direction, so that nothing reaches its end stop.
        let sign = if number.is_multiple_of(2) { 1.0 } else { -1.0 };
        let osmc: Vec<_> = bench.taking(ChannelKind::Osmc, Mode::Duty).map(|(id, _)| id).collect();
        // A random channel, so that many injections cover all of them.
        let victim = osmc.get(self.below(osmc.len() as u64) as usize).copied();
        let Some(victim) = victim else { bail!("no OSMC") };
        Moving::All.begin(bench, victim, sign).await?;
        let moving_ns = MOVING_NS.start + self.below(MOVING_NS.end - MOVING_NS.start);
        let chosen = self.below(1 << 32);
        let watch = async {
            bench.clock.sleep(moving_ns).await;
            check_moving(bench).await?;
            self.let_happen(victim, sign, chosen).await
        };
        let retarget = async {
            loop {
                bench.sleep_ms(RETARGET_MS).await;
                // The board refuses it once it has tripped.
                let _ = Moving::All.retarget_servos(bench).await;
            }
        };
        let once = match select(Box::pin(watch), Box::pin(retarget)).await {
            Either::Left((result, _)) => result?,
            Either::Right((never, _)) => never,
        };
        self.remedy(victim)?;
        Ok((once, self.clear().await?))
    }

    fn below(&mut self, end: u64) -> u64 {
        self.random.next_u64() % end.max(1)
    }

    /// Injects the event and waits until all reachable outputs are safe, or until all plants are at rest.
    async fn let_happen(&self, victim: ChannelId, sign: f32, chosen: u64) -> anyhow::Result<Measured> {
        let bench = self.bench;
        let at_ns = bench.clock.now_ns();
        self.inject(victim, sign, chosen)?;
        // Bytes already in the cable when the host falls silent still arrive.
        let silent_ns = if self.event == Event::LinkLost { bench.cable.arrived_ns.get() } else { 0 };
        let since_ns = Cell::new(at_ns.max(silent_ns));
        let stop = async {
            if self.event == Event::HostStop {
                bench.host.stop().await?;
            }
            anyhow::Ok(())
        };
        let (stopped, (watch, mut plants)) = join(stop, self.watch(&since_ns)).await;
        stopped?;
        if !self.run_out {
            let max_ms = Outputs::ALL.map(|outputs| run_out::ms(watch.safe_since_ns(outputs), since_ns.get()));
            return Ok(Measured { injections: 1, max_ms, ..Measured::default() });
        }
        // Remove the cause first: a session ends if its link is cut for long. A tripped board stays tripped.
        self.remedy(victim)?;
        let until_ns = at_ns + RUN_OUT_NS;
        while !plants.is_over(bench.clock.now_ns()) && bench.clock.now_ns() < until_ns {
            bench.sleep_ms(1).await;
            plants.look(bench.board);
        }
        let ran = plants.ran(bench.board, bench.clock.now_ns());
        Ok(Measured { groups: run_out::by_group(bench.board.robot(), &ran, since_ns.get()), ..Measured::default() })
    }

    /// Polls until all outputs stay safe or time runs out. If an echo carries the event, `since_ns` becomes the echo's
    /// end.
    async fn watch(&self, since_ns: &Cell<u64>) -> (StopWatch, RunOut) {
        /// Time from the end of a trigger to the rise of its echo, with a margin, ns.
        const RISE_NS: u64 = 600_000;
        let bench = self.bench;
        let config = &bench.board.robot().config;
        let in_reach = Outputs::ALL.into_iter().filter(|outputs| self.event.limit(*outputs, config).is_some());
        let in_reach: Vec<_> = in_reach.collect();
        let cycle_ms = if self.event == Event::Proximity { TURN_MS * config.ranges.len() as f64 } else { 0.0 };
        let patience_ms = cycle_ms + 2.0 * self.event.noticed_ms(config) + self.event.braked_ms(config) + 50.0;
        let give_up_ns = since_ns.get() + (patience_ms * 1e6) as u64;
        let appeared_ns = since_ns.get();
        let (mut rose, mut high, mut heard) = (false, false, false);
        let (mut watch, mut plants) = (StopWatch::new(bench.board), RunOut::new(bench.board));
        let look_ns = self.event.look_ns(self.event.braked_ms(config) > 0.0);
        loop {
            bench.clock.sleep(look_ns).await;
            let now_ns = bench.clock.now_ns();
            watch.look(bench.board);
            if self.run_out {
                plants.look(bench.board);
            }
            if self.event == Event::Proximity && !heard {
                let guard = config.ranges.iter().find(|range| range.stop_below_m.is_some());
                let mut world = bench.board.world();
                let sensor = guard.and_then(|range| world.range_sensor(range.id.index));
                let is_high = sensor.is_some_and(|sensor| sensor.echo_is_high(now_ns));
                rose |= is_high && !high && now_ns > appeared_ns + RISE_NS;
                heard = rose && !is_high;
                high = is_high;
                if heard {
                    since_ns.set(now_ns);
                    drop(world);
                    // Positions count from the echo that shows the object.
                    plants = RunOut::new(bench.board);
                }
            }
            let safe_ns = in_reach.iter().map(|outputs| watch.safe_since_ns(*outputs)).collect::<Option<Vec<_>>>();
            let quiet = safe_ns.is_some_and(|safe_ns| safe_ns.iter().all(|safe_ns| now_ns - safe_ns >= QUIET_NS));
            if quiet || now_ns > give_up_ns {
                return (watch, plants);
            }
        }
    }

    fn inject(&self, victim: ChannelId, sign: f32, chosen: u64) -> anyhow::Result<()> {
        let bench = self.bench;
        let config = &bench.board.robot().config;
        let now_ns = bench.clock.now_ns();
        let encoder = usize::from(victim.index);
        match self.event {
            Event::DeadMan => bench.board.dead_man().set(false),
            Event::AuxiliaryStop => bench.board.auxiliary_stop().set(false),
            Event::HostStop => {}
            Event::LinkLost => bench.cable.cut.set(true),
            Event::Proximity => self.guard(|sensor| sensor.set_distance_m(Some(0.2))),
            Event::ProximityLost => self.guard(|sensor| sensor.set_fault(now_ns, Some(HcSr04Fault::Silent))),
            Event::NoAnswer(chip) => {
                let address = match chip {
                    Chip::OsmcPwm => config.osmc_pwm.map(|chip| chip.address),
                    Chip::DhbPwm => config.dhb_pwm.map(|chip| chip.address),
                    Chip::ServoPwm => config.servo_pwm.map(|chip| chip.address),
                    Chip::BldcDac => config.bldc_dac.map(|chip| chip.address),
                    Chip::Expander => config.expander.map(|chip| chip.address),
                };
                self.disturb(Disturbance::AddressNack, address);
            }
            Event::BusHeldLow => self.disturb(Disturbance::StuckLow { persistent: true }, None),
            Event::LostSettings(chip) => {
                let world = bench.board.world();
                let chip = match chip {
                    Chip::OsmcPwm => world.osmc_pwm(),
                    Chip::DhbPwm => world.dhb_pwm(),
                    Chip::ServoPwm => world.servo_pwm(),
                    Chip::BldcDac | Chip::Expander => None,
                };
                chip.context("no such chip")?.borrow_mut().power_cycle(now_ns);
            }
            Event::SupplyLow | Event::SupplyHigh => {
                let supply = &config.supplies[chosen as usize % config.supplies.len()];
                let volts = match self.event {
                    Event::SupplyLow => far_below(supply.range_v.min),
                    _ => far_above(supply.range_v.max),
                };
                bench.board.world().set_emf(supply.id, volts.into());
            }
            Event::EncoderJumps => {
                let mut world = bench.board.world();
                let from = world.position(victim).context("no such motor")?;
                world.set_position(victim, from - std::f64::consts::PI * f64::from(sign));
            }
            Event::EncoderDead => bench.board.world().pins().encoders[encoder]
                .set_noise(EdgeNoise { lost_share: 1.0, ..EdgeNoise::default() }),
            Event::MotorBlocked => bench.board.block_motor(victim, true)?,
        }
        Ok(())
    }

    /// Removes the injected cause.
    fn remedy(&self, victim: ChannelId) -> anyhow::Result<()> {
        let bench = self.bench;
        let now_ns = bench.clock.now_ns();
        match self.event {
            Event::DeadMan => bench.board.dead_man().set(true),
            Event::AuxiliaryStop => bench.board.auxiliary_stop().set(true),
            Event::LinkLost => bench.cable.cut.set(false),
            Event::Proximity => self.guard(|sensor| sensor.set_distance_m(Some(2.0))),
            Event::ProximityLost => self.guard(|sensor| sensor.set_fault(now_ns, None)),
            Event::NoAnswer(_) | Event::BusHeldLow => bench.board.world().bus.clear_injections(),
            Event::SupplyLow | Event::SupplyHigh => {
                for rail in &bench.board.robot().simulation.rails {
                    bench.board.world().set_emf(rail.channel, rail.emf_v);
                }
            }
            Event::EncoderDead => {
                bench.board.world().pins().encoders[usize::from(victim.index)].set_noise(EdgeNoise::default());
            }
            Event::MotorBlocked => bench.board.block_motor(victim, false)?,
            Event::HostStop | Event::LostSettings(_) | Event::EncoderJumps => {}
        }
        Ok(())
    }

    /// Clears as soon as the board permits it; returns the causes of the trip.
    async fn clear(&self) -> anyhow::Result<Causes> {
        let bench = self.bench;
        let until_ns = bench.clock.now_ns() + CLEARED_WITHIN_MS * MS;
        loop {
            match bench.host.arm().await {
                Err(Error::Refused(Refusal::Tripped { causes })) => match bench.host.clear().await {
                    Ok(()) => return Ok(causes),
                    Err(Error::Refused(Refusal::CausesPresent { .. })) => {}
                    Err(error) => return Err(error.into()),
                },
                Err(Error::Refused(Refusal::CausesPresent { causes })) if bench.clock.now_ns() > until_ns => {
                    bail!("the board still reports {causes} {CLEARED_WITHIN_MS} ms after the cause was removed");
                }
                Err(Error::Refused(Refusal::CausesPresent { .. })) => {}
                // The board did not detect the event; the row reports that.
                Ok(()) => {
                    bench.host.disarm().await?;
                    return Ok(Causes::NONE);
                }
                Err(error) => return Err(error.into()),
            }
            bench.sleep_ms(5).await;
        }
    }

    fn disturb(&self, disturbance: Disturbance, address: Option<u8>) {
        let span = Span::Time { from_ns: self.bench.clock.now_ns(), until_ns: u64::MAX };
        self.bench.board.world().bus.inject(Injection { disturbance, span, address });
    }

    /// Changes the range sensor that can stop the board.
    fn guard(&self, change: impl FnOnce(&mut r4_sim::sensors::hc_sr04::HcSr04)) {
        let guard = self.bench.board.robot().config.ranges.iter().find(|range| range.stop_below_m.is_some());
        let mut world = self.bench.board.world();
        if let Some(sensor) = guard.and_then(|range| world.range_sensor(range.id.index)) {
            change(sensor);
        }
    }
}

/// Choice of the moving channels.
#[derive(Clone, Copy)]
enum Moving {
    /// All channels of every kind.
    All,
    /// First and last channel of each kind: an emulated processor is too slow for all at once (docs/performance.md).
    #[cfg_attr(not(feature = "emu"), allow(dead_code))]
    TwoOfEach,
}

impl Moving {
    /// Moving channels of a kind that accept `mode`, with their ranges.
    fn of(self, bench: &Bench<'_>, kind: ChannelKind, mode: Mode) -> Vec<(ChannelId, Range)> {
        let mut moving: Vec<_> = bench.taking(kind, mode).collect();
        if let (Self::TwoOfEach, 3..) = (self, moving.len()) {
            moving.drain(1..moving.len() - 1);
        }
        moving
    }

    /// Moves all chosen outputs; `sign` is the motors' direction.
    async fn begin(self, bench: &Bench<'_>, victim: ChannelId, sign: f32) -> anyhow::Result<()> {
        // A servo's first set point is not rate-limited: send its present position first, then another one.
        let here = |id| bench.board.world().position(id).map_or(0.0, |angle| angle.clamp(-0.7, 0.7)) as f32;
        let of = |kind, mode| self.of(bench, kind, mode).into_iter();
        let servos = of(ChannelKind::Servo, Mode::Position);
        bench.set_all(servos.map(|(id, _)| (id, Mode::Position, here(id)))).await?;
        let mut commands = Vec::new();
        for (id, _) in of(ChannelKind::Osmc, Mode::Duty) {
            commands.push(match (id == victim, id.index % 2 == 0) {
                // High enough that stopping counts as a stall.
                (true, _) => (id, Mode::Duty, 0.85 * sign),
                (false, true) => (id, Mode::Speed, 3.0 * sign),
                (false, false) => (id, Mode::Duty, 0.7 * sign),
            });
        }
        commands.extend(of(ChannelKind::Dhb, Mode::Duty).map(|(id, _)| (id, Mode::Duty, 0.8 * sign)));
        commands.extend(of(ChannelKind::Bldc, Mode::Duty).map(|(id, range)| (id, Mode::Duty, range.max)));
        for (id, range) in of(ChannelKind::Stepper, Mode::Speed) {
            // Away from the nearer end stop.
            let way = if bench.board.world().position(id).unwrap_or(0.0) > 0.0 { -0.8 } else { 0.8 };
            commands.push((id, Mode::Speed, way * range.max));
        }
        commands.extend(of(ChannelKind::Relay, Mode::Switch).map(|(id, _)| (id, Mode::Switch, 1.0)));
        let dacs = of(ChannelKind::Dac, Mode::Voltage);
        commands.extend(dacs.map(|(id, range)| (id, Mode::Voltage, 0.9 * range.max)));
        bench.set_all(commands).await?;
        Ok(self.retarget_servos(bench).await?)
    }

    async fn retarget_servos(self, bench: &Bench<'_>) -> Result<(), Error> {
        let there = |id| if bench.board.world().position(id).unwrap_or(0.0) > 0.0 { -0.75 } else { 0.75 };
        let servos = self.of(bench, ChannelKind::Servo, Mode::Position).into_iter();
        bench.set_all(servos.map(|(id, _)| (id, Mode::Position, there(id)))).await
    }
}

/// Checks that no output is safe before the injection, which would leave nothing to measure.
async fn check_moving(bench: &Bench<'_>) -> anyhow::Result<()> {
    let mut watch = StopWatch::new(bench.board);
    bench.sleep_ms(5).await;
    watch.look(bench.board);
    match Outputs::ALL.into_iter().find(|outputs| watch.safe_since_ns(*outputs).is_some()) {
        None => Ok(()),
        Some(outputs) => {
            let (state, causes) = bench.host.safety();
            bail!("`{outputs}` are safe before the injection; the board is {state}, causes {causes}")
        }
    }
}

fn print(
    report: &Report,
    measured: &[(Event, Measured)],
    robot: &Robot,
    groups: &[Group],
    markdown: bool,
) -> anyhow::Result<()> {
    let line = |(event, of): &(Event, Measured)| Line {
        cause: event.to_string(),
        injections: of.injections,
        brakes: event.braked_ms(&robot.config) > 0.0,
    };
    let lines: Vec<_> = measured.iter().map(line).collect();
    output::line(format_args!(
        "Longest time until outputs are safe / its limit, ms; {} (simulated), {} injections, seed {}",
        report.board, report.injections, report.seed
    ))?;
    report.print_outputs(&lines, markdown)?;
    output::line("*  guaranteed; the other limits follow from the board's configuration")?;
    output::line("-  out of reach: the chip or the bus that would be written does not answer")?;
    output::line("times count from the event; for an object, from the end of the echo that shows it")?;
    report.print_plants(&lines, groups, markdown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_event_stops_everything_in_time_and_only_the_seed_decides() {
        let robot = r4_boards::load("every-interface").unwrap();
        let run = || measure(&robot, 3, EVENTS.len() as u32, 0).unwrap();
        let measured = run();
        assert_eq!(measured.len(), EVENTS.len());
        for (event, of) in &measured {
            assert_eq!(of.wrong, 0, "{event}: {:?}", of.wrong_causes);
            for outputs in Outputs::ALL {
                let max_ms = of.max_ms[outputs as usize];
                let held = event.limit(outputs, &robot.config).is_none_or(|limit| max_ms <= limit.ms);
                assert!(held, "{event}: {outputs} after {max_ms} ms");
            }
        }
        let times = |measured: &[(Event, Measured)]| measured.iter().map(|(_, of)| of.max_ms).collect::<Vec<_>>();
        assert_eq!(times(&run()), times(&measured));
    }

    /// Compares one cause of each category: the same motors, braked and coasting.
    #[test]
    fn plants_are_followed_until_they_are_at_rest() {
        let robot = run_out::robot(r4_boards::load("every-interface").unwrap());
        let groups = groups(&robot);
        let place =
            |kind, brakes| groups.iter().position(|group| group.kind == kind && group.brakes == brakes).unwrap();
        let (braked, coasting) = (place(ChannelKind::Osmc, true), place(ChannelKind::Osmc, false));
        let ran = |event: Event| {
            on_board(&robot, 1, async |bench| {
                let progress = ProgressBar::hidden();
                let random = Pcg64::new(1, 1);
                Injections { bench, event, random, run_out: true, progress: &progress }.run(1).await
            })
            .unwrap()
            .groups
        };
        let (stop, handle) = (ran(Event::HostStop), ran(Event::DeadMan));
        for (event, ran) in [(Event::HostStop, &stop), (Event::DeadMan, &handle)] {
            assert_eq!(ran.len(), groups.len());
            for (group, ran) in groups.iter().zip(ran) {
                let row = Row::of_group(&event, group, ran, event.group_limit(group, &robot.config).unwrap());
                assert!(row.held, "{event}: {group}: {ran:?}");
            }
        }
        // Behind an open relay, the categories make no difference.
        assert!(stop[braked].rest_ms * 10.0 < stop[coasting].rest_ms, "{stop:?}");
        assert!(stop[braked].distance * 10.0 < handle[braked].distance, "{stop:?} {handle:?}");
    }
}
