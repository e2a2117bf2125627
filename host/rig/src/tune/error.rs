//! Failures of tuning.

use r4_driver::{
    Error as DriverError,
    tune::{FitError, RelayError, RuleError},
};
use r4_protocol::{ChannelId, Unit};

use crate::{Error, quantity::Quantity};

/// An experiment that says nothing.
#[derive(Clone, Debug, thiserror::Error)]
pub enum Inconclusive {
    /// The motor does not swing steadily.
    #[error("the relay did not settle into a swing within {after_s:.0} s: {last}")]
    Relay {
        /// How long it was waited for, s.
        after_s: f64,
        /// Why the last cycles are no swing.
        last: RelayError,
    },
    /// The duty that holds the speed is too near to a limit to go to both sides of it.
    #[error("there is no room for a duty around {duty:.3} that holds the speed: --amplitude, or another speed")]
    NoRoom {
        /// Duty that holds the speed, as a share of the supply.
        duty: f64,
    },
}

/// A loop cannot be tuned as it was asked for.
#[derive(Debug, thiserror::Error)]
pub enum TuneError {
    /// No such phase margin can be had.
    #[error("--margin takes 30 to 80 degrees")]
    Margin,
    /// No time.
    #[error("{option} takes a number of seconds above 0")]
    NoTime {
        /// Which of the times.
        option: &'static str,
    },
    /// Nothing of this channel can be tuned.
    #[error("{channel} has no loops to tune: a motor with an encoder or a potentiometer has")]
    NoLoops {
        /// The channel.
        channel: ChannelId,
    },
    /// A travel or position in a unit that the motor does not have.
    #[error("{option} takes a number in {unit}, as in {}", example(*unit))]
    WrongUnit {
        /// Which of the quantities.
        option: &'static str,
        /// Unit of the motor's position.
        unit: Unit,
    },
    /// Too little travel to see anything in.
    #[error("{channel} needs a travel of {least} for this, not {travel}")]
    TravelTooShort {
        /// The motor.
        channel: ChannelId,
        /// Least travel.
        least: Quantity,
        /// Travel that was asked for.
        travel: Quantity,
    },
    /// More travel than there is range.
    #[error("{channel} has no room for a travel of {travel}: its range is {range}")]
    TravelTooLong {
        /// The motor.
        channel: ChannelId,
        /// Travel that was asked for.
        travel: Quantity,
        /// Length of the motor's range.
        range: Quantity,
    },
    /// A beginning from which the travel leaves the range.
    #[error("{channel} has room for a travel of {travel} from {low} to {high}, not at {at}")]
    NoRoomThere {
        /// The motor.
        channel: ChannelId,
        /// Travel that was asked for.
        travel: Quantity,
        /// Lowest beginning.
        low: Quantity,
        /// Highest beginning.
        high: Quantity,
        /// Beginning that was asked for.
        at: Quantity,
    },
    /// No duty, or more than the board allows.
    #[error("{channel} takes an --amplitude up to {most:.3}")]
    Amplitude {
        /// The motor.
        channel: ChannelId,
        /// Largest duty, as a share of the supply.
        most: f64,
    },
    /// A duty that does not move the motor.
    #[error(
        "duty {amplitude:.3} is no more than what friction takes of {channel} ({static_duty:.3}): allow more with --amplitude"
    )]
    WithinFriction {
        /// The motor.
        channel: ChannelId,
        /// Duty of the experiment, as a share of the supply.
        amplitude: f64,
        /// Duty that friction takes, as a share of the supply.
        static_duty: f64,
    },
    /// Nothing moves under the most duty that is safe for a motor that stands.
    #[error(
        "{channel} does not move {direction} under duty {duty:.3}: free it, check its wiring, or raise stall_duty, below which this stays"
    )]
    DoesNotMove {
        /// The motor.
        channel: ChannelId,
        /// Which way it was driven: up or down.
        direction: &'static str,
        /// The most duty that was tried, as a share of the supply.
        duty: f64,
    },
    /// The run does not fit into the time.
    #[error("{channel} may take {needs_s:.0} s: allow it with --time, or less --travel")]
    NotInTime {
        /// The motor.
        channel: ChannelId,
        /// Time that the run may take, s.
        needs_s: f64,
    },
    /// The experiment says nothing.
    #[error(transparent)]
    Inconclusive(#[from] Inconclusive),
    /// No model fits what the motor did.
    #[error(transparent)]
    Fit(#[from] FitError),
    /// There are no gains for what was found.
    #[error(transparent)]
    Rule(#[from] RuleError),
    /// No sample shows the step.
    #[error("no telemetry after the step")]
    NoAnswer,
    /// The run with the proposed gains failed.
    #[error("with the proposed gains, which are not kept")]
    WithProposed(#[source] Box<Error>),
    /// The board does not keep the gains.
    #[error("cannot save the gains")]
    NotSaved(#[source] DriverError),
}

fn example(unit: Unit) -> &'static str {
    if unit == Unit::M { "10mm" } else { "60deg" }
}
