//! Safety promises of the firmware, on the simulated board: every cause that can occur there trips it, in time, and
//! stays tripped. Two causes are missing: this board has no range sensors (proximity), and its simulation does not
//! start after a watchdog reset.
//!
//! Times are virtual. "Off" is the time at which no transistor of a bridge conducts, by the DISABLE line or by the
//! chip's outputs; "written" is the STOP of the transfer that turns all outputs of the PWM chip off.

use std::panic::{AssertUnwindSafe, catch_unwind};

use crate::harness::{
    self, Bench, Device, LINEAR, MS, ROTARY, SUPPLY_12, SUPPLY_24, US, bench, bench_left_alone, control_of, lines_of,
    osmc_bench, pwm_of, raw_bench,
    trip::{CHECK_EVERY, CHECKS, PERIOD_NS, SETTLED_MS, Trip, bench_with_rod_at, nothing},
};
use proptest::prelude::*;
use r4_boards::Robot;
use r4_driver::Error;
use r4_plants::{
    Effect,
    effect::{
        friction::CoulombFriction,
        sensor::{EncoderOffset, PotentiometerDeadSpot},
    },
};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, Mode, Range, Refusal, Request, SafetyState,
    config::{BoardConfig, Feedback},
};
use r4_sim::{
    i2c::{Disturbance, Span},
    world::BoardChip,
};
use rand_pcg::{
    Pcg64,
    rand_core::{Rng, SeedableRng},
};

/// Promised time from the release of the dead-man's handle until all motor channels are written safe, ns.
const WRITTEN_SAFE_NS: u64 = 5 * MS;
/// Period of the supervisor for causes without a line of their own, ns.
const SUPERVISOR_NS: u64 = MS;
#[test]
fn dead_man_released() {
    Trip {
        cause: Cause::DeadMan,
        inject: async |bench, _| bench.board.dead_man().set(false),
        stays: true,
        remedy: |device, _| device.board.dead_man().set(true),
        // the line's edge wakes the supervisor, which drives DISABLE: the same instant, detected by the first poll
        // after it
        off_ns: 10 * US,
        written_ns: Some(WRITTEN_SAFE_NS),
        moments: 8,
    }
    .check("dead-man");
}

#[test]
fn host_stop() {
    Trip {
        cause: Cause::HostStop,
        inject: async |bench, _| bench.host.stop().await.unwrap(),
        stays: false,
        remedy: nothing,
        // a request and its answer are below 20 bytes each: 0.4 ms at 1 Mbit/s
        off_ns: MS,
        written_ns: Some(WRITTEN_SAFE_NS),
        moments: 8,
    }
    .check("host stop");
}

/// Time until the bridges are off after a bus fault, ns: it is detected at the next read-back, then the promised 5 ms.
const BUS_FAULT_OFF_NS: u64 = CHECK_EVERY * PERIOD_NS + 5 * MS;

#[test]
fn bus_held_low() {
    Trip {
        cause: Cause::I2cFault,
        inject: async |bench, _| bench.device().disturb(Disturbance::StuckLow { persistent: true }),
        stays: true,
        remedy: |device, _| device.free_bus(),
        off_ns: BUS_FAULT_OFF_NS,
        written_ns: None,
        moments: 72,
    }
    .check("bus held low");
}

#[test]
fn chip_does_not_answer() {
    Trip {
        cause: Cause::I2cFault,
        inject: async |bench, _| bench.device().disturb(Disturbance::AddressNack),
        stays: true,
        remedy: |device, _| device.free_bus(),
        off_ns: BUS_FAULT_OFF_NS,
        written_ns: None,
        moments: 72,
    }
    .check("chip does not answer");
}

#[test]
fn bus_too_slow_for_the_control_loop() {
    Trip {
        cause: Cause::ControlOverrun,
        // a read-back of 8 bytes then takes 7.2 ms, longer than the five periods after which the loop counts as dead
        inject: async |bench, _| bench.board.world().bus.set_rate_hz(10_000),
        // read-backs of a single byte still fit
        stays: false,
        remedy: |device, _| device.board.world().bus.set_rate_hz(400_000),
        // the slow transfer starts within `CHECK_EVERY` periods; five periods and one period of the supervisor later
        off_ns: CHECK_EVERY * PERIOD_NS + 5 * PERIOD_NS + 2 * SUPERVISOR_NS,
        // then, at 0.9 ms a byte, two bridges' four bytes each and a read-back of ten in progress, the expander's four
        // and the PWM chip's three
        written_ns: Some(CHECK_EVERY * PERIOD_NS + 8 * MS + 10 * MS + 4 * MS + 3 * MS),
        moments: 72,
    }
    .check("slow bus");
}

#[test]
fn chip_lost_its_supply_for_a_moment() {
    Trip {
        cause: Cause::ReadBackMismatch,
        inject: async |bench, _| {
            assert!(bench.board.world().brown_out(BoardChip::OsmcPwm), "the bench has it");
        },
        stays: false,
        remedy: nothing,
        // the outputs of a chip that was just powered up are off
        off_ns: 10 * US,
        // each item is read back once in `CHECKS` read-backs; the first few would do
        written_ns: Some(CHECKS * CHECK_EVERY * PERIOD_NS + WRITTEN_SAFE_NS),
        moments: 72,
    }
    .check("chip without supply");
}

/// Trip by a rail that jumps from its nominal `from_v` to `to_v` and crosses `limit_v` in the supply's 10 ms low-pass.
fn supply_trips(rail: ChannelId, from_v: f64, to_v: f64, limit_v: f64) {
    let crossed_ms = 10.0 * ((from_v - to_v) / (limit_v - to_v)).ln();
    let remedy: fn(&Device, &Robot) = |device, _| {
        device.board.world().set_emf(SUPPLY_24, 24.0);
        device.board.world().set_emf(SUPPLY_12, 12.0);
    };
    let trip = Trip {
        cause: Cause::SupplyOutOfRange,
        inject: async |bench: &Bench<'_>, _: &Robot| bench.board.world().set_emf(rail, to_v),
        stays: true,
        remedy,
        // one period until it is sampled, and one more for the filter's backward Euler
        off_ns: (crossed_ms * 1e6) as u64 + 2 * PERIOD_NS,
        written_ns: Some((crossed_ms * 1e6) as u64 + 2 * PERIOD_NS + WRITTEN_SAFE_NS),
        moments: 4,
    };
    trip.check(&format!("{rail} at {to_v} V"));
}

#[test]
fn supply_too_low_or_too_high() {
    for (rail, from_v, to_v, limit_v) in [
        (SUPPLY_24, 24.0, 15.0, 20.0),
        (SUPPLY_24, 24.0, 40.0, 30.0),
        (SUPPLY_12, 12.0, 0.0, 10.0),
        (SUPPLY_12, 12.0, 20.0, 15.0),
    ] {
        supply_trips(rail, from_v, to_v, limit_v);
    }
}

/// Time for which a potentiometer may crackle, 5 ms; then a period until it is sampled, and one until that pass is
/// over, ns.
const CRACKLE_NS: u64 = 5 * MS + 2 * PERIOD_NS;

#[test]
fn potentiometer_wiper_open_or_shorted() {
    // Shifts the reading far beyond the converter's range in either direction: code 0 or 65535, as a wiper at ground or
    // at the reference.
    fn shift(bench: &Bench<'_>, robot: &Robot, offset: f64) {
        bench.device().add_effect(robot, LINEAR, Effect::EncoderOffset(EncoderOffset { offset }));
    }
    let remedy: fn(&Device, &Robot) = |device, robot| device.repair(robot, LINEAR);
    let (off_ns, written_ns) = (CRACKLE_NS, Some(CRACKLE_NS + WRITTEN_SAFE_NS));
    let cause = Cause::EncoderImplausible;
    let open = async |bench: &Bench<'_>, robot: &Robot| shift(bench, robot, -1.0);
    Trip { cause, inject: open, stays: true, remedy, off_ns, written_ns, moments: 4 }.check("wiper at ground");
    let shorted = async |bench: &Bench<'_>, robot: &Robot| shift(bench, robot, 1.0);
    Trip { cause, inject: shorted, stays: true, remedy, off_ns, written_ns, moments: 4 }.check("wiper at reference");
}

/// Impossible speed is also [`Cause::EncoderImplausible`]: half a turn in a millisecond is 600 times the highest speed
/// that may be commanded, 30 mm in a millisecond 3000 times.
#[test]
fn feedback_that_jumps() {
    for (channel, jump, off_ns) in [(ROTARY, std::f64::consts::PI, 2 * PERIOD_NS), (LINEAR, 0.03, CRACKLE_NS)] {
        Trip {
            cause: Cause::EncoderImplausible,
            inject: async |bench: &Bench<'_>, _: &Robot| {
                let to = bench.position(channel) + jump;
                bench.board.world().set_position(channel, to);
            },
            stays: false,
            remedy: nothing,
            off_ns,
            written_ns: Some(off_ns + WRITTEN_SAFE_NS),
            moments: 2,
        }
        .check(&format!("{channel} jumps"));
    }
}

/// Longest time until a stall trips, ns: a driven motor counts as stalled if it covers less than `stall.travel` in a
/// window of `stall.time_ms`. One that stops in the middle of a window may have covered that before, so the next window
/// decides.
fn longest_stall_ns(channel: ChannelId) -> u64 {
    let config = osmc_bench().config;
    let motor = config.motors.iter().find(|motor| motor.id == channel).expect("the bench has the channel");
    2 * u64::from(motor.control.expect("a measured motor").stall.time_ms) * MS + 2 * PERIOD_NS + SUPERVISOR_NS
}

#[test]
fn motor_jams_under_way() {
    Trip {
        cause: Cause::Stalled,
        inject: async |bench, robot| {
            bench.set(ROTARY, Mode::Duty, 0.9).await.unwrap();
            bench.sleep_ms(400).await;
            // 1 kN m: no motor of this bench moves that
            bench.device().add_effect(robot, ROTARY, Effect::CoulombFriction(CoulombFriction { level: 1e3 }));
        },
        stays: false,
        remedy: |device, robot| device.repair(robot, ROTARY),
        off_ns: 401 * MS + longest_stall_ns(ROTARY),
        written_ns: Some(401 * MS + longest_stall_ns(ROTARY) + WRITTEN_SAFE_NS),
        moments: 1,
    }
    .check("jam");
}

#[test]
fn potentiometer_with_a_dead_spot() {
    Trip {
        cause: Cause::Stalled,
        inject: async |bench, robot| {
            // The rod is at 10 mm. From 11 mm on the last reading stays; at 10 mm/s it gets there in 0.1 s.
            let dead_spot = Effect::PotentiometerDeadSpot(PotentiometerDeadSpot { start: 0.011, width: 0.05 });
            bench.device().add_effect(robot, LINEAR, dead_spot);
            bench.set(LINEAR, Mode::Duty, 0.78).await.unwrap();
        },
        stays: false,
        remedy: |device, robot| device.repair(robot, LINEAR),
        // 0.3 s to the dead spot, including acceleration
        off_ns: 300 * MS + longest_stall_ns(LINEAR),
        written_ns: Some(300 * MS + longest_stall_ns(LINEAR) + WRITTEN_SAFE_NS),
        moments: 1,
    }
    .check("dead spot");
}

/// Function that makes a configuration wrong.
type Spoil = fn(&mut BoardConfig);

/// Feedback of the wrong sign makes the loops run away. From the time the bridge has the duty from which a stall
/// counts, the trip comes within the configured time.
#[test]
fn feedback_that_counts_the_wrong_way() {
    fn encoder(config: &mut BoardConfig) {
        let Feedback::Encoder { inverted, .. } = &mut control_of(config, 0).feedback else { panic!("no encoder") };
        *inverted = true;
    }
    fn bridge(config: &mut BoardConfig) {
        config.motors[0].inverted = true;
    }
    fn potentiometer(config: &mut BoardConfig) {
        let Feedback::Potentiometer { low, high, .. } = &mut control_of(config, 1).feedback else {
            panic!("no potentiometer")
        };
        std::mem::swap(&mut low.code, &mut high.code);
    }
    let cases: [(&str, Spoil, ChannelId, Mode, f32); 5] = [
        ("encoder", encoder, ROTARY, Mode::Position, 1.0),
        ("encoder", encoder, ROTARY, Mode::Speed, -2.0),
        ("bridge", bridge, ROTARY, Mode::Position, -1.0),
        ("potentiometer", potentiometer, LINEAR, Mode::Position, 0.07),
        ("potentiometer", potentiometer, LINEAR, Mode::Speed, 0.008),
    ];
    for (what, invert, channel, mode, value) in cases {
        let mut robot = bench_with_rod_at(0.05);
        invert(&mut robot.config);
        let stall = control_of(&mut robot.config.clone(), usize::from(channel == LINEAR)).stall;
        bench(&robot, async |bench| {
            let device = bench.device();
            bench.host.arm().await.unwrap();
            bench.set(channel, mode, value).await.unwrap();
            // the bridge has the duty in steps of 1/4096
            let hard = || device.duty(channel).abs() > f64::from(stall.duty) - 1.0 / 4096.0;
            let runs_away = device.wait_until(device.clock.now_ns(), 2000 * MS, hard).await;
            assert!(runs_away.is_some(), "{what}, {mode}: the loop must run away");
            let (at_ns, limit_ns) = (device.clock.now_ns(), u64::from(stall.time_ms) * MS + 2 * PERIOD_NS);
            let off_ns = device.wait_off(at_ns, limit_ns).await;
            assert!(off_ns.is_some_and(|ns| ns <= limit_ns), "{what}, {mode}: {off_ns:?}");
            assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::EncoderImplausible)), "{what}");
        });
    }
}

#[test]
fn host_gone_without_a_word() {
    let robot = osmc_bench();
    let timeout_ns = u64::from(robot.config.link_timeout_ms) * MS;
    let mut worst_ns = 0;
    for phase_ns in (0..16).map(|moment| moment * 3_137 * US) {
        let work = async |bench: &Bench<'_>| {
            bench.run_rotary(phase_ns).await;
            bench.device().record_wire();
        };
        let off_ns = bench_left_alone(&robot, work, async |device, ()| {
            let at_ns = device.clock.now_ns();
            // Promised: the configured timeout and 2 ms. The last heartbeat was before the host disappeared, or is
            // still in the cable: a quarter of a millisecond.
            let limit_ns = timeout_ns + 2 * MS + MS / 4;
            let off_ns = device.wait_off(at_ns, limit_ns).await.expect("stops without a host");
            // a host that sends four heartbeats per timeout may lose two in a row
            assert!(off_ns >= timeout_ns * 3 / 4 - MS, "{off_ns} ns are no reason yet");
            assert!(device.wait_all_off_written(at_ns, limit_ns + WRITTEN_SAFE_NS).await.is_some());
            off_ns
        });
        worst_ns = worst_ns.max(off_ns);
    }
    eprintln!("host gone: off after at most {} us", worst_ns / US);
}

#[test]
fn a_host_that_comes_back_finds_the_trip_and_nothing_moves() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.hello().await;
        host.ask(Request::Arm).await.unwrap();
        host.listen(300).await;
        let info = host.hello().await;
        assert_eq!((info.state, info.causes), (SafetyState::Tripped, Causes::only(Cause::LinkLost)));
        assert!(matches!(host.ask(Request::Arm).await, Err(Refusal::Tripped { .. } | Refusal::CausesPresent { .. })));
        assert!(device.is_off(ROTARY));
    });
}

#[test]
fn a_configuration_that_contradicts_itself_never_arms() {
    let cases: [(&str, Spoil); 15] = [
        ("no control period", |config| config.control_period_us = 0),
        ("an endless control period", |config| config.control_period_us = u32::MAX),
        ("no link timeout", |config| config.link_timeout_ms = 0),
        ("a PWM frequency that is no number", |config| pwm_of(config).frequency_hz = f32::NAN),
        ("no PWM frequency", |config| pwm_of(config).frequency_hz = 0.0),
        ("an address beyond 7 bits", |config| pwm_of(config).address = 0xFF),
        ("a bridge line beyond the chip", |config| lines_of(config).bli = 16),
        ("bridge lines far beyond the chip", |config| *lines_of(config) = lines(255)),
        ("a bridge line used twice", |config| lines_of(config).bli = lines_of(config).ali),
        ("a bridge used twice", |config| config.motors[0].bridge = config.motors[1].bridge),
        ("a duty beyond the hard limit", |config| config.motors[0].duty_max = 1.0),
        ("a gain that is no number", |config| control_of(config, 0).position_pid.kp = f32::NAN),
        ("a potentiometer with equal ends", |config| {
            let Feedback::Potentiometer { low, high, .. } = &mut control_of(config, 1).feedback else {
                panic!("no potentiometer")
            };
            high.code = low.code;
        }),
        ("an empty supply range", |config| config.supplies[0].range_v = Range::new(30.0, 20.0)),
        ("an analog input used twice", |config| config.supplies[0].analog = config.supplies[1].analog),
    ];
    let failed: Vec<_> = cases
        .into_iter()
        .filter(|(what, spoil)| {
            let mut robot = osmc_bench();
            spoil(&mut robot.config);
            let run = || raw_bench(&robot, async |host, device| never_arms(host, device).await);
            catch_unwind(AssertUnwindSafe(run)).inspect_err(|_| eprintln!("with {what}")).is_err()
        })
        .map(|(what, _)| what)
        .collect();
    assert_eq!(failed, Vec::<&str>::new());
}

fn lines(all: u8) -> r4_protocol::config::BridgeLines {
    r4_protocol::config::BridgeLines { ahi: all, ali: all, bhi: all, bli: all }
}

async fn never_arms(host: &mut harness::RawHost, device: &Device) {
    let bad = |causes: Causes| causes.contains(Cause::BadConfiguration);
    let info = host.hello().await;
    assert!(info.state == SafetyState::Tripped && bad(info.causes), "{}: {}", info.state, info.causes);
    for request in [Request::Clear, Request::Arm] {
        let refused = host.ask(request).await;
        assert!(matches!(refused, Err(Refusal::CausesPresent { causes }) if bad(causes)), "{refused:?}");
    }
    host.listen(50).await;
    assert!(device.is_off(ROTARY) && device.is_off(LINEAR));
    assert!(bad(host.hello().await.causes));
}

/// Boards start without a trip at the shortest and the longest control period that a configuration may have.
#[test]
fn any_allowed_control_period_starts_without_a_trip() {
    let with_period = |control_period_us| {
        let mut robot = osmc_bench();
        robot.config.control_period_us = control_period_us;
        robot
    };
    // the transfers of one period decide the shortest
    let shortest = (500..).step_by(10).find(|us| with_period(*us).config.validate().is_ok()).unwrap();
    println!("the shortest control period of osmc-bench is {shortest} us");
    assert!(shortest <= 600, "{shortest} us");
    for control_period_us in [shortest, 20_000] {
        let robot = with_period(control_period_us);
        bench(&robot, async |bench| {
            let (state, causes) = bench.safety().await;
            assert_eq!(state, SafetyState::Disarmed, "{control_period_us} us: {causes}");
        });
    }
}

#[test]
fn a_bouncing_dead_mans_handle_cannot_clear() {
    bench(&osmc_bench(), async |bench| {
        bench.run_rotary(0).await;
        bench.board.dead_man().set(false);
        bench.sleep_ms(50).await;
        let begin_ns = bench.clock.now_ns();
        for edge in 1..=50 {
            bench.board.dead_man().set(edge % 2 == 1);
            let refused = bench.host.clear().await;
            assert!(matches!(refused, Err(Error::Refused(Refusal::CausesPresent { .. }))), "edge {edge}: {refused:?}");
            // the request and its answer are below 1 ms
            bench.clock.sleep_until(begin_ns + edge * 2 * MS).await;
        }
        bench.board.dead_man().set(true);
        // the handle counts as held after 20 ms, and the supervisor runs each millisecond
        let held_ns = bench.clock.now_ns();
        bench.clock.sleep_until(held_ns + 18 * MS).await;
        bench.host.clear().await.unwrap_err();
        bench.clock.sleep_until(held_ns + 22 * MS).await;
        bench.host.clear().await.unwrap();
        assert!(bench.is_off(ROTARY));
    });
}

#[test]
fn disarming_stops_and_forgets_the_command() {
    bench(&osmc_bench(), async |bench| {
        bench.run_rotary(0).await;
        let device = bench.device();
        device.record_wire();
        let at_ns = bench.clock.now_ns();
        bench.host.disarm().await.unwrap();
        // a request and its answer: 0.4 ms
        assert!(device.wait_off(at_ns, MS).await.is_some());
        assert!(device.wait_all_off_written(at_ns, WRITTEN_SAFE_NS).await.is_some());
        assert_eq!(bench.safety().await, (SafetyState::Disarmed, Causes::NONE));
        bench.host.arm().await.unwrap();
        bench.sleep_ms(100).await;
        assert_eq!(device.duty(ROTARY), 0.0);
    });
}

/// Stop, clear and arm together, faster than a control period: the trip must still reach the outputs.
#[test]
fn a_stop_cleared_at_once_still_stops() {
    bench(&osmc_bench(), async |bench| {
        for moment in 0..10 {
            bench.run_rotary(moment * 107 * US).await;
            let device = bench.device();
            device.record_wire();
            let at_ns = bench.clock.now_ns();
            let (mut stop, mut clear, mut arm) = (
                std::pin::pin!(bench.host.stop()),
                std::pin::pin!(bench.host.clear()),
                std::pin::pin!(bench.host.arm()),
            );
            // all three are sent before the first answer
            std::future::poll_fn(|context| {
                let _ = (stop.as_mut().poll(context), clear.as_mut().poll(context), arm.as_mut().poll(context));
                std::task::Poll::Ready(())
            })
            .await;
            let written_ns = device.wait_all_off_written(at_ns, WRITTEN_SAFE_NS).await;
            assert!(
                written_ns.is_some_and(|ns| ns <= WRITTEN_SAFE_NS),
                "moment {moment}: written off after {written_ns:?}"
            );
            // the chip takes it over at the end of a PWM period of 0.66 ms
            for _ in 0..20 {
                bench.sleep_ms(1).await;
                assert_eq!(device.duty(ROTARY), 0.0, "moment {moment}: the old command goes on");
            }
            bench.host.disarm().await.unwrap();
            bench.host.clear().await.unwrap();
        }
    });
}

#[test]
fn bus_faults_that_pass_are_counted_and_do_not_trip() {
    let one = Span::Transfers { count: 1 };
    for disturbance in
        [Disturbance::AddressNack, Disturbance::DataNack { byte: 0 }, Disturbance::StuckLow { persistent: false }]
    {
        // in a control loop that writes, and in one that only reads back; at eight times each
        for moment in 0..16 {
            bench(&osmc_bench(), async |bench| {
                bench.run_rotary(moment / 2 * (1137 * US)).await;
                let before = bench.host.stats().await.unwrap().bus_retries;
                bench.device().inject(disturbance, one);
                if moment % 2 == 0 {
                    bench.set(ROTARY, Mode::Duty, 0.6).await.unwrap();
                }
                bench.sleep_ms(100).await;
                let (state, causes) = bench.host.safety();
                assert_eq!(state, SafetyState::Armed, "{disturbance:?}, moment {moment}: {causes}");
                assert!(bench.host.stats().await.unwrap().bus_retries > before, "{disturbance:?}");
                assert!(bench.device().duty(ROTARY) > 0.5, "goes on as if nothing had been");
            });
        }
    }
}

/// A chip that lost its settings is present as a cause until it has them again.
#[test]
fn clearing_waits_until_the_chip_is_set_up_again() {
    bench(&osmc_bench(), async |bench| {
        for moment in 0..16 {
            bench.run_rotary(moment * 1_137 * US).await;
            let device = bench.device();
            let at_ns = bench.clock.now_ns();
            assert!(bench.board.world().brown_out(BoardChip::OsmcPwm), "the bench has it");
            device.record_wire();
            // The first write of the safe state shows the trip; clearing is tried from then on without a pause.
            let limit_ns = (CHECKS + 1) * CHECK_EVERY * PERIOD_NS;
            assert!(device.wait_all_off_written(at_ns, limit_ns).await.is_some(), "moment {moment}: not tripped");
            while bench.host.clear().await.is_err() {}
            // 7.3.1, 7.3.2 and 7.3.5 of the datasheet: awake with auto-increment, totem pole, 1526 Hz
            let chip = bench.board.world().osmc_pwm().expect("the bench has it").clone();
            let registers = [0x00, 0x01, 0xFE].map(|register| chip.borrow().register(register));
            assert_eq!(registers, [Some(0x21), Some(0x04), Some(3)], "moment {moment}: cleared before it was set up");
            bench.sleep_ms(SETTLED_MS).await;
        }
    });
}

/// The promise for the dead-man's handle, at 300 times in every kind of motion.
#[test]
fn dead_man_released_at_any_moment() {
    const SEED: u64 = 0x5AFE;
    let mut random = Pcg64::seed_from_u64(SEED);
    let mut between = move |low: u64, high: u64| low + random.next_u64() % (high - low);
    let (mut worst_off_ns, mut worst_written_ns) = (0, 0);
    bench(&bench_with_rod_at(0.05), async |bench| {
        let device = bench.device();
        for case in 0..300 {
            bench.host.arm().await.unwrap();
            let (mode, rotary, linear) = match between(0, 3) {
                0 => (Mode::Duty, 0.9, 0.78),
                1 => (Mode::Speed, 2.0, 0.008),
                _ => (Mode::Position, 6.0, 0.0),
            };
            // back and forth, to include reversals
            let sign = if between(0, 2) == 0 { 1.0 } else { -1.0 };
            let linear = if mode == Mode::Position { 0.05 + sign * 0.04 } else { sign * linear };
            bench.set(ROTARY, mode, sign * rotary).await.unwrap();
            bench.set(LINEAR, mode, linear).await.unwrap();
            bench.clock.sleep(between(0, 60 * MS)).await;
            device.record_wire();
            let at_ns = bench.clock.now_ns();
            bench.board.dead_man().set(false);
            let off_ns = device.wait_off(at_ns, WRITTEN_SAFE_NS).await;
            let written_ns = device.wait_all_off_written(at_ns, WRITTEN_SAFE_NS).await;
            // as in `dead_man_released`
            assert!(off_ns.is_some_and(|ns| ns <= 10 * US), "seed {SEED:#x}, case {case}: off after {off_ns:?} ns");
            assert!(
                written_ns.is_some_and(|ns| ns <= WRITTEN_SAFE_NS),
                "seed {SEED:#x}, case {case}: written after {written_ns:?} ns"
            );
            worst_off_ns = worst_off_ns.max(off_ns.unwrap_or(u64::MAX));
            worst_written_ns = worst_written_ns.max(written_ns.unwrap_or(u64::MAX));
            bench.board.dead_man().set(true);
            bench.sleep_ms(30).await;
            bench.host.clear().await.unwrap();
        }
    });
    eprintln!(
        "dead-man, 300 moments: off after at most {worst_off_ns} ns, written off after at most {worst_written_ns} ns"
    );
}

/// Relay 0 switches the supply of both motors on this bench.
#[test]
fn the_motor_power_relay_follows_arming_and_opens_first() {
    let relay = ChannelId::new(ChannelKind::Relay, 0);
    bench(&osmc_bench(), async |bench| {
        let closed = || bench.board.world().relay_closed(relay).expect("the bench has the relay");
        assert!(!closed(), "open at power-up");
        bench.host.arm().await.expect("nothing is in the way");
        bench.sleep_ms(20).await;
        assert!(closed());
        // commands wait until the supply is reliable
        bench.set(ROTARY, Mode::Duty, 0.8).await.expect("armed");
        assert_eq!(bench.device().duty(ROTARY), 0.0);
        bench.sleep_ms(500).await;
        assert!(bench.board.world().speed(ROTARY).expect("a motor") > 0.5);

        bench.board.world().bus.set_trace(64);
        let released_ns = bench.clock.now_ns();
        bench.board.dead_man().set(false);
        bench.sleep_ms(5).await;
        assert!(!closed());
        // on the wire: the relays' latches before the PWM chip's all-off, the first of them within a millisecond
        let world = bench.board.world();
        let written = |address: u8| {
            let after = world.bus.trace().filter(|record| record.start_ns >= released_ns);
            after
                .filter(|record| record.address == address && !record.written.is_empty() && record.read.is_empty())
                .map(|record| record.end_ns - released_ns)
                .next()
        };
        let (relays_ns, motors_ns) = (written(0x20).expect("relays"), written(0x40).expect("motors"));
        assert!(
            relays_ns < motors_ns && relays_ns <= 1_000_000 && motors_ns <= 5_000_000,
            "{relays_ns} {motors_ns} ns"
        );
    });
}

#[test]
fn a_general_relay_is_switched_while_armed_and_opens_on_a_stop() {
    let [power, relay] = [0, 1].map(|index| ChannelId::new(ChannelKind::Relay, index));
    bench(&osmc_bench(), async |bench| {
        let closed = || bench.board.world().relay_closed(relay).expect("the bench has the relay");
        let not_armed = bench.set(relay, Mode::Switch, 1.0).await;
        assert!(matches!(not_armed, Err(Error::Refused(Refusal::NotArmed { .. }))), "{not_armed:?}");
        bench.host.arm().await.expect("nothing is in the way");
        for (value, expected) in [(1.0, true), (0.0, false), (1.0, true)] {
            bench.set(relay, Mode::Switch, value).await.expect("armed");
            bench.sleep_ms(5).await;
            assert_eq!(closed(), expected);
        }
        let half = bench.set(relay, Mode::Switch, 0.5).await;
        assert!(matches!(half, Err(Error::Refused(Refusal::OutOfRange { .. }))), "{half:?}");
        // the motors' supply belongs to the supervisor
        let by_hand = bench.set(power, Mode::Switch, 0.0).await;
        assert!(matches!(by_hand, Err(Error::Refused(Refusal::WrongMode { .. }))), "{by_hand:?}");
        bench.host.stop().await.expect("a stop is always taken");
        bench.sleep_ms(5).await;
        assert!(!closed());
        bench.host.clear().await.expect("no cause is left");
        bench.host.arm().await.expect("cleared");
        bench.sleep_ms(20).await;
        assert!(!closed(), "a relay closed before the stop stays open after it");
    });
}

/// Actions of a host and the world in a random test.
#[derive(Clone, Copy, Debug)]
enum Act {
    Arm,
    Disarm,
    Clear,
    Stop,
    Drive,
    Handle(bool),
    Wait(u64),
}

fn acts() -> impl Strategy<Value = Vec<Act>> {
    let act = prop_oneof![
        3 => Just(Act::Arm),
        1 => Just(Act::Disarm),
        2 => Just(Act::Clear),
        1 => Just(Act::Stop),
        3 => Just(Act::Drive),
        2 => any::<bool>().prop_map(Act::Handle),
        3 => (1u64..120).prop_map(Act::Wait),
    ];
    proptest::collection::vec(act, 1..24)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    /// For any sequence of actions the board behaves as this model. Nothing moves unless it is armed and was commanded
    /// since, and a stop reaches the bridges within 5 ms.
    #[test]
    fn nothing_moves_unless_armed_and_told_since(acts in acts()) {
        bench(&osmc_bench(), async |bench| {
            let device = bench.device();
            let (mut armed, mut tripped, mut told, mut held) = (false, false, false, true);
            for (place, act) in acts.iter().enumerate() {
                match *act {
                    Act::Arm => {
                        let taken = bench.host.arm().await.is_ok();
                        assert_eq!(taken, held && !tripped, "{place} of {acts:?}");
                        (armed, told) = (taken, told && armed);
                    }
                    Act::Disarm => {
                        bench.host.disarm().await.unwrap();
                        armed = false;
                    }
                    Act::Clear => {
                        assert_eq!(bench.host.clear().await.is_ok(), held, "{place} of {acts:?}");
                        tripped &= !held;
                    }
                    Act::Stop => {
                        bench.host.stop().await.unwrap();
                        (armed, tripped) = (false, true);
                    }
                    Act::Drive => {
                        let taken = bench.set(ROTARY, Mode::Duty, 0.8).await.is_ok();
                        assert_eq!(taken, armed, "{place} of {acts:?}");
                        told |= taken;
                    }
                    Act::Handle(hold) => {
                        bench.board.dead_man().set(hold);
                        // the handle counts as held after 20 ms
                        bench.sleep_ms(25).await;
                        (armed, tripped, held) = (armed && hold, tripped || !hold, hold);
                    }
                    Act::Wait(ms) => bench.sleep_ms(ms).await,
                }
                told &= armed;
                // longer than any promised stop, and than power takes to come on
                bench.sleep_ms(if told { 100 } else { 5 }).await;
                assert_eq!(device.duty(ROTARY) > 0.0, told, "{place} of {acts:?}");
                assert_eq!(bench.board.lights().green, armed, "{place} of {acts:?}");
                if !armed {
                    assert!(device.is_off(ROTARY) && device.is_off(LINEAR), "{place} of {acts:?}");
                    assert_eq!(bench.board.world().relay_closed(ChannelId::new(ChannelKind::Relay, 0)), Some(false));
                }
            }
        });
    }
}
