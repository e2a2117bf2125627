//! Motor model: the speed of a motor, and the duty that a speed takes, learned while it moves.

use r4_protocol::config::{ControlConfig, Feedback};

use super::{drive_curve::DriveCurve, pid::OutputLimits};
use crate::{
    channel,
    sensing::{encoder::Encoder, observer::Observer},
};

/// First-order motor behind a steady curve: `T v' = w(u) - v`, where `w` is the speed at which the motor settles with
/// the duty `u`.
///
/// An [`Observer`] with this model estimates the speed. Its disturbance shows the error of the curve at the present
/// duty, and the curve follows: friction, dead bands, convex curves and loads are learned without a parameter for any
/// of them.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    observer: Observer,
    curve: DriveCurve,
    /// Time constant `T`, s.
    time_constant_s: f32,
    /// Duty per speed of the straight line that the loops are tuned for.
    duty_per_speed: f32,
    /// Control periods since the last update of the curve, 0..[`LEARN_TURNS`].
    turn: u8,
    /// Speed below which nothing is learned, rad/s or m/s.
    slowest: f32,
    /// Duty beyond the threshold that the last breakaway took.
    stiction: f32,
    /// True if a measured position was known in the last period.
    is_placed: bool,
    /// Sign of the last count, and the least and greatest duty since then, in 127ths.
    counted: i8,
    given: [i8; 2],
    period_s: f32,
}

/// Direction in which a motor is to move, and its drive shares.
#[derive(Clone, Copy, Debug)]
pub(super) struct Aim {
    /// Sign of the direction; 0 for none.
    pub(super) sign: f32,
    /// True at the target: the motor is then only braked.
    pub(super) rests: bool,
    /// Duty added to break away.
    pub(super) pushed: f32,
    /// Shares of the loop's output, and of the friction duty, that it gets towards its target.
    pub(super) share: f32,
    pub(super) threshold: f32,
}

impl Aim {
    /// Aim along a path that moves to the sign of `sign`, or rests where it is 0.
    pub(super) fn along(sign: f32) -> Self {
        Self { sign, rests: false, pushed: 0.0, share: 1.0, threshold: 1.0 }
    }
}

/// Share of the last breakaway duty that a standing motor gets at once; the rest is added gradually.
const STICTION_SHARE: f32 = 0.8;
/// Time constant with which the curve is learned, s.
const LEARN_S: f32 = 0.1;
/// Control periods between two updates of a motor's curve. Motors with neighbouring sensor inputs update in different periods, so that
/// the updates, the costliest part of the model, do not add up in one tick. The gain of an update grows in proportion: learning is as fast as
/// with one in each period. Our choice: other values have not been measured.
const LEARN_TURNS: u8 = 4;

impl Model {
    /// Creates the model; `None` where the configuration gives no time constant of the motor, or the only sensor is an
    /// angle sensor, whose filter is timed by its readings.
    pub(super) fn new(control: &ControlConfig, duty_max: f32, period_s: f32) -> Option<Self> {
        let feed_forward = control.feed_forward;
        let resolution = match (control.motor_side, control.feedback) {
            (Some(side), _) => core::f32::consts::TAU / side.counts_per_turn as f32,
            (None, Feedback::Angle { .. } | Feedback::Pulses { .. }) => return None,
            // A smaller displacement is noise.
            (None, Feedback::Potentiometer { .. }) => control.settle.error,
            (None, feedback) => channel::resolution(feedback),
        };
        let turn = match (control.motor_side, control.feedback) {
            (Some(side), _) => side.index,
            (None, Feedback::Encoder { index, .. }) => index,
            (None, Feedback::Potentiometer { analog, .. }) => analog,
            (None, Feedback::Angle { .. } | Feedback::Pulses { .. }) => 0,
        };
        let known = feed_forward.duty_per_speed > 0.0 && feed_forward.duty_per_acceleration > 0.0;
        let time_constant_s = feed_forward.duty_per_acceleration / feed_forward.duty_per_speed;
        known.then(|| Self {
            observer: Observer::new(control.speed_filter_s, time_constant_s, period_s),
            curve: DriveCurve::new(feed_forward.static_duty, feed_forward.duty_per_speed, control.speed_max, duty_max),
            time_constant_s,
            duty_per_speed: feed_forward.duty_per_speed,
            turn: turn % LEARN_TURNS,
            slowest: 0.1 * resolution / control.speed_filter_s.max(period_s),
            stiction: 0.0,
            is_placed: false,
            counted: 0,
            given: [0; 2],
            period_s,
        })
    }

    /// Advances one period in which `duty` was applied, and takes the encoder's counts in it. Returns the speed, rad/s
    /// or m/s.
    pub(super) fn count(&mut self, encoder: &Encoder, duty: f32, resolution: f32) -> f32 {
        self.predict(duty);
        let (counts, periods) = encoder.last();
        self.turn_round(counts, duty);
        if encoder.is_still() && counts == 0 {
            self.observer.rest(0.5 * resolution);
        } else if self.observer.count(counts, periods, resolution) {
            self.learn(duty);
        }
        self.observer.speed()
    }

    /// Like [`Model::count`], for a position that is measured each period.
    pub(super) fn measure(&mut self, position: f32, duty: f32) -> f32 {
        if !core::mem::replace(&mut self.is_placed, true) {
            self.observer.rest(position);
        }
        self.predict(duty);
        self.observer.measure(position);
        self.learn(duty);
        self.observer.speed()
    }

    /// Detects a load: a motor whose counts reverse was at rest in between; if every duty since the last count opposed
    /// the new direction, the load overcame the most favourable of them.
    fn turn_round(&mut self, counts: i32, duty: f32) {
        // Rounded away from 0: the load is estimated at most 1/127 of duty too high.
        let rounded = (duty * 127.0 + 0.5f32.copysign(duty)) as i8;
        self.given = [self.given[0].min(rounded), self.given[1].max(rounded)];
        if counts == 0 {
            return;
        }
        let sign = counts.signum() as i8;
        // The duty that favoured the direction of motion most.
        let favour = if sign < 0 { -self.given[0] } else { self.given[1] };
        if sign == -self.counted && favour < 0 {
            self.curve.gave_way(f32::from(sign), f32::from(favour) / 127.0);
        }
        (self.counted, self.given) = (sign, [rounded; 2]);
    }

    /// Estimated speed, 0 where it is too low to show a direction.
    fn direction(&self) -> f32 {
        let speed = self.observer.speed();
        if speed.abs() < self.slowest { 0.0 } else { speed }
    }

    /// Marks the position as unknown: the motor counts as at rest where it is found again.
    pub(super) fn lose(&mut self) {
        self.is_placed = false;
    }

    fn predict(&mut self, duty: f32) {
        let steady = self.curve.steady(duty, self.direction());
        // Backward Euler: stable also with a time constant shorter than a period.
        self.observer.predict((steady - self.observer.speed()) / (self.time_constant_s + self.period_s));
    }

    fn learn(&mut self, duty: f32) {
        self.turn = (self.turn + 1) % LEARN_TURNS;
        if self.turn != 0 {
            return;
        }
        let moves = self.direction();
        if moves != 0.0 {
            let steady = self.curve.steady(duty, moves) + self.time_constant_s * self.observer.disturbance();
            let share = f32::from(LEARN_TURNS) * self.period_s / LEARN_S;
            self.curve.learn(steady, duty, moves, share);
        }
    }

    /// Feed-forward that a loop adds to its output for a path of `speed` and `acceleration`: duty of the straight line,
    /// which [`Model::drive`] converts to the motor's duty.
    pub(super) fn feed_forward(&self, speed: f32, acceleration: f32) -> f32 {
        self.duty_per_speed * (speed + self.time_constant_s * acceleration)
    }

    /// Motor duty for a loop's output, which is a duty of the straight line.
    pub(super) fn drive(&self, straight: f32, aim: Aim) -> f32 {
        let Aim { sign, rests, pushed, share, threshold } = aim;
        let load = self.curve.duty(0.0, 0.0);
        if sign == 0.0 {
            return load + straight;
        }
        let steady = straight / self.duty_per_speed;
        let duty = if steady * sign < 0.0 && pushed == 0.0 {
            self.curve.duty(steady, sign)
        } else if rests {
            // The loop's integral may hold a load that has not been learned yet.
            load + straight
        } else {
            // A motor that stands is not braked.
            let along = if steady * sign < 0.0 { 0.0 } else { steady };
            load + (self.curve.duty(along * share, sign) - load) * threshold
        };
        duty + pushed.copysign(sign)
    }

    /// Loop output that leaves a motor at rest with `duty`: the duty less that of the known load.
    pub(super) fn straight(&self, duty: f32) -> f32 {
        duty - self.curve.duty(0.0, 0.0)
    }

    /// Limits of a loop's output at which the motor's duty reaches its own.
    pub(super) fn limits(&self, limits: OutputLimits, towards: f32) -> OutputLimits {
        let most = limits.magnitude;
        let reach = self.curve.steady(most.copysign(towards), towards).abs();
        OutputLimits { magnitude: self.duty_per_speed * reach, slew_per_s: f32::MAX }
    }

    /// Expected breakaway duty beyond the threshold.
    pub(super) fn stiction(&self) -> f32 {
        STICTION_SHARE * self.stiction
    }

    /// Records the duty `pushed` beyond the threshold that the breakaway took.
    pub(super) fn broke_away(&mut self, pushed: f32) {
        self.stiction = pushed;
    }

    /// Duty that a breakaway may take.
    pub(super) fn threshold(&self) -> f32 {
        self.curve.threshold().max(0.0) + self.stiction
    }
}
