//! Outputs after a reset of the processor, which their chips do not notice: every kind of output is made safe within a
//! few milliseconds, however the run ended and whether the crystal starts or not. Firmware that fails again and again
//! holds them safe, and reports the reason.

use crate::emulated::{
    BOOT_MS, Board, Emu, Setup,
    harness::{Device, MS, RawHost, US},
};
use r4_emu::fault::{Fault, Lasting};
use r4_mcu::{Level, Pin, peripherals::rcc::Oscillators};
use r4_protocol::{Cause, Causes, ChannelId, ChannelKind, Mode, Refusal, Reply, Request, SafetyState};
use r4_sim::{
    i2c::Disturbance,
    stop::{Outputs, StopWatch},
};

/// Backup register with the number of bad starts in its low half (see `reset.rs` of the firmware).
const BAD_STARTS: usize = 22;
/// Number of successive bad starts that lead to hold mode; as many more lead to hold mode without links.
const HOLD: u32 = 3;
/// Longest period of the watchdog, ns: that after a reset, 4096 times 4 cycles of 32 kHz.
const LONGEST_WATCHDOG_NS: u64 = 512 * MS;
/// Time limit from the reset to safe outputs, ns: start-up's clearing of 100 KB (0.5 ms at the emulator's 240 million
/// instructions a second), reading the configuration, and the sweep of five chips at 400 kHz.
const SWEPT_NS: u64 = 5 * MS;

const fn channel(kind: ChannelKind, index: u8) -> ChannelId {
    ChannelId::new(kind, index)
}

/// Moves everything, on a board with each kind of output.
async fn move_everything(emu: &Emu<'_>) {
    emu.host.arm().await.expect("nothing is wrong");
    emu.sleep_ms(60).await;
    for (channel, mode, value) in [
        (channel(ChannelKind::Osmc, 0), Mode::Duty, 0.4),
        (channel(ChannelKind::Dhb, 1), Mode::Duty, 0.5),
        (channel(ChannelKind::Bldc, 3), Mode::Duty, 0.5),
        (channel(ChannelKind::Dac, 1), Mode::Voltage, 1.0),
        (channel(ChannelKind::Stepper, 0), Mode::Speed, 10.0),
        (channel(ChannelKind::Servo, 5), Mode::Position, 0.7),
    ] {
        emu.set(channel, mode, value).await.expect("armed");
    }
    emu.sleep_ms(100).await;
    assert_eq!(emu.safety().await.0, SafetyState::Armed);
}

/// Returns the chip's level at DISABLE of the bridges; it floats during reset and until the firmware claims it.
fn disable(board: &Board) -> Level {
    let carrier = r4_boards::load_carrier("r4-carrier").expect("built in");
    let pin = carrier.pin("osmc_dis").expect("it has it").stm32;
    board.machine().chip.gpio().driven(Pin::new(pin.port, pin.number))
}

fn is_floating(board: &Board) -> bool {
    matches!(disable(board), Level::Floating(_))
}

/// Waits for the next reset; returns its time, accurate to 20 µs.
async fn next_reset(device: &Device, board: &Board, limit_ns: u64) -> u64 {
    let since_ns = device.clock.now_ns();
    while !is_floating(board) {
        assert!(device.clock.now_ns() < since_ns + limit_ns, "no reset within {} ms", limit_ns / MS);
        device.clock.sleep(20 * US).await;
    }
    device.clock.now_ns()
}

/// Injects a fault while everything moves, and measures the time from the following reset until each kind of output is
/// safe, ns.
fn after_reset(name: &str, setup: &Setup, fault: Fault, without_crystal: bool) -> u64 {
    let (worst_ns, _) = setup.bench_with_misuse(async |emu| {
        move_everything(emu).await;
        let (device, board) = (emu.device(), &emu.emulated);
        if without_crystal {
            board.lose_crystal_at_reset();
        }
        board.inject(fault, Lasting::UntilReset).expect("the image has it");
        let reset_ns = next_reset(&device, board, 30 * MS).await;
        let mut watch = StopWatch::new(&emu.board);
        while device.clock.now_ns() < reset_ns + 120 * MS {
            device.clock.sleep(20 * US).await;
            watch.look(&emu.board);
        }
        let mut worst_ns = 0;
        let mut told = String::new();
        for outputs in Outputs::ALL {
            let safe_ns = watch.safe_since_ns(outputs).unwrap_or_else(|| panic!("{name}: {outputs} never safe"));
            let after_ns = safe_ns.saturating_sub(reset_ns);
            told += &format!("{outputs} {:.2}; ", after_ns as f64 / 1e6);
            worst_ns = worst_ns.max(after_ns);
        }
        eprintln!("{name}, ms after the reset: {told}");
        worst_ns
    });
    worst_ns
}

#[test]
fn every_output_is_safe_right_after_a_reset() {
    let setup = || Setup::new("every-interface");
    for (name, fault, without_crystal) in [
        ("watchdog", Fault::SupervisorHangs, false),
        ("hard fault", Fault::UndefinedInstruction, false),
        ("watchdog, and the crystal does not start again", Fault::SupervisorHangs, true),
    ] {
        let worst_ns = after_reset(name, &setup(), fault, without_crystal);
        assert!(worst_ns <= SWEPT_NS, "{name}: {worst_ns} ns");
    }
}

/// The processor's own analog outputs keep the sweep's values during the rest of the boot. They are sampled so often
/// that a reset of the converter would show.
#[test]
fn analog_outputs_keep_their_safe_voltage_through_the_boot() {
    Setup::new("every-interface").bench_with_misuse(async |emu| {
        move_everything(emu).await;
        let (device, board) = (emu.device(), &emu.emulated);
        board.inject(Fault::UndefinedInstruction, Lasting::UntilReset).expect("the image has it");
        let reset_ns = next_reset(&device, board, 30 * MS).await;
        device.clock.sleep(SWEPT_NS).await;
        let safe_v: Vec<_> =
            board.robot().config.dacs.iter().map(|dac| (dac.id.index, f64::from(dac.safe_v))).collect();
        assert!(safe_v.iter().any(|(_, volts)| *volts > 0.5), "one that a reset does not make safe");
        while device.clock.now_ns() < reset_ns + BOOT_MS * MS {
            device.clock.sleep(US).await;
            for (index, safe_v) in &safe_v {
                let volts = board.world().pins().dac_v(usize::from(*index)).expect("it has two");
                let after_us = (device.clock.now_ns() - reset_ns) / US;
                assert!((volts - safe_v).abs() < 0.001, "dac{index} at {volts} V, {after_us} us after the reset");
            }
        }
    });
}

/// A chip that was sending at the processor's reset holds the data line; the sweep clocks it free. A chip that does not
/// answer at all does not keep the others from being written.
#[test]
fn a_held_bus_is_freed_and_a_silent_chip_is_left_out() {
    for disturbance in [Disturbance::StuckLow { persistent: false }, Disturbance::AddressNack] {
        Setup::new("every-interface").bench_with_misuse(async |emu| {
            move_everything(emu).await;
            let (device, board) = (emu.device(), &emu.emulated);
            board.inject(Fault::SupervisorHangs, Lasting::UntilReset).expect("the image has it");
            let reset_ns = next_reset(&device, board, 30 * MS).await;
            device.inject(disturbance, r4_sim::i2c::Span::Transfers { count: 1 });
            let mut watch = StopWatch::new(&emu.board);
            let all_safe = device
                .wait_until(reset_ns, SWEPT_NS, || {
                    watch.look(&emu.board);
                    Outputs::ALL.into_iter().all(|outputs| watch.safe_since_ns(outputs).is_some())
                })
                .await;
            let all_safe = all_safe.unwrap_or_else(|| panic!("{disturbance:?}: not safe"));
            eprintln!("{disturbance:?}: all safe {:.2} ms after the reset", all_safe as f64 / 1e6);
        });
    }
}

fn bad_starts(board: &Board) -> u32 {
    board.machine().chip.backup_register(BAD_STARTS).expect("0 to 31") & 0xFFFF
}

/// Asserts that the board is in hold mode and reports the reason.
async fn is_held(host: &mut RawHost, device: &Device, board: &Board) {
    host.listen(100).await;
    host.bad_frames = 0;
    let info = host.hello().await;
    assert_eq!((info.state, info.causes), (SafetyState::Tripped, Causes::only(Cause::RepeatedBadStarts)));
    assert_eq!(&info.robot[..], "every-interface");
    for request in [Request::Arm, Request::Clear] {
        let refused = host.ask(request.clone()).await;
        assert!(matches!(refused, Err(Refusal::CausesPresent { .. })), "{request:?}: {refused:?}");
    }
    assert!(matches!(host.ask(Request::Describe { index: 0 }).await, Ok(Reply::Channel(_))));
    assert!(matches!(host.ask(Request::Stats).await, Ok(Reply::Stats(_))));
    let mut watch = StopWatch::new(&device.board);
    device.clock.sleep(MS).await;
    watch.look(&device.board);
    for outputs in Outputs::ALL {
        assert!(watch.safe_since_ns(outputs).is_some(), "{outputs}");
    }
    assert_eq!(disable(board), Level::High);
}

/// The supervisor hangs at once at every start: after three bad starts the board holds its outputs and reports the
/// reason; a chip that lost its settings is written again; a host's restart leaves hold mode.
#[test]
fn firmware_that_hangs_at_every_start_holds_outputs_safe_and_says_why() {
    let setup = Setup::new("every-interface");
    let _ = setup.raw(async |host, device, board| {
        let patch = board.inject(Fault::SupervisorHangs, Lasting::Always).expect("the image has it");
        for start in 1..=HOLD {
            next_reset(device, board, LONGEST_WATCHDOG_NS).await;
            device.clock.sleep(SWEPT_NS).await;
            assert_eq!(bad_starts(board), start);
        }
        device.clock.sleep(100 * MS).await;
        is_held(host, device, board).await;
        // The DAC loses its supply meanwhile.
        assert!(board.world().brown_out(r4_sim::world::BoardChip::BldcDac), "it has it");
        // Hold mode has no time limit: the watchdog does not reset the board, and only the red light flashes.
        let mut seen = [false; 2];
        for _ in 0..100 {
            device.clock.sleep(20 * MS).await;
            let lights = board.lights();
            seen[usize::from(lights.red)] = true;
            assert!(!is_floating(board) && !lights.green && !lights.blue);
        }
        assert_eq!((seen, bad_starts(board)), ([true; 2], HOLD));
        is_held(host, device, board).await;
        // The fault is removed, as by flashing another image.
        patch.undo(&mut board.machine()).expect("code is in memory");
        host.ask(Request::Restart).await.expect("it is not armed");
        next_reset(device, board, 100 * MS).await;
        device.clock.sleep(1500 * MS).await;
        host.listen(100).await;
        host.bad_frames = 0;
        let info = host.hello().await;
        assert_eq!((info.state, bad_starts(board)), (SafetyState::Disarmed, 0), "{}", info.causes);
    });
}

/// Hold mode continues without time driver and links if one of them hangs too.
#[test]
fn hold_mode_that_hangs_too_goes_on_alone() {
    let setup = Setup::new("every-interface");
    let _ = setup.raw(async |_, device, board| {
        for fault in [Fault::SupervisorHangs, Fault::LinksHang] {
            board.inject(fault, Lasting::Always).expect("the image has it");
        }
        for start in 1..=2 * HOLD {
            next_reset(device, board, LONGEST_WATCHDOG_NS).await;
            device.clock.sleep(SWEPT_NS).await;
            assert_eq!(bad_starts(board), start);
        }
        let mut watch = StopWatch::new(&device.board);
        for _ in 0..100 {
            device.clock.sleep(20 * MS).await;
            watch.look(&device.board);
            assert!(Outputs::ALL.into_iter().all(|outputs| watch.safe_since_ns(outputs).is_some()));
            assert_eq!(disable(board), Level::High);
        }
        assert_eq!(bad_starts(board), 2 * HOLD);
    });
}

/// A single bad end does not lead to hold mode: it is forgotten after ten seconds.
#[test]
fn bad_starts_are_forgotten_when_the_board_has_run_well() {
    Setup::osmc_bench().raw(async |host, device, board| {
        for _ in 0..HOLD {
            board.inject(Fault::UndefinedInstruction, Lasting::UntilReset).expect("the image has it");
            next_reset(device, board, 30 * MS).await;
            device.clock.sleep(200 * MS).await;
            assert_eq!(bad_starts(board), 1);
            device.clock.sleep(10_000 * MS).await;
            assert_eq!(bad_starts(board), 0);
        }
        host.listen(100).await;
        host.bad_frames = 0;
        assert_eq!(host.hello().await.causes, Causes::only(Cause::WatchdogReset));
    });
}

/// Timers that run too fast or too slow against the independent oscillator: the watchdog's window detects them.
#[test]
fn a_crystal_of_another_frequency_is_found_by_the_watchdogs_window() {
    // The crystal's nominal frequency is 16 MHz.
    for hse_hz in [11_000_000, 20_000_000] {
        Setup::osmc_bench().raw(async |_, device, board| {
            device.clock.sleep(100 * MS).await;
            let exact = Oscillators::default();
            board.machine().chip.drift(Oscillators { hse_hz, ..exact });
            let since_ns = device.clock.now_ns();
            let reset_ns = next_reset(device, board, 30 * MS).await;
            eprintln!("crystal at {hse_hz} Hz: reset after {:.1} ms", (reset_ns - since_ns) as f64 / 1e6);
        });
    }
}

/// The crystal stops while everything moves: the clock security system stops the outputs at once, and the board
/// restarts from its internal oscillator and reports the reason.
#[test]
fn a_crystal_that_stops_at_run_time_stops_everything_and_is_told() {
    Setup::new("every-interface").bench_with_misuse(async |emu| {
        move_everything(emu).await;
        let (device, board) = (emu.device(), &emu.emulated);
        let mut watch = StopWatch::new(&emu.board);
        let stops_ns = device.clock.now_ns() + 100 * US;
        board.stop_crystal_at(stops_ns);
        device.clock.sleep(100 * US).await;
        while device.clock.now_ns() < stops_ns + 60 * MS {
            device.clock.sleep(20 * US).await;
            watch.look(&emu.board);
        }
        let mut told = String::new();
        for outputs in Outputs::ALL {
            let after_ns = watch.safe_since_ns(outputs).unwrap_or_else(|| panic!("{outputs}")).saturating_sub(stops_ns);
            told += &format!("{outputs} {:.2}; ", after_ns as f64 / 1e6);
            assert!(after_ns <= SWEPT_NS, "{outputs}: {after_ns} ns");
        }
        eprintln!("crystal stops, ms: {told}");
        // Clock source 2: the board runs from the internal oscillator.
        assert_eq!(board.machine().chip.backup_register(21), Some(2));
    });
}

/// State of the board after that, for a host that connects anew.
#[test]
fn a_stopped_crystal_is_the_cause_of_the_next_start() {
    Setup::osmc_bench().raw(async |host, device, board| {
        board.stop_crystal_at(device.clock.now_ns() + 100 * US);
        device.clock.sleep(200 * MS).await;
        host.listen(100).await;
        host.bad_frames = 0;
        let info = host.hello().await;
        assert_eq!((info.state, info.causes), (SafetyState::Tripped, Causes::only(Cause::ClockFault)));
        assert_eq!(host.ask(Request::Clear).await, Ok(Reply::Done));
        assert_eq!(host.ask(Request::Arm).await, Ok(Reply::Done));
    });
}

/// The processor's 3.3 V supply sags: the stop lines follow within microseconds and the chips are written while the
/// processor runs; while the rail is low the trip cannot be cleared.
#[test]
fn a_sagging_supply_stops_the_board_before_it_resets() {
    Setup::osmc_bench().raw(async |host, device, board| {
        let info = host.hello().await;
        host.ask(Request::Arm).await.expect("nothing is wrong");
        let session = info.session;
        let heartbeat = r4_protocol::ToDevice::Heartbeat { session, host_us: 0 };
        let dips_ns = device.clock.now_ns() + MS;
        board.dip_supply(dips_ns, 2.7, 100 * MS);
        device.clock.sleep(MS + 10 * US).await;
        assert_eq!(disable(board), Level::High, "10 us later");
        host.send(&heartbeat).await;
        host.listen(20).await;
        let refused = host.ask(Request::Clear).await;
        let low = Causes::only(Cause::SupplyOutOfRange);
        assert_eq!(refused, Err(Refusal::CausesPresent { causes: low }));
        host.send(&heartbeat).await;
        host.listen(100).await;
        assert_eq!(host.ask(Request::Clear).await, Ok(Reply::Done));
        assert_eq!(host.ask(Request::Arm).await, Ok(Reply::Done));
    });
}

/// A brown-out with the level that docs/bring-up.md sets: the processor is reset, and every output is safe right after
/// the supply returns.
#[test]
fn after_a_brown_out_every_output_is_safe() {
    Setup::new("every-interface").bench_with_misuse(async |emu| {
        move_everything(emu).await;
        let (device, board) = (emu.device(), &emu.emulated);
        let mut watch = StopWatch::new(&emu.board);
        let dips_ns = device.clock.now_ns() + MS;
        // Without a brown-out level the chip runs on down to 1.6 V.
        board.dip_supply(dips_ns, 1.5, 2 * MS);
        let back_ns = dips_ns + 2 * MS;
        while device.clock.now_ns() < back_ns + 60 * MS {
            device.clock.sleep(20 * US).await;
            watch.look(&emu.board);
        }
        for outputs in Outputs::ALL {
            let after_ns = watch.safe_since_ns(outputs).unwrap_or_else(|| panic!("{outputs}")).saturating_sub(back_ns);
            assert!(after_ns <= SWEPT_NS, "{outputs}: {after_ns} ns");
        }
    });
}

/// Time from power-on to the end of the first write to each chip; with a crystal that does not start, it is the same.
#[test]
fn chips_are_written_before_anything_else_is_done() {
    // This board's servos hold when safe, so their chip is left alone.
    const CHIPS: [(&str, u8); 4] = [("expander", 0x20), ("DAC", 0x60), ("OSMC PWM", 0x40), ("DHB PWM", 0x41)];
    for crystal in [true, false] {
        let setup = Setup::new("every-interface").prepared(move |board| {
            board.machine().chip.rcc().fit_crystals(crystal, true);
            board.world().bus.set_trace(100_000);
        });
        let _ = setup.raw(async |_, device, _| {
            device.clock.sleep(1500 * MS).await;
            let mut told = String::new();
            for (chip, address) in CHIPS {
                let mut records = device.wire_since(0);
                let first = records.find(|record| record.address == address && record.read.is_empty());
                let end_ns = first.expect("each is written").end_ns;
                told += &format!("{chip} {:.2}; ", end_ns as f64 / 1e6);
                assert!(end_ns <= SWEPT_NS, "{chip}: {end_ns} ns, crystal {crystal}");
            }
            eprintln!("first written, ms after power-on, crystal {crystal}: {told}");
        });
    }
}
