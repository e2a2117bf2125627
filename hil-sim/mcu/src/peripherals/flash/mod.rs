//! Embedded flash memory (RM0399, 4): registers of both banks, programming and erasing, error correction.
//!
//! Programming and erasing take the typical times of DS12930 for the parallelism chosen by PSIZE. Stores of the core come
//! through [`Flash::store`], reads through [`Flash::load`]. Reading a bank that is at work waits on the chip:
//! [`LoadError::Busy`] says until when, and the caller lets that time pass; so do fetches, wherefore a program that erases the
//! bank it is in stands still, and one that erases itself then meets ones. SR is read-only, as in the manual (flags are
//! cleared by CCR); a write to it does nothing.
//!
//! **Option bytes** (4.4): OPTSR_PRG is unlocked by OPTKEYR and goes into force by OPTCR.OPTSTART, which takes 100 ms (the manual
//! gives no time; this is only so that a program has to wait). Of its bits the brown-out level and the watchdog's hardware mode
//! do something; bank swap, read-out protection, security and other boot settings end the run. Not modelled either: write
//! protection, PCROP and secure areas, CRC, mass erase (OPTCR.MER); their registers and bits end the run.

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
const OPTKEYR: u32 = 0x08;
const OPTCR: u32 = 0x18;
const OPTSR_CUR: u32 = 0x1C;
const OPTSR_PRG: u32 = 0x20;
const OPTCCR: u32 = 0x24;
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
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];
const OPTION_NS: u64 = 100_000_000;
/// OPTCR.
const OPTLOCK: u32 = 1;
const OPTSTART: u32 = 1 << 1;
/// OPTSR: OPT_BUSY, which is not programmed; what can be changed here: BOR_LEV, IWDG1_SW and IWDG2_SW, and resets, freezes and I/O
/// speed, which have no meaning without low-power modes.
const OPT_BUSY: u32 = 1;
const CHANGEABLE: u32 = 0b11 << 2 | 0b1111 << 4 | 0b11 << 17 | 0b11 << 24 | 1 << 29;
const IWDG1_SW: u32 = 1 << 4;
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
    conditions: (u64, VoltageScale),
    /// OPTSR_CUR, and OPTSR_PRG.
    options: u32,
    options_next: u32,
    /// How many of the keys were given; `None` after a wrong one, until a reset.
    option_keys: Option<usize>,
    options_unlocked: bool,
    /// When the change is in force.
    options_at_ns: u64,
    raised: bool,
    power_lost: bool,
}

impl<C: FlashCells> Flash<C> {
    /// After a reset.
    #[must_use]
    pub fn new(cells: C) -> Self {
        Self {
            cells,
            acr: ACR_AT_RESET,
            banks: [Bank::new(0), Bank::new(1)],
            conditions: (0, VoltageScale::Vos3),
            options: OPTIONS,
            options_next: OPTIONS,
            option_keys: Some(0),
            options_unlocked: false,
            options_at_ns: u64::MAX,
            raised: false,
            power_lost: false,
        }
    }

    /// Until when bank 0 or 1 programs or erases, and cannot be read.
    #[must_use]
    pub fn busy_until_ns(&self, bank: usize) -> Option<u64> {
        self.banks.get(bank).map(Bank::busy_until_ns).filter(|until_ns| *until_ns != u64::MAX)
    }

    /// IWDG1_SW is cleared: the watchdog runs from each reset on.
    #[must_use]
    pub fn starts_watchdog(&self) -> bool {
        self.options & IWDG1_SW == 0
    }

    /// BOR_LEV of the option bytes in force, 0 to 3.
    #[must_use]
    pub fn brown_out_level(&self) -> u8 {
        (self.options >> 2 & 3) as u8
    }

    /// The option bytes (OPTSR) as a programmer has left them.
    pub fn set_options(&mut self, options: u32) {
        (self.options, self.options_next) = (options, options);
    }

    fn write_option_key(&mut self, key: u32, context: &mut Context<'_>) {
        self.option_keys = match self.option_keys {
            Some(given) if !self.options_unlocked && OPTION_KEYS.get(given) == Some(&key) => Some(given + 1),
            _ => {
                let what = "a wrong key: option bytes stay locked until a reset (RM0399, 4.5.1)";
                context.misuse("FLASH", what);
                self.options_unlocked = false;
                None
            }
        };
        if self.option_keys == Some(OPTION_KEYS.len()) {
            (self.options_unlocked, self.option_keys) = (true, Some(0));
        }
    }

    fn write_option_control(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let refuse = |what: &str| Err(Unmodelled { peripheral: "FLASH", what: what.into() });
        if !self.options_unlocked {
            if value & !OPTLOCK != 0 {
                let what = "OPTCR is written while it is locked; the chip ignores it (RM0399, 4.5.1)";
                context.misuse("FLASH", what);
            }
            return Ok(());
        }
        if value & 1 << 4 != 0 {
            return refuse("the erase of both banks (OPTCR.MER)");
        }
        if value & 1 << 30 != 0 {
            return refuse("the interrupt of option bytes (OPTCR.OPTCHANGEERRIE)");
        }
        if value & OPTSTART != 0 && self.options_at_ns == u64::MAX {
            self.options_at_ns = context.now_ns + OPTION_NS;
        }
        self.options_unlocked = value & OPTLOCK == 0;
        Ok(())
    }

    fn write_options(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if !self.options_unlocked {
            let what = "OPTSR_PRG is written while OPTCR is locked; the chip ignores it (RM0399, 4.4.3)";
            context.misuse("FLASH", what);
            return Ok(());
        }
        let refused = (value ^ self.options_next) & !(CHANGEABLE | OPT_BUSY);
        if refused != 0 {
            let what = format!("option bytes {refused:#010x} of OPTSR_PRG (bank swap, protection or boot settings)");
            return Err(Unmodelled { peripheral: "FLASH", what });
        }
        self.options_next = value & !OPT_BUSY;
        Ok(())
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
            let enough = enough.map_or_else(
                || "no setting is enough".to_owned(),
                |(latency, delay)| format!("at least {latency} and {delay} are needed"),
            );
            let (latency, delay) = set;
            let what = format!(
                "LATENCY {latency} and WRHIGHFREQ {delay} at {axi_hz} Hz and {scale}: {enough} (RM0399, 4.3.8)"
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
        self.banks[number].store(word, at, bytes, context);
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
            OPTKEYR | OPTCCR => Some(0),
            OPTCR => Some(u32::from(!self.options_unlocked)),
            OPTSR_CUR => Some(self.options | u32::from(self.options_at_ns != u64::MAX)),
            OPTSR_PRG => Some(self.options_next),
            // No sector is protected.
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
        match at {
            ACR => {
                self.acr = merged(self.acr, offset, size, value) & 0x3F;
                self.check_wait_states(context);
            }
            KEYR => bank.write_key(value, context),
            CR if merged(0, offset, size, value) & bank::CRC_EN != 0 => {
                return Err(Unmodelled { peripheral: "FLASH", what: "the CRC unit (CR.CRC_EN)".into() });
            }
            CR => bank.write_cr(merged(bank.cr, offset, size, value), context),
            SR => {}
            CCR => bank.clear(merged(0, offset, size, value)),
            OPTKEYR => self.write_option_key(value, context),
            OPTCR => {
                let before = u32::from(!self.options_unlocked);
                self.write_option_control(merged(before, offset, size, value), context)?;
            }
            OPTSR_PRG => self.write_options(merged(self.options_next, offset, size, value), context)?,
            // It clears OPTCHANGEERR, which is never set.
            OPTCCR => {}
            _ => return Err(Unmodelled::register("FLASH", offset)),
        }
        self.raise(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        let banks_ns = self.banks[0].busy_until_ns().min(self.banks[1].busy_until_ns());
        if self.power_lost { u64::MAX } else { banks_ns.min(self.options_at_ns) }
    }

    fn stable_until_ns(&self, _: u32, _: u64) -> Option<u64> {
        Some(self.next_event_ns())
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        if self.power_lost {
            return;
        }
        for bank in &mut self.banks {
            self.power_lost |= bank.advance(&mut self.cells, context).is_err();
        }
        if self.options_at_ns <= context.now_ns {
            (self.options, self.options_at_ns) = (self.options_next, u64::MAX);
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
        // A change that was not finished is none.
        (self.options_next, self.options_at_ns) = (self.options, u64::MAX);
        (self.option_keys, self.options_unlocked) = (Some(0), false);
        self.raise(context);
    }
}
