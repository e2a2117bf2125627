//! Violations of the screen controller's datasheet, and requests that it ignores.

use core::fmt;

/// Violation of the screen controller's datasheet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ScreenMisuse {
    /// A command the controller does not have, or not on its serial interface.
    UnknownCommand {
        /// Command byte that was sent.
        command: u8,
    },
    /// A command sent too soon after one that takes time.
    CommandTooEarly {
        /// Command byte that was sent.
        command: u8,
        /// Earlier command that takes time; `None` for the reset line.
        after: Option<u8>,
        /// Time since that command, ns.
        waited_ns: u64,
        /// Time that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// A command followed by another before its last parameter.
    ParametersMissing {
        /// Command byte whose parameters are missing.
        command: u8,
        /// Number of parameters sent.
        sent: usize,
        /// Number of parameters the command has.
        needed: usize,
    },
    /// Data that belongs to no command.
    UnexpectedData {
        /// Preceding command; `None` if there was none since the reset.
        command: Option<u8>,
    },
    /// A window whose ends are in the wrong order or outside the memory.
    WindowOutside {
        /// First column or page.
        start: u16,
        /// Last column or page.
        end: u16,
        /// Number of columns or pages of the memory.
        size: u16,
    },
    /// Pixels sent to a sleeping panel.
    PixelsWhileAsleep,
    /// More pixels than the window holds.
    PixelsBeyondWindow {
        /// Number of pixels of the window.
        window: u32,
    },
    /// A memory write that ended inside a pixel.
    PixelIncomplete,
    /// A pixel format that the serial interface does not support.
    PixelFormat {
        /// Value of the COLMOD parameter.
        value: u8,
    },
    /// A reset pulse that is too short.
    ResetTooShort {
        /// Length of the pulse, ns.
        low_ns: u64,
        /// Length that the datasheet requires, ns.
        needed_ns: u64,
    },
    /// Bytes sent faster than the serial clock allows.
    ClockTooFast {
        /// Time from one byte to the next, ns.
        byte_ns: u64,
        /// Eight cycles of the fastest clock, ns.
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
