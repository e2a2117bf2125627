//! How long a leg of a robot takes: a turn on the spot towards the goal, then a straight line.

use std::f64::consts::PI;

use r4_rig::Place;
use serde::Serialize;

/// From rest to rest with limited speed and acceleration, over a distance or an angle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Trapezoid {
    /// m/s or rad/s
    pub speed: f64,
    /// m/s² or rad/s², at both ends.
    pub acceleration: f64,
}

impl Trapezoid {
    /// Length from which the top speed is reached: `v² / a`.
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

    /// Length that is covered `time_s` after the start of a motion over `length`.
    #[must_use]
    pub fn covered(self, length: f64, time_s: f64) -> f64 {
        let Self { speed, acceleration } = self;
        let duration_s = self.duration_s(length);
        let time_s = time_s.clamp(0.0, duration_s);
        let ramp_s = (speed / acceleration).min(duration_s / 2.0);
        let left_s = duration_s - time_s;
        if ramp_s == 0.0 {
            // Without ramps: an infinite acceleration has no square of time to be multiplied by.
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

/// How a robot turns on the spot, from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub enum Turn {
    /// In no time.
    Free,
    /// With ramps of the turn rate.
    Ramps(Trapezoid),
    /// At a rate in proportion to the angle that remains, with a limit: the law of [`r4_rig::Follower`].
    Proportional {
        /// Limit of the rate, rad/s.
        rate_rad_s: f64,
        /// Angle that remains over the rate, s.
        time_constant_s: f64,
        /// Smaller angles are turned on the way, rad.
        from_rad: f64,
        /// The turn ends at this angle, rad; the rest is turned on the way.
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

    /// Angle that is turned `time_s` after the start of a turn by `angle_rad`, rad. What a proportional turn leaves is turned at its end.
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

/// How a robot moves from goal to goal, in the abstract fidelity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Motion {
    /// Straight lines.
    pub travel: Trapezoid,
    /// Turns on the spot, before them.
    pub turn: Turn,
    /// A goal counts as reached this far in front of it, m.
    pub reached_m: f64,
}

/// The constant speed of the paper's arm, m/s: that which the boards are driven at, so that no arm has a faster robot. The published
/// package has 0.5 m/s.
const SPEED_M_S: f64 = 0.4;

impl Motion {
    /// The paper's: distance over speed, without ramps and turns.
    pub const PRINTED: Self =
        Self { travel: Trapezoid { speed: SPEED_M_S, acceleration: f64::INFINITY }, turn: Turn::Free, reached_m: 0.0 };

    /// What is known before any leg was driven: the speeds that are asked for, 0.4 m/s and 1 rad/s, and the 1 m/s² of the wheels'
    /// profile, which are 5.7 rad/s² at wheels 0.175 m off the middle.
    pub const NOMINAL: Self = Self {
        travel: Trapezoid { speed: SPEED_M_S, acceleration: 1.0 },
        turn: Turn::Ramps(Trapezoid { speed: 1.0, acceleration: 5.7 }),
        reached_m: 0.0,
    };

    /// The same without time for turns.
    #[must_use]
    pub fn without_turns(self) -> Self {
        Self { turn: Turn::Free, ..self }
    }

    /// The leg from a place to a goal, from rest to rest.
    #[must_use]
    pub fn leg(&self, from: Place, goal_m: [f64; 2]) -> Leg {
        let (x_m, y_m) = (goal_m[0] - from.x_m, goal_m[1] - from.y_m);
        let length_m = (x_m.hypot(y_m) - self.reached_m).max(0.0);
        let turn_rad = if length_m > 0.0 { wrapped(y_m.atan2(x_m) - from.yaw_rad) } else { 0.0 };
        let turn_s = self.turn.duration_s(turn_rad.abs());
        Leg { motion: *self, from, turn_rad, turn_s, length_m, travel_s: self.travel.duration_s(length_m) }
    }
}

/// A robot's way from rest at a place to rest at a goal.
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
    /// Duration, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.turn_s + self.travel_s
    }

    /// Path length that is covered `time_s` after the start, m.
    #[must_use]
    pub fn covered_m(&self, time_s: f64) -> f64 {
        self.motion.travel.covered(self.length_m, time_s - self.turn_s)
    }

    /// Place `time_s` after the start.
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

/// The same angle within half a turn.
fn wrapped(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(2.0 * PI) - PI
}
