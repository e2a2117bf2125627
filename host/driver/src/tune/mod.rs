//! Tuning of a motor's control loops: models from recorded experiments, and gains by stated rules.
//!
//! This module does not talk to a board. An experiment is a list of [`Sample`]s on the board's clock. A host makes it
//! with duties as set points and the motor's telemetry, which has duty and measurement of the same moment. So the
//! result is the motor as the board sees it: the transmission time of set points and telemetry decides how fast a relay
//! oscillates, but enters neither gain nor phase.
//!
//! There are two experiments, each with its rules:
//!
//! - Relay feedback around a set point ([`Relay`], [`Oscillation`]): the motor's gain and phase at the frequency of the
//!   oscillation, from the first harmonics of duty and measurement. A position loop is designed through that point
//!   ([`position_through`]); other loops treat the motor as an integrator with a delay there ([`Point::integrator`]).
//! - Runs with varying duty ([`Fit`]): gain, lag, delay and friction by least squares, with the models that the
//!   recording does not exclude. Gains follow the SIMC rules ([`LoopConditions::design`]), as fast as the phase margin on
//!   all these models and the sensor's resolution allow, with a feed-forward ([`feed_forward`]).
//!
//! Phase margins are those of the loop as the board closes it ([`LoopConditions::phase_margin`]), with its delay and its
//! speed estimate.
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
    Design, Gains, LoopConditions, RuleError, SpeedEstimate, feed_forward, position_for, position_through, speed_for,
};

/// Sample of an experiment: duty and measurement at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Duty, or the part of it beyond friction.
    pub input: f64,
    /// Measurement of the loop: rad, m, rad/s or m/s.
    pub output: f64,
}

/// Control loop of a motor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loop {
    /// Position loop, whose plant integrates the speed.
    Position,
    /// Speed loop, whose plant follows the duty.
    Speed,
    /// Position loop around the speed loop.
    Cascade,
}

/// Returns the part of `duty` beyond the static friction `static_duty`, as the board's feed-forward assumes it; 0
/// below.
#[must_use]
pub fn beyond_friction(duty: f64, static_duty: f64) -> f64 {
    (duty.abs() - static_duty).max(0.0).copysign(duty)
}
