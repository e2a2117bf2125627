//! Errors of a calibration.

use r4_driver::Error as DriverError;
use r4_protocol::{ChannelId, ParameterKey};

use crate::{Error, quantity::Quantity};

/// Error of a person who gave no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{why}")]
pub struct NoAnswer {
    /// Reason, with the question.
    pub why: String,
}

/// Error of a calibration without a result.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// The channel lacks what is calibrated, or cannot do what the calibration needs.
    #[error("{channel} {why}")]
    Unfit {
        /// Channel of the calibration.
        channel: ChannelId,
        /// Reason, as the end of a sentence that begins with the channel's name.
        why: &'static str,
    },
    /// The number of turns by hand is 0 or not finite.
    #[error("--turns takes a number of turns other than 0")]
    NoTurns,
    /// The drive is not an angle, or is 0.
    #[error("--drive takes an angle, as in 720deg")]
    NoDrive,
    /// The wheels' angle is not above 0.
    #[error("--turn takes an angle above 0, as in 2turns")]
    NoTurn,
    /// The sensor reported no motion.
    #[error("{channel} was not seen to move: is its encoder wired to this connector?")]
    NotSeen {
        /// Channel of the encoder.
        channel: ChannelId,
    },
    /// The answer says that the shaft did not turn.
    #[error("a shaft that did not turn cannot be calibrated")]
    NotTurned,
    /// The counts fall while the shaft turns forwards.
    #[error("{channel} counts backwards: change `inverted` of its encoder in the robot's file, not its scale")]
    Backwards {
        /// Channel of the encoder.
        channel: ChannelId,
    },
    /// The two positions of a potentiometer are too close together.
    #[error("the two places are too near: at least {least}")]
    TooNear {
        /// Least distance between them.
        least: Quantity,
    },
    /// A point of a potentiometer lies outside the converter's range.
    #[error("one end would be at code {code:.0}, which no converter has: was all measured right?")]
    NoSuchCode {
        /// Code of the point, out of 16 bits.
        code: f64,
    },
    /// The board has no chip that makes pulses for servos.
    #[error("the board has no servo chip")]
    NoServoChip,
    /// The answer implies an oscillator further off than any is.
    #[error(
        "that would be an oscillator of {:.2} MHz, {:+.0} % from what is assumed: measure again", true_hz * 1e-6, off * 100.0
    )]
    OscillatorFarOff {
        /// Frequency that follows from the answer, Hz.
        true_hz: f64,
        /// Difference from the assumed frequency, as a share of it.
        off: f64,
    },
    /// A wheel is given on the left and on the right.
    #[error("{channel} cannot be on both sides")]
    BothSides {
        /// Channel of the wheel's motor.
        channel: ChannelId,
    },
    /// The answer says that the robot did not move forwards.
    #[error("a robot that did not drive forwards gives no radius")]
    NoRadius,
    /// The answer says that the robot did not turn to the left.
    #[error("a robot that did not turn to the left gives no track width")]
    NoTrack,
    /// The answer does not fit the question.
    #[error("`{answer}` is not what was asked for: {why}")]
    WrongAnswer {
        /// Answer as it was given.
        answer: String,
        /// Reason for the user, in words.
        why: String,
    },
    /// The person gave no answer.
    #[error(transparent)]
    NoAnswer(#[from] NoAnswer),
    /// The board refuses the new value of a parameter.
    #[error("the board does not take {parameter} = {to}: was all measured right?")]
    NotTaken {
        /// Parameter that was set.
        parameter: ParameterKey,
        /// Value that was measured.
        to: f32,
        /// Error of the request.
        source: DriverError,
    },
    /// The board cannot save the parameters.
    #[error("cannot save")]
    NotSaved(#[source] DriverError),
}

impl From<NoAnswer> for Error {
    fn from(error: NoAnswer) -> Self {
        CalibrateError::from(error).into()
    }
}
