//! Causes of a start, and kinds of a restart.

use r4_protocol::Cause;

/// Cause of the processor's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power, reset pin or a deliberate restart.
    Normal,
    /// Watchdog reset: the firmware hung.
    Watchdog,
    /// The clock failed, and the processor reset itself.
    Clock,
    /// The firmware failed several times in a row: only links run, and outputs are held safe.
    RepeatedBadStarts,
    /// The image in flash differs from the built one: only links run, as above.
    DamagedImage,
}

impl ResetCause {
    /// Cause that trips the board from its start on; `None` after a start that is no trip.
    #[must_use]
    pub const fn cause(self) -> Option<Cause> {
        match self {
            Self::Normal => None,
            Self::Watchdog => Some(Cause::WatchdogReset),
            Self::Clock => Some(Cause::ClockFault),
            Self::RepeatedBadStarts => Some(Cause::RepeatedBadStarts),
            Self::DamagedImage => Some(Cause::DamagedImage),
        }
    }

    /// Returns true if only links run until the next start.
    pub(super) const fn holds(self) -> bool {
        matches!(self, Self::RepeatedBadStarts | Self::DamagedImage)
    }
}

/// Program that a board starts when it restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restart {
    /// This same firmware again.
    Firmware,
    /// The bootloader, which waits for another image.
    Bootloader,
}
