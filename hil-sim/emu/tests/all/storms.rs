//! Edge storms on the lines with interrupts above the supervisor: encoder 3, the four echoes and the dead-man's handle.
//! A loose wire beside a motor's leads makes millions of edges a second.
//!
//! The tests print the measured times and instructions (`--nocapture`).

use crate::emulated::{
    Emu, Setup,
    harness::{Device, MS, US},
};
use r4_mcu::Settings;
use r4_protocol::{Cause, ChannelId, ChannelKind, Mode, SafetyState};
use r4_sim::sensors::{interference::SquareWave, quadrature::Channel};

/// Time limit of the relays' write, which switches off the motors' supply, ns.
const RELAYS_NS: u64 = MS;
/// Time limit from the handle's edge to DISABLE, as in `stops.rs`, ns.
const LINE_NS: u64 = 100 * US;
/// Interval between edges of the wave, ns: more edges than the processor can handle one by one at the emulator's 240
/// million instructions a second, 67 for each.
const EDGE_NS: u64 = 200;
/// Interval between edges at echoes 0 and 1, ns: their timer's filter passes nothing faster than 267 ns.
const FILTERED_EDGE_NS: u64 = 300;
const STORM_NS: u64 = 100 * MS;
/// Longest time until the chip polls its lines again and then sees the wave, ns.
const AHEAD_NS: u64 = 2 * MS;
/// Recovery time: a masked line is tried again after a second, and then each range sensor needs its turn of 60 ms for a
/// measurement.
const OVER_MS: u64 = 1800;

/// Returns the share of all that the emulator executes in `ms`, in percent. Instructions are no cycles of the processor,
/// so this is not its share of a real one's time.
fn percent(instructions: u64, ms: u64) -> f64 {
    let all = Settings::default().instructions_per_second * ms / 1000;
    100.0 * instructions as f64 / all as f64
}

/// Line with an interrupt.
#[derive(Clone, Copy, Debug)]
enum Line {
    Track(Channel),
    Echo(usize),
}

const LINES: [Line; 6] =
    [Line::Track(Channel::A), Line::Track(Channel::B), Line::Echo(0), Line::Echo(1), Line::Echo(2), Line::Echo(3)];

const MOTOR: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);

/// Couples square waves into `lines`; returns the time at which they begin, ns.
fn storm(device: &Device, lines: &[Line]) -> u64 {
    let from_ns = device.clock.now_ns() + AHEAD_NS;
    let wave = |half_period_ns| SquareWave { from_ns, until_ns: from_ns + STORM_NS, half_period_ns };
    let mut world = device.board.world();
    for line in lines {
        match *line {
            Line::Track(track) => world.pins().encoders[3].set_interference(track, wave(EDGE_NS)),
            Line::Echo(sensor @ ..2) => {
                world.pins().rangers.modules[sensor].set_interference(wave(FILTERED_EDGE_NS));
            }
            Line::Echo(sensor) => world.pins().rangers.modules[sensor].set_interference(wave(EDGE_NS)),
        }
    }
    from_ns
}

/// Iterates over the cases: all lines at once, then each alone.
fn cases() -> impl Iterator<Item = Vec<Line>> {
    std::iter::once(LINES.to_vec()).chain(LINES.map(|line| vec![line]))
}

async fn run(emu: &Emu<'_>) {
    emu.host.arm().await.expect("nothing is wrong yet");
    emu.set(MOTOR, Mode::Duty, 0.5).await.expect("armed");
    emu.sleep_ms(100).await;
    assert!(!emu.is_off(MOTOR), "nothing to stop");
}

/// Returns the end of the first write to the port expander after `since_ns`, relative to it, ns.
fn relays_written(device: &Device, since_ns: u64) -> Option<u64> {
    let written = device.wire_since(since_ns).find(|record| {
        record.address == 0x20 && record.read.is_empty() && record.fault.is_none() && !record.written.is_empty()
    });
    written.map(|record| record.end_ns - since_ns)
}

/// A storm alone: the outputs are off, its cause is raised, and the host hears from the board while it lasts.
#[test]
fn a_storm_trips_and_the_board_goes_on() {
    let mut worst_ns = 0;
    Setup::new("every-interface").bench(async |emu| {
        let device = emu.device();
        for lines in cases() {
            run(emu).await;
            let begins_ns = storm(&device, &lines);
            let until_ns = AHEAD_NS + STORM_NS;
            let off_ns = device.wait_until(begins_ns - AHEAD_NS, until_ns, || device.is_off(MOTOR)).await;
            let off_ns = off_ns.and_then(|off_ns| off_ns.checked_sub(AHEAD_NS)).expect("off, and by the storm");
            worst_ns = worst_ns.max(off_ns);
            // The request is answered in the middle of the storm.
            let stats = emu.host.stats().await.expect("the board answers");
            emu.sleep_ms(20).await;
            let ticks = emu.host.stats().await.expect("the board answers").ticks.wrapping_sub(stats.ticks);
            assert!(emu.clock.now_ns() < begins_ns + STORM_NS, "{lines:?}: still in the storm");
            assert!((20..=30).contains(&ticks), "{lines:?}: {ticks} control ticks in 20 ms and an answer");
            let (state, causes) = emu.safety().await;
            assert!(state == SafetyState::Tripped && causes.contains(Cause::InterruptStorm), "{lines:?}: {causes}");
            let refused = emu.host.clear().await;
            assert!(refused.is_err(), "{lines:?}: edges are lost yet");
            emu.sleep_ms(OVER_MS).await;
            emu.host.clear().await.expect("the storm is over");
        }
    });
    eprintln!("storm: off after at most {} us", worst_ns / US);
    // The masked line is noticed in the next period, and the cause at the supervisor's next pass.
    assert!(worst_ns <= 2 * MS + LINE_NS);
}

/// The handle is released at moments around the beginning of a storm on all lines: while their interrupts still have
/// their budgets, and when they are masked.
#[test]
fn a_released_handle_stops_in_a_storm() {
    let (mut worst_off_ns, mut worst_relays_ns) = (0, 0);
    Setup::new("every-interface").bench(async |emu| {
        let device = emu.device();
        for after_ns in [0, 3 * US, 10 * US, 30 * US, 200 * US, 700 * US] {
            run(emu).await;
            device.record_wire();
            let begins_ns = storm(&device, &LINES);
            emu.clock.sleep_until(begins_ns + after_ns).await;
            let at_ns = emu.clock.now_ns();
            emu.board.dead_man().set(false);
            let off_ns = device.wait_until(at_ns, STORM_NS, || device.is_off(MOTOR)).await;
            worst_off_ns = worst_off_ns.max(off_ns.expect("the handle stops it in the end"));
            // The storm itself may have opened the relays before.
            let written = || relays_written(&device, begins_ns);
            device.wait_until(at_ns, STORM_NS, || written().is_some()).await.expect("relays are written in the end");
            worst_relays_ns = worst_relays_ns.max(written().unwrap_or(u64::MAX).saturating_sub(after_ns));
            assert!(emu.safety().await.1.contains(Cause::DeadMan));
            emu.board.dead_man().set(true);
            emu.sleep_ms(OVER_MS).await;
            emu.host.clear().await.expect("the storm is over");
        }
    });
    eprintln!("in a storm: off after at most {} us, relays written {} us", worst_off_ns / US, worst_relays_ns / US);
    assert!(worst_off_ns <= LINE_NS && worst_relays_ns <= RELAYS_NS);
}

/// Lines that no channel of the robot uses make no interrupts.
#[test]
fn an_unused_line_makes_no_interrupts() {
    let setup = Setup::new("osmc-bench").prepared(|board| board.start_measuring().expect("the image has its symbols"));
    setup.bench(async |emu| {
        run(emu).await;
        let urgent = |emu: &Emu<'_>| -> u64 {
            let shares = emu.emulated.stack().expect("measured").shares;
            shares.iter().filter(|share| share.level.is_some_and(|level| level <= 1)).map(|share| share.entries).sum()
        };
        let begins_ns = storm(&emu.device(), &LINES);
        emu.clock.sleep_until(begins_ns).await;
        let before = urgent(emu);
        emu.clock.sleep(20 * MS).await;
        // Only alarms of embassy's time remain, a few per millisecond.
        let entries = urgent(emu) - before;
        assert!(entries < 200, "{entries} interrupts above the supervisor in 20 ms");
        assert_eq!(emu.safety().await.0, SafetyState::Armed);
    });
}

/// The handle is released and held every 10 µs: it stops the board at once, and costs the supervisor two passes per
/// millisecond.
#[test]
fn a_chattering_handle_leaves_the_processor_to_others() {
    let setup = Setup::new("osmc-bench").prepared(|board| board.start_measuring().expect("the image has its symbols"));
    setup.bench(async |emu| {
        run(emu).await;
        let supervisor = |emu: &Emu<'_>| {
            let shares = emu.emulated.stack().expect("measured").shares;
            let share = shares.into_iter().find(|share| share.who == "supervisor").expect("it runs");
            (share.instructions, share.entries)
        };
        let before = supervisor(emu);
        for _ in 0..1000 {
            emu.board.dead_man().set(false);
            emu.clock.sleep(10 * US).await;
            emu.board.dead_man().set(true);
            emu.clock.sleep(10 * US).await;
        }
        let after = supervisor(emu);
        let (instructions, entries) = (after.0 - before.0, after.1 - before.1);
        let share = percent(instructions, 20);
        eprintln!(
            "dead-man's handle, 100 000 edges a second for 20 ms: {instructions} instructions in {entries} looks, \
             {share:.2} %"
        );
        assert!(emu.safety().await.1.contains(Cause::DeadMan));
        assert!(share <= 1.0, "{share} %");
        emu.sleep_ms(25).await;
        emu.host.clear().await.expect("held");
    });
}

/// Cost of one edge, and of all budgets together: `docs/performance.md`.
#[test]
fn the_budgets_are_a_small_share_of_the_processor() {
    let setup =
        Setup::new("every-interface").prepared(|board| board.start_measuring().expect("the image has its symbols"));
    setup.bench(async |emu| {
        let device = emu.device();
        let urgent = |emu: &Emu<'_>| {
            let shares = emu.emulated.stack().expect("measured").shares;
            let urgent = shares.iter().filter(|share| share.level.is_some_and(|level| level <= 1));
            urgent.fold((0, 0), |(instructions, entries), share| {
                (instructions + share.instructions, entries + share.entries)
            })
        };
        let mut all = 0;
        for lines in cases() {
            let begins_ns = storm(&device, &lines);
            emu.clock.sleep_until(begins_ns - US).await;
            let before = urgent(emu);
            emu.clock.sleep(MS).await;
            let after = urgent(emu);
            let (instructions, entries) = (after.0 - before.0, after.1 - before.1);
            let share = percent(instructions, 1);
            eprintln!("{lines:?}: {instructions} instructions, {share:.1} %, in {entries} interrupts in the first ms");
            all = all.max(instructions);
            emu.sleep_ms(OVER_MS).await;
        }
        // The end of one budget and the beginning of the next may meet in a millisecond, which is twice this.
        assert!(percent(all, 1) <= 10.0, "{all} instructions");
    });
}
