//! Errors of a motor's excitation.

use r4_driver::Error as DriverError;
use r4_protocol::ChannelId;

/// Error of a motor that cannot be excited.
#[derive(Debug, thiserror::Error)]
pub enum ExciteError {
    /// The channel is no motor with feedback.
    #[error("{channel} cannot be excited: a motor with an encoder or a potentiometer can")]
    Unfit {
        /// Channel of the request.
        channel: ChannelId,
    },
    /// The requested duty is above the board's limit.
    #[error("{channel} takes a duty up to {duty_max:.3}: give --duty that or less")]
    TooMuch {
        /// Channel of the motor.
        channel: ChannelId,
        /// Largest duty that the board allows.
        duty_max: f64,
    },
    /// The requested duty does not overcome friction.
    #[error(
        "duty {duty:.3} is no more than what friction takes of {channel} ({static_duty:.3}): allow more with --duty"
    )]
    BelowFriction {
        /// Channel of the motor.
        channel: ChannelId,
        /// Largest duty of the request.
        duty: f64,
        /// Duty that overcomes friction.
        static_duty: f64,
    },
    /// The telemetry has stopped.
    #[error("no telemetry of {channel} for {silent_s} s")]
    Silent {
        /// Channel of the motor.
        channel: ChannelId,
        /// Time without telemetry, s.
        silent_s: f64,
    },
    /// The motor stands still at every duty that the board allows.
    #[error(
        "{channel} does not move at any duty that the board allows before it counts as a stall: free the mechanism, check the wires of motor and sensor, or raise duty_max"
    )]
    Immovable {
        /// Channel of the motor.
        channel: ChannelId,
    },
    /// The board does not clear the trip that ended the excitation.
    #[error("cannot clear the trip that ended the excitation")]
    NotCleared(#[source] DriverError),
}
