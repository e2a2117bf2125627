//! Watches whether a motor does what it is driven to.

use r4_protocol::{Cause, Causes, config::ControlConfig};

/// What one period of a motor looked like.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    /// Share of the supply.
    pub(super) duty: f32,
    /// rad or m
    pub(super) position: f64,
    /// Distance from the path, rad or m; 0 where there is none.
    pub(super) path_error: f32,
    /// Whether a loop wants the motor to move.
    pub(super) wants_motion: bool,
}

/// Memory of a motor's watch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Watch {
    /// Where the motor was in the last period.
    last: Option<f64>,
    /// Direction of hard drive, since when, and from where.
    sign: f32,
    driven_s: f32,
    start: f64,
    /// Where it was when it should have come round to the direction of the drive.
    turned: Option<f64>,
    off_path_s: f32,
    /// Duty beyond friction, times s, spent since the sensor last showed motion, and where that was.
    effort: f32,
    rest: f64,
}

/// A motor that is driven hard the other way may still run on for this long.
const TURN_ROUND_S: f32 = 0.15;
/// A sensor that shows more than this many times the highest speed within a period, and a few counts, has jumped.
const JUMP_SPEEDS: f32 = 4.0;
const JUMP_COUNTS: f32 = 8.0;
/// A motor that does not move costs at most so many stalls' worth of duty: friction may be higher than configured.
const EFFORT_STALLS: f32 = 4.0;
/// A stall's duty counts as at least so much above friction, also where the configuration has it lower.
const LEAST_BEYOND_FRICTION: f32 = 0.1;

impl Watch {
    /// Takes one period and returns the causes it shows.
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
            // One that goes away from its path is misread; one that only lags has too much to move.
            let away = moved * error < 0.0;
            causes.set(if away { Cause::EncoderImplausible } else { Cause::Stalled }, true);
        }
        causes
    }

    /// A loop whose sensor is dead drives ever harder, and the motor runs long before that is as hard as a stall. So the
    /// duty beyond friction may last the shorter the higher it is: a few times what a stall is given.
    fn effort(&mut self, seen: Seen, resolution: f32, period_s: f32, config: &ControlConfig) -> bool {
        let shown = config.settle.error.max(2.0 * resolution);
        if !seen.wants_motion || ((seen.position - self.rest) as f32).abs() >= shown {
            (self.effort, self.rest) = (0.0, seen.position);
            return false;
        }
        let friction = config.feed_forward.static_duty;
        self.effort += (seen.duty.abs() - friction).max(0.0) * period_s;
        let beyond = (config.stall.duty - friction).max(LEAST_BEYOND_FRICTION);
        self.effort > EFFORT_STALLS * beyond * f32::from(config.stall.time_ms) * 1e-3
    }

    /// Driven hard, a motor moves, and in the direction of the drive.
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
