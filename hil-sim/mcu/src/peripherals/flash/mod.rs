//! Embedded flash memory (RM0399, 4): registers of both banks, programming and erasing, error correction.
//!
//! Programming and erasing take the typical times of DS12930 for the parallelism chosen by PSIZE. Stores of the core come
//! through [`Flash::store`], reads through [`Flash::load`]. Reading a bank that is at work waits on the chip:
//! [`LoadError::Busy`] says until when, and the caller lets that time pass. SR is read-only, as in the manual (flags are
//! cleared by CCR); a write to it does nothing. Not modelled: option byte changes, protections (read-out, PCROP, secure
//! areas, write protection), CRC, bank swap; their registers end the run.

mod bank;
mod cells;
#[cfg(test)]
mod tests;
mod wait_states;

use bank::Bank;
pub use cells::{BANK_SECTORS, BANK_WORDS, FlashCells, PlainCells, PowerLost, SECTOR_WORDS, WORD_BYTES, Word};

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::{
        access::{merged, part},
        pwr::VoltageScale,
    },
};

/// Where the flash begins on the bus.
pub const BASE: u32 = 0x0800_0000;
/// Bytes of both banks.
pub const BYTES: u32 = 2 * BANK_WORDS * WORD_BYTES as u32;

const ACR: u32 = 0x00;
const OPTCR: u32 = 0x18;
const OPTSR_CUR: u32 = 0x1C;
const OPTSR_PRG: u32 = 0x20;
const BANK_2: u32 = 0x100;
/// Within a bank.
const KEYR: u32 = 0x04;
const CR: u32 = 0x0C;
const SR: u32 = 0x10;
const CCR: u32 = 0x14;
const WPSN_CUR: u32 = 0x38;
const ECC_FA: u32 = 0x60;

/// As the Arduino Giga is delivered: RDP level 0, the Cortex-M7 boots and the Cortex-M4 does not, software watchdogs, banks
/// not swapped.
const OPTIONS: u32 = 0x0B86_AAF0;
/// LATENCY 7, WRHIGHFREQ 3.
const ACR_AT_RESET: u32 = 0x37;

const IRQ: u16 = 4;

/// Why a read gives nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadError {
    /// A bus error: the word has more wrong bits than can be corrected.
    Ecc,
    /// The bank programs or erases; the bus waits.
    Busy {
        /// Until then.
        until_ns: u64,
    },
    /// No flash there.
    Outside,
}

/// The flash: its registers, and access to its cells.
pub struct Flash<C> {
    /// The content.
    pub cells: C,
    acr: u32,
    banks: [Bank; 2],
    /// The bank that the core's code is in.
    running_bank: Option<usize>,
    conditions: (u64, VoltageScale),
    /// OPTSR.
    options: u32,
    raised: bool,
    power_lost: bool,
}

impl<C: FlashCells> Flash<C> {
    /// After a reset; code is in bank 1.
    #[must_use]
    pub fn new(cells: C) -> Self {
        Self {
            cells,
            acr: ACR_AT_RESET,
            banks: [Bank::new(0), Bank::new(1)],
            running_bank: Some(0),
            conditions: (0, VoltageScale::Vos3),
            options: OPTIONS,
            raised: false,
            power_lost: false,
        }
    }

    /// Says in which bank (0, 1) the core's code is, if it is in the flash.
    pub fn set_running_bank(&mut self, bank: Option<usize>) {
        self.running_bank = bank;
    }

    /// BOR_LEV of the option bytes in force, 0 to 3.
    #[must_use]
    pub fn brown_out_level(&self) -> u8 {
        (self.options >> 2 & 3) as u8
    }

    /// The option bytes (OPTSR) as a programmer has left them.
    pub fn set_options(&mut self, options: u32) {
        self.options = options;
    }

    /// Whether the cells told that the power went during a step. The chip is off then, and nobody should run it.
    #[must_use]
    pub fn power_lost(&self) -> bool {
        self.power_lost
    }

    /// The clock of the AXI bus by its nominal frequency, and the voltage: too few wait states are reported.
    pub fn set_conditions(&mut self, axi_hz: u64, scale: VoltageScale, context: &mut Context<'_>) {
        if self.conditions != (axi_hz, scale) {
            self.conditions = (axi_hz, scale);
            self.check_wait_states(context);
        }
    }

    fn check_wait_states(&self, context: &mut Context<'_>) {
        let (axi_hz, scale) = self.conditions;
        let set = (self.acr & 0xF, self.acr >> 4 & 3);
        let enough = wait_states::needed(axi_hz, scale);
        if enough.is_none_or(|(latency, delay)| set.0 < latency || set.1 < delay) {
            let what = format!(
                "LATENCY {} and WRHIGHFREQ {} at {axi_hz} Hz and {scale:?}; needed are {enough:?} (RM0399, 4.3.8)",
                set.0, set.1
            );
            context.misuse("FLASH", what);
        }
    }

    /// Bank, word in it, byte in the word.
    fn locate(address: u32) -> Option<(usize, u32, usize)> {
        let offset = address.checked_sub(BASE).filter(|offset| *offset < BYTES)?;
        let word = offset / WORD_BYTES as u32;
        Some(((word / BANK_WORDS) as usize, word % BANK_WORDS, offset as usize % WORD_BYTES))
    }

    /// The core or a DMA reads. Aligned accesses only.
    ///
    /// # Errors
    /// A bus error, or that it takes longer.
    pub fn load(&mut self, address: u32, size: Size, context: &mut Context<'_>) -> Result<u32, LoadError> {
        self.advance(context);
        let (number, word, at) = Self::locate(address).ok_or(LoadError::Outside)?;
        let bank = &mut self.banks[number];
        let until_ns = bank.busy_until_ns();
        if until_ns != u64::MAX {
            return Err(LoadError::Busy { until_ns });
        }
        let bytes = match self.cells.word(number as u32 * BANK_WORDS + word) {
            Word::Good(bytes) => bytes,
            Word::Corrected(bytes) => {
                bank.note_ecc(bank::SNECCERR, word);
                self.raise(context);
                bytes
            }
            Word::Unreadable => {
                bank.note_ecc(bank::DBECCERR, word);
                self.raise(context);
                return Err(LoadError::Ecc);
            }
        };
        let read = bytes[at..].iter().take(size.bytes() as usize);
        Ok(read.rev().fold(0, |value, byte| value << 8 | u32::from(*byte)))
    }

    /// The core stores to an address in the flash: one of the parts of a flash word, which is programmed when all 32 bytes
    /// are there. Aligned accesses only. What goes wrong is in SR.
    pub fn store(&mut self, address: u32, size: Size, value: u32, context: &mut Context<'_>) {
        self.advance(context);
        let Some((number, word, at)) = Self::locate(address) else { return };
        let bytes = &value.to_le_bytes()[..size.bytes() as usize];
        self.banks[number].store(word, at, bytes, self.running_bank == Some(number), context);
        self.raise(context);
    }

    fn raise(&mut self, context: &mut Context<'_>) {
        let level = self.banks.iter().any(Bank::interrupt);
        if level != self.raised {
            self.raised = level;
            context.irq(IRQ, level);
        }
    }

    /// Registers of the first bank and common ones, and the bank.
    fn split(offset: u32) -> (usize, u32) {
        if offset >= BANK_2 { (1, (offset - BANK_2) & !3) } else { (0, offset & !3) }
    }

    fn value(&self, bank: &Bank, at: u32) -> Option<u32> {
        match at {
            ACR => Some(self.acr),
            KEYR | CCR => Some(0),
            CR => Some(bank.cr),
            SR => Some(bank.status()),
            ECC_FA => Some(bank.fault_word),
            // Option bytes are locked, no sector is protected.
            OPTCR => Some(1),
            OPTSR_CUR | OPTSR_PRG => Some(self.options),
            WPSN_CUR => Some(0xFF),
            _ => None,
        }
    }
}

impl<C: FlashCells> Peripheral for Flash<C> {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.advance(context);
        let (number, at) = Self::split(offset);
        let value = self.value(&self.banks[number], at).ok_or_else(|| Unmodelled::register("FLASH", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.advance(context);
        let (number, at) = Self::split(offset);
        let bank = &mut self.banks[number];
        let runs_here = self.running_bank == Some(number);
        match at {
            ACR => {
                self.acr = merged(self.acr, offset, size, value) & 0x3F;
                self.check_wait_states(context);
            }
            KEYR => bank.write_key(value, context),
            CR if merged(0, offset, size, value) & bank::CRC_EN != 0 => {
                return Err(Unmodelled { peripheral: "FLASH", what: "the CRC unit (CR.CRC_EN)".into() });
            }
            CR => bank.write_cr(merged(bank.cr, offset, size, value), runs_here, context),
            SR => {}
            CCR => bank.clear(merged(0, offset, size, value)),
            OPTCR | OPTSR_PRG => {
                return Err(Unmodelled { peripheral: "FLASH", what: "changing option bytes".into() });
            }
            _ => return Err(Unmodelled::register("FLASH", offset)),
        }
        self.raise(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        if self.power_lost { u64::MAX } else { self.banks[0].busy_until_ns().min(self.banks[1].busy_until_ns()) }
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        if self.power_lost {
            return;
        }
        for bank in &mut self.banks {
            self.power_lost |= bank.advance(&mut self.cells, context).is_err();
        }
        self.raise(context);
    }

    /// A reset of the chip. What was being programmed or erased is abandoned.
    fn reset(&mut self, context: &mut Context<'_>) {
        self.advance(context);
        for bank in &mut self.banks {
            bank.reset(&mut self.cells);
        }
        (self.acr, self.power_lost) = (ACR_AT_RESET, false);
        self.raise(context);
    }
}
