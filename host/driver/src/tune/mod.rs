//! Tuning of a motor's loops: what a recorded experiment says of a motor, and gains for it by stated rules.
//!
//! Nothing here talks to a board. An experiment is a list of [`Sample`]s on the board's clock; a host makes it with duties as
//! set points and the motor's telemetry, which tells for the same moment what the board drove and what it measured. So what is
//! computed is the motor as the board sees it: the time that commands and telemetry take to and from the host decides how
//! fast a relay swings, but is in neither gain nor phase.
//!
//! Two experiments and their rules:
//!
//! - A relay around a set point ([`Relay`], [`Oscillation`]): the motor's gain and phase at the frequency of the swing, from
//!   the first harmonics of duty and measurement. A position loop is laid through that point ([`position_through`]); other loops
//!   take the motor for an integrator with a delay there ([`Point::integrator`]).
//! - Runs under changing duties ([`Fit`]): gain, lag, delay and friction by least squares, with what the recording does not exclude.
//!   Gains are by the SIMC rules ([`Surroundings::design`]), as fast as leaves the phase margin on all of that and as the sensor's
//!   resolution allows, with a feed-forward ([`feed_forward`]).
//!
//! Phase margins are those of the loop as the board closes it ([`Surroundings::phase_margin`]): with its delay and its estimate of
//! the speed.
//!
//! Sources: Åström, Hägglund, *Automatic tuning of simple regulators with specifications on phase and amplitude margins*,
//! Automatica 20 (5), 1984. Skogestad, *Simple analytic rules for model reduction and PID controller tuning*, Journal of
//! Process Control 13, 2003.

mod complex;
mod fit;
mod relay;
mod response;
mod rule;

pub use fit::{Fit, FitError, Friction, Model, Run};
pub use relay::{Oscillation, Point, Relay, RelayError};
pub use response::Response;
pub use rule::{
    Design, Gains, RuleError, SpeedEstimate, Surroundings, feed_forward, position_for, position_through, speed_for,
};

/// One moment of an experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// On the board's clock, s.
    pub time_s: f64,
    /// Duty, or what of it is beyond friction.
    pub input: f64,
    /// What the loop measures: rad, m, rad/s or m/s.
    pub output: f64,
}

/// Which loop of a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loop {
    /// Its output integrates the speed.
    Position,
    /// Its output follows the duty.
    Speed,
    /// Positions by the speed loop.
    Cascade,
}

/// What of a duty drives a motor that stands still up to `static_duty`, as the board's feed-forward assumes.
#[must_use]
pub fn beyond_friction(duty: f64, static_duty: f64) -> f64 {
    (duty.abs() - static_duty).max(0.0).copysign(duty)
}
