//! Duration of a robot's leg: a turn on the spot towards the goal, then a straight line.

use std::f64::consts::PI;

use r4_rig::Place;
use serde::Serialize;

/// Trapezoidal speed profile over a distance or an angle, from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Trapezoid {
    /// Top speed, m/s or rad/s.
    pub speed: f64,
    /// Acceleration and deceleration, m/s² or rad/s².
    pub acceleration: f64,
}

impl Trapezoid {
    /// Length from which on the top speed is reached, m or rad: `v² / a`.
    #[must_use]
    pub fn full_speed_from(self) -> f64 {
        self.speed * self.speed / self.acceleration
    }

    /// Duration of `length`, s: `L / v + v / a`, or `2 sqrt(L / a)` where the top speed is not reached.
    #[must_use]
    pub fn duration_s(self, length: f64) -> f64 {
        if length < self.full_speed_from() {
            2.0 * (length / self.acceleration).sqrt()
        } else {
            length / self.speed + self.speed / self.acceleration
        }
    }

    /// Length covered `time_s` after the start of a motion over `length`, m or rad.
    #[must_use]
    pub fn covered(self, length: f64, time_s: f64) -> f64 {
        let Self { speed, acceleration } = self;
        let duration_s = self.duration_s(length);
        let time_s = time_s.clamp(0.0, duration_s);
        let ramp_s = (speed / acceleration).min(duration_s / 2.0);
        let left_s = duration_s - time_s;
        if ramp_s == 0.0 {
            // An infinite acceleration has no ramps: multiplied by a time of 0 it would be NaN.
            speed * time_s
        } else if time_s <= ramp_s {
            acceleration * time_s * time_s / 2.0
        } else if left_s <= ramp_s {
            length - acceleration * left_s * left_s / 2.0
        } else {
            acceleration * ramp_s * (time_s - ramp_s / 2.0)
        }
    }
}

/// Turn on the spot, from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Turn {
    /// Turns that take no time.
    Free,
    /// Turns with ramps of the turn rate.
    Ramps(Trapezoid),
    /// Turns at a rate proportional to the remaining angle, with a limit: the law of [`r4_rig::Follower`].
    Proportional {
        /// Limit of the turn rate, rad/s.
        rate_rad_s: f64,
        /// Remaining angle over turn rate, s.
        time_constant_s: f64,
        /// Threshold of turns on the spot, rad; smaller angles are turned while the robot travels.
        from_rad: f64,
        /// Remaining angle at which the turn ends, rad; it is turned while the robot travels.
        to_rad: f64,
    },
}

impl Turn {
    /// Duration of a turn by `angle_rad`, not negative, s.
    #[must_use]
    pub fn duration_s(self, angle_rad: f64) -> f64 {
        match self {
            Self::Free => 0.0,
            Self::Ramps(ramps) => ramps.duration_s(angle_rad),
            Self::Proportional { from_rad, .. } if angle_rad < from_rad => 0.0,
            Self::Proportional { rate_rad_s, time_constant_s, to_rad, .. } => {
                let slows_rad = (rate_rad_s * time_constant_s).max(to_rad);
                let limited_s = (angle_rad - slows_rad).max(0.0) / rate_rad_s;
                limited_s + time_constant_s * (angle_rad.min(slows_rad) / to_rad).ln().max(0.0)
            }
        }
    }

    /// Angle turned `time_s` after the start of a turn by `angle_rad`, rad. The remainder of a proportional turn is
    /// turned at its end.
    #[must_use]
    pub fn turned_rad(self, angle_rad: f64, time_s: f64) -> f64 {
        if time_s >= self.duration_s(angle_rad) {
            return angle_rad;
        }
        match self {
            Self::Free => angle_rad,
            Self::Ramps(ramps) => ramps.covered(angle_rad, time_s),
            Self::Proportional { rate_rad_s, time_constant_s, to_rad, .. } => {
                let slows_rad = (rate_rad_s * time_constant_s).max(to_rad);
                let limited_s = (angle_rad - slows_rad).max(0.0) / rate_rad_s;
                if time_s <= limited_s {
                    rate_rad_s * time_s.max(0.0)
                } else {
                    angle_rad - angle_rad.min(slows_rad) * ((limited_s - time_s) / time_constant_s).exp()
                }
            }
        }
    }
}

/// Motion of a robot from goal to goal, at the abstract fidelity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Motion {
    /// Profile of straight lines, m/s and m/s².
    pub travel: Trapezoid,
    /// Turn on the spot before each line.
    pub turn: Turn,
    /// Distance in front of a goal at which it counts as reached, m.
    pub reached_m: f64,
}

/// Constant speed of the paper's arm, m/s: that of the boards, so that no arm has a faster robot. The published package
/// has 0.5 m/s.
const SPEED_M_S: f64 = 0.4;

impl Motion {
    /// Motion of the paper: distance over speed, without ramps and turns.
    pub const PRINTED: Self =
        Self { travel: Trapezoid { speed: SPEED_M_S, acceleration: f64::INFINITY }, turn: Turn::Free, reached_m: 0.0 };

    /// Motion known before any leg was driven: the requested speeds, 0.4 m/s and 1 rad/s, and the 1 m/s² of the wheels'
    /// profile, which are 5.7 rad/s² at wheels 0.175 m off the middle.
    pub const NOMINAL: Self = Self {
        travel: Trapezoid { speed: SPEED_M_S, acceleration: 1.0 },
        turn: Turn::Ramps(Trapezoid { speed: 1.0, acceleration: 5.7 }),
        reached_m: 0.0,
    };

    /// Returns the same motion without time for turns.
    #[must_use]
    pub fn without_turns(self) -> Self {
        Self { turn: Turn::Free, ..self }
    }

    /// Leg from a pose to a goal, from rest to rest.
    #[must_use]
    pub fn leg(&self, from: Place, goal_m: [f64; 2]) -> Leg {
        let (x_m, y_m) = (goal_m[0] - from.x_m, goal_m[1] - from.y_m);
        let length_m = (x_m.hypot(y_m) - self.reached_m).max(0.0);
        let turn_rad = if length_m > 0.0 { wrapped(y_m.atan2(x_m) - from.yaw_rad) } else { 0.0 };
        let turn_s = self.turn.duration_s(turn_rad.abs());
        Leg { motion: *self, from, turn_rad, turn_s, length_m, travel_s: self.travel.duration_s(length_m) }
    }
}

/// A robot's leg from rest at a pose to rest at a goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leg {
    motion: Motion,
    from: Place,
    turn_rad: f64,
    turn_s: f64,
    length_m: f64,
    travel_s: f64,
}

impl Leg {
    /// Duration of the leg, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.turn_s + self.travel_s
    }

    /// Path length covered `time_s` after the start, m.
    #[must_use]
    pub fn covered_m(&self, time_s: f64) -> f64 {
        self.motion.travel.covered(self.length_m, time_s - self.turn_s)
    }

    /// Pose `time_s` after the start.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Place {
        let turned_rad = self.turn_rad.signum() * self.motion.turn.turned_rad(self.turn_rad.abs(), time_s);
        let (sin, cos) = (self.from.yaw_rad + self.turn_rad).sin_cos();
        let covered_m = self.covered_m(time_s);
        Place {
            x_m: self.from.x_m + covered_m * cos,
            y_m: self.from.y_m + covered_m * sin,
            yaw_rad: self.from.yaw_rad + turned_rad,
        }
    }
}

/// Wraps an angle to -π..π, rad.
fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(2.0 * PI) - PI
}
