//! Cause of the processor's start, and the record that the last run left in the backup registers.
//!
//! The registers of the RTC's domain keep their content over every reset, and over a power cut if VBAT is supplied. Of
//! the 32 the Arduino bootloader uses DR0 (request for an upload) and DR8 (reset cause); ours are DR16 to DR22 and DR24
//! to DR31:
//!
//! | register | contents |
//! | --- | --- |
//! | DR16 | "R4" and the [`Kind`] of the end; anything else is no record |
//! | DR17, DR18 | PC and LR of a fault; address of the location and stack pointer of a panic |
//! | DR19 | CFSR of a fault, line of a panic, number of an interrupt |
//! | DR20 | HFSR of a fault, address of the file's name of a panic |
//! | DR21 | clock source of the run that ended: 1 crystal, 2 internal |
//! | DR22 | "BS" and the number of consecutive runs that ended badly before they had run well |
//! | DR24 to DR31 | heat of each motor's winding: `r4_firmware::control::overload` |
//!
//! Each is written atomically: a reset leaves the old word or the new.

use embassy_stm32::pac::{PWR, RCC, RTC};
use embassy_time::Duration;
use r4_firmware::ResetCause;
use r4_protocol::config::MAX_MOTORS;

const MAGIC: u32 = 0x5234_0000;
const FIRST: usize = 16;
const CLOCK: usize = 21;
const BAD_STARTS: usize = 22;
/// First register of the words that are kept for the application.
const KEPT: usize = 24;
const BAD_STARTS_MAGIC: u32 = 0x4253_0000;
/// Register of the Arduino bootloader's note, numbered as mbed's `reset_reason_t`.
const BOOTLOADER_NOTE: usize = 8;
const MBED_WATCHDOG: u32 = 4;

/// There is a backup register for each motor, of the 32 in total.
const _: () = assert!(KEPT + MAX_MOTORS <= 32);

/// Bits of RCC_RSR (RM0399, 8.7.40).
const RMVF: u32 = 1 << 16;
const IWDG1: u32 = 1 << 26;
const WWDG1: u32 = 1 << 28;

/// Kind of a run's bad end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) enum Kind {
    /// A panic in Rust code.
    Panic = 1,
    /// A fault exception of the processor.
    Fault = 2,
    /// An interrupt without a handler.
    Interrupt = 3,
    /// A stop of the crystal.
    Clock = 4,
}

/// Record of the end of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) struct Record {
    pub(crate) kind: Kind,
    /// Contents of DR17: PC, or address of the location.
    pub(crate) pc: u32,
    /// Contents of DR18: LR, or stack pointer.
    pub(crate) lr: u32,
    /// Contents of DR19: CFSR, line, or interrupt number.
    pub(crate) detail: u32,
    /// Contents of DR20: HFSR, or address of the file's name.
    pub(crate) more: u32,
}

/// Information about the processor's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) struct Start {
    /// Value of RCC_RSR at the start; 0 behind the bootloader, which clears it.
    pub(crate) flags: u32,
    /// Note of the bootloader, when this image is started by it.
    pub(crate) note: Option<u32>,
    /// Record of the last run's end; `None` if it ended well or without a record.
    pub(crate) record: Option<Record>,
    /// Number of consecutive runs that ended badly before they had run well, the last one included.
    pub(crate) bad_starts: u16,
    /// True if the image in flash differs from the built one.
    pub(crate) damaged: bool,
}

impl Start {
    /// Reads the information, and clears it for the next start.
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
            4 => Some(Kind::Clock),
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
        let mut start = Self { flags, note, record, bad_starts: 0, damaged: false };
        if start.ended_badly() {
            // A register without the magic number, as after power-up, holds no count.
            let before = read(BAD_STARTS) ^ BAD_STARTS_MAGIC;
            start.bad_starts = u16::try_from(before).unwrap_or(0).saturating_add(1);
        }
        write(BAD_STARTS, BAD_STARTS_MAGIC | u32::from(start.bad_starts));
        start
    }

    /// Returns true if the last run ended by the watchdog or left a record. Power, the reset pin, a debugger and a
    /// restart by a host are no bad ends.
    fn ended_badly(&self) -> bool {
        let bitten = self.flags & (IWDG1 | WWDG1) != 0 || self.note == Some(MBED_WATCHDOG);
        bitten || self.record.is_some()
    }

    /// Mode in which to start.
    pub(crate) fn mode(&self) -> Mode {
        match self.bad_starts {
            HOLD_ALONE.. => Mode::HoldAlone,
            HOLD.. => Mode::Hold,
            0..HOLD if self.damaged => Mode::Hold,
            0..HOLD => Mode::Run,
        }
    }

    /// Returns true if hold mode is tried for the first time. The second time its optional parts are left out.
    pub(crate) fn is_first_hold(&self) -> bool {
        self.bad_starts == HOLD
    }

    /// Cause for the application: a panic or fault counts as an early watchdog reset.
    pub(crate) fn cause(&self) -> ResetCause {
        match self.record {
            _ if self.damaged => ResetCause::DamagedImage,
            _ if self.mode() != Mode::Run => ResetCause::RepeatedBadStarts,
            Some(Record { kind: Kind::Clock, .. }) => ResetCause::Clock,
            _ if self.ended_badly() => ResetCause::Watchdog,
            _ => ResetCause::Normal,
        }
    }
}

/// Mode of a start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) enum Mode {
    /// Normal operation: all tasks run.
    Run,
    /// Outputs are held safe, and links answer with the cause.
    Hold,
    /// Outputs are held safe, and nothing else is used: no clock tree, no interrupts, no links.
    HoldAlone,
}

/// Number of consecutive bad ends after which outputs are only held safe. One may be a transient fault, or be triggered
/// by a host's command; a cause that ends three runs within [`RUN_WELL`] each ends the fourth too.
const HOLD: u16 = 3;
/// Number after which hold mode with links has ended badly as often.
const HOLD_ALONE: u16 = 2 * HOLD;

/// Time after which the count of bad ends restarts: far longer than any task waits at its start, and shorter than a
/// person takes to arm the board again.
pub(crate) const RUN_WELL: Duration = Duration::from_secs(10);

/// Records that the board has run for [`RUN_WELL`].
pub(crate) fn ran_well() {
    write(BAD_STARTS, BAD_STARTS_MAGIC);
}

/// Requests that the Arduino bootloader stays, and waits for another image (mcuboot-arduino-stm32h7, app/main.cpp: its
/// magic number in RTC_BKP_DR0), at the following reset.
pub(crate) fn ask_for_bootloader() {
    open();
    write(0, 0xDF59);
}

/// Stores `record` for the next start.
pub(crate) fn leave(record: &Record) {
    open();
    write(FIRST + 1, record.pc);
    write(FIRST + 2, record.lr);
    write(FIRST + 3, record.detail);
    write(FIRST + 4, record.more);
    write(FIRST, MAGIC | record.kind as u32);
}

/// Stores the clock source, for a debugger and for the next start.
pub(crate) fn note_clock(crystal: bool) {
    write(CLOCK, if crystal { 1 } else { 2 });
}

/// Word that is kept for the application; 0 beyond the last index.
pub(crate) fn kept(index: usize) -> u32 {
    if index < MAX_MOTORS { read(KEPT + index) } else { 0 }
}

/// Keeps a word for the application. [`Start::take`] has unlocked the domain.
pub(crate) fn keep(index: usize, word: u32) {
    if index < MAX_MOTORS {
        write(KEPT + index, word);
    }
}

/// Unlocks the backup domain, which is write-protected after a reset (RM0399, 7.4.5).
fn open() {
    RCC.apb4enr().modify(|w| w.set_rtcapben(true));
    PWR.cr1().modify(|w| w.set_dbp(true));
    // The bit takes effect some cycles later, and is read back until it has; a handful of reads is enough.
    let _ = (0..100).any(|_| PWR.cr1().read().dbp());
}

fn read(register: usize) -> u32 {
    RTC.bkpr(register).read().0
}

fn write(register: usize, value: u32) {
    RTC.bkpr(register).write(|w| w.0 = value);
}
