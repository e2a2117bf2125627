//! Errors of tuning a loop.

use r4_driver::{
    Error as DriverError,
    tune::{FitError, RelayError, RuleError},
};
use r4_protocol::{ChannelId, Unit};

use crate::{Error, quantity::Quantity};

/// Experiment without a conclusion.
#[derive(Clone, Debug, thiserror::Error)]
pub enum Inconclusive {
    /// The motor does not oscillate steadily under the relay.
    #[error("the relay did not settle into a swing within {after_s:.0} s: {last}")]
    Relay {
        /// Duration of the relay experiment, s.
        after_s: f64,
        /// Reason why the last cycles do not count as an oscillation.
        last: RelayError,
    },
    /// The duty that holds the speed is too close to a limit for an experiment around it.
    #[error("there is no room for a duty around {duty:.3} that holds the speed: --amplitude, or another speed")]
    NoRoom {
        /// Duty that holds the speed, as a share of the supply.
        duty: f64,
    },
}

/// Error of a loop that cannot be tuned as requested.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// The requested phase margin is outside 30 to 80 degrees.
    #[error("--margin takes 30 to 80 degrees")]
    Margin,
    /// A requested time is not above 0.
    #[error("{option} takes a number of seconds above 0")]
    NoTime {
        /// Option of the time.
        option: &'static str,
    },
    /// The channel has no loops.
    #[error("{channel} has no loops to tune: a motor with an encoder or a potentiometer has")]
    NoLoops {
        /// Channel of the request.
        channel: ChannelId,
    },
    /// A travel or position is in a unit that the motor does not have.
    #[error("{option} takes a number in {unit}, as in {}", example(*unit))]
    WrongUnit {
        /// Option of the quantity.
        option: &'static str,
        /// Unit of the motor's position.
        unit: Unit,
    },
    /// The requested travel is too short to show a response.
    #[error("{channel} needs a travel of {least} for this, not {travel}")]
    TravelTooShort {
        /// Channel of the motor.
        channel: ChannelId,
        /// Least travel for the experiment.
        least: Quantity,
        /// Travel of the request.
        travel: Quantity,
    },
    /// The requested travel exceeds the range.
    #[error("{channel} has no room for a travel of {travel}: its range is {range}")]
    TravelTooLong {
        /// Channel of the motor.
        channel: ChannelId,
        /// Travel of the request.
        travel: Quantity,
        /// Length of the motor's range.
        range: Quantity,
    },
    /// From the requested start, the travel leaves the range.
    #[error("{channel} has room for a travel of {travel} from {low} to {high}, not at {at}")]
    NoRoomThere {
        /// Channel of the motor.
        channel: ChannelId,
        /// Travel of the request.
        travel: Quantity,
        /// Lowest start within the range.
        low: Quantity,
        /// Highest start within the range.
        high: Quantity,
        /// Start of the request.
        at: Quantity,
    },
    /// The requested duty is not above 0, or above the board's limit.
    #[error("{channel} takes an --amplitude up to {most:.3}")]
    Amplitude {
        /// Channel of the motor.
        channel: ChannelId,
        /// Largest duty, as a share of the supply.
        most: f64,
    },
    /// The duty does not overcome friction.
    #[error(
        "duty {amplitude:.3} is no more than what friction takes of {channel} ({static_duty:.3}): allow more with --amplitude"
    )]
    WithinFriction {
        /// Channel of the motor.
        channel: ChannelId,
        /// Duty of the experiment, as a share of the supply.
        amplitude: f64,
        /// Duty that overcomes friction, as a share of the supply.
        static_duty: f64,
    },
    /// The motor does not move under the largest duty that is safe for a motor at standstill.
    #[error(
        "{channel} does not move {direction} under duty {duty:.3}: free it, check its wiring, or raise stall_duty, below which this stays"
    )]
    DoesNotMove {
        /// Channel of the motor.
        channel: ChannelId,
        /// Direction of the duty: up or down.
        direction: &'static str,
        /// Largest duty that was tried, as a share of the supply.
        duty: f64,
    },
    /// The run would exceed the time limit.
    #[error("{channel} may take {needs_s:.0} s: allow it with --time, or less --travel")]
    NotInTime {
        /// Channel of the motor.
        channel: ChannelId,
        /// Longest duration of the run, s.
        needs_s: f64,
    },
    /// The experiment has no conclusion.
    #[error(transparent)]
    Inconclusive(#[from] Inconclusive),
    /// No model fits the motion of the motor.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// The rule gives no gains for the identified motor.
    #[error(transparent)]
    Rule(#[from] RuleError),
    /// The telemetry has no sample after the step.
    #[error("no telemetry after the step")]
    NoAnswer,
    /// The run with the proposed gains failed.
    #[error("with the proposed gains, which are not kept")]
    WithProposed(#[source] Box<Error>),
    /// The board cannot save the gains.
    #[error("cannot save the gains")]
    NotSaved(#[source] DriverError),
}

fn example(unit: Unit) -> &'static str {
    if unit == Unit::M { "10mm" } else { "60deg" }
}
