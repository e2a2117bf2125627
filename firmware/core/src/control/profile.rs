//! Path of a motor to a position, kept as the distance to go, and ramp of a motor's speed.
//!
//! Without a limit of jerk a path is a trapezoid, whose next speed follows from the distance to go alone. With a limit
//! it is planned when it begins, by the steppers' [`scurve`](crate::motion::scurve), and stored as its remaining
//! segments of constant jerk; each control period evaluates one of their cubics.

use crate::{
    motion::scurve::{Limits, Motion, Path, Position},
    root::{sqrt, sqrtf},
    within::Within,
};
use r4_protocol::config::ProfileLimits;

/// State of a path at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Moment {
    /// Distance to the target, rad or m.
    pub to_go: f32,
    /// Speed of the path, rad/s or m/s.
    pub speed: f32,
    /// Acceleration of the last period, rad/s² or m/s².
    pub acceleration: f32,
}

/// Path with limited speed, acceleration and, where the limits have one, jerk.
///
/// It stores the distance to go and not a position, so that its resolution is best near the target, however far that is
/// from zero.
#[derive(Clone, Copy, Debug)]
pub struct Profile {
    limits: ProfileLimits,
    period_s: f32,
    now: Moment,
    /// Remaining segments where jerk is limited.
    arcs: Arcs,
}

impl Profile {
    /// Creates a path that has arrived.
    #[must_use]
    pub fn new(limits: ProfileLimits, period_s: f32) -> Self {
        Self { limits, period_s, now: Moment::default(), arcs: Arcs::NONE }
    }

    /// Starts a new path `distance` away from the target, moving at `speed` (clipped to the limit).
    pub fn start(&mut self, distance: f32, speed: f32) {
        let speed = speed.within(-self.limits.speed, self.limits.speed);
        self.join(distance, Ramp { speed, acceleration: 0.0 });
    }

    /// Continues from a motion under way, `distance` away from the target: a speed or acceleration above the limits is
    /// brought inside by them.
    pub fn join(&mut self, distance: f32, Ramp { speed, acceleration }: Ramp) {
        self.now = Moment { to_go: distance, speed, acceleration };
        self.plan();
    }

    /// State at the present period.
    #[must_use]
    pub fn now(&self) -> Moment {
        self.now
    }

    /// Moves the target by `distance` while under way.
    pub fn shift_target(&mut self, distance: f32) {
        self.now.to_go += distance;
        self.plan();
    }

    // Called for commands, not each period, so it may stay in flash.
    #[inline(never)]
    fn plan(&mut self) {
        if self.limits.jerk != 0.0 {
            self.arcs = Arcs::plan(self.now, &self.limits);
        }
    }

    /// Advances one period along the path and returns its state.
    pub fn step(&mut self) -> Moment {
        let ProfileLimits { speed, acceleration, jerk } = self.limits;
        let Moment { to_go, speed: before, .. } = self.now;
        self.now = if jerk == 0.0 {
            let (to_go, speed) = towards(to_go, before, speed, acceleration, self.period_s);
            Moment { to_go, speed, acceleration: (speed - before) / self.period_s }
        } else {
            self.arcs.step(jerk.into(), self.period_s.into())
        };
        self.now
    }

    /// Shortest distance, rad or m, over which `motion` comes to rest.
    #[must_use]
    pub fn stopping(&self, motion: Ramp) -> f32 {
        motion.stopping(&self.limits)
    }
}

/// Advances a trapezoid of `rate` by one period towards a target `to_go` away; returns the remaining distance and the
/// rate.
fn towards(to_go: f32, rate: f32, most: f32, change_per_s: f32, dt: f32) -> (f32, f32) {
    let distance = to_go.abs();
    let side = if to_go < 0.0 { -1.0 } else { 1.0 };
    // Highest rate from which stopping in steps of `dt` ends exactly at the target: v²/2a + v dt/2 = distance.
    let half = change_per_s * dt / 2.0;
    let stoppable = sqrtf(half * half + 2.0 * change_per_s * distance) - half;
    let wanted = side * stoppable.min(most);
    let change = change_per_s * dt;
    let rate = wanted.within(rate - change, rate + change);
    let moved = rate * dt;
    if distance <= change * dt && moved.abs() <= change * dt { (0.0, 0.0) } else { (to_go - moved, rate) }
}

/// Largest number of segments of constant jerk in a path: speeding up, cruise, braking.
const MAX_ARCS: usize = 7;

/// Remaining part of a path with limited jerk.
#[derive(Clone, Copy, Debug)]
struct Arcs {
    /// Durations of the segments, s; 0 for unused ones.
    durations_s: [f64; MAX_ARCS],
    /// Jerks of the segments, in units of the limit.
    jerks: [i8; MAX_ARCS],
    /// Index of the first unfinished segment.
    first: u8,
    /// State at its start: distance to go, rad or m, and the position's first two derivatives, rad/s and rad/s² or m/s
    /// and m/s².
    from: [f64; 3],
    /// Time since then, s.
    time_s: f64,
}

impl Arcs {
    const NONE: Self =
        Self { durations_s: [0.0; MAX_ARCS], jerks: [0; MAX_ARCS], first: 0, from: [0.0; 3], time_s: 0.0 };

    fn plan(Moment { to_go, speed, acceleration }: Moment, limits: &ProfileLimits) -> Self {
        let from = [to_go, speed, acceleration].map(f64::from);
        let [to_go, speed, acceleration] = from;
        let start = Motion { position: Position::near_zero(-to_go), speed, acceleration };
        let [speed, acceleration, jerk] = [limits.speed, limits.acceleration, limits.jerk].map(f64::from);
        let path = Path::to_position(start, 0, &Limits { speed, acceleration, jerk });
        let mut arcs = Self { from, ..Self::NONE };
        let pieces = path.pieces();
        let slots = arcs.durations_s.iter_mut().zip(&mut arcs.jerks);
        for ((duration_s, jerk), (piece, next)) in slots.zip(pieces.iter().zip(pieces.iter().skip(1))) {
            *duration_s = next.start_s - piece.start_s;
            *jerk = i8::from(piece.jerk > 0.0) - i8::from(piece.jerk < 0.0);
        }
        arcs
    }

    /// Advances one period and returns the path's state.
    fn step(&mut self, jerk: f64, period_s: f64) -> Moment {
        self.time_s += period_s;
        let first = usize::from(self.first);
        for (duration_s, sign) in self.durations_s.iter().zip(&self.jerks).skip(first) {
            let [to_go, speed, acceleration] = self.from;
            let (t, j) = (self.time_s.min(*duration_s), jerk * f64::from(*sign));
            let state = [
                to_go - t * (speed + t * (acceleration / 2.0 + t * j / 6.0)),
                speed + t * (acceleration + t * j / 2.0),
                acceleration + t * j,
            ];
            if self.time_s < *duration_s {
                let [to_go, speed, acceleration] = state.map(|value| value as f32);
                return Moment { to_go, speed, acceleration };
            }
            self.from = state;
            self.time_s -= duration_s;
            self.first += 1;
        }
        // Arrived, up to rounding.
        Moment::default()
    }
}

/// Speed ramp: the present speed on its way to another.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ramp {
    /// Present speed, rad/s or m/s.
    pub speed: f32,
    /// Acceleration of the last period, rad/s² or m/s².
    pub acceleration: f32,
}

impl Ramp {
    /// Advances one period towards the speed `wanted`, or towards one from which it can stop within the room behind and
    /// ahead, rad or m. Returns the speed aimed at.
    pub fn step(&mut self, wanted: f32, [behind, ahead]: [f32; 2], limits: &ProfileLimits, dt: f32) -> f32 {
        let before = self.speed;
        if limits.jerk == 0.0 {
            let stoppable = |room: f32| sqrtf(2.0 * limits.acceleration * room.max(0.0));
            let wanted = wanted.within(-stoppable(behind), stoppable(ahead));
            let change = limits.acceleration * dt;
            self.speed = wanted.within(before - change, before + change);
            self.acceleration = (self.speed - before) / dt;
            wanted
        } else {
            let towards = |wanted: f32| {
                let (to_go, acceleration) =
                    towards(wanted - before, self.acceleration, limits.acceleration, limits.jerk, dt);
                Self { speed: wanted - to_go, acceleration }
            };
            let next = towards(wanted);
            // The distance of this period, and as much again for ramps that change their jerk in whole periods.
            let stopping = next.stopping(limits) + 2.0 * next.speed * dt;
            let passes = wanted > 0.0 && stopping > ahead || wanted < 0.0 && -stopping > behind;
            let wanted = if passes { 0.0 } else { wanted };
            *self = if passes { towards(0.0) } else { next };
            wanted
        }
    }

    /// Shortest stopping distance within the limits, rad or m; negative if it lies behind. An acceleration above its
    /// limit counts as the limit.
    fn stopping(self, limits: &ProfileLimits) -> f32 {
        let most = f64::from(limits.acceleration);
        let per_jerk = if limits.jerk == 0.0 { 0.0 } else { 1.0 / f64::from(limits.jerk) };
        let (speed, acceleration) = (f64::from(self.speed), f64::from(self.acceleration).within(-most, most));
        // Sign of the speed after its acceleration has been removed.
        let side = (speed + acceleration * acceleration.abs() * per_jerk / 2.0).signum();
        let (speed, acceleration) = (side * speed, side * acceleration);
        // Compared with braking from `whole` without acceleration, braking begins, or has begun, that much later or
        // earlier.
        let later_s = acceleration * per_jerk;
        let whole = (speed + acceleration * later_s / 2.0).max(0.0);
        let onset_s = most * per_jerk;
        let braking = if whole >= most * onset_s {
            (whole * whole / most + whole * onset_s) / 2.0
        } else {
            whole * sqrt(whole * per_jerk)
        };
        (side * (braking + later_s * (speed + acceleration * later_s / 3.0))) as f32
    }
}

#[cfg(test)]
mod tests;
