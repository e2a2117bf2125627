//! Failures of sessions.

use r4_boards::BoardError;
use r4_driver::Error as DriverError;
use r4_links::OpenError;
use r4_plants::error::PlantError;
use r4_protocol::ChannelId;
use r4_sim::SimError;

use crate::{FlashFileError, Interrupted, NotVirtual, PlantFileError, emulated::EmulatedError};

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
    Robot(#[from] BoardError),
    /// A robot without a body is to stand in a world.
    #[error("{robot} has no [body] to stand in a world: add one to its file (boards/README.md), or leave out --world")]
    NoBody {
        /// Name or file.
        robot: String,
    },
    /// The robot's environment cannot be simulated.
    #[error(transparent)]
    Simulation(#[from] SimError),
    /// A plant of the robot's file is wrong.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A plant file cannot be used.
    #[error(transparent)]
    PlantFile(#[from] PlantFileError),
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
    /// Another host has the board's only port.
    #[error("the simulated board is already connected")]
    Connected,
}
