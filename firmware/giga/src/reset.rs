//! Why the processor started, and what the last run left in the backup registers.
//!
//! The registers of the RTC's domain keep their content over every reset, and over a power cut if VBAT is supplied. Of the 32
//! the Arduino bootloader uses DR0 (request for an upload) and DR8 (reset cause); ours are DR16 to DR22:
//!
//! | register | holds |
//! | --- | --- |
//! | DR16 | "R4" and the [`Kind`] of the end; anything else is no record |
//! | DR17, DR18 | of a fault PC and LR, of a panic the address of its location and the stack pointer |
//! | DR19 | of a fault CFSR, of a panic its line, of an interrupt its number |
//! | DR20 | of a fault HFSR, of a panic the address of its file's name |
//! | DR21 | clock source of the run that ended: 1 crystal, 2 internal |

use embassy_stm32::pac::{PWR, RCC, RTC};
use r4_firmware::ResetCause;

const MAGIC: u32 = 0x5234_0000;
const FIRST: usize = 16;
const CLOCK: usize = 21;
/// The Arduino bootloader's note, numbered as mbed's `reset_reason_t`.
const BOOTLOADER_NOTE: usize = 8;
const MBED_WATCHDOG: u32 = 4;

/// RCC_RSR (RM0399, 8.7.40).
const RMVF: u32 = 1 << 16;
const IWDG1: u32 = 1 << 26;
const WWDG1: u32 = 1 << 28;

/// How a run ended that did not end well.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) enum Kind {
    /// A Rust panic.
    Panic = 1,
    /// A processor fault.
    Fault = 2,
    /// An interrupt that nothing handles.
    Interrupt = 3,
}

/// What is kept of the end of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) struct Record {
    pub(crate) kind: Kind,
    /// DR17.
    pub(crate) pc: u32,
    /// DR18.
    pub(crate) lr: u32,
    /// DR19.
    pub(crate) detail: u32,
    /// DR20.
    pub(crate) more: u32,
}

/// What is known of why the processor started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) struct Start {
    /// RCC_RSR as it was; 0 behind the bootloader, which clears it.
    pub(crate) flags: u32,
    /// The bootloader's note, when this image is started by it.
    pub(crate) note: Option<u32>,
    /// How the last run ended, if badly and orderly.
    pub(crate) record: Option<Record>,
}

impl Start {
    /// Reads all of it, and clears it for the next start.
    pub(crate) fn take() -> Self {
        open();
        let flags = RCC.rsr().read().0;
        RCC.rsr().modify(|w| w.0 |= RMVF);
        let note = (env!("R4_IMAGE_KIND") == "hosted").then(|| read(BOOTLOADER_NOTE));
        let first = read(FIRST);
        let kind = match first ^ MAGIC {
            1 => Some(Kind::Panic),
            2 => Some(Kind::Fault),
            3 => Some(Kind::Interrupt),
            _ => None,
        };
        let record = kind.map(|kind| Record {
            kind,
            pc: read(FIRST + 1),
            lr: read(FIRST + 2),
            detail: read(FIRST + 3),
            more: read(FIRST + 4),
        });
        write(FIRST, 0);
        Self { flags, note, record }
    }

    /// As the application is told: a panic or fault is a watchdog bite that came early.
    pub(crate) fn cause(&self) -> ResetCause {
        let bitten = self.flags & (IWDG1 | WWDG1) != 0 || self.note == Some(MBED_WATCHDOG);
        if bitten || self.record.is_some() { ResetCause::Watchdog } else { ResetCause::Normal }
    }
}

/// Leaves `record` for the next start.
pub(crate) fn leave(record: &Record) {
    open();
    write(FIRST + 1, record.pc);
    write(FIRST + 2, record.lr);
    write(FIRST + 3, record.detail);
    write(FIRST + 4, record.more);
    write(FIRST, MAGIC | record.kind as u32);
}

/// Notes what the clock is made from, for a debugger and for the next start.
pub(crate) fn note_clock(crystal: bool) {
    write(CLOCK, if crystal { 1 } else { 2 });
}

/// The backup domain is write-protected after a reset (RM0399, 7.4.5).
fn open() {
    RCC.apb4enr().modify(|w| w.set_rtcapben(true));
    PWR.cr1().modify(|w| w.set_dbp(true));
    // The bit takes effect some cycles later, and is to be read back until it has; a handful is enough.
    let _ = (0..100).any(|_| PWR.cr1().read().dbp());
}

fn read(register: usize) -> u32 {
    RTC.bkpr(register).read().0
}

fn write(register: usize, value: u32) {
    RTC.bkpr(register).write(|w| w.0 = value);
}
