//! Faults of the processor's crystal and supply: missing at the start, off its frequency, lost at run time; a dip.

use crate::emulated::{
    Setup,
    harness::{MS, ROTARY},
};
use r4_mcu::{Chip, peripherals::rcc::Oscillators};
use r4_protocol::{Causes, Mode, SafetyState};

/// Backup register with the clock source (see `reset.rs` of the firmware): 1 crystal, 2 internal oscillator.
const CLOCK_SOURCE: usize = 21;

/// Without a crystal the board starts from the internal oscillator, shows it by three flashes of red and blue, and
/// works normally.
#[test]
fn without_a_crystal_the_board_works_from_the_internal_oscillator_and_says_so() {
    let setup = Setup::osmc_bench().prepared(|board| board.machine().chip.rcc().fit_crystals(false, false));
    let (_, misuse) = setup.raw(async |host, device, board| {
        // The crystal's time-out is below 0.1 s; the flashes take 0.9 s.
        let (mut flashes, mut lit) = (0, false);
        for _ in 0..140 {
            let lights = board.lights();
            let now = lights.red && lights.blue;
            flashes += u32::from(now && !lit);
            lit = now;
            device.clock.sleep(10 * MS).await;
        }
        assert_eq!(flashes, 3);
        let info = host.hello().await;
        assert_eq!((info.state, info.causes), (SafetyState::Disarmed, Causes::NONE));
        assert_eq!(board.machine().chip.backup_register(CLOCK_SOURCE), Some(2));
        // The control loop runs at 1 kHz of true time, because the internal oscillator is exact in this test.
        let before = host.stats().await;
        host.listen(100).await;
        let after = host.stats().await;
        assert!((98..=104).contains(&(after.ticks - before.ticks)), "{} ticks in 0.1 s", after.ticks - before.ticks);
        assert_eq!(after.late_ticks, before.late_ticks);
    });
    assert_eq!(misuse, Vec::<String>::new());
}

/// With its crystal the board does not flash, and records that it has one.
#[test]
fn with_a_crystal_it_uses_it() {
    Setup::osmc_bench().bench(async |emu| {
        assert_eq!(emu.emulated.machine().chip.backup_register(CLOCK_SOURCE), Some(1));
        assert!(!emu.board.lights().red);
    });
}

/// Cheap crystals are within 100 ppm: bytes arrive, waits end, and the driver's clock map holds.
#[test]
fn a_crystal_that_is_100_ppm_off_does_no_harm() {
    for ppm in [-100_i64, 100] {
        let drift = move |hz: u64| hz.saturating_add_signed(hz as i64 * ppm / 1_000_000);
        let setup = Setup::osmc_bench().prepared(move |board| {
            let exact = Oscillators::default();
            board.machine().chip.rcc().set_oscillators(Oscillators { hse_hz: drift(exact.hse_hz), ..exact });
        });
        setup.bench(async |emu| {
            let begin = (emu.clock.now_ns(), emu.host.stats().await.expect("it answers").ticks);
            let mut stream = emu.host.telemetry();
            emu.host.subscribe(ROTARY, 10).await.expect("there is room");
            emu.host.arm().await.expect("nothing is wrong");
            emu.set(ROTARY, Mode::Speed, 2.0).await.expect("fresh by the board's clock too");
            emu.sleep_ms(2000).await;
            assert_eq!(emu.safety().await, (SafetyState::Armed, Causes::NONE));
            // The driver's estimate of the board's clock is compared with the latest sample, which is at most 10 ms old
            // and was 1 ms on its way.
            let sample = std::iter::from_fn(|| stream.try_next()).last().expect("samples come");
            let behind_us = emu.host.device_us().saturating_sub(sample.device_us);
            assert!(behind_us < 13_000, "{ppm} ppm: {behind_us} us between the clocks");
            // The board's seconds are longer or shorter than true ones: in two of them by 200 µs, a fifth of a tick.
            let ticks = f64::from(emu.host.stats().await.expect("it answers").ticks - begin.1);
            let expected = (emu.clock.now_ns() - begin.0) as f64 / 1e6 * (1.0 + ppm as f64 * 1e-6);
            assert!((ticks - expected).abs() < 3.0, "{ppm} ppm: {ticks} ticks, {expected} expected");
            assert_eq!(emu.host.bad_frames(), 0);
            let speed = emu.board.world().speed(ROTARY).expect("the bench has it");
            assert!((speed - 2.0).abs() < 0.3, "{ppm} ppm: {speed} rad/s");
        });
    }
}

/// The crystal stops at run time: the board restarts from the internal oscillator, whatever the firmware does at once.
#[test]
fn a_crystal_that_stops_at_run_time_ends_in_a_start_from_the_internal_oscillator() {
    let setup = Setup::osmc_bench();
    setup.raw(async |host, device, board| {
        host.hello().await;
        board.stop_crystal_at(device.clock.now_ns() + MS);
        // The wait covers the watchdog, the crystal's time-out and the flashes.
        device.clock.sleep(3_000 * MS).await;
        assert_eq!(board.machine().chip.backup_register(CLOCK_SOURCE), Some(2));
        assert_eq!(board.machine().chip.core_hz(), 480_000_000);
        host.bad_frames = 0;
        host.hello().await;
    });
}

/// The processor's supply sags below the brown-out level of its option bytes: the processor is reset, stays in reset,
/// and starts again.
#[test]
fn a_dip_of_the_supply_restarts_the_processor() {
    // Option bytes as the Giga is delivered, but with BOR_LEV 3.
    let setup = Setup::osmc_bench().prepared(|board| board.machine().chip.set_option_bytes(0x0B86_AAFC));
    setup.raw(async |host, device, board| {
        host.hello().await;
        let (now_ns, executed) = (device.clock.now_ns(), board.machine().instructions());
        board.dip_supply(now_ns + MS, 2.5, 50 * MS);
        device.clock.sleep(40 * MS).await;
        let held = board.machine().instructions();
        device.clock.sleep(10 * MS).await;
        assert_eq!(board.machine().instructions(), held, "held in reset");
        assert!(held > executed);
        device.clock.sleep(500 * MS).await;
        host.bad_frames = 0;
        let info = host.hello().await;
        assert!(info.device_us < 600_000, "its clock began anew: {} us", info.device_us);
    });
}
