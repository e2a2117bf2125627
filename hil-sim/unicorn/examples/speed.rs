//! Speed and activity of an emulated board: `cargo run --release -p r4-unicorn --example speed -- openscout 3
//! [thumb|unicorn] [registers]`.
//!
//! Connects, arms, drives every motor at constant duty for some virtual seconds, and prints simulated against real
//! time, the activity per virtual second, and a digest of all exceptions with their times: two versions of the emulator
//! with the same digest behaved identically.

use std::{cell::RefCell, env, error::Error, rc::Rc, time::Instant};

use r4_driver::with_board;
use r4_emu::{EmuBoard, Image};
use r4_mcu::cpu::Core;
use r4_protocol::{ChannelKind, Mode, Setpoint};
use r4_sim::{Simulation, VirtualBoard};
use r4_thumb::ThumbCore;
use r4_unicorn::UnicornCore;

/// Clock of the session: the simulation's time.
#[derive(Clone)]
struct HostClock(r4_sim::Clock);

impl r4_driver::Clock for HostClock {
    fn now_us(&self) -> u64 {
        self.0.now_ns() / 1000
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        self.0.sleep_until(at_us.saturating_mul(1000))
    }
}

/// Duty as a share of the supply; half of it lets every motor turn.
const DUTY: f32 = 0.5;
/// Telemetry period of each channel, ms.
const TELEMETRY_MS: u16 = 10;
/// Number of registers printed, those accessed most.
const REGISTERS: usize = 40;

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = env::args().skip(1);
    let name = args.next().unwrap_or_else(|| "openscout".into());
    let seconds: f64 = args.next().map_or(Ok(3.0), |text| text.parse())?;
    let words: Vec<String> = args.collect();
    let registers = words.iter().any(|word| word == "registers");
    if words.iter().any(|word| word == "thumb") {
        measure(&name, seconds, registers, ThumbCore::new())
    } else {
        measure(&name, seconds, registers, UnicornCore::new()?)
    }
}

fn measure<C: Core + 'static>(name: &str, seconds: f64, registers: bool, core: C) -> Result<(), Box<dyn Error>> {
    let robot = r4_boards::load(name)?;
    let image = Image::find(name)?;
    let mut simulation = Simulation::default();
    let board = Rc::new(EmuBoard::start(&mut simulation, &robot, 1, &image, core, None, Default::default())?);
    board.machine().start_trace();
    if registers {
        board.machine().chip.activity().count_registers();
    }
    let clock = simulation.clock();
    let port = board.connect().ok_or("the board is connected already")?;
    let heard = Rc::new(RefCell::new(0_u64));
    let begin = Instant::now();
    let result = simulation.block_on(with_board(port.rx, port.tx, HostClock(clock.clone()), async |session| {
        let mut telemetry = session.telemetry();
        for channel in session.channels() {
            session.subscribe(channel.id, TELEMETRY_MS).await?;
        }
        session.arm().await?;
        for channel in session.channels() {
            if matches!(channel.id.kind, ChannelKind::Dhb | ChannelKind::Osmc | ChannelKind::Actuator) {
                session.set(channel.id, Setpoint { mode: Mode::Duty, value: DUTY }).await?;
            }
        }
        let end_s = session.now_s() + seconds;
        while session.now_s() < end_s {
            session.sleep_s(0.1).await;
            while telemetry.try_next().is_some() {
                *heard.borrow_mut() += 1;
            }
        }
        session.disarm().await
    }));
    let wall_s = begin.elapsed().as_secs_f64();
    if let Some(failure) = board.failure() {
        return Err(failure.into());
    }
    result.ok_or("the simulation came to a standstill")???;

    let simulated_s = clock.now_ns() as f64 * 1e-9;
    let per_s = |count: u64| count as f64 / simulated_s;
    let mut machine = board.machine();
    println!("{name}: {simulated_s:.3} s in {wall_s:.3} s, {:.2} x real time", simulated_s / wall_s);
    println!("each virtual second:");
    println!("{:12.0} instructions", per_s(machine.instructions()));
    println!("{:12.0} runs of the core", per_s(machine.runs()));
    let trace = machine.trace().ok_or("no trace")?;
    println!("{:12.0} exceptions taken and left", per_s(trace.exceptions()));
    let activity = machine.chip.activity().clone();
    println!("{:12.0} polls of the outside", per_s(activity.polls));
    println!("{:12.0} beats of DMA", per_s(activity.beats));
    let (accesses, events) = activity.peripherals().fold((0, 0), |sum, (_, all, own)| (sum.0 + all, sum.1 + own));
    println!("{:12.0} accesses, {:.0} events", per_s(accesses), per_s(events));
    for (peripheral, all, own) in activity.peripherals().filter(|(_, all, own)| all + own > 0) {
        println!("{:12.0} accesses, {:8.0} events: {peripheral}", per_s(all), per_s(own));
    }
    let mut most: Vec<_> = activity.registers().collect();
    most.sort_by_key(|(_, count)| std::cmp::Reverse(count.reads + count.writes));
    for (address, count) in most.into_iter().take(REGISTERS) {
        println!("{:12.0} reads, {:8.0} writes: {address:#010x}", per_s(count.reads), per_s(count.writes));
    }
    let heard = heard.borrow();
    println!("digest {:016x}, {} instructions, {heard} telemetry frames", trace.hash(), machine.instructions());
    Ok(())
}
