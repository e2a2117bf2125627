//! Ten defects of the control code released with the OSMC evaluation paper (Alabi, Camara, Fox, TAROS 2023; repository
//! Pelex-a/osh-motor-control), with tests that this firmware is free of them. One test each, in the paper's order of
//! use.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::f64::consts::TAU;

use crate::harness::{Bench, LINEAR, ROTARY, SUPPLY_12, SUPPLY_24, bench, control_of, osmc_bench};
use r4_boards::{Robot, SimulatedSensor};
use r4_protocol::{
    Mode, SafetyState, Sample,
    config::{Feedback, PidGains},
};

/// One encoder count of the bench, rad.
const COUNT_RAD: f64 = TAU / 2400.0;

/// Position, speed and duty of the rotary motor, every millisecond for `ms`.
async fn trace(bench: &Bench<'_>, ms: usize) -> Vec<(i32, f32, f32)> {
    let mut telemetry = bench.host.telemetry();
    bench.host.subscribe(ROTARY, 1).await.unwrap();
    let mut samples = Vec::new();
    while samples.len() < ms {
        for sample in telemetry.next().await.unwrap().samples {
            if let Sample::Motor { position, speed, duty, .. } = sample {
                samples.push((position, speed, duty));
            }
        }
    }
    samples
}

/// Defect 1: the position error was set to the target, the count commented out: full duty, open loop.
#[test]
fn position_is_closed_loop() {
    bench(&osmc_bench(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.host.move_to(ROTARY, 1.0, 10.0).await.unwrap();
        // The shaft is turned by hand, in both directions: the motor must return from both sides.
        for displaced in [0.5, 1.5] {
            // no faster than the motor itself, or the firmware would reject its sensor
            let from = bench.position(ROTARY);
            for step in 1..=50 {
                bench.board.world().set_position(ROTARY, from + (displaced - from) * f64::from(step) / 50.0);
                bench.sleep_ms(1).await;
            }
            bench.sleep_ms(3000).await;
            // the band in which a settled position is not corrected, and the encoder's count
            let band = 2.0 * 0.004 + COUNT_RAD;
            assert!((bench.position(ROTARY) - 1.0).abs() < band, "{}", bench.position(ROTARY));
        }
    });
}

/// Defect 2: dt from a millisecond clock was 0 in a fast loop: infinite or NaN derivative, NaN also with kd = 0.
#[test]
fn commands_faster_than_the_loop_give_finite_outputs() {
    bench(&osmc_bench(), async |bench| {
        bench.host.arm().await.unwrap();
        for kd in [0.0, 0.05] {
            let gains = PidGains { kp: 2.0, ki: 1.0, kd };
            bench.host.set_gains(ROTARY, Mode::Position, gains).await.unwrap();
            // many commands within one period of the loop, with gain changes in between
            for step in 0..200 {
                bench.set(ROTARY, Mode::Position, step as f32 * 0.001).await.unwrap();
            }
            for (_, speed, duty) in trace(bench, 500).await {
                assert!(speed.is_finite() && duty.abs() <= 0.902, "{speed} {duty}");
            }
        }
        bench.sleep_ms(3000).await;
        // the band in which a settled position is not corrected, and the encoder's count
        let band = 2.0 * 0.004 + COUNT_RAD;
        assert!((bench.position(ROTARY) - 0.199).abs() < band, "{}", bench.position(ROTARY));
    });
}

/// Defect 3: time and error started at 0, so the first step included the time the operator took to type.
#[test]
fn waiting_before_a_command_changes_nothing() {
    let after = |wait_ms| {
        bench(&osmc_bench(), async |bench| {
            bench.host.arm().await.unwrap();
            bench.sleep_ms(wait_ms).await;
            bench.set(ROTARY, Mode::Position, 1.0).await.unwrap();
            let mut samples = trace(bench, 1000).await;
            // from the first sample of the motion on, independent of the command's place in a telemetry period
            let start = samples.iter().position(|(_, _, duty)| *duty > 0.03).unwrap();
            samples.drain(start..).take(900).collect::<Vec<_>>()
        })
    };
    let (at_once, later) = (after(0), after(10_000));
    for (sample, sample_later) in at_once.into_iter().zip(later) {
        // Equal until the first count, except for the supply's noise, by which duties are scaled: no kick, no integral.
        // Afterwards the PWM chip's cycle, whose phase differs after 10 s, may move an edge into the next period.
        let duties_differ = (sample.2 - sample_later.2).abs();
        let exact = sample.0 > 0 || (sample.1 == sample_later.1 && duties_differ < 1e-3);
        assert!(exact && (sample.0 - sample_later.0).abs() <= 1, "{sample:?} {sample_later:?}");
    }
}

/// Defect 4: the integral had no anti-windup.
#[test]
fn a_saturated_move_does_not_overshoot() {
    let mut robot = osmc_bench();
    // a path that no motor can follow is in effect a step
    control_of(&mut robot.config, 0).speed_max = 50.0;
    control_of(&mut robot.config, 0).profile.speed = 50.0;
    control_of(&mut robot.config, 0).profile.acceleration = 500.0;
    control_of(&mut robot.config, 0).follow.error = 100.0;
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(ROTARY, Mode::Position, TAU as f32).await.unwrap();
        let samples = trace(bench, 6000).await;
        let saturated = samples.iter().filter(|(_, _, duty)| *duty >= 0.9).count();
        assert!(saturated > 1500, "the test needs a long saturation: {saturated} ms");
        let highest = samples.iter().map(|(position, ..)| *position).max().unwrap();
        // Target: at most 1 % overshoot of 2400 counts; an integral of 2 s at 3 rad would be 6, seven times the duty.
        assert!(highest <= 2424, "{highest} counts");
        assert!((bench.position(ROTARY) - TAU).abs() < 0.0175, "within a degree: {}", bench.position(ROTARY));
    });
}

/// Defect 5: the direction was never 0, so the branch that stopped, and logged the position, was dead code.
#[test]
fn a_motor_at_its_target_is_off_and_still_logged() {
    bench(&osmc_bench(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.host.move_to(ROTARY, 0.7, 10.0).await.unwrap();
        // the duty at rest is released with a time constant of a second, and is 0 below 0.01
        bench.sleep_ms(6000).await;
        assert_eq!(bench.board.world().drive(ROTARY).unwrap().duty, 0.0);
        let samples = trace(bench, 1000).await;
        assert_eq!(samples.len(), 1000);
        assert!(samples.iter().all(|(position, _, duty)| *duty == 0.0 && *position == samples[0].0));
    });
}

/// Defect 6: a 16-bit count, read without a lock, of one edge in four.
#[test]
fn counts_of_many_turns_are_exact_both_ways() {
    let mut robot: Robot = osmc_bench();
    // ten times the lines: 24 000 counts a turn, so that nine turns wrap a 16-bit counter more than three times
    let Feedback::Encoder { counts_per_turn, .. } = &mut control_of(&mut robot.config, 0).feedback else {
        unreachable!()
    };
    *counts_per_turn = 24_000;
    let Some(SimulatedSensor::Encoder { lines_per_turn, .. }) = &mut robot.simulation.motors[0].sensor else {
        unreachable!()
    };
    *lines_per_turn = 6000;
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        for turns in [9.0, -9.0, 0.0] {
            let measured = bench.host.move_to(ROTARY, turns * TAU, 120.0).await.unwrap().position;
            // one count of 24 000, and the shaft may creep by less than another while it is read
            let error = measured - bench.position(ROTARY);
            assert!(error.abs() < 2.0 * TAU / 24_000.0, "{turns} turns: {error} rad");
        }
    });
}

/// Defect 7: prints at 9600 baud set the rate of the loop.
#[test]
fn telemetry_does_not_change_the_motion() {
    let path = |channels: &[_]| {
        bench(&osmc_bench(), async |bench| {
            for channel in channels {
                bench.host.subscribe(*channel, 1).await.unwrap();
            }
            bench.host.arm().await.unwrap();
            let begin_us = bench.host.device_us();
            // Commands take effect at the next tick: at a millisecond of the board's clock both runs use the same one.
            bench.clock.sleep_until((begin_us / 1000 + 50) * 1_000_000).await;
            let begin_ns = bench.clock.now_ns();
            bench.set(ROTARY, Mode::Position, 1.0).await.unwrap();
            let mut positions = Vec::new();
            for ms in 1..1500 {
                bench.clock.sleep_until(begin_ns + ms * 1_000_000).await;
                positions.push(bench.position(ROTARY));
            }
            let stats = bench.host.stats().await.unwrap();
            assert_eq!(stats.late_ticks, 0);
            positions
        })
    };
    let quiet = path(&[]);
    let loud = path(&[ROTARY, LINEAR, SUPPLY_24, SUPPLY_12]);
    // The command may be sent after a telemetry frame and so arrive a tick later: at most one tick of motion at 3
    // rad/s.
    let apart = quiet.iter().zip(&loud).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart <= 0.003, "{apart} rad");
}

/// Defect 8: millimetres were truncated to whole ones before display.
#[test]
fn positions_are_reported_to_the_sensor_s_resolution() {
    bench(&osmc_bench(), async |bench| {
        for position_m in [0.010_4, 0.033_37, 0.080_99] {
            bench.board.world().set_position(LINEAR, position_m);
            // such a jump is accepted after 100 ms; the rest is for filters
            bench.sleep_ms(300).await;
            assert!((reported_m(bench).await - position_m).abs() < 20e-6, "converter noise is 4 um rms: 5 sigma");
        }
    });
}

/// Defect 9: three potentiometer zeros in one file.
#[test]
fn both_ends_of_the_stroke_read_true() {
    bench(&osmc_bench(), async |bench| {
        for position_m in [0.0, 0.1] {
            bench.board.world().set_position(LINEAR, position_m);
            // such a jump is accepted after 100 ms; the rest is for filters
            bench.sleep_ms(300).await;
            assert!((reported_m(bench).await - position_m).abs() < 20e-6, "converter noise is 4 um rms: 5 sigma");
        }
    });
}

/// Defect 10: a misplaced bracket between target and display caused a difference of 2.99 mm between command and
/// reading.
#[test]
fn what_is_commanded_is_what_is_read_and_what_is_true() {
    bench(&osmc_bench(), async |bench| {
        bench.host.arm().await.unwrap();
        for target_m in [0.010, 0.085, 0.050] {
            let measured_m = bench.host.move_to(LINEAR, target_m, 30.0).await.unwrap().position;
            let true_m = bench.position(LINEAR);
            // the settle band is 0.05 mm and is left at twice that
            assert!(
                (measured_m - target_m).abs() < 1e-4 && (true_m - target_m).abs() < 1.2e-4,
                "{measured_m} {true_m}"
            );
        }
        assert_eq!(bench.safety().await.0, SafetyState::Armed);
    });
}

async fn reported_m(bench: &Bench<'_>) -> f64 {
    let mut telemetry = bench.host.telemetry();
    bench.host.subscribe(LINEAR, 1).await.unwrap();
    let resolution = f64::from(bench.host.channel(LINEAR).unwrap().resolution);
    match telemetry.next().await.unwrap().samples[..] {
        [Sample::Motor { position, .. }] => f64::from(position) * resolution,
        ref other => panic!("one motor is subscribed: {other:?}"),
    }
}
