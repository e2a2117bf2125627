//! Flash for parameters and trips: the last four sectors of bank 2.
//!
//! While bank 2 is programmed or erased, bank 1 can still be read, so code in bank 1 runs on; the end of an operation
//! is polled, and other tasks run meanwhile. A read of bank 2 would stall the processor until then: all accesses go
//! through one [`Bank2`], which has no operation under way when it reads.
//!
//! # Words that fail their error correction
//! Such a word answers the read with a bus error, which [`bus_faults`] survives; DBECCERR shows it, too, and is cleared
//! before and after. Nothing else runs meanwhile: that is 8 loads, less than 1 µs.
//!
//! One wrong bit is corrected (SNECCERR) and is no error.

use cortex_m::asm;
use embassy_stm32::{
    Peri,
    pac::{FLASH, flash},
    peripherals,
};
use embassy_time::{Duration, Instant, Timer};
use embedded_storage_async::nor_flash::{ErrorType, NorFlash, NorFlashError, NorFlashErrorKind, ReadNorFlash};

use crate::{bus_faults, watchdog};

/// First address of bank 2, and of the sectors used here.
const BANK: u32 = 0x0810_0000;
const BASE: u32 = 0x0818_0000;
const SECTOR_BYTES: u32 = 128 * 1024;
const SECTORS: u32 = 4;
const WORD_BYTES: usize = 32;
/// Index of bank 2 in the register block, whose registers repeat at 0x100.
const BANK_2: usize = 1;

/// Keys of FLASH_KEYR2 (RM0399, 4.5.1).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// Polling intervals of the operations: a word takes 0.1 ms, a sector 1 s (data sheet).
const WRITE_LOOK: Duration = Duration::from_micros(50);
const ERASE_LOOK: Duration = Duration::from_millis(2);
/// Time limits: ten times the data sheet's time of a word, and twice that of a sector at the slowest parallelism.
const WRITE_WAIT: Duration = Duration::from_millis(10);
const ERASE_WAIT: Duration = Duration::from_secs(8);

/// Reason why flash was not read or written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub enum FlashError {
    /// Address beyond the four sectors.
    OutOfBounds,
    /// Range of incomplete words, or incomplete sectors.
    NotAligned,
    /// A word fails its error correction.
    Uncorrectable,
    /// The sector is write-protected (WRPERR).
    Protected,
    /// The controller rejected the access (PGSERR, STRBERR, INCERR), or stayed locked.
    Sequence,
    /// The operation failed (OPERR).
    Operation,
    /// The operation did not end in time.
    Timeout,
}

impl NorFlashError for FlashError {
    fn kind(&self) -> NorFlashErrorKind {
        match self {
            Self::OutOfBounds => NorFlashErrorKind::OutOfBounds,
            Self::NotAligned => NorFlashErrorKind::NotAligned,
            _ => NorFlashErrorKind::Other,
        }
    }
}

/// Driver of the four sectors, with addresses from 0 on.
pub struct Bank2 {
    _flash: Peri<'static, peripherals::FLASH>,
}

impl Bank2 {
    /// Takes the flash controller.
    #[must_use]
    pub fn new(flash: Peri<'static, peripherals::FLASH>) -> Self {
        Self { _flash: flash }
    }
}

/// Checks that `from..to` is within the sectors, and both are multiples of `unit`.
fn check(from: u32, to: u64, unit: u32) -> Result<(), FlashError> {
    match () {
        () if u64::from(from) > to || to > u64::from(SECTORS * SECTOR_BYTES) => Err(FlashError::OutOfBounds),
        () if !from.is_multiple_of(unit) || !to.is_multiple_of(unit.into()) => Err(FlashError::NotAligned),
        () => Ok(()),
    }
}

fn bank() -> flash::Bank {
    FLASH.bank(BANK_2)
}

/// Clears the flags of earlier operations.
fn clear_flags() {
    bank().ccr().write(|w| {
        w.set_clr_eop(true);
        w.set_clr_wrperr(true);
        w.set_clr_pgserr(true);
        w.set_clr_strberr(true);
        w.set_clr_incerr(true);
        w.set_clr_operr(true);
        w.set_clr_rdperr(true);
        w.set_clr_rdserr(true);
        w.set_clr_sneccerr(true);
        w.set_clr_dbeccerr(true);
    });
}

/// Waits for the operation under way, which may be one that a dropped task has left.
async fn finished(look: Duration, limit: Duration) -> Result<(), FlashError> {
    let end = Instant::now() + limit;
    loop {
        let status = bank().sr().read();
        if !(status.bsy() || status.qw()) {
            return Ok(());
        }
        if Instant::now() > end {
            return Err(FlashError::Timeout);
        }
        watchdog::feed_in_boot();
        Timer::after(look).await;
    }
}

/// Guard that unlocks the controller until it is dropped.
struct Unlocked;

impl Unlocked {
    fn new() -> Result<Self, FlashError> {
        if bank().cr().read().lock() {
            // Nothing must come between the keys, or the controller locks until a reset.
            critical_section::with(|_| KEYS.into_iter().for_each(|key| bank().keyr().write_value(key)));
        }
        if bank().cr().read().lock() { Err(FlashError::Sequence) } else { Ok(Self) }
    }
}

impl Drop for Unlocked {
    fn drop(&mut self) {
        bank().cr().modify(|w| {
            w.set_pg(false);
            w.set_ser(false);
            w.set_lock(true);
        });
    }
}

fn outcome() -> Result<(), FlashError> {
    let status = bank().sr().read();
    match () {
        () if status.wrperr() => Err(FlashError::Protected),
        () if status.pgserr() || status.strberr() || status.incerr() => Err(FlashError::Sequence),
        () if status.operr() => Err(FlashError::Operation),
        () => Ok(()),
    }
}

/// Programs a word by the "Single write sequence" (RM0399, 4.3.9).
async fn program(address: u32, word: &[u8; WORD_BYTES]) -> Result<(), FlashError> {
    finished(ERASE_LOOK, ERASE_WAIT).await?;
    clear_flags();
    let unlocked = Unlocked::new()?;
    bank().cr().modify(|w| w.set_pg(true));
    asm::dsb();
    let (parts, _) = word.as_chunks::<4>();
    for (part, at) in parts.iter().zip((address..).step_by(4)) {
        #[allow(unsafe_code, reason = "programming is writing to the address")]
        // SAFETY: aligned, within the sectors that this driver owns, which hold no code.
        unsafe {
            core::ptr::with_exposed_provenance_mut::<u32>(at as usize).write_volatile(u32::from_le_bytes(*part));
        }
    }
    asm::dsb();
    finished(WRITE_LOOK, WRITE_WAIT).await?;
    drop(unlocked);
    outcome()
}

/// Erases a sector by the "Flash sector erase sequence" (RM0399, 4.3.10).
async fn erase(sector: u8) -> Result<(), FlashError> {
    finished(ERASE_LOOK, ERASE_WAIT).await?;
    clear_flags();
    let unlocked = Unlocked::new()?;
    bank().cr().modify(|w| {
        w.set_ser(true);
        w.set_snb(sector);
    });
    bank().cr().modify(|w| w.set_start(true));
    asm::dsb();
    finished(ERASE_LOOK, ERASE_WAIT).await?;
    drop(unlocked);
    outcome()
}

/// Reads a word; the module's documentation describes the error handling.
fn read_word(address: u32) -> Result<[u8; WORD_BYTES], FlashError> {
    bank().ccr().write(|w| w.set_clr_dbeccerr(true));
    let (word, faults) = bus_faults::ignored(|| {
        let mut word = [0; WORD_BYTES];
        let (parts, _) = word.as_chunks_mut::<4>();
        for (part, at) in parts.iter_mut().zip((address..).step_by(4)) {
            #[allow(unsafe_code, reason = "flash is read by its address")]
            // SAFETY: aligned, within the sectors.
            let value = unsafe { core::ptr::with_exposed_provenance::<u32>(at as usize).read_volatile() };
            *part = value.to_le_bytes();
        }
        word
    });
    let uncorrectable = bank().sr().read().dbeccerr();
    bank().ccr().write(|w| {
        w.set_clr_dbeccerr(true);
        w.set_clr_sneccerr(true);
    });
    if uncorrectable || faults { Err(FlashError::Uncorrectable) } else { Ok(word) }
}

impl ErrorType for Bank2 {
    type Error = FlashError;
}

impl ReadNorFlash for Bank2 {
    const READ_SIZE: usize = 1;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        check(offset, u64::from(offset) + bytes.len() as u64, 1)?;
        finished(ERASE_LOOK, ERASE_WAIT).await?;
        let mut done = 0;
        while done < bytes.len() {
            let at = offset as usize + done;
            let skip = at % WORD_BYTES;
            let word = read_word(BASE + (at - skip) as u32)?;
            let count = (WORD_BYTES - skip).min(bytes.len() - done);
            bytes[done..done + count].copy_from_slice(&word[skip..skip + count]);
            done += count;
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        (SECTORS * SECTOR_BYTES) as usize
    }
}

impl NorFlash for Bank2 {
    const WRITE_SIZE: usize = WORD_BYTES;
    const ERASE_SIZE: usize = SECTOR_BYTES as usize;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        check(from, to.into(), SECTOR_BYTES)?;
        for sector in from / SECTOR_BYTES..to / SECTOR_BYTES {
            erase((sector + (BASE - BANK) / SECTOR_BYTES) as u8).await?;
        }
        Ok(())
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        check(offset, u64::from(offset) + bytes.len() as u64, WORD_BYTES as u32)?;
        let (words, _) = bytes.as_chunks::<WORD_BYTES>();
        for (word, address) in words.iter().zip((BASE + offset..).step_by(WORD_BYTES)) {
            program(address, word).await?;
        }
        Ok(())
    }
}
