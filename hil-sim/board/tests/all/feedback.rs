//! Motors with position sensors other than a single encoder: an absolute angle sensor on the bus, and an encoder on
//! either side of play.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::f64::consts::TAU;

use r4_boards::{PlantFile, Robot, SimulatedAngle, SimulatedEncoder, SimulatedPulses, SimulatedSensor};
use r4_protocol::{
    Cause, ChannelId, ChannelKind, Mode, Quality, Range, SafetyState, Sample,
    config::{As5600Config, FeedForward, Feedback, MotorSideConfig, PidGains, ProfileLimits, SensorChip, SensorConfig},
};
use r4_sim::{
    chips::as5600::Magnet,
    i2c::{Disturbance, Injection, Span},
};

use crate::{
    harness::{Bench, MS, ROTARY, bench, control_of, osmc_bench},
    whole_board::sample,
};

const ANGLE: ChannelId = ChannelId::new(ChannelKind::Angle, 0);
const COUNT_RAD: f64 = TAU / 4096.0;
/// Error that counts as settled in these tests, rad; the bench itself settles within 0.0027 rad.
const SETTLE_RAD: f64 = 0.004;
/// Angle of the magnet at position 0, rad.
const ZERO: f32 = 5.0;
/// Position of the shaft at power-on, rad: with this zero the angle has passed through 0 on the way there.
const START: f64 = 2.0;

/// The bench with an angle sensor, read `rate_hz` times a second, in place of its encoder, its range within one turn.
fn angle_bench(rate_hz: u16) -> Robot {
    let mut robot = osmc_bench();
    let control = control_of(&mut robot.config, 0);
    control.feedback = Feedback::Angle { angle: 0, zero: ZERO, inverted: false };
    control.position = Range::symmetric(3.1);
    // Noise of 0.45 counts, rounding included, is 10 mrad/s rms of the speed behind two poles of 10 ms; with 10 ms and
    // twice the noise it would be 34 mrad/s, and a standstill would not be detected.
    control.speed_filter_s = 0.020;
    control.settle.speed = 0.05;
    let chip = SensorChip::As5600(As5600Config { averages: 4 });
    robot.config.sensors.push(SensorConfig { id: ANGLE, address: 0x36, rate_hz, chip }).unwrap();
    robot.config.validate().unwrap();
    robot.simulation.motors[0].sensor = None;
    robot.simulation.motors[0].start = START;
    robot.simulation.angles = vec![SimulatedAngle { channel: ANGLE, of: Some(ROTARY), zero_rad: ZERO.into() }];
    robot
}

/// Reported position, rad, and flags: settled, and homed.
async fn told(bench: &Bench<'_>) -> (f64, bool, bool) {
    let Sample::Motor { position, settled, homed, .. } = sample(bench, ROTARY).await else { panic!("a motor") };
    (f64::from(position) * COUNT_RAD, settled, homed)
}

/// Time of a move until the board reports arrival, ms, and the overshoot, rad.
async fn go(bench: &Bench<'_>, target: f32) -> (u64, f64) {
    let way = (f64::from(target) - bench.position(ROTARY)).signum();
    bench.set(ROTARY, Mode::Position, target).await.unwrap();
    let mut beyond = 0.0f64;
    let mut telemetry = bench.host.telemetry();
    bench.host.subscribe(ROTARY, 1).await.unwrap();
    let from_ns = bench.clock.now_ns();
    loop {
        let frame = telemetry.next().await.unwrap();
        beyond = beyond.max((bench.position(ROTARY) - f64::from(target)) * way);
        let settled = frame.samples.iter().any(|sample| matches!(sample, Sample::Motor { settled: true, .. }));
        let passed_ms = (bench.clock.now_ns() - from_ns) / MS;
        if settled && passed_ms > 20 {
            return (passed_ms, beyond);
        }
        assert!(passed_ms < 9000, "{target}: stands at {}", bench.position(ROTARY));
    }
}

/// The board knows the shaft's position before a command, and moves to targets without homing.
#[test]
fn a_motor_with_an_angle_sensor_needs_no_zero_and_goes_where_it_is_sent() {
    for rate_hz in [1000, 500, 250] {
        bench(&angle_bench(rate_hz), async |bench| {
            let (position, _, homed) = told(bench).await;
            // rounded down to a count, noise of half a count, and the rounding of the zero
            assert!(homed && (position - START).abs() < 3.0 * COUNT_RAD, "{position}");
            let Sample::Sensor { values, quality, .. } = sample(bench, ANGLE).await else { panic!("a sensor") };
            assert_eq!(quality, Quality::Good);
            let shown = (f64::from(values[0]) - f64::from(ZERO)).rem_euclid(TAU);
            assert!((shown - START).abs() < 3.0 * COUNT_RAD, "{shown}");
            bench.host.arm().await.unwrap();
            // through the angle's 0, which is at 1.28 rad, and nearly to both ends
            for target in [0.0, 3.0, -3.0, 0.5] {
                let (took_ms, beyond) = go(bench, target).await;
                let error = bench.position(ROTARY) - f64::from(target);
                println!("{rate_hz} Hz to {target}: {took_ms} ms, {beyond:.4} rad beyond, {error:+.4} rad off");
                // twice the bench's settling error of 4 mrad, which is not corrected, a count and its noise
                assert!(error.abs() < 0.008 + 2.0 * COUNT_RAD, "{rate_hz} Hz, {target}: {error}");
            }
            assert_eq!(bench.host.safety().0, SafetyState::Armed);
        });
    }
}

/// More than a turn: turns are counted by following the angle.
#[test]
fn an_angle_is_followed_over_turns() {
    let mut robot = angle_bench(1000);
    control_of(&mut robot.config, 0).position = Range::symmetric(60.0);
    bench(&robot, async |bench| {
        let (position, _, homed) = told(bench).await;
        assert!(!homed && (position - START).abs() < 3.0 * COUNT_RAD, "within half a turn of 0: {position}");
        bench.host.arm().await.unwrap();
        for target in [10.0, -4.0] {
            go(bench, target).await;
            let error = bench.position(ROTARY) - f64::from(target);
            assert!(error.abs() < 0.008 + 2.0 * COUNT_RAD, "{target}: {error}");
        }
    });
}

fn refuse(bench: &Bench<'_>) {
    let span = Span::Time { from_ns: bench.clock.now_ns(), until_ns: u64::MAX };
    let address = Some(0x36);
    bench.board.world().bus.inject(Injection { disturbance: Disturbance::AddressNack, span, address });
}

fn set_magnet(bench: &Bench<'_>, magnet: Magnet) {
    bench.board.world().angle_sensor(ANGLE).unwrap().borrow_mut().set_magnet(magnet);
}

/// Without valid readings the motor stops: five of them may be missing, one may be in progress, and a period passes
/// until that is detected and one until it takes effect.
#[test]
fn a_motor_stops_when_its_angle_sensor_is_lost() {
    type Change = fn(&Bench<'_>);
    let faults: [(&str, Change, Change); 2] = [
        ("no answer", refuse, |bench| bench.device().free_bus()),
        ("no magnet", |bench| set_magnet(bench, Magnet::Absent), |bench| set_magnet(bench, Magnet::Good)),
    ];
    for rate_hz in [1000, 250] {
        bench(&angle_bench(rate_hz), async |bench| {
            for (fault, break_it, repair) in faults {
                bench.host.arm().await.unwrap();
                bench.set(ROTARY, Mode::Position, if bench.position(ROTARY) > 0.0 { -3.0 } else { 3.0 }).await.unwrap();
                bench.sleep_ms(700).await;
                let speed = bench.board.world().speed(ROTARY).unwrap();
                assert!(speed.abs() > 0.5, "{speed} rad/s");
                let since_ns = bench.clock.now_ns();
                break_it(bench);
                let off_ns = bench.device().wait_off(since_ns, 100 * MS).await.unwrap();
                println!("{rate_hz} Hz, {fault}: off after {:.1} ms", off_ns as f64 * 1e-6);
                let readings_ns = 6 * 1_000_000_000 / u64::from(rate_hz);
                assert!(off_ns <= readings_ns + 3 * MS, "{fault}: {off_ns} ns");
                let (state, causes) = bench.safety().await;
                assert!(state == SafetyState::Tripped && causes.contains(Cause::EncoderImplausible), "{causes}");
                repair(bench);
                // a sensor that did not answer is addressed again after a second
                bench.sleep_ms(1200).await;
                let (position, _, homed) = told(bench).await;
                let truth = bench.position(ROTARY);
                assert!(homed && (position - truth).abs() < 3.0 * COUNT_RAD, "{fault}: {position}, {truth}");
                bench.host.clear().await.unwrap();
            }
        });
    }
}

/// A quality that is only a warning does not stop the motor.
#[test]
fn a_weak_or_strong_magnet_is_told_of_and_stops_nothing() {
    bench(&angle_bench(1000), async |bench| {
        bench.host.arm().await.unwrap();
        for (magnet, expected) in [(Magnet::Weak, Quality::WeakMagnet), (Magnet::Strong, Quality::StrongMagnet)] {
            set_magnet(bench, magnet);
            bench.set(ROTARY, Mode::Position, if bench.position(ROTARY) > 0.0 { -2.0 } else { 2.0 }).await.unwrap();
            bench.sleep_ms(3000).await;
            let Sample::Sensor { quality, .. } = sample(bench, ANGLE).await else { panic!("a sensor") };
            assert_eq!((quality, bench.host.safety().0), (expected, SafetyState::Armed));
        }
    });
}

/// A board powered up without a magnet does not arm, and does once there is one.
#[test]
fn a_board_without_its_angle_does_not_arm() {
    bench(&angle_bench(1000), async |bench| {
        set_magnet(bench, Magnet::Absent);
        bench.sleep_ms(20).await;
        let (state, causes) = bench.safety().await;
        assert!(state == SafetyState::Tripped && causes.contains(Cause::EncoderImplausible), "{causes}");
        assert!(bench.host.clear().await.is_err(), "it is still not there");
        set_magnet(bench, Magnet::Good);
        bench.sleep_ms(20).await;
        bench.host.clear().await.unwrap();
        bench.host.arm().await.unwrap();
    });
}

/// Any shaft turns, but this sensor counts in the wrong direction.
#[test]
fn an_angle_that_falls_while_the_motor_drives_up_trips() {
    let mut robot = angle_bench(1000);
    let control = control_of(&mut robot.config, 0);
    control.feedback = Feedback::Angle { angle: 0, zero: ZERO, inverted: true };
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(ROTARY, Mode::Position, 0.0).await.unwrap();
        bench.sleep_ms(2000).await;
        let (state, causes) = bench.safety().await;
        assert!(state == SafetyState::Tripped && causes.contains(Cause::EncoderImplausible), "{causes}");
    });
}

/// Lines of the encoder at the output, 2400 counts per turn, and of the one on the motor side, 12 000.
const OUTPUT_LINES: u32 = 600;
const MOTOR_LINES: u32 = 3000;

/// A geared motor with the bench's electrical parameters, whose duty is a voltage, with friction, and play of 2°: 32
/// rad/s without load and 73 ms.
const PLANT: &str = "model = \"dc-gear-motor\"
source = \"the bench's motor, its driver without dead zone and curve\"
[parameters]
resistance_ohm = 0.6
inductance_h = 0.001
torque_constant_nm_per_a = 0.0293
gear_ratio = 25.0
inertia_kg_m2 = 0.065
viscous_nm_s_per_rad = 0.03
[[effects]]
effect = \"coulomb-friction\"
torque_nm = 1.0
[[effects]]
effect = \"backlash\"
gap_rad = 0.034906585
";

/// Position sensors of the motor with play.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sensors {
    /// One encoder, at the output.
    Output,
    /// An encoder at the output, and one on the motor side.
    Both,
    /// An angle sensor at the output, and an encoder on the motor side.
    AngleAndMotor,
}

/// The bench with a motor that has play. The gains put both poles of the position loop at 42 rad/s, damped to 0.9,
/// without play.
fn play_bench(sensors: Sensors) -> Robot {
    let mut robot = if sensors == Sensors::AngleAndMotor { angle_bench(1000) } else { osmc_bench() };
    robot.config.motors[0].winding.as_mut().unwrap().dead_duty = 0.0;
    let control = control_of(&mut robot.config, 0);
    control.speed_max = 20.0;
    control.position_pid = PidGains { kp: 4.0, ki: 10.0, kd: 0.14 };
    control.profile = ProfileLimits { speed: 5.0, acceleration: 20.0, jerk: 0.0 };
    // Without a model: an observer at the output alone lands as well as two sensors do (friction.rs), and this test is
    // about the sensors.
    control.feed_forward = FeedForward { static_duty: 0.03, duty_per_speed: 0.031, duty_per_acceleration: 0.0 };
    control.settle.speed = 0.05;
    let two = sensors != Sensors::Output;
    let side = MotorSideConfig { index: 1, counts_per_turn: 4 * MOTOR_LINES, inverted: false, gap_max: 0.06 };
    control.motor_side = two.then_some(side);
    robot.config.validate().unwrap();
    let motor = &mut robot.simulation.motors[0];
    motor.plant = PlantFile { name: "play".into(), text: PLANT.into() };
    motor.start = 0.0;
    if sensors != Sensors::AngleAndMotor {
        motor.sensor = Some(SimulatedSensor::Encoder { input: 0, lines_per_turn: OUTPUT_LINES });
    }
    motor.motor_side = two.then_some(SimulatedEncoder { input: 1, lines_per_turn: MOTOR_LINES });
    robot
}

/// Result of moves of a motor with play.
#[derive(Clone, Copy, Debug, Default)]
struct Played {
    /// Largest overshoot of a target, rad.
    overshoot: f64,
    /// Longest time until the output stays within the settling error, s.
    settled_s: f64,
    /// Travel of the output in the last second, rad, and the number of sign changes of the duty.
    moves: f64,
    turns: u32,
    /// Largest error at the end, rad.
    error: f64,
}

/// Moves to four targets, two of them slightly more than the play apart, and stays at each for three seconds.
fn play(sensors: Sensors) -> Played {
    bench(&play_bench(sensors), async |bench| {
        bench.host.arm().await.unwrap();
        let mut played = Played::default();
        for target in [1.0f32, 0.95, 1.0, -1.0] {
            let way = (f64::from(target) - bench.position(ROTARY)).signum();
            bench.set(ROTARY, Mode::Position, target).await.unwrap();
            let (mut last_off_s, mut turns, mut last_duty) = (0.0f64, 0, 0.0f64);
            let mut last_second = (f64::INFINITY, f64::NEG_INFINITY);
            for ms in 0..3000u32 {
                bench.sleep_ms(1).await;
                let error = bench.position(ROTARY) - f64::from(target);
                played.overshoot = played.overshoot.max(error * way);
                if error.abs() > SETTLE_RAD {
                    last_off_s = f64::from(ms) * 1e-3;
                }
                if ms >= 2000 {
                    last_second = (last_second.0.min(error), last_second.1.max(error));
                    let duty = bench.device().duty(ROTARY);
                    turns += u32::from(duty * last_duty < 0.0);
                    last_duty = if duty == 0.0 { last_duty } else { duty };
                }
            }
            played.settled_s = played.settled_s.max(last_off_s);
            played.moves = played.moves.max(last_second.1 - last_second.0);
            played.turns = played.turns.max(turns);
            played.error = played.error.max((bench.position(ROTARY) - f64::from(target)).abs());
        }
        let (state, causes) = bench.safety().await;
        assert_eq!(state, SafetyState::Armed, "{causes}");
        played
    })
}

/// The encoder at the output alone crosses the play without damping and rests beyond it; with the same gains and one
/// sensor on either side the motor side is damped, and its integral waits while it crosses. The noise of the angle
/// sensor, 0.5 mrad, moves nothing.
///
/// Measured: overshoot 38 mrad, not settled in 3 s; two encoders 6.8 mrad, 0.85 s; angle sensor and encoder 9.8 mrad, 0.64 s.
#[test]
fn an_encoder_on_either_side_of_play_holds_better_than_one_behind_it() {
    let [single, dual, angle] = [Sensors::Output, Sensors::Both, Sensors::AngleAndMotor].map(play);
    println!("one at the output: {single:?}\none on either side: {dual:?}\nangle and encoder: {angle:?}");
    assert!(dual.overshoot < 0.25 * single.overshoot && dual.overshoot < 2.0 * SETTLE_RAD, "{dual:?}, {single:?}");
    assert!(dual.settled_s < 0.5 * single.settled_s && dual.settled_s < 1.0, "{dual:?}, {single:?}");
    assert!(angle.overshoot < 0.5 * single.overshoot && angle.settled_s < 1.0, "{angle:?}, {single:?}");
    for two in [dual, angle] {
        // a count of the angle sensor beyond the settling error
        assert!(two.error < SETTLE_RAD + COUNT_RAD && two.moves < COUNT_RAD && two.turns == 0, "{two:?}");
    }
}

/// More play than the limit: a coupling has slipped, or an encoder lost its shaft.
#[test]
fn sensors_further_apart_than_the_play_stop_the_motor() {
    let mut robot = play_bench(Sensors::Both);
    robot.simulation.motors[0].plant.text = PLANT.replace("0.034906585", "0.2");
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(ROTARY, Mode::Position, 1.0).await.unwrap();
        bench.sleep_ms(1500).await;
        let (state, causes) = bench.safety().await;
        assert!(state == SafetyState::Tripped && causes.contains(Cause::EncoderImplausible), "{causes}");
    });
}

/// The bench with its angle sensor's PWM output at a range connector, instead of the bus; `off` is the error of the
/// sensor's clock.
fn pulse_bench(frames_hz: u16, off: f64) -> Robot {
    let mut robot = angle_bench(1000);
    robot.config.sensors.clear();
    robot.simulation.angles.clear();
    let control = control_of(&mut robot.config, 0);
    control.feedback = Feedback::Pulses { range: 1, frames_hz, zero: ZERO, inverted: false };
    // a frame may be a count wrong at each end, noise of 0.6 counts; readings are further apart
    control.speed_filter_s = 0.040;
    robot.config.validate().unwrap();
    let frames_hz = f64::from(frames_hz) * (1.0 + off);
    let source = SimulatedPulses { connector: 1, of: Some(ROTARY), zero_rad: ZERO.into(), frames_hz };
    robot.simulation.pulses = vec![source];
    robot
}

#[test]
fn a_motor_goes_where_it_is_sent_by_the_pulses_of_its_angle_sensor() {
    for (frames_hz, off) in [(230, 0.05), (230, -0.05), (115, 0.0)] {
        bench(&pulse_bench(frames_hz, off), async |bench| {
            let (position, _, homed) = told(bench).await;
            assert!(homed && (position - START).abs() < 4.0 * COUNT_RAD, "{position}");
            bench.host.arm().await.unwrap();
            for target in [0.0, 3.0, -3.0] {
                let (took_ms, beyond) = go(bench, target).await;
                let error = bench.position(ROTARY) - f64::from(target);
                println!("{frames_hz} frames/s to {target}: {took_ms} ms, {beyond:.4} rad beyond, {error:+.4} rad off");
                assert!(error.abs() < 2.0 * SETTLE_RAD + 3.0 * COUNT_RAD, "{frames_hz}, {target}: {error}");
            }
            // without a magnet there are no pulses: five frames may be missing, one may be in progress
            bench.set(ROTARY, Mode::Position, 3.0).await.unwrap();
            bench.sleep_ms(700).await;
            let since_ns = bench.clock.now_ns();
            bench.board.world().pulse_sensor(1).unwrap().set_magnet(false);
            let off_ns = bench.device().wait_off(since_ns, 200 * MS).await.unwrap();
            println!("{frames_hz} frames/s, no magnet: off after {:.1} ms", off_ns as f64 * 1e-6);
            assert!(off_ns <= 7 * 1_000_000_000 / u64::from(frames_hz) + 3 * MS, "{off_ns} ns");
            let (state, causes) = bench.safety().await;
            assert!(state == SafetyState::Tripped && causes.contains(Cause::EncoderImplausible), "{causes}");
            bench.board.world().pulse_sensor(1).unwrap().set_magnet(true);
            bench.sleep_ms(100).await;
            let (position, _, _) = told(bench).await;
            assert!((position - bench.position(ROTARY)).abs() < 4.0 * COUNT_RAD, "{position}");
            bench.host.clear().await.unwrap();
        });
    }
}

/// A sensor programmed to another rate is not accepted.
#[test]
fn pulses_of_another_rate_are_no_angle() {
    bench(&pulse_bench(115, 1.0), async |bench| {
        let (state, causes) = bench.safety().await;
        assert!(state == SafetyState::Tripped && causes.contains(Cause::EncoderImplausible), "{causes}");
    });
}
