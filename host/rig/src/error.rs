//! Errors of sessions and of the programs that run in them.

use r4_boards::BoardError;
use r4_driver::Error as DriverError;
use r4_links::OpenError;
use r4_plants::error::PlantError;
use r4_protocol::{ChannelId, Parameter};
use r4_sim::SimError;

use crate::{
    FlashFileError, Interrupted, NotReached, NotVirtual, PlantFileError, Unsuitable, WatchError,
    calibrate::CalibrateError, emulated::EmulatedError, excite::ExciteError, recording::RecordingError,
    replay::ReplayError, round::RoundError, scenario::ScenarioError, tune::TuneError, twin::TwinError,
};

/// Error of a session that could not be opened, or did not end as it should.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The driver cannot open a session on the link.
    #[error("cannot connect to {board}")]
    Connect {
        /// Name of the board.
        board: String,
        /// Error of the driver.
        source: DriverError,
    },
    /// The link to the board cannot be opened.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The board refuses to arm.
    #[error("cannot arm")]
    Arm(#[source] DriverError),
    /// The board refuses to disarm.
    #[error("cannot disarm; closing the session makes the board stop by itself")]
    Disarm(#[source] DriverError),
    /// An interrupted session could not disarm.
    #[error("interrupted; could not disarm, the board stops by itself")]
    NotDisarmed(#[source] DriverError),
    /// A request to the board failed.
    #[error(transparent)]
    Board(#[from] DriverError),
    /// A channel does not accept the request; nothing was sent.
    #[error(transparent)]
    Unsuitable(#[from] Unsuitable),
    /// A motor did not reach what was requested in time.
    #[error(transparent)]
    NotReached(#[from] NotReached),
    /// A motor does not take a set point.
    #[error("cannot command {channel}")]
    NotCommanded {
        /// Channel of the motor.
        channel: ChannelId,
        /// Error of the request.
        source: DriverError,
    },
    /// The board lacks a parameter that the channel must have.
    #[error("the board does not tell {} of {channel}", parameter.name())]
    NotTold {
        /// Channel of the parameter.
        channel: ChannelId,
        /// Parameter that is missing.
        parameter: Parameter,
    },
    /// A required sensor gives no good readings.
    #[error("{channel} gives no good readings: `r4 watch {channel}` shows its quality")]
    NoReadings {
        /// Channel of the sensor.
        channel: ChannelId,
    },
    /// A state of a program reached its timeout.
    #[error("`{state}` did not end within {at_most_s} s")]
    StateTimedOut {
        /// Name of the state.
        state: &'static str,
        /// Timeout of the state, s.
        at_most_s: f64,
    },
    /// An experiment with a motor ended early.
    #[error(transparent)]
    Watch(Box<WatchError>),
    /// A calibration has no result.
    #[error(transparent)]
    Calibrate(Box<CalibrateError>),
    /// A loop could not be tuned.
    #[error(transparent)]
    Tune(Box<TuneError>),
    /// A motor cannot be excited.
    #[error(transparent)]
    Excite(Box<ExciteError>),
    /// A log cannot be replayed.
    #[error(transparent)]
    Replay(Box<ReplayError>),
    /// A simulated board cannot be compared with a recording.
    #[error(transparent)]
    Twin(#[from] TwinError),
    /// A robot cannot drive round its waypoints.
    #[error(transparent)]
    Round(Box<RoundError>),
    /// A scenario cannot be read or played.
    #[error(transparent)]
    Scenario(Box<ScenarioError>),
    /// The session was ended by an [`Interrupt`](crate::Interrupt).
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
    /// The gains for the end of the session could not be set.
    #[error("{channel} has other gains than it began with: restart the board")]
    GainsLeft {
        /// Channel of the motor.
        channel: ChannelId,
        /// Error of the request.
        source: DriverError,
    },
    /// The operation needs a simulated environment.
    #[error(transparent)]
    NotVirtual(#[from] NotVirtual),
    /// The file of the robot or of the world is not valid.
    #[error(transparent)]
    Robot(Box<BoardError>),
    /// A robot without a body cannot stand in a world.
    #[error("{robot} has no [body] to stand in a world: add one to its file (boards/README.md), or leave out --world")]
    NoBody {
        /// Name or file of the robot.
        robot: String,
    },
    /// The robot's environment cannot be simulated.
    #[error(transparent)]
    Simulation(Box<SimError>),
    /// A plant in the robot's file is not valid.
    #[error(transparent)]
    Plant(Box<PlantError>),
    /// A plant file cannot be used.
    #[error(transparent)]
    PlantFile(Box<PlantFileError>),
    /// The flash file cannot be used.
    #[error(transparent)]
    FlashFile(#[from] FlashFileError),
    /// The emulated board cannot be started.
    #[error(transparent)]
    Emulated(#[from] EmulatedError),
    /// The emulated processor accessed something that its models lack.
    #[error("the emulated board stopped: {0}")]
    Stopped(String),
    /// No event remains in the simulation, and the program still waits.
    #[error("the simulation came to a standstill")]
    Standstill,
    /// The operating system gives no thread for a board.
    #[error("cannot start a thread for the board: {0}")]
    Thread(#[source] std::io::Error),
    /// A recording is not complete.
    #[error(transparent)]
    Recording(Box<RecordingError>),
    /// A [`BoardThread`](crate::BoardThread) has closed its session, or the call was aborted.
    #[error("the session has ended: open the board again")]
    SessionEnded,
    /// The only port of the board is in use by another host.
    #[error("the simulated board is already connected")]
    Connected,
}

impl Error {
    /// The underlying error, without the context of the operation around it.
    #[must_use]
    pub fn innermost(&self) -> &Self {
        match self {
            Self::Tune(error) => match &**error {
                TuneError::WithProposed(error) => error.innermost(),
                _ => self,
            },
            _ => self,
        }
    }
}

/// Boxes the large variants, so that results of this type stay small.
macro_rules! boxed {
    ($($variant:ident($error:ty)),*) => {
        $(impl From<$error> for Error {
            fn from(error: $error) -> Self {
                Self::$variant(Box::new(error))
            }
        })*
    };
}

boxed!(
    Calibrate(CalibrateError),
    Excite(ExciteError),
    Plant(PlantError),
    PlantFile(PlantFileError),
    Robot(BoardError),
    Recording(RecordingError),
    Replay(ReplayError),
    Round(RoundError),
    Scenario(ScenarioError),
    Simulation(SimError),
    Tune(TuneError),
    Watch(WatchError)
);
