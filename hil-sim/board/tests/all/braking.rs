//! Stops that brake before they switch off (IEC 60204-1, category 1): which outputs brake, for how long, and which
//! causes end the braking at once.

use crate::harness::{Bench, Device, LINEAR, MS, ROTARY, US, bench, bench_left_alone, bench_with_misuse, osmc_bench};
use r4_boards::Robot;
use r4_protocol::{Cause, Causes, ChannelId, ChannelKind, Mode, SafetyState};
use r4_sim::i2c::Disturbance;

/// Braking time in the bench's file, ns.
const BRAKE_NS: u64 = 500 * MS;
/// Period of the supervisor, ns.
const SUPERVISOR_NS: u64 = MS;
/// Promised time until all motor channels are written, ns.
const WRITTEN_NS: u64 = 5 * MS;
const POWER: ChannelId = ChannelId::new(ChannelKind::Relay, 0);

fn braking_bench() -> Robot {
    r4_boards::load("osmc-bench").expect("built in")
}

const fn channel(kind: ChannelKind, index: u8) -> ChannelId {
    ChannelId::new(kind, index)
}

/// True if both terminals are on one rail, neither driven nor open.
fn is_shorted(device: &Device, channel: ChannelId) -> bool {
    let drive = device.board.world().drive(channel).expect("a motor");
    drive.duty == 0.0 && drive.coast == 0.0
}

fn has_power(device: &Device) -> bool {
    device.board.world().relay_closed(POWER).expect("the bench has the relay")
}

/// Time, ns, and travel, rad, until the rotary motor is slower than 0.05 rad/s.
async fn run_out(device: &Device) -> (u64, f64) {
    let from = device.board.world().position(ROTARY).expect("a motor");
    let since_ns = device.clock.now_ns();
    let slow = || device.board.world().speed(ROTARY).expect("a motor").abs() < 0.05;
    let rest_ns = device.wait_until(since_ns, 20_000 * MS, slow).await.expect("friction stops it");
    (rest_ns, device.board.world().position(ROTARY).expect("a motor") - from)
}

/// Runs the rotary motor at the highest speed of the bench.
async fn run_fast(bench: &Bench<'_>) {
    bench.run_rotary(0).await;
    bench.set(ROTARY, Mode::Duty, 0.9).await.expect("armed");
    bench.sleep_ms(500).await;
}

/// The electrical time constant of the shorted motor is 70 ms, that of its bearing 2.2 s: after a category 0 stop it
/// turns on for ten seconds.
#[test]
fn a_silent_host_leaves_a_braked_shaft_and_not_a_coasting_one() {
    let ran_out = |robot: &Robot| {
        bench_left_alone(robot, run_fast, async |device, ()| {
            let tripped = || device.board.lights().red;
            let since_ns = device.clock.now_ns();
            // the timeout and 2 ms, plus a heartbeat that may still be in the cable
            let limit_ns = u64::from(robot.config.link_timeout_ms) * MS + 2 * MS + MS / 4;
            device.wait_until(since_ns, limit_ns, tripped).await.expect("tripped in time");
            run_out(device).await
        })
    };
    let (braked_ns, braked_rad) = ran_out(&braking_bench());
    let (coasted_ns, coasted_rad) = ran_out(&osmc_bench());
    eprintln!(
        "braked: {} ms, {braked_rad:.3} rad; coasted: {} ms, {coasted_rad:.3} rad",
        braked_ns / MS,
        coasted_ns / MS
    );
    // the ramp takes 45 ms, then ln(2.8 / 0.05) = 4 time constants
    assert!(braked_ns < 400 * MS && braked_rad < 0.35, "{braked_ns} ns, {braked_rad} rad");
    assert!(coasted_ns > 10 * braked_ns && coasted_rad > 10.0 * braked_rad);
}

/// The causes that may brake are tested completely in `safety/stop.rs` of the firmware.
#[test]
fn a_host_stop_brakes_for_its_time_and_then_switches_off() {
    bench(&braking_bench(), async |bench| {
        run_fast(bench).await;
        let device = bench.device();
        device.record_wire();
        let at_ns = bench.clock.now_ns();
        bench.host.stop().await.expect("a stop is always taken");
        // 0.9 at 20 a second is 45 ms, the answer arrives within 1 ms, and a change takes one control and one PWM
        // period
        let shorted = device.wait_until(at_ns, 49 * MS, || is_shorted(&device, ROTARY)).await;
        assert!(shorted.is_some_and(|ns| ns > 40 * MS), "{shorted:?}: the ramp of the configuration");
        // outputs that do not brake are off within the time promised for writing all channels
        assert!(device.is_off(LINEAR));
        assert!(has_power(&device), "brakes need it");
        let off_ns = device.wait_off(at_ns, BRAKE_NS + SUPERVISOR_NS + MS).await.expect("off at its deadline");
        assert!(off_ns >= BRAKE_NS, "{off_ns} ns");
        let written_ns = device.wait_all_off_written(at_ns, BRAKE_NS + SUPERVISOR_NS + MS + WRITTEN_NS).await;
        assert!(written_ns.is_some_and(|ns| ns >= BRAKE_NS), "{written_ns:?}");
        bench.sleep_ms(5).await;
        assert!(!has_power(&device));
        assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::HostStop)));
    });
}

/// The promises for the handle also hold while a stop brakes.
#[test]
fn the_handle_ends_a_braking_stop_at_once() {
    bench(&braking_bench(), async |bench| {
        let device = bench.device();
        for moment in [0, 1, 7, 100, 499] {
            bench.run_rotary(0).await;
            bench.host.stop().await.expect("a stop is always taken");
            bench.clock.sleep(moment * MS + 137 * US).await;
            device.record_wire();
            let at_ns = bench.clock.now_ns();
            bench.board.dead_man().set(false);
            assert!(device.wait_off(at_ns, 10 * US).await.is_some(), "{moment} ms");
            let open = device.wait_until(at_ns, MS, || !has_power(&device)).await;
            assert!(open.is_some(), "{moment} ms: the relay");
            let written_ns = device.wait_all_off_written(at_ns, WRITTEN_NS).await;
            assert!(written_ns.is_some_and(|ns| ns <= WRITTEN_NS), "{moment} ms: {written_ns:?}");
            bench.board.dead_man().set(true);
            bench.sleep_ms(30).await;
            bench.host.clear().await.expect("held again");
        }
    });
}

/// The bus fails while the brakes are written, or later: the lines stop the bridges without it.
#[test]
fn without_the_bus_a_braking_stop_is_switched_off_by_the_lines() {
    for after_ms in [0, 20, 300] {
        bench(&braking_bench(), async |bench| {
            run_fast(bench).await;
            let device = bench.device();
            let stopped_ns = bench.clock.now_ns();
            if after_ms == 0 {
                device.disturb(Disturbance::StuckLow { persistent: true });
            }
            bench.host.stop().await.expect("a stop is always taken");
            bench.sleep_ms(after_ms).await;
            device.disturb(Disturbance::StuckLow { persistent: true });
            // three tries that time out after 1 ms each, with a recovery of the bus between them, or the 5 ms in which
            // the brakes must be written; then the supervisor
            let since_ns = stopped_ns + after_ms * MS;
            let off_ns = device.wait_off(since_ns, WRITTEN_NS + 2 * MS + SUPERVISOR_NS).await;
            assert!(off_ns.is_some(), "bus lost after {after_ms} ms: not off");
        });
    }
}

/// Arming again ends the stop, and earlier commands are not resumed.
#[test]
fn a_braking_stop_can_be_cleared_and_armed_again() {
    bench(&braking_bench(), async |bench| {
        run_fast(bench).await;
        bench.host.stop().await.expect("a stop is always taken");
        bench.sleep_ms(100).await;
        bench.host.clear().await.expect("no cause is left");
        bench.sleep_ms(10).await;
        let device = bench.device();
        assert!(is_shorted(&device, ROTARY) && has_power(&device), "clearing does not end it");
        bench.host.arm().await.expect("cleared");
        bench.sleep_ms(700).await;
        assert_eq!(bench.safety().await, (SafetyState::Armed, Causes::NONE));
        assert_eq!(device.duty(ROTARY), 0.0);
        bench.set(ROTARY, Mode::Duty, 0.8).await.expect("armed");
        bench.sleep_ms(300).await;
        assert!(bench.board.world().speed(ROTARY).expect("a motor") > 0.5);
    });
}

/// Channels of both categories on one board: each stops by its own category.
#[test]
fn channels_that_brake_and_channels_that_coast_stop_side_by_side() {
    const ALL_OFF_NS: u64 = 450 * MS;
    let mut robot = r4_boards::load("every-interface").expect("built in");
    let config = &mut robot.config;
    for motor in &mut config.motors {
        motor.stop_brake_ms = if motor.id.index < 2 { 300 } else { 0 };
    }
    (config.bldcs[0].stop_brake_ms, config.steppers[0].stop_brake_ms) = (450, 450);
    let ((), misuse) = bench_with_misuse(&robot, async |bench| {
        bench.host.arm().await.expect("nothing is wrong");
        bench.sleep_ms(60).await;
        let motors = [ChannelKind::Osmc, ChannelKind::Dhb].map(|kind| (0..4).map(move |index| channel(kind, index)));
        for motor in motors.into_iter().flatten() {
            bench.set(motor, Mode::Duty, 0.7).await.expect("armed");
        }
        for index in 0..2 {
            bench.set(channel(ChannelKind::Bldc, 2 * index), Mode::Duty, 1.0).await.expect("armed");
            bench.set(channel(ChannelKind::Stepper, 2 * index), Mode::Speed, 10.0).await.expect("armed");
        }
        bench.sleep_ms(1200).await;
        let device = bench.device();
        let at_ns = bench.clock.now_ns();
        bench.host.stop().await.expect("a stop is always taken");
        bench.sleep_ms(6).await;
        for kind in [ChannelKind::Osmc, ChannelKind::Dhb] {
            for index in 0..4 {
                assert_eq!(device.is_off(channel(kind, index)), index >= 2, "{kind:?} {index}");
            }
        }
        let commanded = |index| {
            let mut world = bench.board.world();
            world.stepper(channel(ChannelKind::Stepper, index)).expect("a stepper").commanded()
        };
        let [ramping, ended] = [commanded(0), commanded(2)];
        // the ramps of the DHBs, 0.7 at 10 a second, are the longest
        bench.sleep_ms(80).await;
        for motor in
            [ChannelKind::Osmc, ChannelKind::Dhb].into_iter().flat_map(|kind| [channel(kind, 0), channel(kind, 1)])
        {
            assert!(is_shorted(&device, motor), "{motor}");
        }
        assert!(bench.board.world().bldc(channel(ChannelKind::Bldc, 0)).expect("a drive").is_braking());
        // 10 rad/s at 40 rad/s^2 take 250 ms; the drive brakes from full speed in 300 ms
        bench.clock.sleep_until(at_ns + 300 * MS).await;
        let stepper = |index| {
            let mut world = bench.board.world();
            let stepper = world.stepper(channel(ChannelKind::Stepper, index)).expect("a stepper");
            (stepper.position() == stepper.commanded(), stepper.is_enabled())
        };
        assert_eq!(stepper(0), (true, true), "it came to rest without losing a step, and holds");
        assert!(commanded(0) > ramping && commanded(2) == ended, "pulses of the other one ended at once");
        bench.clock.sleep_until(at_ns + 320 * MS).await;
        assert_eq!(bench.board.world().speed(channel(ChannelKind::Bldc, 0)), Some(0.0));
        let off = || {
            let motors =
                [ChannelKind::Osmc, ChannelKind::Dhb].map(|kind| (0..4).map(move |index| channel(kind, index)));
            motors.into_iter().flatten().all(|motor| device.is_off(motor))
        };
        let off_ns = device.wait_until(at_ns, ALL_OFF_NS + 2 * SUPERVISOR_NS, off).await.expect("off at the deadline");
        assert!(off_ns >= ALL_OFF_NS, "{off_ns} ns");
        bench.sleep_ms(6).await;
        assert!(!has_power(&device) && !stepper(0).1);
    });
    // the stepper beyond its start-stop speed stops by category 0, and no other does
    assert!(misuse.len() == 1 && misuse[0].contains("stepper driver 0x02: steps at 0 Hz"), "{misuse:?}");
}
