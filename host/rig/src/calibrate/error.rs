//! Failures of calibration.

use r4_driver::Error as DriverError;
use r4_protocol::{ChannelId, ParameterKey};

use crate::{Error, quantity::Quantity};

/// A person gave no answer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{why}")]
pub struct NoAnswer {
    /// Why not, with the question.
    pub why: String,
}

/// A calibration came to no result.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// The channel has nothing of what is calibrated, or cannot do what the calibration takes.
    #[error("{channel} {why}")]
    Unfit {
        /// The channel.
        channel: ChannelId,
        /// What it lacks, as the end of a sentence that begins with its name.
        why: &'static str,
    },
    /// No turns to make by hand.
    #[error("--turns takes a number of turns other than 0")]
    NoTurns,
    /// No angle to drive by.
    #[error("--drive takes an angle, as in 720deg")]
    NoDrive,
    /// No angle for wheels to turn by.
    #[error("--turn takes an angle above 0, as in 2turns")]
    NoTurn,
    /// The sensor told no motion.
    #[error("{channel} was not seen to move: is its encoder wired to this connector?")]
    NotSeen {
        /// The channel.
        channel: ChannelId,
    },
    /// The shaft is said not to have turned.
    #[error("a shaft that did not turn cannot be calibrated")]
    NotTurned,
    /// The counts fall while the shaft turns forwards.
    #[error("{channel} counts backwards: change `inverted` of its encoder in the robot's file, not its scale")]
    Backwards {
        /// The channel.
        channel: ChannelId,
    },
    /// Two places that are nearly one.
    #[error("the two places are too near: at least {least}")]
    TooNear {
        /// Least distance between them.
        least: Quantity,
    },
    /// A point of a potentiometer that no converter reads.
    #[error("one end would be at code {code:.0}, which no converter has: was all measured right?")]
    NoSuchCode {
        /// The code, of 16 bits.
        code: f64,
    },
    /// No chip makes pulses for servos.
    #[error("the board has no servo chip")]
    NoServoChip,
    /// No oscillator is so far off.
    #[error(
        "that would be an oscillator of {:.2} MHz, {:+.0} % from what is assumed: measure again", true_hz * 1e-6, off * 100.0
    )]
    OscillatorFarOff {
        /// Frequency that follows from the answer, Hz.
        true_hz: f64,
        /// Its difference from the assumed one, as a share of that.
        off: f64,
    },
    /// A wheel on the left and on the right.
    #[error("{channel} cannot be on both sides")]
    BothSides {
        /// Its motor.
        channel: ChannelId,
    },
    /// The robot went nowhere, or backwards.
    #[error("a robot that did not drive forwards gives no radius")]
    NoRadius,
    /// The robot turned nowhere, or to the right.
    #[error("a robot that did not turn to the left gives no track width")]
    NoTrack,
    /// An answer to something else.
    #[error("`{answer}` is not what was asked for: {why}")]
    WrongAnswer {
        /// The answer.
        answer: String,
        /// What it lacks.
        why: String,
    },
    /// No answer.
    #[error(transparent)]
    NoAnswer(#[from] NoAnswer),
    /// The board refuses what was found.
    #[error("the board does not take {parameter} = {to}: was all measured right?")]
    NotTaken {
        /// The parameter.
        parameter: ParameterKey,
        /// What was found.
        to: f32,
        /// Why not.
        source: DriverError,
    },
    /// The board does not keep what was found.
    #[error("cannot save")]
    NotSaved(#[source] DriverError),
}

impl From<NoAnswer> for Error {
    fn from(error: NoAnswer) -> Self {
        CalibrateError::from(error).into()
    }
}
