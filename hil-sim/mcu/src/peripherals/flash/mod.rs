//! Embedded flash memory (RM0399, 4): registers of both banks, programming and erasing, error correction.
//!
//! Programming and erasing take the typical times of DS12930 for the parallelism selected by PSIZE. Stores of the core
//! come through [`Flash::store`], reads through [`Flash::load`]. A read of a busy bank stalls on the chip:
//! [`LoadError::Busy`] has the end, and the caller lets that time pass. The same holds for fetches: a program that
//! erases another sector of its own bank stalls, and one that erases itself then fetches ones. SR is read-only, as in
//! the manual (CCR clears the flags); a write to it has no effect.
//!
//! **Option bytes** (4.4): OPTSR_PRG is unlocked by OPTKEYR and takes effect by OPTCR.OPTSTART after 100 ms (the manual
//! gives no time; the value only forces programs to wait). A reset before that keeps the old ones. The modelled options
//! are:
//!
//! - the brown-out level and the watchdog's hardware mode;
//! - **bank swap** (4.3.13): the next reset after the change exchanges the banks' addresses and the two sets of
//!   registers, so that the registers from 0x000 on are those of the bank at 0x0800_0000;
//! - **readout protection** (4.5.3), levels 0 and 1. At level 1 [`Flash::set_debugger`] closes the flash, the backup
//!   SRAM and the backup registers: reads are bus errors with RDPERR, stores and erases set WRPERR. They stay closed
//!   without the debugger until a power cycle (the manual says "is or has been connected", not until when). The change
//!   back to level 0 also takes the time of a mass erase, and erases all of these. Boots from RAM or system memory,
//!   which close them too, are not modelled.
//!
//! Any other option ends the run with its name: level 2, security, boot settings, write protection, PCROP and secure
//! areas. So does the CRC unit.

mod bank;
mod cells;
mod options;
#[cfg(test)]
mod tests;
mod wait_states;

use bank::Bank;
pub use cells::{BANK_SECTORS, BANK_WORDS, FlashCells, PlainCells, PowerLost, SECTOR_WORDS, WORD_BYTES, Word};
use options::{Level, Options};

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::{
        access::{merged, part},
        pwr::VoltageScale,
    },
};

/// First address of the flash on the bus.
pub const BASE: u32 = 0x0800_0000;
/// Size of both banks, bytes.
pub const BYTES: u32 = 2 * BANK_WORDS * WORD_BYTES as u32;

const ACR: u32 = 0x00;
const OPTKEYR: u32 = 0x08;
const OPTCR: u32 = 0x18;
const OPTSR_CUR: u32 = 0x1C;
const OPTSR_PRG: u32 = 0x20;
const OPTCCR: u32 = 0x24;
const BANK_2: u32 = 0x100;
/// Register offsets within a bank.
const KEYR: u32 = 0x04;
const CR: u32 = 0x0C;
const SR: u32 = 0x10;
const CCR: u32 = 0x14;
const WPSN_CUR: u32 = 0x38;
const ECC_FA: u32 = 0x60;

/// Reset value of ACR: LATENCY 7, WRHIGHFREQ 3.
const ACR_AT_RESET: u32 = 0x37;

const IRQ: u16 = 4;

/// Reason why a read has no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LoadError {
    /// Bus error: the word has more wrong bits than can be corrected.
    Ecc,
    /// Bus error: readout protection with a debugger.
    Protected,
    /// The bank programs or erases, and the bus stalls.
    Busy {
        /// End of the operation, ns.
        until_ns: u64,
    },
    /// The address is outside the flash.
    Outside,
}

/// Flash with its registers and access to its cells.
pub struct Flash<C> {
    /// Memory cells with the content.
    pub cells: C,
    acr: u32,
    banks: [Bank; 2],
    conditions: (u64, VoltageScale),
    options: Options,
    /// Banks are swapped, OPTCR.SWAP_BANK.
    swapped: bool,
    /// A debugger is connected now.
    debugger: bool,
    /// A debugger was connected since power-on.
    intruded: bool,
    /// The backup SRAM and the backup registers must be erased.
    erases_backup: bool,
    raised: bool,
    power_lost: bool,
}

impl<C: FlashCells> Flash<C> {
    /// Makes the flash in its reset state.
    #[must_use]
    pub fn new(cells: C) -> Self {
        Self {
            cells,
            acr: ACR_AT_RESET,
            banks: [Bank::new(0, BASE), Bank::new(1, BASE + BYTES / 2)],
            conditions: (0, VoltageScale::Vos3),
            options: Options::new(),
            swapped: false,
            debugger: false,
            intruded: false,
            erases_backup: false,
            raised: false,
            power_lost: false,
        }
    }

    /// Returns the end of programming or erasing in the bank at an address, ns; `None` if it can be read.
    #[must_use]
    pub fn busy_until_ns(&self, address: u32) -> Option<u64> {
        let (number, ..) = self.locate(address)?;
        Some(self.banks[number].busy_until_ns()).filter(|until_ns| *until_ns != u64::MAX)
    }

    /// Returns true while the banks' addresses are exchanged, since the last reset, by SWAP_BANK_OPT.
    #[must_use]
    pub fn is_swapped(&self) -> bool {
        self.swapped
    }

    /// Returns true while readout protection blocks the flash, the backup SRAM and the backup registers.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.intruded && self.options.level() == Level::One
    }

    /// Connects or disconnects a debugger.
    pub fn set_debugger(&mut self, connected: bool) {
        self.debugger = connected;
        self.intruded |= connected;
        self.follow_protection();
    }

    /// Handles a power cycle.
    pub fn power_on(&mut self) {
        self.intruded = self.debugger;
        self.follow_protection();
    }

    /// Returns true once if the backup SRAM and registers must be erased.
    pub fn take_backup_erase(&mut self) -> bool {
        std::mem::take(&mut self.erases_backup)
    }

    fn follow_protection(&mut self) {
        let closed = self.is_closed();
        self.banks.iter_mut().for_each(|bank| bank.closed = closed);
    }

    /// Returns true if IWDG1_SW is cleared: the watchdog runs from each reset on.
    #[must_use]
    pub fn starts_watchdog(&self) -> bool {
        self.options.current & options::IWDG1_SW == 0
    }

    /// Returns BOR_LEV of the present option bytes, 0 to 3.
    #[must_use]
    pub fn brown_out_level(&self) -> u8 {
        (self.options.current >> 2 & 3) as u8
    }

    /// Sets the option bytes (OPTSR), as a programmer would; a bank swap takes effect at the next reset.
    ///
    /// # Errors
    /// [`Unmodelled`] names an option that is not modelled; nothing has changed then.
    pub fn set_options(&mut self, options: u32) -> Result<(), Unmodelled> {
        options::unmodelled(options).map_or(Ok(()), Err)?;
        self.options.set(options);
        self.follow_protection();
        Ok(())
    }

    fn option_control(&self) -> u32 {
        let lock = if self.options.unlocked { 0 } else { options::OPTLOCK };
        lock | if self.swapped { options::SWAP_BANK } else { 0 }
    }

    fn write_option_control(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        use options::{MER, OPTCHANGEERRIE, OPTLOCK, OPTSTART, SWAP_BANK};
        if !self.options.unlocked {
            if value & !(OPTLOCK | SWAP_BANK) != 0 {
                let what = "OPTCR is written while it is locked; the chip ignores it (RM0399, 4.5.1)";
                context.misuse("FLASH", what);
            }
            return Ok(());
        }
        if value & OPTCHANGEERRIE != 0 {
            let what = "the interrupt of option bytes (OPTCR.OPTCHANGEERRIE)".into();
            return Err(Unmodelled { peripheral: "FLASH", what });
        }
        if value & MER != 0 {
            // MER erases both banks, so the lock of either one blocks it.
            if self.banks.iter().any(Bank::is_locked) {
                let what = "OPTCR.MER while CR1 or CR2 is locked; both are to be unlocked before (RM0399, 4.3.10)";
                context.misuse("FLASH", what);
            } else {
                self.banks.iter_mut().for_each(|bank| bank.mass_erase(context.now_ns));
            }
        }
        if value & OPTSTART != 0 {
            self.start_change(context.now_ns);
        }
        self.options.unlocked = value & OPTLOCK == 0;
        Ok(())
    }

    /// Starts a change of the option bytes, unless they are equal (4.4.3).
    fn start_change(&mut self, now_ns: u64) {
        if self.options.next == self.options.current {
            return;
        }
        self.options.ends_ns = now_ns + options::CHANGE_NS;
        // A regression to level 0 erases both banks; the change lasts until the slower of the two is done.
        if self.options.regresses() {
            for bank in &mut self.banks {
                let ends_ns = bank.erase_for_regression(now_ns, options::CHANGE_NS);
                self.options.ends_ns = self.options.ends_ns.max(ends_ns);
            }
        }
    }

    fn finish_change(&mut self) {
        self.erases_backup |= self.options.regresses();
        self.options.finish();
        self.follow_protection();
    }

    /// Returns true after a power failure during a step. The chip is off then and must not run.
    #[must_use]
    pub fn power_lost(&self) -> bool {
        self.power_lost
    }

    /// Sets the nominal frequency of the AXI clock, Hz, and the voltage; reports too few wait states.
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

    /// Converts an address to bank, word in it, and byte in the word.
    fn locate(&self, address: u32) -> Option<(usize, u32, usize)> {
        let offset = address.checked_sub(BASE).filter(|offset| *offset < BYTES)?;
        let word = offset / WORD_BYTES as u32;
        // SWAP_BANK exchanges the addresses of the banks, not their cells.
        let bank = (word / BANK_WORDS) as usize ^ usize::from(self.swapped);
        Some((bank, word % BANK_WORDS, offset as usize % WORD_BYTES))
    }

    /// Returns the number of the word at an address, in the cells' order.
    #[must_use]
    pub fn word_at(&self, address: u32) -> Option<u32> {
        self.locate(address).map(|(bank, word, _)| bank as u32 * BANK_WORDS + word)
    }

    /// Reads for the core or a DMA controller. Aligned accesses only.
    ///
    /// # Errors
    /// [`LoadError`] for a bus error, or a busy bank.
    pub fn load(&mut self, address: u32, size: Size, context: &mut Context<'_>) -> Result<u32, LoadError> {
        self.advance(context);
        let (number, word, at) = self.locate(address).ok_or(LoadError::Outside)?;
        let bank = &mut self.banks[number];
        // The read protection is examined before the wait for a busy bank: a refused read does not stall.
        if bank.closed {
            bank.refuse_read(address, context);
            self.raise(context);
            return Err(LoadError::Protected);
        }
        // A read of a busy bank stalls the reader; the other bank remains readable.
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

    /// Handles a store of the core: a part of a flash word, which is programmed when all 32 bytes are there. Aligned
    /// accesses only. Errors appear in SR.
    pub fn store(&mut self, address: u32, size: Size, value: u32, context: &mut Context<'_>) {
        self.advance(context);
        let Some((number, word, at)) = self.locate(address) else { return };
        let bytes = &value.to_le_bytes()[..size.bytes() as usize];
        self.banks[number].store(word, at, bytes, context);
        self.raise(context);
    }

    fn raise(&mut self, context: &mut Context<'_>) {
        // Both banks share one interrupt line.
        let level = self.banks.iter().any(Bank::interrupt);
        if level != self.raised {
            self.raised = level;
            context.irq(IRQ, level);
        }
    }

    /// Returns the bank whose registers are at an offset (4.3.13, table 19), and the offset in its set; common
    /// registers are in both sets.
    fn split(&self, offset: u32) -> (usize, u32) {
        let (second, at) = if offset >= BANK_2 { (true, offset - BANK_2) } else { (false, offset) };
        (usize::from(second ^ self.swapped), at & !3)
    }

    fn value(&self, bank: &Bank, at: u32) -> Option<u32> {
        match at {
            ACR => Some(self.acr),
            KEYR | CCR => Some(0),
            CR => Some(bank.cr),
            SR => Some(bank.status()),
            ECC_FA => Some(bank.fault_word),
            OPTKEYR | OPTCCR => Some(0),
            OPTCR => Some(self.option_control()),
            OPTSR_CUR => Some(self.options.status()),
            OPTSR_PRG => Some(self.options.next),
            // No sector is write-protected.
            WPSN_CUR => Some(0xFF),
            _ => None,
        }
    }
}

impl<C: FlashCells> Peripheral for Flash<C> {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.advance(context);
        let (number, at) = self.split(offset);
        let value = self.value(&self.banks[number], at).ok_or_else(|| options::unmodelled_register(offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.advance(context);
        let (number, at) = self.split(offset);
        if self.options.is_busy() {
            let what = "a register is written while option bytes change; the chip ignores it (RM0399, 4.9.8, OPT_BUSY)";
            context.misuse("FLASH", what);
            return Ok(());
        }
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
            OPTKEYR => self.options.write_key(value, context),
            OPTCR => {
                let value = merged(self.option_control(), offset, size, value);
                self.write_option_control(value, context)?;
            }
            OPTSR_PRG => {
                let value = merged(self.options.next, offset, size, value);
                self.options.write_next(value, context)?;
            }
            // It clears OPTCHANGEERR, which the model never sets.
            OPTCCR => {}
            _ => return Err(options::unmodelled_register(offset)),
        }
        self.raise(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        let banks_ns = self.banks[0].busy_until_ns().min(self.banks[1].busy_until_ns());
        if self.power_lost { u64::MAX } else { banks_ns.min(self.options.ends_ns) }
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
        if self.options.ends_ns <= context.now_ns && !self.power_lost {
            self.finish_change();
        }
        self.raise(context);
    }

    /// Resets the registers with the chip. Operations in progress are abandoned.
    fn reset(&mut self, context: &mut Context<'_>) {
        self.advance(context);
        self.options.reset();
        self.swapped = self.options.current & options::SWAP_BANK_OPT != 0;
        for (number, bank) in self.banks.iter_mut().enumerate() {
            bank.reset(&mut self.cells, BASE + (number as u32 ^ u32::from(self.swapped)) * BYTES / 2);
        }
        self.follow_protection();
        (self.acr, self.power_lost) = (ACR_AT_RESET, false);
        self.raise(context);
    }
}
