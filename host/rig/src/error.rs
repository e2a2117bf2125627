//! Failures of sessions.

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

/// A session could not be opened, or did not end as it should.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// There is no session.
    #[error("cannot connect to {board}")]
    Connect {
        /// The board's name.
        board: String,
        /// Why not.
        source: DriverError,
    },
    /// There is no link to the board.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The board does not arm.
    #[error("cannot arm")]
    Arm(#[source] DriverError),
    /// The board does not disarm.
    #[error("cannot disarm; closing the session makes the board stop by itself")]
    Disarm(#[source] DriverError),
    /// An interrupted session could not disarm.
    #[error("interrupted; could not disarm, the board stops by itself")]
    NotDisarmed(#[source] DriverError),
    /// A request failed.
    #[error(transparent)]
    Board(#[from] DriverError),
    /// A channel does not take what it was asked for; nothing was sent.
    #[error(transparent)]
    Unsuitable(#[from] Unsuitable),
    /// A motor did not do what it was asked for in time.
    #[error(transparent)]
    NotReached(#[from] NotReached),
    /// A motor does not take a set point.
    #[error("cannot command {channel}")]
    NotCommanded {
        /// The motor.
        channel: ChannelId,
        /// Why not.
        source: DriverError,
    },
    /// The board lacks a parameter that its channel should have.
    #[error("the board does not tell {} of {channel}", parameter.name())]
    NotTold {
        /// The channel.
        channel: ChannelId,
        /// The parameter.
        parameter: Parameter,
    },
    /// A sensor that is relied on gives no good readings.
    #[error("{channel} gives no good readings: `r4 watch {channel}` shows its quality")]
    NoReadings {
        /// The sensor.
        channel: ChannelId,
    },
    /// A program's state did not end in time.
    #[error("`{state}` did not end within {at_most_s} s")]
    StateTimedOut {
        /// Name of the state.
        state: &'static str,
        /// Its time-out, s.
        at_most_s: f64,
    },
    /// An experiment with a motor ended early.
    #[error(transparent)]
    Watch(Box<WatchError>),
    /// A calibration came to no result.
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
    /// A robot cannot drive round waypoints.
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
        /// The motor.
        channel: ChannelId,
        /// Why not.
        source: DriverError,
    },
    /// The operation needs a simulated environment.
    #[error(transparent)]
    NotVirtual(#[from] NotVirtual),
    /// The robot's or world's file is wrong.
    #[error(transparent)]
    Robot(Box<BoardError>),
    /// A robot without a body is to stand in a world.
    #[error("{robot} has no [body] to stand in a world: add one to its file (boards/README.md), or leave out --world")]
    NoBody {
        /// Name or file.
        robot: String,
    },
    /// The robot's environment cannot be simulated.
    #[error(transparent)]
    Simulation(Box<SimError>),
    /// A plant of the robot's file is wrong.
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
    /// The emulated processor met something that its models do not have.
    #[error("the emulated board stopped: {0}")]
    Stopped(String),
    /// Nothing in the simulation will ever happen again.
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
    /// Another host has the board's only port.
    #[error("the simulated board is already connected")]
    Connected,
}

impl Error {
    /// The failure itself, below what was being done meanwhile.
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

/// Boxed, so that results of which most are none of these stay small.
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
