//! From a board that runs, or waits in its bootloader, to one that runs another image.

use std::{error::Error, time::Duration};

use crate::{Progress, UpdateError, Usb, leave, update};

/// The bootloader waits for half a second, and USB for a second or two, after a restart.
const RESTART: Duration = Duration::from_secs(10);
/// For a person who presses a button.
const PERSON: Duration = Duration::from_secs(60);
/// From leaving the bootloader to a session.
const START: Duration = Duration::from_secs(15);
/// Between two looks.
const LOOK: Duration = Duration::from_millis(250);

/// An image that a board runs, by its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Running {
    /// Length, bytes.
    pub bytes: u32,
    /// CRC-32.
    pub crc: u32,
}

/// What became of the request to restart into the bootloader.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Asked {
    /// The board does.
    Restarts,
    /// There is no board to ask.
    NoBoard,
    /// There is one, which cannot be asked; why.
    Cannot(String),
}

/// What a person is to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// A board in its bootloader is found.
    Found,
    /// The running board was asked, and restarts into its bootloader.
    Restarts,
    /// A person has to press the reset button twice, within this time; why, where there is a board.
    PressReset {
        /// s
        within_s: u64,
        /// Why the board cannot do it by itself.
        why: Option<String>,
    },
    /// How far it is.
    Progress(Progress),
    /// It was written, and starts.
    Starts,
}

/// The machine that boards are plugged into.
pub trait Machine {
    /// A bootloader.
    type Device: Usb;
    /// Why the machine cannot do something.
    type Error: Error;

    /// The board that waits in its bootloader.
    ///
    /// # Errors
    /// What keeps the machine from telling, such as a right that is missing.
    fn bootloader(&mut self) -> Result<Option<Self::Device>, Self::Error>;

    /// Asks the board that runs to restart into its bootloader.
    ///
    /// # Errors
    /// What the board refuses, such as while it is armed.
    fn ask(&mut self) -> Result<Asked, Self::Error>;

    /// Which image the board runs, if one answers.
    fn running(&mut self) -> Option<Running>;

    /// Since any moment.
    fn now(&self) -> Duration;

    /// Waits.
    fn sleep(&mut self, time: Duration);
}

/// Why a board does not run the image.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FlashError<E: Error> {
    /// The machine's, or the board's.
    #[error(transparent)]
    Machine(E),
    /// No board came into its bootloader.
    #[error(
        "no board has come into its bootloader within {waited_s} s: is its USB cable plugged in, and one for data? Press its reset \
         button twice within half a second, so that the green light pulses, and give the same command again"
    )]
    NoBootloader {
        /// s
        waited_s: u64,
    },
    /// Writing it.
    #[error(transparent)]
    Update(#[from] UpdateError),
    /// The board came back with another image.
    #[error(
        "the board runs an image of {} bytes with CRC {:08x} instead of {} bytes with CRC {:08x}: is another board plugged in, too? Give \
         the same command again with that board alone", .running.bytes, .running.crc, .wanted.bytes, .wanted.crc
    )]
    Other {
        /// What it says.
        running: Running,
        /// What was written.
        wanted: Running,
    },
    /// It could not be read back, and no board came back that could tell.
    #[error(
        "the image was written, but this bootloader does not read back, and no board has answered within {waited_s} s: press reset once \
         and look with `r4 info`; else give the same command again"
    )]
    NotBack {
        /// s
        waited_s: u64,
    },
}

/// What became of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Flashed {
    /// Flash was read back, and is the same.
    pub verified: bool,
    /// The board came back, and says that it runs the image.
    pub confirmed: bool,
}

/// Writes `image` to `address` of a board, starts it, and asks it whether it runs `wanted`.
///
/// # Errors
/// [`FlashError`]
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
        None if updated.verified => Ok(Flashed { verified: true, confirmed: false }),
        None => Err(FlashError::NotBack { waited_s: START.as_secs() }),
    }
}

/// A board in its bootloader, however it gets there.
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
        if machine.now() >= end {
            return Ok(None);
        }
        machine.sleep(LOOK);
    }
}
