//! Flashing of a board that runs, or waits in its bootloader, until it runs another image.

use std::{error::Error, time::Duration};

use crate::{Progress, UpdateError, Usb, leave, update};

/// Time-out for a restart into the bootloader, which waits for half a second; USB takes a second or two more.
const RESTART: Duration = Duration::from_secs(10);
/// Time-out for a person who presses a button.
const PERSON: Duration = Duration::from_secs(60);
/// Time-out from leaving the bootloader to a session.
const START: Duration = Duration::from_secs(15);
/// Time between two searches for a board.
const LOOK: Duration = Duration::from_millis(250);

/// Image that a board runs, by its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Running {
    /// Length of the image, bytes.
    pub bytes: u32,
    /// CRC-32 of the image.
    pub crc: u32,
}

/// Outcome of the request to restart into the bootloader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Asked {
    /// The board restarts into its bootloader.
    Restarts,
    /// There is no board to ask.
    NoBoard,
    /// There is a board that cannot be asked, for this reason.
    Cannot(String),
}

/// Message for the person who flashes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// A board in its bootloader has been found.
    Found,
    /// The running board was asked, and restarts into its bootloader.
    Restarts,
    /// The person has to press the reset button twice.
    PressReset {
        /// Time in which the button must be pressed, s.
        within_s: u64,
        /// Reason why the board cannot restart by itself; `None` when there is no board.
        why: Option<String>,
    },
    /// Progress of the update.
    Progress(Progress),
    /// The image is written, and starts.
    Starts,
}

/// Machine that boards are plugged into.
pub trait Machine {
    /// Bootloader on this machine's USB.
    type Device: Usb;
    /// Error of this machine.
    type Error: Error;

    /// Returns the board that waits in its bootloader; `None` when there is none.
    ///
    /// # Errors
    /// The machine cannot look for it, for example without the right to.
    fn bootloader(&mut self) -> Result<Option<Self::Device>, Self::Error>;

    /// Asks the running board to restart into its bootloader.
    ///
    /// # Errors
    /// The board refuses, for example while it is armed.
    fn ask(&mut self) -> Result<Asked, Self::Error>;

    /// Returns the image that the board runs; `None` when no board answers.
    fn running(&mut self) -> Option<Running>;

    /// Returns the time since any fixed moment.
    fn now(&self) -> Duration;

    /// Waits for this time.
    fn sleep(&mut self, time: Duration);
}

/// Reason why a board does not run the image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FlashError<E: Error> {
    /// The machine or the board failed.
    #[error(transparent)]
    Machine(E),
    /// No board came into its bootloader.
    #[error(
        "no board has come into its bootloader within {waited_s} s: is its USB cable plugged in, and one for data? Press its reset \
         button twice within half a second, so that the green light pulses, and give the same command again"
    )]
    NoBootloader {
        /// Time that was waited, s.
        waited_s: u64,
    },
    /// Writing the image failed.
    #[error(transparent)]
    Update(#[from] UpdateError),
    /// The board came back with another image.
    #[error(
        "the board runs an image of {} bytes with CRC {:08x} instead of {} bytes with CRC {:08x}: is another board plugged in, too? Give \
         the same command again with that board alone", .running.bytes, .running.crc, .wanted.bytes, .wanted.crc
    )]
    Other {
        /// Image that the board reports.
        running: Running,
        /// Image that was written.
        wanted: Running,
    },
    /// The image could not be read back, and no board came back to report it.
    #[error(
        "the image was written, but this bootloader does not read back, and no board has answered within {waited_s} s: press reset once \
         and look with `r4 info`; else give the same command again"
    )]
    NotBack {
        /// Time that was waited, s.
        waited_s: u64,
    },
}

/// Result of flashing a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flashed {
    /// True when flash was read back and is the same.
    pub verified: bool,
    /// True when the board came back and reports this image.
    pub confirmed: bool,
}

/// Writes `image` to `address` of a board, starts it, and asks it whether it runs `wanted`.
///
/// # Errors
/// [`FlashError`] when the board does not run the image.
pub fn flash<M: Machine>(
    machine: &mut M,
    image: &[u8],
    address: u32,
    wanted: Running,
    tell: &mut dyn FnMut(Note),
) -> Result<Flashed, FlashError<M::Error>> {
    let mut device = find(machine, tell)?;
    let updated = update(&mut device, image, address, &mut |progress| tell(Note::Progress(progress)))?;
    leave(&mut device, address)?;
    drop(device);
    tell(Note::Starts);
    match wait(machine, START, |machine| Ok(machine.running())).map_err(FlashError::Machine)? {
        Some(running) if running == wanted => Ok(Flashed { verified: updated.verified, confirmed: true }),
        Some(running) => Err(FlashError::Other { running, wanted }),
        // Without an answer of the board the read-back is the proof.
        None if updated.verified => Ok(Flashed { verified: true, confirmed: false }),
        None => Err(FlashError::NotBack { waited_s: START.as_secs() }),
    }
}

/// Finds a board in its bootloader, after a restart by request or by hand.
fn find<M: Machine>(machine: &mut M, tell: &mut dyn FnMut(Note)) -> Result<M::Device, FlashError<M::Error>> {
    if let Some(device) = machine.bootloader().map_err(FlashError::Machine)? {
        tell(Note::Found);
        return Ok(device);
    }
    let asked = machine.ask().map_err(FlashError::Machine)?;
    let press = |why| Note::PressReset { within_s: PERSON.as_secs(), why };
    let mut waited = Duration::ZERO;
    let why = match asked {
        Asked::Restarts => {
            tell(Note::Restarts);
            if let Some(device) = wait(machine, RESTART, M::bootloader).map_err(FlashError::Machine)? {
                return Ok(device);
            }
            waited += RESTART;
            Some("it has restarted, but its bootloader does not appear".into())
        }
        Asked::NoBoard => None,
        Asked::Cannot(why) => Some(why),
    };
    tell(press(why));
    let found = wait(machine, PERSON, M::bootloader).map_err(FlashError::Machine)?;
    found.ok_or(FlashError::NoBootloader { waited_s: (waited + PERSON).as_secs() })
}

fn wait<M: Machine, T>(
    machine: &mut M,
    limit: Duration,
    mut look: impl FnMut(&mut M) -> Result<Option<T>, M::Error>,
) -> Result<Option<T>, M::Error> {
    let end = machine.now() + limit;
    loop {
        if let Some(found) = look(machine)? {
            return Ok(Some(found));
        }
        // After a search, so that a limit of 0 searches once.
        if machine.now() >= end {
            return Ok(None);
        }
        machine.sleep(LOOK);
    }
}
