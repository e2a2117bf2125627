//! Watch over a motor: does it move as it is driven?

use r4_protocol::{Cause, Causes, config::ControlConfig};

/// Sample of a motor in one period.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Duty, as a share of the supply.
    pub(super) duty: f32,
    /// Measured position, rad or m.
    pub(super) position: f64,
    /// Distance from the path, rad or m; 0 where there is none.
    pub(super) path_error: f32,
    /// True if a loop wants the motor to move.
    pub(super) wants_motion: bool,
    /// Duty that friction takes.
    pub(super) friction: f32,
}

/// State of a motor's watch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watch {
    /// Position in the last period; `None` before the first.
    last: Option<f64>,
    /// Direction of hard drive, its duration, s, and the position at its start.
    sign: f32,
    driven_s: f32,
    start: f64,
    /// Position at the moment by which the motor should have reversed to the direction of the drive.
    turned: Option<f64>,
    off_path_s: f32,
    /// Duty beyond friction, integrated over time, s, since the sensor last showed motion, and the position of that
    /// motion.
    effort: f32,
    rest: f64,
}

/// Time for which a motor may run on after it is driven hard the other way, s.
const TURN_ROUND_S: f32 = 0.15;
/// Limits of a motion within a period, as a multiple of the highest speed plus a number of counts: beyond them the
/// sensor has jumped.
const JUMP_SPEEDS: f32 = 4.0;
const JUMP_COUNTS: f32 = 8.0;
/// Effort limit of a motor that does not move, in multiples of a stall's duty-time product: friction may be higher than
/// configured.
const EFFORT_STALLS: f32 = 4.0;
/// Least difference between the stall's duty and friction, also where the configured one is lower.
const LEAST_BEYOND_FRICTION: f32 = 0.1;

impl Watch {
    /// Takes one period and returns the causes that it shows.
    pub(super) fn step(&mut self, seen: Seen, resolution: f32, period_s: f32, config: &ControlConfig) -> Causes {
        let mut causes = self.drive(seen, period_s, config);
        causes.set(Cause::Stalled, causes.contains(Cause::Stalled) || self.effort(seen, resolution, period_s, config));
        let moved = self.last.replace(seen.position).map_or(0.0, |last| (seen.position - last) as f32);
        let possible = JUMP_SPEEDS * config.speed_max * period_s + JUMP_COUNTS * resolution;
        causes.set(Cause::EncoderImplausible, causes.contains(Cause::EncoderImplausible) || moved.abs() > possible);
        let error = seen.path_error;
        self.off_path_s = if error.abs() > config.follow.error { self.off_path_s + period_s } else { 0.0 };
        if self.off_path_s * 1e3 >= f32::from(config.follow.time_ms) {
            self.off_path_s = 0.0;
            // A motor that moves away from its path is misread; one that only lags has too much to move.
            let away = moved * error < 0.0;
            causes.set(if away { Cause::EncoderImplausible } else { Cause::Stalled }, true);
        }
        causes
    }

    /// Effort check: a loop whose sensor is dead drives ever harder, and the motor runs long before the duty is that of
    /// a stall. So the permitted time of a duty beyond friction falls with its magnitude: the product is limited to a
    /// few times a stall's.
    fn effort(&mut self, seen: Seen, resolution: f32, period_s: f32, config: &ControlConfig) -> bool {
        let shown = config.settle.error.max(2.0 * resolution);
        if !seen.wants_motion || ((seen.position - self.rest) as f32).abs() >= shown {
            (self.effort, self.rest) = (0.0, seen.position);
            return false;
        }
        let friction = seen.friction;
        self.effort += (seen.duty.abs() - friction).max(0.0) * period_s;
        let beyond = (config.stall.duty - friction).max(LEAST_BEYOND_FRICTION);
        self.effort > EFFORT_STALLS * beyond * f32::from(config.stall.time_ms) * 1e-3
    }

    /// Drive check: a motor that is driven hard moves, and in the direction of the drive.
    fn drive(&mut self, seen: Seen, period_s: f32, config: &ControlConfig) -> Causes {
        let sign = if seen.duty.abs() >= config.stall.duty { seen.duty.signum() } else { 0.0 };
        if sign == 0.0 || sign != self.sign {
            *self = Self { sign, driven_s: 0.0, start: seen.position, turned: None, ..*self };
            return Causes::NONE;
        }
        self.driven_s += period_s;
        let travel = |from: f64| (seen.position - from) as f32 * sign;
        if self.driven_s >= TURN_ROUND_S {
            let turned = *self.turned.get_or_insert(seen.position);
            if travel(turned) <= -config.stall.travel {
                return Causes::only(Cause::EncoderImplausible);
            }
        }
        if self.driven_s * 1e3 < f32::from(config.stall.time_ms) {
            return Causes::NONE;
        }
        let travelled = travel(self.start);
        *self = Self { driven_s: 0.0, start: seen.position, turned: None, ..*self };
        if travelled < config.stall.travel { Causes::only(Cause::Stalled) } else { Causes::NONE }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::config::{Feedback, FollowConfig, StallConfig};

    use super::*;

    const PERIOD_S: f32 = 1e-3;
    const RESOLUTION: f32 = 1e-3;

    /// Motor of the bench with round numbers: friction 0.25, stall at 0.75 without 0.02 rad in 300 ms, path error limit
    /// 1 rad or 100 ms.
    fn config() -> ControlConfig {
        let robot = crate::testing::robot("osmc-bench");
        let mut config = robot.motors[0].control.expect("it is measured");
        assert!(matches!(config.feedback, Feedback::Encoder { .. }));
        config.stall = StallConfig { duty: 0.75, travel: 0.02, time_ms: 300 };
        config.follow = FollowConfig { error: 1.0, time_ms: 100 };
        config.speed_max = 5.0;
        config.settle.error = 0.004;
        config
    }

    const AT_REST: Seen = Seen { duty: 0.0, position: 0.0, path_error: 0.0, wants_motion: false, friction: 0.25 };

    /// Number of periods until a cause shows, and the causes, for a motor described by `seen` in each.
    fn until(at_most: u32, seen: impl Fn(u32) -> Seen) -> Option<(u32, Causes)> {
        let (mut watch, config) = (Watch::default(), config());
        let mut step = |period| watch.step(seen(period), RESOLUTION, PERIOD_S, &config);
        (0..at_most).map(|period| (period, step(period))).find(|(_, causes)| !causes.is_empty())
    }

    /// The time is counted in f32, whose rounding over 300 periods may amount to one period.
    #[track_caller]
    fn at(found: Option<(u32, Causes)>, period: u32, cause: Cause) {
        let (when, causes) = found.expect("a cause shows");
        assert!(when.abs_diff(period) <= 1, "after {when} periods");
        assert_eq!(causes, Causes::only(cause));
    }

    #[test]
    fn a_stall_is_duty_without_travel_for_its_time() {
        for duty in [0.75, 1.0, -0.75, -1.0] {
            at(until(1000, |_| Seen { duty, ..AT_REST }), 300, Cause::Stalled);
        }
        assert_eq!(until(1000, |_| Seen { duty: 0.749, ..AT_REST }), None);
        // Travel counts in the direction of the drive, from where the drive became hard.
        for (travel, stalls) in [(0.0199, true), (0.0201, false)] {
            for sign in [1.0, -1.0] {
                let moving = |period: u32| Seen {
                    duty: sign,
                    position: f64::from(sign * travel * period as f32 / 300.0),
                    ..AT_REST
                };
                assert_eq!(until(400, moving).is_some(), stalls, "{travel}");
            }
        }
    }

    #[test]
    fn a_stall_begins_anew_with_each_pause_and_turn() {
        let paused = |period: u32| Seen { duty: if period.is_multiple_of(299) { 0.0 } else { 1.0 }, ..AT_REST };
        assert_eq!(until(3000, paused), None);
        let turned = |period: u32| Seen { duty: if (period / 298).is_multiple_of(2) { 1.0 } else { -1.0 }, ..AT_REST };
        assert_eq!(until(3000, turned), None);
    }

    /// A motor may take 150 ms to reverse, and then travel less than the stall's travel against the drive.
    #[test]
    fn a_motor_may_run_on_and_then_not_against_its_drive() {
        let backwards = |rad_s: f32| {
            move |period: u32| Seen { duty: 1.0, position: f64::from(-rad_s * PERIOD_S * period as f32), ..AT_REST }
        };
        // At 2 rad/s 0.02 rad take 10 periods.
        at(until(1000, backwards(2.0)), 150 + 10, Cause::EncoderImplausible);
        // A motor that is still at that time has reversed.
        let stops = |period: u32| Seen { position: backwards(2.0)(period.min(149)).position, duty: 1.0, ..AT_REST };
        at(until(1000, stops), 300, Cause::Stalled);
    }

    /// A jump is more than four times the highest speed for a period plus eight counts: 0.028 rad.
    #[test]
    fn a_jump_is_more_than_any_motor_moves() {
        for sign in [1.0, -1.0] {
            let jumping = |rad: f64| move |period: u32| Seen { position: sign * rad * f64::from(period), ..AT_REST };
            assert_eq!(until(1000, jumping(0.0279)), None);
            at(until(1000, jumping(0.0281)), 1, Cause::EncoderImplausible);
        }
    }

    /// Positions from before the hard drive, or from the other direction, are discarded.
    #[test]
    fn travel_counts_from_where_the_drive_began() {
        let moved_before = |period: u32| Seen { duty: if period < 400 { 0.0 } else { 1.0 }, position: 5.0, ..AT_REST };
        at(until(1000, moved_before), 700, Cause::Stalled);
        // It moves 0.1 rad after the time to reverse, and then stands: in the other direction it has not moved at all.
        let turned = |period: u32| Seen {
            duty: if period < 250 { 1.0 } else { -1.0 },
            position: f64::from(period.min(250)) * 1e-3,
            ..AT_REST
        };
        at(until(1000, turned), 250 + 300, Cause::Stalled);
        // Each 300 ms are judged separately: 0.03 rad forwards, and then nothing.
        let stops = |period: u32| Seen { duty: 1.0, position: f64::from(period.min(300)) * 1e-4, ..AT_REST };
        at(until(1000, stops), 601, Cause::Stalled);
        // As much back and further, before the time to reverse has passed once more.
        let falls_back = |period: u32| {
            let back = f64::from(period.clamp(310, 370) - 310) * 1e-3;
            Seen { position: stops(period).position - back, ..stops(period) }
        };
        at(until(1000, falls_back), 601, Cause::Stalled);
    }

    /// With numbers that are exact in binary: a stall of 256 periods without 1/64 rad.
    #[test]
    fn a_stall_is_to_the_period_and_to_the_count() {
        let config = ControlConfig { stall: StallConfig { duty: 0.75, travel: 1.0 / 64.0, time_ms: 250 }, ..config() };
        for (travel, stalled) in [(0.0, true), (1.0 / 64.0 - 1e-6, true), (1.0 / 64.0, false)] {
            let mut watch = Watch::default();
            let mut step = |position| watch.step(Seen { duty: 1.0, position, ..AT_REST }, 1.0, 1.0 / 1024.0, &config);
            // The drive begins with the first period.
            for period in 0..256 {
                assert_eq!(step(0.0), Causes::NONE, "{period}");
            }
            assert_eq!(step(travel).contains(Cause::Stalled), stalled, "{travel}");
        }
    }

    /// With numbers that are exact in binary: 4 · 4 rad/s · 1/1024 s and eight counts of 1/1024 rad.
    #[test]
    fn the_most_that_a_motor_moves_is_no_jump() {
        for (rad, jumped) in [(24.0 / 1024.0, false), (24.001 / 1024.0, true)] {
            let mut watch = Watch::default();
            let config = ControlConfig { speed_max: 4.0, ..config() };
            let mut step = |position| watch.step(Seen { position, ..AT_REST }, 1.0 / 1024.0, 1.0 / 1024.0, &config);
            assert_eq!(step(0.0), Causes::NONE);
            assert_eq!(step(rad).contains(Cause::EncoderImplausible), jumped, "{rad}");
        }
    }

    /// A motor off its path for 100 ms is misread if it moves away from the path, and too slow otherwise. A moment on
    /// the path restarts the time.
    #[test]
    fn a_motor_off_its_path_is_slow_or_misread() {
        let lags = |period: u32| Seen { path_error: 1.01, position: f64::from(period) * 1e-3, ..AT_REST };
        at(until(1000, lags), 99, Cause::Stalled);
        let leaves = |period: u32| Seen { path_error: 1.01, position: f64::from(period) * -1e-3, ..AT_REST };
        at(until(1000, leaves), 99, Cause::EncoderImplausible);
        let mirrored = |period: u32| Seen { path_error: -1.01, position: f64::from(period) * 1e-3, ..AT_REST };
        at(until(1000, mirrored), 99, Cause::EncoderImplausible);
        assert_eq!(until(1000, |_| Seen { path_error: 1.0, ..AT_REST }), None);
        let back = |period: u32| Seen { path_error: if period.is_multiple_of(99) { 1.0 } else { 1.01 }, ..AT_REST };
        assert_eq!(until(1000, back), None);
    }

    /// A stall's duty just above friction counts as a tenth above it: 0.04 beyond friction reach 4 · 0.1 · 0.3 s after
    /// 3 s.
    #[test]
    fn a_stall_close_to_friction_leaves_time() {
        let mut watch = Watch::default();
        let mut config = config();
        config.stall.duty = 0.75;
        let seen = Seen { duty: 0.74, wants_motion: true, friction: 0.7, ..AT_REST };
        let mut step = || watch.step(seen, RESOLUTION, PERIOD_S, &config);
        at((0..5000).map(|period| (period, step())).find(|(_, causes)| !causes.is_empty()), 3000, Cause::Stalled);
    }

    /// The limit is four stalls' effort beyond friction, 4 · (0.75 − 0.25) · 0.3 s: the higher the duty, the sooner.
    #[test]
    fn duty_that_moves_nothing_adds_up() {
        for (duty, periods) in [(0.5f32, 2400), (0.7, 1333), (-0.7, 1333)] {
            // The position does not matter.
            for position in [0.0, 5.0, -5.0] {
                at(until(3000, |_| Seen { duty, position, wants_motion: true, ..AT_REST }), periods, Cause::Stalled);
            }
        }
        assert_eq!(until(10_000, |_| Seen { duty: 0.25, wants_motion: true, ..AT_REST }), None);
        assert_eq!(until(10_000, |_| Seen { duty: 0.7, wants_motion: false, ..AT_REST }), None);
        // Motion shown by the sensor restarts the sum: 0.004 rad, the settling error.
        for (rad, moves) in [(0.0041, true), (0.0039, false)] {
            let creeps = |period: u32| Seen {
                duty: 0.7,
                position: f64::from(period / 1000) * rad,
                wants_motion: true,
                ..AT_REST
            };
            assert_eq!(until(2000, creeps).is_none(), moves, "{rad}");
        }
    }
}
