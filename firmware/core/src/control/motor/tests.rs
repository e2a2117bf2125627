//! Tests of [`Motor`] on counts that they choose: loops, path, limits and searches, with numbers that are exact in
//! binary.

extern crate std;

use r4_protocol::{
    Range,
    config::{
        FeedForward, FollowConfig, ForceConfig, ForceSensor, HomingConfig, PotPoint, ProfileLimits, SettleConfig,
        StallConfig,
    },
};

use super::*;
use crate::path::Knot;

/// Control periods per second.
const HZ: u32 = 1024;
const PERIOD_S: f32 = 1.0 / HZ as f32;
const COUNTS_PER_TURN: u32 = 2048;
/// Size of a count, rad.
const RESOLUTION: f32 = core::f32::consts::TAU / COUNTS_PER_TURN as f32;
const LIMITS: OutputLimits = OutputLimits { magnitude: 0.75, slew_per_s: 8.0 };
/// Limits with a slew so fast that the output equals the loops' request.
const FREE: OutputLimits = OutputLimits { magnitude: 1.0, slew_per_s: 4096.0 };
const NO_GAINS: PidGains = PidGains { kp: 0.0, ki: 0.0, kd: 0.0 };
/// Gains of a loop that keeps its integral: with no integral gain at all it is released within seconds.
const KEEPS: PidGains = PidGains { kp: 0.0, ki: 1e-12, kd: 0.0 };

/// Motor with an encoder whose speed is not smoothed, ±8 rad, 4 rad/s and 8 rad/s², without gains and feed-forward, and
/// with a watch that cannot trip.
fn config() -> ControlConfig {
    ControlConfig {
        feedback: Feedback::Encoder {
            index: 0,
            counts_per_turn: COUNTS_PER_TURN,
            inverted: false,
            counts_per_index: 0,
        },
        position: Range::new(-8.0, 8.0),
        speed_max: 1e6,
        position_pid: NO_GAINS,
        speed_pid: NO_GAINS,
        cascade_per_s: 0.0,
        speed_filter_s: 0.0,
        profile: ProfileLimits { speed: 4.0, acceleration: 8.0, jerk: 0.0 },
        feed_forward: FeedForward { static_duty: 0.0, duty_per_speed: 0.0, duty_per_acceleration: 0.0 },
        settle: SettleConfig { error: 0.0625, speed: 0.0625, time_ms: 250 },
        stall: StallConfig { duty: 2.0, travel: 0.02, time_ms: u16::MAX },
        follow: FollowConfig { error: 1e6, time_ms: u16::MAX },
        homing: Some(HomingConfig { switch: 0, position: 1.5, speed_max: 4.0 }),
        motor_side: None,
        force: None,
    }
}

/// Settling that no motor reaches: nothing is pushed where it stands short of its target.
const NEVER_AT_REST: SettleConfig = SettleConfig { error: 0.0625, speed: -1.0, time_ms: 250 };

/// Configuration in which the duty is a sixteenth of the path's speed, whatever the motor does.
fn shows_the_path(config: ControlConfig) -> ControlConfig {
    ControlConfig {
        feed_forward: FeedForward { static_duty: 0.0, duty_per_speed: 1.0 / 16.0, duty_per_acceleration: 0.0 },
        ..config
    }
}

/// Motor whose counter is set by the test.
struct Bench {
    motor: Motor,
    counts: i32,
    switch: Option<bool>,
    causes: Causes,
}

impl Bench {
    fn with(config: ControlConfig, limits: OutputLimits) -> Self {
        let motor = Motor::new(config, limits, PERIOD_S).expect("a period");
        let mut bench = Self { motor, counts: 0, switch: None, causes: Causes::NONE };
        bench.motor.sense(0, None);
        bench
    }

    fn new(config: ControlConfig) -> Self {
        Self::with(config, FREE)
    }

    fn command(&mut self, mode: Mode, value: f32) {
        self.motor.command(Setpoint { mode, value });
    }

    /// Advances one period and returns its duty.
    fn step(&mut self) -> f32 {
        let sensed = self.motor.sense(self.counts as u16, self.switch);
        let (duty, causes) = self.motor.step();
        self.causes = self.causes.union(sensed).union(causes);
        self.motor.set_applied(duty);
        duty
    }

    /// Advances `periods` periods and returns the last duty.
    fn steps(&mut self, periods: u32) -> f32 {
        (0..periods).map(|_| self.step()).last().expect("one at least")
    }

    /// Puts the shaft at a position, rad, as near as its counts allow, at rest.
    fn rest_at(&mut self, rad: f32) {
        self.counts = (rad / RESOLUTION).round() as i32;
        self.motor.sense(self.counts as u16, self.switch);
        // The encoder calls a shaft still after half a second.
        for _ in 0..HZ {
            self.motor.sense(self.counts as u16, self.switch);
        }
    }

    fn settled(&self) -> bool {
        self.motor.status().settled
    }
}

#[track_caller]
fn near(value: f32, expected: f32, tolerance: f32) {
    assert!((value - expected).abs() <= tolerance, "{value}, not {expected}");
}

#[test]
fn an_open_duty_comes_at_the_slew_limit_and_within_the_largest() {
    for (sign, value, reached) in [(1.0, 0.5, 0.5), (-1.0, 0.5, 0.5), (1.0, 2.0, 0.75), (-1.0, 2.0, 0.75)] {
        let mut bench = Bench::with(config(), LIMITS);
        bench.command(Mode::Duty, sign * value);
        // The slew of 8/s is 1/128 per period.
        assert_eq!(bench.step(), sign / 128.0);
        assert_eq!(bench.steps(31), sign * 0.25);
        assert_eq!(bench.steps(128), sign * reached);
        bench.command(Mode::Duty, 0.0);
        assert_eq!(bench.step(), sign * (reached - 1.0 / 128.0));
    }
}

#[test]
fn counts_are_position_and_speed_at_the_shaft() {
    let mut bench = Bench::new(config());
    // From rest, a speed is a mean over half a second.
    bench.motor.sense(1, None);
    for (before, counts) in [(1, 40), (40, 80), (80, -400)] {
        bench.motor.sense(counts as u16, None);
        bench.motor.set_applied(0.25);
        let speed = (counts - before) as f32 * RESOLUTION * HZ as f32;
        let status = bench.motor.status();
        assert_eq!((status.position, status.duty, status.homed, status.settled), (counts, 0.25, false, false));
        near(status.speed, speed, speed.abs() * 1e-6);
        assert_eq!(bench.motor.applied(), (0.25, status.speed));
    }
}

/// Potentiometer with 100 mm between codes 2000 and 62000; a wiper at a rail has no position.
#[test]
fn a_potentiometer_knows_its_position_in_micrometres() {
    let point = |code, position_m| PotPoint { code, position_m };
    let feedback = Feedback::Potentiometer { analog: 0, low: point(2000, 0.0), high: point(62_000, 0.1) };
    let mut motor = Motor::new(ControlConfig { feedback, ..config() }, FREE, PERIOD_S).expect("a period");
    assert_eq!(motor.sense(u16::MAX, None), Causes::only(Cause::EncoderImplausible));
    assert_eq!(motor.sense(32_000, None), Causes::NONE);
    let status = motor.status();
    assert!((status.position - 50_000).abs() <= 1, "{}", status.position);
    assert!(status.homed);
    // A change of 600 codes in a period is 1 mm.
    assert_eq!(motor.sense(32_600, None), Causes::NONE);
    near(motor.status().speed, 1e-3 * HZ as f32, 1e-2);
    assert_eq!(resolution(feedback), 1e-6);
}

#[test]
fn a_speed_is_come_to_along_a_ramp() {
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(shows_the_path(config()));
        bench.command(Mode::Speed, sign * 2.0);
        // The acceleration of 8 rad/s² is 1/128 rad/s per period.
        assert_eq!(bench.step(), sign / 128.0 / 16.0);
        assert_eq!(bench.steps(127), sign / 16.0);
        assert_eq!(bench.steps(500), sign * 2.0 / 16.0);
        // A repeated or changed set point continues from the ramp's present speed.
        bench.command(Mode::Speed, sign * 1.0);
        assert_eq!(bench.step(), sign * (2.0 - 1.0 / 128.0) / 16.0);
    }
}

/// The friction share has the sign of the ramp, and is 0 at rest.
#[test]
fn a_speed_loop_adds_its_parts() {
    let gains = PidGains { kp: 0.125, ki: 0.0, kd: 0.0 };
    let feed_forward = FeedForward { static_duty: 0.25, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(ControlConfig { speed_pid: gains, feed_forward, ..config() });
        bench.command(Mode::Speed, sign * 2.0);
        assert_eq!(bench.steps(256), sign * (0.25 + 0.125 * 2.0));
    }
    // A shaft at 3.14 rad/s is where the ramp begins, also that of a search; after a quarter of a second it is 2 rad/s
    // further.
    for mode in [Mode::Speed, Mode::Home] {
        let mut bench = Bench::new(ControlConfig { speed_pid: gains, ..config() });
        for periods in 0..512 {
            if periods == 256 {
                bench.command(mode, 8.0);
            }
            bench.counts += 1;
            bench.step();
        }
        near(bench.motor.status().duty, 0.125 * 2.0, 1e-3);
    }
    // The derivative acts on the shaft's acceleration: one count in a period, then two.
    let gains = PidGains { kp: 0.0, ki: 0.0, kd: 1.0 / 8192.0 };
    let mut bench = Bench::new(ControlConfig { speed_pid: gains, ..config() });
    bench.command(Mode::Speed, 2.0);
    for counts in [1, 2, 3, 5] {
        bench.counts = counts;
        bench.step();
    }
    near(bench.motor.status().duty, -RESOLUTION * 1024.0 * 1024.0 / 8192.0, 1e-4);
}

/// A mode starts from the present speed and duty, whatever mode gave them.
#[test]
fn another_mode_begins_where_the_last_one_left() {
    for (mode, value) in [(Mode::Speed, 4.0), (Mode::Position, 6.0), (Mode::Home, 4.0)] {
        let config = ControlConfig { position_pid: KEEPS, speed_pid: KEEPS, ..config() };
        let mut bench = Bench::with(config, LIMITS);
        bench.command(Mode::Duty, 0.5);
        bench.steps(128);
        bench.command(mode, value);
        // The loops request nothing: back from 0.5 at the slew limit.
        assert_eq!(bench.step(), 0.5 - 1.0 / 128.0, "{mode:?}");
    }
    for (mode, value) in [(Mode::Speed, 4.0), (Mode::Position, 6.0), (Mode::Home, 4.0)] {
        let mut bench = Bench::new(shows_the_path(config()));
        bench.counts = 1;
        let mut speed = 0.0;
        for _ in 0..100 {
            bench.counts += 1;
            bench.step();
            speed = bench.motor.status().speed;
        }
        bench.command(mode, value);
        bench.counts += 1;
        // A count per period is 3.14 rad/s: the ramp continues from there.
        near(bench.step() * 16.0, speed + 8.0 * PERIOD_S, 1e-4);
    }
}

/// The speed near the end follows `v = sqrt(2 a s)`: 1 rad from the end of the range, 4 rad/s at 8 rad/s².
#[test]
fn a_speed_is_never_more_than_stops_before_the_end_of_the_range() {
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(shows_the_path(config()));
        bench.rest_at(sign * 7.5);
        bench.command(Mode::Speed, sign * 16.0);
        let room = 8.0 - (7.5f32 / RESOLUTION).round() * RESOLUTION;
        near(bench.steps(2048) * 16.0, sign * (2.0 * 8.0 * room).sqrt(), 1e-3);
        // In the other direction there are 15.5 rad: 15.7 rad/s.
        bench.command(Mode::Speed, -sign * 15.0);
        near(bench.steps(4096) * 16.0, -sign * 15.0, 1e-3);
    }
}

/// Duty that holds the load in the tests of holding; friction alone takes 0.125.
const LOAD: f32 = 0.5;

/// Motor at rest in speed mode at 0, with the duty that holds a load.
fn at_speed_zero(sign: f32) -> Bench {
    let feed_forward = FeedForward { static_duty: 0.125, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
    // With a proportional part: without one, anti-windup would unload within a period what the slew limit takes away.
    let speed_pid = PidGains { kp: 0.0625, ..KEEPS };
    let mut bench = Bench::with(ControlConfig { speed_pid, feed_forward, ..config() }, LIMITS);
    bench.command(Mode::Duty, sign * LOAD);
    bench.steps(256);
    bench.command(Mode::Speed, 0.0);
    bench
}

/// Motor settled at position 0, with the duty that holds a load.
fn at_position_zero(sign: f32) -> Bench {
    let feed_forward = FeedForward { static_duty: 0.125, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
    let position_pid = PidGains { kp: 0.0, ki: 1.0, kd: 0.0 };
    let mut bench = Bench::with(ControlConfig { position_pid, feed_forward, ..config() }, LIMITS);
    bench.rest_at(-sign * 0.5);
    bench.command(Mode::Position, 0.0);
    assert!((0..8 * HZ).any(|_| bench.step().abs() >= LOAD + 0.125));
    // It arrives. Friction is still compensated in the direction of arrival.
    bench.rest_at(0.0);
    assert!(!bench.settled());
    // Settling takes 250 ms of rest.
    bench.steps(255);
    assert!(!bench.settled());
    near(bench.step(), sign * (LOAD + 0.125), 1e-2);
    assert!(bench.settled());
    bench
}

/// At rest the duty is released by 1/e per second, and below a hundredth at once.
#[test]
fn at_rest_a_duty_is_let_go() {
    for sign in [1.0, -1.0] {
        for (mut bench, duty) in [(at_speed_zero(sign), LOAD), (at_position_zero(sign), LOAD + 0.125)] {
            near(bench.steps(HZ), sign * duty * (-1.0f32).exp(), 5e-3);
            let periods = (0..8 * HZ).find(|_| bench.step() == 0.0).expect("it ends");
            near(periods as f32, (100.0 * duty).ln() * HZ as f32 - HZ as f32, 30.0);
        }
    }
}

/// A slip of half the settling error against the duty, 0.03125 rad or 10.2 counts, restores the duty at which the motor
/// came to rest.
#[test]
fn a_load_that_slips_is_held() {
    for sign in [1.0, -1.0] {
        for (counts, slips) in [(-11i32, true), (-10, false), (11, false)] {
            for (mut bench, duty) in [(at_speed_zero(sign), LOAD), (at_position_zero(sign), LOAD + 0.125)] {
                bench.steps(HZ);
                // A speed of 0.05 rad/s still counts as rest.
                let mut last = bench.step();
                for period in 0..HZ * 2 {
                    if period.is_multiple_of(64) && period / 64 < counts.unsigned_abs() {
                        bench.counts += counts.signum() * sign as i32;
                    }
                    let duty = bench.step();
                    assert!((duty - last).abs() <= 8.0 * PERIOD_S, "no jump");
                    last = duty;
                }
                if slips {
                    near(last, sign * duty, 1e-2);
                } else {
                    assert!(last.abs() < 0.1, "{counts}: {last}");
                }
            }
        }
    }
}

/// A load that keeps slipping, however slowly, is left to the speed loop, which starts from the duty that held it:
/// 0.049 rad/s for a second.
#[test]
fn a_load_that_goes_on_slipping_is_driven_against() {
    let mut bench = at_speed_zero(1.0);
    let slip = |bench: &mut Bench, counts| {
        (0..counts).fold(0.0, |_, _| {
            bench.counts -= 1;
            bench.steps(64)
        })
    };
    let held = slip(&mut bench, 20);
    near(held, LOAD, 2e-2);
    bench.motor.set_gains(Mode::Speed, PidGains { kp: 0.0625, ki: 1.0, kd: 0.0 });
    near(slip(&mut bench, 16) - held, 0.049, 5e-3);
}

/// A duty within friction holds no load: it is released, with or without a slip.
#[test]
fn friction_is_no_load() {
    let feed_forward = FeedForward { static_duty: 0.125, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
    for (duty, held) in [(0.125, false), (0.126, true)] {
        let mut bench = Bench::new(ControlConfig { speed_pid: KEEPS, feed_forward, ..config() });
        bench.command(Mode::Duty, duty);
        bench.step();
        bench.command(Mode::Speed, 0.0);
        bench.steps(64);
        for _ in 0..20 {
            bench.counts -= 1;
            bench.steps(64);
        }
        assert_eq!(bench.step() > 0.12, held, "{duty}");
    }
}

/// The friction share of the holding duty is added again for a move in the same direction, and taken twice for the
/// opposite one.
#[test]
fn a_held_motor_moves_on_without_a_jump() {
    for sign in [1.0, -1.0] {
        for (target, change) in [(0.5, 0.0), (-0.5, -0.25)] {
            let mut bench = at_position_zero(sign);
            let held = bench.step();
            bench.command(Mode::Position, sign * target);
            near(bench.steps(64), held + sign * change, 2e-2);
        }
    }
}

/// Neither a motor that moves faster than rest nor one that is to move is released.
#[test]
fn a_motor_that_moves_is_not_let_go() {
    let mut bench = at_speed_zero(1.0);
    // A count every 48 periods is 0.065 rad/s.
    let mut creep = |counts| {
        (0..counts).fold(0.0, |_, _| {
            bench.counts += 1;
            bench.steps(48)
        })
    };
    let begin = creep(4);
    near(creep(40), begin, 1e-3);
    assert!(begin > 0.4);
    let mut bench = at_speed_zero(1.0);
    bench.steps(HZ);
    let held = bench.step();
    bench.command(Mode::Speed, 0.5);
    // Friction is added, and the proportional part of 0.5 rad/s.
    let expected = held + 0.125 + 0.0625 * 0.5;
    near(bench.steps(64), expected, 1e-2);
    near(bench.steps(HZ), expected, 1e-2);
}

/// Path with 8 rad/s² up to 4 rad/s, and down again.
#[test]
fn a_position_is_come_to_along_its_path() {
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(shows_the_path(ControlConfig { settle: NEVER_AT_REST, ..config() }));
        bench.command(Mode::Position, sign * 4.0);
        assert_eq!(bench.step(), sign / 128.0 / 16.0);
        assert_eq!(bench.steps(127), sign / 16.0);
        assert_eq!(bench.steps(512), sign * 4.0 / 16.0);
        // At 1 s, after half a second up and half a second down: 4 rad in 1.5 s.
        near(bench.steps(HZ * 5 / 4 - 640) * 16.0, sign * 2.0, 0.02);
        assert_eq!(bench.steps(HZ / 4 + 4), 0.0);
        assert_eq!(bench.steps(100), 0.0);
    }
}

/// Parts of the duty: `kp` of the distance from the path, `kd` of the speed relative to it, and friction in its
/// direction.
#[test]
fn a_position_loop_adds_its_parts() {
    for sign in [1.0, -1.0] {
        let part = |kp, kd, static_duty| {
            let position_pid = PidGains { kp, ki: 0.0, kd };
            let feed_forward = FeedForward { static_duty, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
            let mut bench = Bench::new(ControlConfig { position_pid, feed_forward, ..config() });
            bench.command(Mode::Position, sign * 4.0);
            bench.steps(512)
        };
        // After half a second it is 1 rad behind, at 4 rad/s; discrete sums have half a period more.
        near(part(0.5, 0.0, 0.0), sign * 0.5, 2e-3);
        near(part(0.0, 0.125, 0.0), sign * 0.5, 1e-6);
        assert_eq!(part(0.0, 0.0, 0.25), sign * 0.25);
        // A shaft at 3.14 rad/s.
        let position_pid = PidGains { kp: 0.0, ki: 0.0, kd: 0.125 };
        let mut bench = Bench::new(ControlConfig { position_pid, ..config() });
        bench.command(Mode::Position, sign * 8.0);
        let mut duty = 0.0;
        for _ in 0..768 {
            bench.counts += sign as i32;
            duty = bench.step();
        }
        near(duty, sign * 0.125 * (4.0 - RESOLUTION * HZ as f32), 1e-3);
    }
}

/// After the path the friction share pushes towards the target, until the motor is within the band; there it stays
/// unchanged.
#[test]
fn friction_is_overcome_towards_the_target() {
    let feed_forward = FeedForward { static_duty: 0.25, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(ControlConfig { feed_forward, ..config() });
        bench.command(Mode::Position, sign * 1.0);
        // The motor runs past its target.
        bench.steps(HZ);
        bench.rest_at(sign * 1.25);
        near(bench.step(), sign * -0.25, 0.05);
        bench.rest_at(sign * 1.02);
        // Within the band the share stays, also on the far side.
        near(bench.steps(8), sign * -0.25, 0.05);
        bench.rest_at(sign * 0.98);
        near(bench.steps(8), sign * -0.25, 0.05);
        // A new target within a step of the path does not change it either.
        bench.command(Mode::Position, sign * 1.000_001);
        near(bench.steps(8), sign * -0.25, 0.05);
    }
}

/// The duty of a motor that stands short of its target rises by 0.1 per second; it does not on the way there, in the
/// band, or while the motor moves.
#[test]
fn a_motor_that_stands_short_is_driven_harder() {
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(ControlConfig { position_pid: KEEPS, ..config() });
        bench.command(Mode::Position, sign * 0.125);
        // The way takes sqrt(4 · 0.125 / 8) s.
        near(bench.steps(250), 0.0, 1e-9);
        let before = bench.steps(16);
        near(bench.steps(HZ) - before, sign * 0.1, 2e-3);
        // A count every 48 periods is 0.065 rad/s, faster than rest.
        let mut bench = Bench::new(ControlConfig { position_pid: KEEPS, ..config() });
        bench.command(Mode::Position, sign * 0.25);
        let mut last = 0.0;
        for _ in 0..40 {
            bench.counts += sign as i32;
            last = bench.steps(48);
        }
        near(last, 0.0, 1e-9);
        let mut bench = Bench::new(ControlConfig { position_pid: KEEPS, ..config() });
        bench.command(Mode::Position, sign * 0.0625);
        near(bench.steps(2 * HZ), 0.0, 1e-9);
    }
}

/// An integral that holds the motor away from its target is released by 1/e per second.
#[test]
fn an_integral_against_the_target_is_let_go() {
    for sign in [1.0, -1.0] {
        let position_pid = PidGains { kp: 0.0, ki: 1.0, kd: 0.0 };
        let mut bench = Bench::new(ControlConfig { position_pid, ..config() });
        bench.rest_at(-sign * 0.5);
        bench.command(Mode::Position, 0.0);
        assert!((0..8 * HZ).any(|_| bench.step().abs() >= LOAD));
        // Beyond the target, in the band: the integral opposes the return, which itself adds 0.05 per second.
        bench.rest_at(sign * 0.05);
        bench.command(Mode::Position, 0.0);
        let begin = bench.step();
        near(begin, sign * LOAD, 1e-2);
        let after = bench.steps(200);
        let expected = LOAD * (-200.0f32 / 1024.0).exp() - 0.05 * 200.0 / 1024.0;
        near(after, sign * expected, 1e-2);
    }
}

/// Settling takes 250 ms within 0.0625 rad at less than 0.0625 rad/s; it ends beyond twice that distance.
#[test]
fn a_motor_settles_and_is_pushed_away() {
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(shows_the_path(config()));
        bench.rest_at(sign * 0.0614);
        bench.command(Mode::Position, 0.0);
        // The path there, and then the settling time.
        let until = (0..HZ).find(|_| {
            bench.step();
            bench.settled()
        });
        // The path takes 2 sqrt(0.0614 / 8) s, 180 periods.
        assert!(until.is_some_and(|periods| periods.abs_diff(180 + 256) < 5), "{until:?}");
        bench.rest_at(sign * 0.122);
        bench.steps(8);
        assert!(bench.settled());
        bench.rest_at(sign * 0.128);
        // A path leads the motor back.
        assert!(bench.step() * sign < 0.0);
        assert!(!bench.settled());
        // A shaft that moves is not at rest.
        let mut bench = Bench::new(config());
        bench.command(Mode::Position, 0.0);
        for turn in 0..20 {
            bench.counts += if turn % 2 == 0 { 1 } else { -1 };
            bench.steps(40);
            assert!(!bench.settled());
        }
    }
    // Outside the band it never settles.
    let mut bench = Bench::new(config());
    bench.rest_at(0.066);
    bench.command(Mode::Position, 0.0);
    bench.steps(2 * HZ);
    assert!(!bench.settled());
}

/// A repeated set point changes nothing; a new position under way bends the path, without a stop.
#[test]
fn a_position_is_told_again_and_anew() {
    let mut bench = Bench::new(config());
    bench.command(Mode::Position, 0.0);
    bench.steps(300);
    assert!(bench.settled());
    bench.command(Mode::Position, 0.0);
    bench.step();
    assert!(bench.settled());
    let mut bench = Bench::new(shows_the_path(ControlConfig { settle: NEVER_AT_REST, ..config() }));
    bench.command(Mode::Position, 4.0);
    bench.steps(512);
    bench.command(Mode::Position, 6.0);
    assert_eq!(bench.step(), 4.0 / 16.0);
    // The additional 2 rad take half a second more: up, 1 s, down.
    near(bench.steps(HZ * 7 / 4 - 513) * 16.0, 2.0, 0.02);
    assert_eq!(bench.steps(HZ), 0.0);
    // A further set point from rest.
    bench.command(Mode::Position, 5.0);
    assert_eq!(bench.step(), -1.0 / 128.0 / 16.0);
}

/// At an end of the range no duty drives further out, until the motor has come back by more than the settling error.
#[test]
fn the_end_of_the_range_stops_a_motor() {
    for sign in [1.0, -1.0] {
        for mode in [Mode::Duty, Mode::Speed] {
            let mut bench = Bench::new(ControlConfig { speed_pid: KEEPS, ..shows_the_path(config()) });
            let out = if mode == Mode::Duty { 0.25 } else { 2.0 };
            // The last count within the range is 8 rad less a fifth of a count.
            bench.counts = sign as i32 * 2607;
            bench.command(mode, sign * out);
            bench.steps(600);
            assert!((0..10).all(|_| bench.step() * sign > 0.0), "{mode:?}");
            bench.counts = sign as i32 * 2608;
            assert_eq!(bench.step(), 0.0, "{mode:?}");
            assert_eq!(bench.steps(10), 0.0, "{mode:?}");
            // The settling error of 0.0625 rad is 20.4 counts.
            bench.counts = sign as i32 * 2588;
            assert_eq!(bench.steps(10), 0.0, "{mode:?}");
            bench.counts = sign as i32 * 2587;
            assert!(bench.steps(10) * sign > 0.0, "{mode:?}");
            // Inwards the motor may move at any time.
            bench.counts = sign as i32 * 2700;
            bench.step();
            bench.command(mode, -sign * out);
            assert!(bench.steps(600) * sign < 0.0, "{mode:?}");
        }
        // A position at the very end is held from both sides: the range is wider by the settling error.
        let position_pid = PidGains { kp: 4.0, ki: 0.0, kd: 0.0 };
        let mut bench = Bench::new(ControlConfig { position_pid, ..config() });
        bench.rest_at(sign * 8.0);
        bench.command(Mode::Position, sign * 8.5);
        bench.steps(HZ);
        bench.counts = sign as i32 * 2627;
        assert!(bench.step() * sign > 0.0);
        bench.counts = sign as i32 * 2630;
        assert_eq!(bench.step(), 0.0);
    }
}

/// Homing seeks the switch, leaves it at a fifth of the speed, and takes its opening as 1.5 rad.
#[test]
fn a_search_takes_the_place_where_its_switch_opens() {
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(shows_the_path(config()));
        bench.switch = Some(false);
        bench.counts = 77;
        bench.command(Mode::Home, sign * 2.0);
        assert_eq!(bench.step(), sign / 128.0 / 16.0);
        assert_eq!(bench.steps(300), sign * 2.0 / 16.0);
        assert!(!bench.motor.status().homed);
        bench.switch = Some(true);
        // The motor reverses along the ramp, and comes back at 0.4 rad/s.
        near(bench.steps(HZ), -sign * 0.4 / 16.0, 1e-6);
        bench.switch = Some(false);
        bench.step();
        let status = bench.motor.status();
        assert!(status.homed);
        // The zero of 1.5 rad is 489 counts, where the motor also stays.
        bench.step();
        assert_eq!(bench.motor.status().position, 489);
        bench.steps(HZ);
        assert!(bench.settled());
        bench.counts += 10;
        bench.step();
        assert_eq!(bench.motor.status().position, 499);
        // A second search discards the first, starting from the present position.
        bench.command(Mode::Home, sign * 2.0);
        bench.step();
        assert!(!bench.motor.status().homed);
        assert_eq!(bench.causes, Causes::NONE);
    }
}

/// Turns the shaft by `per_period` counts in each of `periods` periods; pulses come at multiples of 256 counts from
/// 100.
fn turn(bench: &mut Bench, periods: u32, per_period: i32) {
    for _ in 0..periods {
        let before = bench.counts;
        bench.counts += per_period;
        let sensed = bench.motor.sense(bench.counts as u16, bench.switch);
        bench.causes = bench.causes.union(sensed);
        let (least, most) = ((before + 1).min(bench.counts), (before - 1).max(bench.counts));
        for count in (least..=most).filter(|count| (count - 100).rem_euclid(256) == 0) {
            bench.causes = bench.causes.union(bench.motor.sense_index(count as u16));
        }
        bench.causes = bench.causes.union(bench.motor.step().1);
    }
}

fn with_index(switch: u8) -> Bench {
    let feedback =
        Feedback::Encoder { index: 0, counts_per_turn: COUNTS_PER_TURN, inverted: false, counts_per_index: 256 };
    let homing = Some(HomingConfig { switch, position: 1.5, speed_max: 4.0 });
    Bench::new(ControlConfig { feedback, homing, ..config() })
}

/// From any place, in either direction and at any speed, the zero is the pulse itself, not the motor's position when it
/// was reported.
#[test]
fn a_search_takes_the_first_index_pulse() {
    for (start, per_period, pulse) in [(0, 7, 100), (99, 1, 100), (101, 9, 356), (0, -7, -156), (356, -9, 100)] {
        let mut bench = with_index(0);
        bench.counts = start;
        bench.motor.sense(start as u16, None);
        bench.command(Mode::Home, (per_period as f32).signum());
        // The state of a debounced switch does not matter.
        bench.switch = Some(true);
        turn(&mut bench, 64, per_period);
        assert!(bench.motor.status().homed, "{start} {per_period}");
        // The zero of 1.5 rad is 489 counts.
        assert_eq!(bench.motor.status().position - 489, bench.counts - pulse, "{start} {per_period}");
        let target = bench.motor.target;
        assert_eq!((target, bench.causes), (1.5, Causes::NONE));
    }
}

/// With a switch on another input, pulses before the switch has opened do not count.
#[test]
fn a_search_by_switch_and_index_takes_the_pulse_after_the_switch() {
    let mut bench = with_index(1);
    bench.switch = Some(false);
    bench.command(Mode::Home, 2.0);
    turn(&mut bench, 100, 5);
    bench.switch = Some(true);
    turn(&mut bench, 300, 1);
    turn(&mut bench, 300, -1);
    bench.switch = Some(false);
    turn(&mut bench, 1, -1);
    assert!(!bench.motor.status().homed);
    // At 499 the switch has opened; the pulse follows at 356.
    assert_eq!(bench.counts, 499);
    turn(&mut bench, 142, -1);
    assert!(!bench.motor.status().homed);
    turn(&mut bench, 1, -1);
    assert!(bench.motor.status().homed);
    assert_eq!(bench.motor.status().position, 489);
}

/// Counts that the counter did not see are reported at the next pulse, once, and the motor is no longer homed.
#[test]
fn lost_counts_are_seen_at_the_next_index_pulse() {
    let mut bench = with_index(0);
    bench.command(Mode::Home, 1.0);
    turn(&mut bench, 100, 8);
    assert!(bench.motor.status().homed);
    bench.causes = Causes::NONE;
    for lost in [0, 8] {
        // The pulses keep their places, and the counter is behind.
        let at = (100 + 256 * 8 - lost) as u16;
        bench.motor.sense(at, None);
        let causes = bench.motor.sense_index(at);
        assert_eq!(causes.contains(Cause::EncoderImplausible), lost > 0);
        assert_eq!(bench.motor.status().homed, lost == 0);
    }
    let at = (100 + 256 * 9 - 8) as u16;
    bench.motor.sense(at, None);
    assert_eq!(bench.motor.sense_index(at), Causes::NONE, "told once");
    // A new search finds the zero again.
    bench.command(Mode::Home, 1.0);
    bench.motor.sense(at, None);
    assert_eq!(bench.motor.sense_index(at), Causes::NONE);
    bench.motor.step();
    assert!(bench.motor.status().homed);
}

/// The motor overshoots a short cam: the switch opens on the far side while the ramp reverses, which is no zero.
#[test]
fn a_switch_that_opens_on_the_far_side_is_no_zero() {
    for sign in [1.0, -1.0] {
        let mut bench = Bench::new(config());
        bench.switch = Some(false);
        bench.command(Mode::Home, sign * 2.0);
        bench.steps(300);
        for switch in [true, false] {
            bench.switch = Some(switch);
            bench.steps(32);
        }
        assert!(!bench.motor.status().homed);
        // On the way back it closes once more, and opens at the zero.
        bench.steps(HZ);
        for (switch, homed) in [(true, false), (false, true)] {
            bench.switch = Some(switch);
            bench.steps(32);
            assert_eq!(bench.motor.status().homed, homed);
        }
    }
}

/// The switch counts as seen again only on the way back: neither while the ramp still runs on, nor while the shaft
/// does.
#[test]
fn a_switch_seen_while_the_motor_runs_on_does_not_count() {
    for (backwards, homed) in [(false, false), (true, true)] {
        let mut bench = Bench::new(config());
        bench.switch = Some(false);
        bench.command(Mode::Home, 2.0);
        bench.steps(HZ);
        for switch in [true, false] {
            bench.switch = Some(switch);
            // After half a second the ramp has reversed long ago.
            for _ in 0..HZ / 2 {
                bench.counts += if backwards { -1 } else { 1 };
                bench.step();
            }
        }
        assert_eq!(bench.motor.status().homed, homed, "{backwards}");
    }
}

/// A search gives up after 1.2 times the range of 16 rad: 6258.3 counts in either direction. An unknown switch counts
/// as none.
#[test]
fn a_search_that_goes_too_far_is_implausible() {
    for (sign, switch) in [(1, Some(false)), (-1, None)] {
        let mut bench = Bench::new(config());
        bench.switch = switch;
        bench.rest_at(1.0);
        bench.command(Mode::Home, sign as f32);
        bench.counts += sign * 6258;
        bench.step();
        assert_eq!(bench.causes, Causes::NONE);
        bench.counts += sign;
        bench.step();
        assert_eq!(bench.causes, Causes::only(Cause::EncoderImplausible));
    }
}

/// A search goes beyond the ends of the range, which it has yet to find.
#[test]
fn a_search_knows_no_ends() {
    let mut bench = Bench::new(shows_the_path(config()));
    bench.rest_at(9.0);
    bench.command(Mode::Home, 2.0);
    assert_eq!(bench.steps(300), 2.0 / 16.0);
}

#[test]
fn a_repeated_search_goes_on() {
    let mut bench = Bench::new(shows_the_path(config()));
    bench.switch = Some(false);
    bench.command(Mode::Home, 2.0);
    bench.steps(300);
    bench.switch = Some(true);
    bench.steps(HZ);
    bench.command(Mode::Home, 2.0);
    // A restarted search would reverse again.
    near(bench.step(), -0.4 / 16.0, 1e-6);
    bench.command(Mode::Home, 1.0);
    // At half the speed: this search begins with a closed switch.
    near(bench.steps(200), -0.2 / 16.0, 1e-6);
}

#[test]
fn a_stopped_motor_has_forgotten_everything() {
    let mut bench = Bench::new(shows_the_path(config()));
    bench.command(Mode::Speed, 2.0);
    bench.steps(300);
    bench.motor.stop();
    let status = bench.motor.status();
    assert_eq!((status.setpoint, status.duty), (Setpoint { mode: Mode::Duty, value: 0.0 }, 0.0));
    assert_eq!(bench.motor.step(), (0.0, Causes::NONE));
}

/// Each mode has its own loop, and open-loop duty none.
#[test]
fn new_gains_are_for_one_loop() {
    let gains = PidGains { kp: 0.25, ki: 0.0, kd: 0.0 };
    for (changed, mode, duty) in [
        (Mode::Speed, Mode::Speed, 0.25),
        (Mode::Speed, Mode::Position, 0.0),
        (Mode::Position, Mode::Position, 0.25),
        (Mode::Position, Mode::Speed, 0.0),
        (Mode::Duty, Mode::Speed, 0.0),
        (Mode::Duty, Mode::Position, 0.0),
    ] {
        let mut bench = Bench::new(config());
        bench.motor.set_gains(changed, gains);
        bench.command(mode, 1.0);
        // A distance of 1 rad/s or 1 rad, by a ramp or a path; over a long time the push is included.
        near(bench.steps(HZ), duty, 0.1);
    }
}

/// The watch sees every mode that wants motion: a loop whose sensor is dead drives without motion.
#[test]
fn a_dead_sensor_is_seen_in_every_mode_that_wants_motion() {
    // More than 4 · 0.75 · 100 ms: half a second at 0.625 beyond friction.
    let stall = StallConfig { duty: 0.75, travel: 0.02, time_ms: 100 };
    let speed_pid = PidGains { kp: 0.3125, ki: 0.0, kd: 0.0 };
    let config = ControlConfig { stall, speed_pid, position_pid: speed_pid, ..config() };
    for (mode, value, seen) in
        [(Mode::Speed, 2.0, true), (Mode::Position, 2.0, true), (Mode::Home, 2.0, true), (Mode::Duty, 0.625, false)]
    {
        let mut bench = Bench::new(config);
        bench.command(mode, value);
        bench.steps(HZ);
        assert_eq!(bench.causes.contains(Cause::Stalled), seen, "{mode:?}");
    }
    // A motor that holds a load, in either mode, does not trip.
    for mut bench in [at_speed_zero(1.0), at_position_zero(1.0)] {
        // Three hundredths of duty beyond friction for a second would trip if it wanted motion.
        bench.motor.control.stall = StallConfig { duty: 0.75, travel: 0.02, time_ms: 12 };
        bench.steps(HZ);
        assert_eq!(bench.causes, Causes::NONE);
    }
    // A motor that is shaken at rest, and is not released, does not trip either.
    let mut bench = at_speed_zero(1.0);
    bench.motor.control.stall = StallConfig { duty: 0.75, travel: 0.02, time_ms: 12 };
    for turn in 0..20 {
        bench.counts += if turn % 2 == 0 { 1 } else { -1 };
        bench.steps(20);
    }
    assert_eq!(bench.causes, Causes::NONE);
    // Behind its path by more than a quarter of a rad for 100 ms.
    let follow = FollowConfig { error: 0.25, time_ms: 100 };
    let mut bench = Bench::new(ControlConfig { follow, ..self::config() });
    bench.command(Mode::Position, 4.0);
    // Error reached after sqrt(2 · 0.25 / 8) s: 256 periods, and 102 more.
    let periods = (0..HZ).find(|_| {
        bench.step();
        !bench.causes.is_empty()
    });
    assert!(periods.is_some_and(|periods| periods.abs_diff(256 + 102) <= 3), "{periods:?}");
    assert_eq!(bench.causes, Causes::only(Cause::Stalled));
}

// Tests of paths.

/// Path with 8 rad/s² for half a second up to 4 rad/s, that speed, and the same down again.
#[test]
fn a_duty_for_the_acceleration_of_the_path_is_added() {
    let feed_forward = FeedForward { static_duty: 0.0, duty_per_speed: 0.0, duty_per_acceleration: 1.0 / 64.0 };
    for (mode, value, ends) in [(Mode::Position, 6.0, true), (Mode::Speed, 4.0, false)] {
        let mut bench = Bench::new(ControlConfig { feed_forward, settle: NEVER_AT_REST, ..config() });
        bench.command(mode, value);
        let duties: std::vec::Vec<f32> = (0..3 * HZ).map(|_| bench.step()).collect();
        let [up, steady, down] = [HZ / 4, HZ, 3 * HZ / 2 + HZ / 4].map(|period| duties[period as usize]);
        // A speed of a few rad/s is rounded to 2e-7 rad/s, over a period of 1e-3 s: 2e-4 rad/s².
        near(up, 0.125, 1e-5);
        near(steady, 0.0, 1e-5);
        near(down, if ends { -0.125 } else { 0.0 }, 1e-5);
    }
}

/// The cascade asks for 4 rad/s per rad of distance, up to the highest speed; the duty is that of the speed loop.
#[test]
fn in_a_cascade_the_speed_loop_holds_the_position() {
    let speed_pid = PidGains { kp: 1.0 / 16.0, ki: 0.0, kd: 0.0 };
    let position_pid = PidGains { kp: 1.0, ki: 1.0, kd: 1.0 };
    for (speed_max, duty) in [(8.0, 0.125), (1.0, 0.0625)] {
        let cascade = ControlConfig { cascade_per_s: 4.0, speed_max, speed_pid, position_pid, ..config() };
        let mut bench = Bench::new(ControlConfig { settle: NEVER_AT_REST, ..cascade });
        bench.command(Mode::Position, 0.5);
        // The path ends after 0.5 s.
        near(bench.steps(HZ), duty, 1e-6);
        bench.command(Mode::Position, -0.5);
        near(bench.steps(HZ), -duty, 1e-6);
    }
}

/// A motor at rest keeps its duty when the position loop is exchanged: only the slope of the integral changes.
#[test]
fn another_loop_takes_over_a_position_without_a_jump() {
    let position_pid = PidGains { kp: 0.0, ki: 0.25, kd: 0.0 };
    let speed_pid = PidGains { kp: 0.0, ki: 0.25, kd: 0.0 };
    let mut bench = Bench::new(ControlConfig { settle: NEVER_AT_REST, position_pid, speed_pid, ..config() });
    bench.command(Mode::Position, 0.5);
    let before = bench.steps(2 * HZ);
    assert!(before > 0.1, "{before}");
    let feed_forward = FeedForward { static_duty: 0.0, duty_per_speed: 0.0, duty_per_acceleration: 0.0 };
    bench.motor.set_tuning(Tuning { feed_forward, cascade_per_s: 4.0 });
    // At a distance of 0.5 rad the cascade asks for 2 rad/s: four times as much as before is integrated per period,
    // which shows in the next.
    near(bench.step(), before, 1e-6);
    near(bench.step(), before + 0.25 * 2.0 / HZ as f32, 1e-4);
    // A feed-forward set during a motion takes effect in the next period.
    let mut bench = Bench::new(ControlConfig { settle: NEVER_AT_REST, ..config() });
    bench.command(Mode::Position, 6.0);
    bench.steps(HZ / 4);
    let feed_forward = FeedForward { static_duty: 0.125, ..feed_forward };
    bench.motor.set_tuning(Tuning { feed_forward, cascade_per_s: 0.0 });
    near(bench.steps(HZ / 4), 0.125, 0.02);
}

fn knot(at_us: u64, position: f32, speed: f32) -> Knot {
    Knot { at_us, position, speed, feed_forward: 0.0 }
}

impl Bench {
    /// Advances one period at `now_us` on the way to `next`.
    fn go(&mut self, passed: Option<Knot>, next: Option<Knot>, now_us: u64) -> f32 {
        self.motor.follow(Leg { passed, next }, now_us);
        self.step()
    }
}

/// The duty is a sixteenth of the cubic's speed plus the point's feed-forward; the loop sees the distance from the
/// path.
#[test]
fn a_path_gives_its_speed_and_its_duty_and_the_loop_its_distance() {
    let mut bench = Bench::new(shows_the_path(config()));
    bench.command(Mode::Follow, 1.0);
    assert!(bench.motor.follows());
    let next = Knot { feed_forward: 0.25, ..knot(1_000_000, 1.0, 0.0) };
    // Speed 6 s (1 - s) rad/s: 0, 1.5 in the middle, 1.125 at three quarters.
    for (now_us, speed) in [(0, 0.0), (500_000, 1.5), (750_000, 1.125)] {
        near(bench.go(None, Some(next), now_us), 0.25 + speed / 16.0, 1e-6);
    }
    let status = bench.motor.status();
    assert_eq!((status.setpoint.mode, status.settled), (Mode::Follow, false));
    near(status.setpoint.value, 0.84375, 1e-6);
    let mut bench = Bench::new(ControlConfig { position_pid: PidGains { kp: 0.5, ki: 0.0, kd: 0.0 }, ..config() });
    bench.command(Mode::Follow, 1.0);
    bench.go(None, Some(next), 0);
    near(bench.go(None, Some(next), 500_000), 0.25 + 0.5 * 0.5, 1e-6);
}

/// From 2 rad/s a deceleration of 8 rad/s² ends 0.25 rad further on, or at the end of the range.
#[test]
fn a_path_that_ends_at_a_speed_is_left_along_the_profile() {
    for (place, target) in [(1.0, 1.25), (7.9, 8.0), (-7.9, -8.0)] {
        let speed = 2.0f32.copysign(place);
        let mut bench = Bench::new(shows_the_path(config()));
        bench.rest_at(place);
        bench.command(Mode::Follow, place);
        let last = knot(10_000, place, speed);
        bench.go(None, Some(last), 0);
        let first = bench.go(Some(last), None, 10_000);
        assert!(!bench.motor.follows());
        let Setpoint { mode, value } = bench.motor.status().setpoint;
        assert_eq!(mode, Mode::Position);
        near(value, target, 1e-5);
        // Slower by half a period's deceleration, as the profile is that ends at the target; by more where the range
        // cuts it short.
        near(first.abs(), (2.0 - 4.0 * PERIOD_S) / 16.0, 5e-4);
        let second = bench.step();
        assert!(second.abs() < first.abs() && second * first > 0.0, "{first} {second}");
        // Another set point ends it like any other movement.
        bench.command(Mode::Duty, 0.0);
        near(bench.step(), 0.0, 1e-6);
    }
}

/// Between two points at one place the motor settles there as at any position, and leaves with the next segment.
#[test]
fn a_pause_of_a_path_is_held_like_a_position() {
    let mut bench = Bench::new(shows_the_path(config()));
    bench.rest_at(1.0);
    bench.command(Mode::Follow, 1.0);
    let [pause, next] = [knot(2_000_000, 1.0, 0.0), knot(3_000_000, 2.0, 0.0)];
    for period in 0..HZ {
        bench.go(None, Some(pause), u64::from(period) * 976);
    }
    assert!(bench.settled() && bench.motor.follows());
    assert_eq!(bench.motor.status().setpoint.mode, Mode::Follow);
    near(bench.go(Some(pause), Some(next), 2_500_000), 1.5 / 16.0, 1e-6);
    assert!(!bench.settled());
    // A path command meanwhile continues the same path; a stop ends it.
    bench.command(Mode::Follow, 2.0);
    near(bench.go(Some(pause), Some(next), 2_500_000), 1.5 / 16.0, 1e-6);
    bench.motor.stop();
    assert!(!bench.motor.follows());
}

/// From a position movement under way, the path begins at that movement's reference, at its speed.
#[test]
fn a_path_begins_where_a_movement_is() {
    let mut bench = Bench::new(shows_the_path(config()));
    bench.command(Mode::Position, 8.0);
    let before = bench.steps(HZ / 4);
    bench.command(Mode::Follow, 8.0);
    near(bench.go(None, Some(knot(1_000_000, 3.0, 2.0)), 0), before, 1e-6);
    // A position movement likewise begins at the path's reference.
    let before = bench.go(None, Some(knot(1_000_000, 3.0, 2.0)), 500_000);
    bench.command(Mode::Position, 8.0);
    near(bench.step(), before + 8.0 * PERIOD_S / 16.0, 1e-5);
}

/// Motor with 4 rad/s, 8 rad/s² and 64 rad/s³, whose duty shows the path's speed and acceleration by these factors.
fn with_jerk(duty_per_speed: f32, duty_per_acceleration: f32) -> Bench {
    let feed_forward = FeedForward { static_duty: 0.0, duty_per_speed, duty_per_acceleration };
    let profile = ProfileLimits { speed: 4.0, acceleration: 8.0, jerk: 64.0 };
    Bench::new(ControlConfig { feed_forward, profile, settle: NEVER_AT_REST, ..config() })
}

/// Between any two movements, speed and acceleration are continuous.
#[test]
fn with_limited_jerk_nothing_jumps_between_movements() {
    let commands = [
        (Mode::Position, 6.0, 200),
        (Mode::Position, -3.0, 100),
        (Mode::Speed, -4.0, 300),
        (Mode::Speed, 4.0, 200),
        (Mode::Position, 2.0, 250),
        (Mode::Home, 3.0, 200),
        (Mode::Speed, 0.0, 100),
        (Mode::Position, 7.0, 300),
    ];
    // The last step of a ramp takes the remainder of two steps.
    let [speed, acceleration] = [(1.0 / 16.0, 8.0 * PERIOD_S), (1.0 / 64.0, 2.0 * 64.0 * PERIOD_S)];
    for (mut bench, (factor, most)) in
        [(with_jerk(speed.0, 0.0), speed), (with_jerk(0.0, acceleration.0), acceleration)]
    {
        let mut last = 0.0f32;
        let mut reached = 0.0f32;
        for (mode, value, periods) in commands {
            bench.command(mode, value);
            for period in 0..periods {
                let now = bench.step() / factor;
                // Rounding of numbers up to 8 in an f32.
                assert!(
                    (now - last).abs() <= most * 1.001,
                    "{last}, then {now} in period {period} of {mode:?} {value}"
                );
                reached = reached.max(now.abs());
                last = now;
            }
        }
        // Nearly 4 rad/s and 8 rad/s² are reached.
        assert!(reached > 3.5, "{reached}");
    }
}

/// Acceleration of 4 rad/s² from rest to 2 rad/s, where the path has no more points: a jerk of 64 rad/s³ removes the
/// acceleration.
#[test]
fn with_limited_jerk_a_path_is_left_without_a_jump() {
    let last = knot(500_000, 0.5, 2.0);
    for (factor, mut bench, on_the_path, then) in [
        (16.0, with_jerk(1.0 / 16.0, 0.0), 2.0 - 4e-3, 2.0 + 4.0 * PERIOD_S),
        (64.0, with_jerk(0.0, 1.0 / 64.0), 4.0, 4.0 - 64.0 * PERIOD_S),
    ] {
        bench.command(Mode::Follow, 0.0);
        bench.go(None, Some(last), 0);
        near(bench.go(None, Some(last), 499_000) * factor, on_the_path, 1e-3);
        // Half of the change of speed by the jerk in a period, 3e-5 rad/s, is within the rounding of the path's cubic.
        near(bench.go(Some(last), None, 500_000) * factor, then, 1e-3);
        assert!(!bench.motor.follows());
        // The motor continues to rest, further than without a limit of jerk.
        assert!(bench.motor.status().setpoint.value > 0.5 + 2.0 * 2.0 / (2.0 * 8.0));
        near(bench.steps(2 * HZ) * factor, 0.0, 1e-6);
    }
}

/// Geared motor that a force slows down, and an object at 1 rad with a stiffness of 200 N/rad.
struct Gripper {
    bench: Bench,
    position: f64,
    object: Option<f64>,
    offset_n: f32,
}

impl Gripper {
    const STIFFNESS_N_PER_RAD: f64 = 200.0;

    fn new() -> Self {
        let base = config();
        let config = ControlConfig {
            position_pid: PidGains { kp: 8.0, ki: 4.0, kd: 0.0 },
            // Watched like a real motor: standing with that much duty is a stall in every other mode.
            stall: StallConfig { duty: 0.3, travel: 0.02, time_ms: 300 },
            force: Some(ForceConfig {
                sensor: ForceSensor::Analog { analog: 0, zero_v: 0.0, newtons_per_v: 1.0 },
                range: Range::new(0.0, 12.0),
                limit_n: 15.0,
                speed_per_n: 0.05,
                approach_speed: 0.25,
                contact_n: 0.5,
                // A count is 0.6 N on the object.
                error_n: 0.5,
                filter_s: 0.0,
                drift_s: 0.0,
            }),
            ..base
        };
        Self { bench: Bench::with(config, LIMITS), position: 0.0, object: Some(1.0), offset_n: 0.0 }
    }

    fn force_n(&self) -> f64 {
        self.object.map_or(0.0, |at| (self.position - at).max(0.0) * Self::STIFFNESS_N_PER_RAD)
    }

    /// Advances one period: 10 rad/s at full duty, less 2 rad/s per 10 N.
    fn step(&mut self) {
        let force_n = self.force_n();
        let causes = self.bench.motor.sense_force(Some(force_n as f32 + self.offset_n));
        let duty = self.bench.step();
        self.bench.causes = self.bench.causes.union(causes);
        self.position += (10.0 * f64::from(duty) - 0.2 * force_n) * f64::from(PERIOD_S);
        self.bench.counts = libm::round(self.position / f64::from(RESOLUTION)) as i32;
    }

    fn run(&mut self, periods: u32) {
        (0..periods).for_each(|_| self.step());
    }
}

#[test]
fn a_motor_presses_an_object_with_its_force() {
    let mut gripper = Gripper::new();
    for (force_n, after_s) in [(5.0, 8), (10.0, 3), (2.0, 3)] {
        gripper.bench.command(Mode::Force, force_n);
        gripper.run(after_s * HZ);
        // Within the band, plus the motion of the motor within a count.
        let pressed_n = gripper.force_n();
        assert!((pressed_n - f64::from(force_n)).abs() < 0.5 + 0.6, "{pressed_n} N for {force_n} N");
        assert_eq!(gripper.bench.causes, Causes::NONE, "at {force_n} N");
    }
    assert!(gripper.bench.settled());
    // After the object is taken away it closes again, no faster than the approach speed, and is no longer settled.
    (gripper.object, gripper.bench.causes) = (None, Causes::NONE);
    let before = gripper.position;
    gripper.run(HZ);
    let travel = gripper.position - before;
    assert!((0.05..0.3).contains(&travel), "{travel} rad in a second");
    assert!(!gripper.bench.settled());
}

/// A force beyond the limit trips in every mode; a pressing motor also trips when its sensor falls silent.
#[test]
fn too_much_force_trips_and_so_does_none_that_is_known() {
    let mut gripper = Gripper::new();
    gripper.run(10);
    gripper.offset_n = 15.5;
    gripper.step();
    assert_eq!(gripper.bench.causes, Causes::only(Cause::ForceLimit));
    let mut bench = Gripper::new().bench;
    assert_eq!(bench.motor.sense_force(Some(1.0)), Causes::NONE);
    let silence = |bench: &mut Bench| (0..100).fold(Causes::NONE, |all, _| all.union(bench.motor.sense_force(None)));
    assert_eq!(silence(&mut bench), Causes::NONE, "it does not press");
    assert_eq!(bench.motor.sense_force(Some(1.0)), Causes::NONE);
    bench.command(Mode::Force, 3.0);
    assert_eq!(silence(&mut bench), Causes::only(Cause::EncoderImplausible));
}

/// Between force mode and any other, the duty does not jump.
#[test]
fn pressing_begins_and_ends_without_a_jump() {
    let mut gripper = Gripper::new();
    gripper.bench.command(Mode::Force, 6.0);
    gripper.run(8 * HZ);
    let mut last = gripper.bench.motor.duty;
    for (mode, value) in [(Mode::Speed, 0.0), (Mode::Force, 6.0), (Mode::Position, 1.02), (Mode::Force, 3.0)] {
        gripper.bench.command(mode, value);
        for _ in 0..HZ / 4 {
            gripper.step();
            let duty = gripper.bench.motor.duty;
            // The slew of 8/s per period, and rounding.
            assert!((duty - last).abs() <= 1.01 * 8.0 * PERIOD_S, "{mode}: {last} to {duty}");
            last = duty;
        }
    }
    assert_eq!(gripper.bench.causes, Causes::NONE);
}
