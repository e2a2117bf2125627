//! What the controller was asked to do that its datasheet forbids, or that it ignores.

use core::fmt;

/// What was done wrong with the screen's controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ScreenMisuse {
    /// A command the controller does not have, or not on its serial interface.
    UnknownCommand {
        /// Its byte.
        command: u8,
    },
    /// A command came too soon after one that takes time.
    CommandTooEarly {
        /// Its byte.
        command: u8,
        /// The command that takes time; `None` for the reset line.
        after: Option<u8>,
        /// Time since then.
        waited_ns: u64,
        /// Time the datasheet asks for.
        needed_ns: u64,
    },
    /// A command was followed by another before its last parameter.
    ParametersMissing {
        /// Its byte.
        command: u8,
        /// Parameters sent.
        sent: usize,
        /// Parameters it has.
        needed: usize,
    },
    /// Data that belongs to no command.
    UnexpectedData {
        /// The command before it; `None` when there was none since the reset.
        command: Option<u8>,
    },
    /// The window's ends are in the wrong order or outside the memory.
    WindowOutside {
        /// First column or page.
        start: u16,
        /// Last column or page.
        end: u16,
        /// Columns or pages there are.
        size: u16,
    },
    /// Pixels were sent to a panel that sleeps.
    PixelsWhileAsleep,
    /// More pixels were sent than the window has.
    PixelsBeyondWindow {
        /// Pixels of the window.
        window: u32,
    },
    /// A write ended inside a pixel.
    PixelIncomplete,
    /// A pixel format that the serial interface does not have.
    PixelFormat {
        /// The parameter.
        value: u8,
    },
    /// The reset line was low too briefly.
    ResetTooShort {
        /// For how long.
        low_ns: u64,
        /// Time the datasheet asks for.
        needed_ns: u64,
    },
    /// Bytes came faster than the serial clock allows.
    ClockTooFast {
        /// From one byte to the next.
        byte_ns: u64,
        /// Eight cycles of the fastest clock.
        needed_ns: u64,
    },
}

impl fmt::Display for ScreenMisuse {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::UnknownCommand { command } => {
                write!(f, "there is no command 0x{command:02X}: it is taken as no operation; leave it out")
            }
            Self::CommandTooEarly { command, after, waited_ns, needed_ns } => {
                write!(f, "command 0x{command:02X} sent {waited_ns} ns after ")?;
                match after {
                    Some(after) => write!(f, "command 0x{after:02X}")?,
                    None => f.write_str("the reset")?,
                }
                write!(f, ": the controller may lose it, or what it loads at that time; wait {needed_ns} ns")
            }
            Self::ParametersMissing { command, sent, needed } => write!(
                f,
                "command 0x{command:02X} had {sent} of {needed} parameters: it is not carried out; send all of them"
            ),
            Self::UnexpectedData { command: Some(command) } => write!(
                f,
                "data after command 0x{command:02X} had all its parameters: it is ignored; check the command's length \
                 and the D/CX line"
            ),
            Self::UnexpectedData { command: None } => {
                f.write_str("data before any command: it is ignored; check the D/CX line")
            }
            Self::WindowOutside { start, end, size } => write!(
                f,
                "window from {start} to {end} of {size}: what is outside is ignored; order its ends, and check whether \
                 MADCTL swaps columns and pages"
            ),
            Self::PixelsWhileAsleep => f.write_str(
                "pixels sent to a panel that sleeps: the memory takes them but they are not shown; send SLPOUT first",
            ),
            Self::PixelsBeyondWindow { window } => write!(
                f,
                "more than the {window} pixels of the window: they start over at its first pixel; set the window anew"
            ),
            Self::PixelIncomplete => {
                f.write_str("a write ended inside a pixel: the pixel is dropped; send three bytes for each")
            }
            Self::PixelFormat { value } => write!(
                f,
                "pixel format 0x{value:02X} does not exist on the serial interface: colours will be wrong; use 0x66, \
                 18 bits in three bytes"
            ),
            Self::ResetTooShort { low_ns, needed_ns } => {
                write!(f, "reset low for {low_ns} ns: it may be ignored; hold it low for {needed_ns} ns or more")
            }
            Self::ClockTooFast { byte_ns, needed_ns } => {
                write!(f, "a byte in {byte_ns} ns: bits may be lost; take {needed_ns} ns or more, 20 MHz at most")
            }
        }
    }
}
