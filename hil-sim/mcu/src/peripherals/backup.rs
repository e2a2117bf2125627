//! Backup domain without its clock (RM0399, 50 "RTC"): the 32 backup registers.
//!
//! The backup registers are writable only while PWR_CR1.DBP is set, and keep their content through every reset but that
//! of the backup domain. The calendar does not run: its registers read as after that reset, and writing them ends the
//! run.

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::access::{merged, part},
};

const WPR: u32 = 0x24;
const BKP0R: u32 = 0x50;
const BKP31R: u32 = 0xCC;

/// Calendar registers after a backup domain reset: TR, DR, CR, ISR, PRER, WUTR.
const CALENDAR: [u32; 6] = [0, 0x2101, 0, 0x7, 0x007F_00FF, 0xFFFF];

/// Backup registers of the RTC.
pub struct Backup {
    registers: [u32; 32],
    writable: bool,
}

impl Default for Backup {
    fn default() -> Self {
        Self::new()
    }
}

impl Backup {
    /// Makes the registers after the first power-on: zeros.
    #[must_use]
    pub fn new() -> Self {
        Self { registers: [0; 32], writable: false }
    }

    /// Sets the write permission, PWR_CR1.DBP.
    pub fn set_writable(&mut self, writable: bool) {
        self.writable = writable;
    }

    /// Clears the registers at a reset of the backup domain (RCC_BDCR.BDRST), or a loss of VBAT and VDD.
    pub fn clear(&mut self) {
        self.registers = [0; 32];
    }

    /// Returns a backup register, 0 to 31, for tests; `None` beyond.
    #[must_use]
    pub fn register(&self, index: usize) -> Option<u32> {
        self.registers.get(index).copied()
    }
}

impl Peripheral for Backup {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let at = offset & !3;
        let value = match at {
            BKP0R..=BKP31R => self.registers[((at - BKP0R) / 4) as usize],
            WPR => 0,
            _ => *CALENDAR.get((at / 4) as usize).ok_or_else(|| Unmodelled::register("RTC", offset))?,
        };
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let at = offset & !3;
        match at {
            BKP0R..=BKP31R if !self.writable => {
                context.misuse(
                    "RTC",
                    "a backup register is written while PWR_CR1.DBP is 0; the chip ignores it (RM0399, 7.4.4)",
                );
            }
            BKP0R..=BKP31R => {
                let register = &mut self.registers[((at - BKP0R) / 4) as usize];
                *register = merged(*register, offset, size, value);
            }
            // WPR takes the keys for the calendar's registers, which are not writable here anyway.
            WPR => {}
            _ => {
                return Err(Unmodelled {
                    peripheral: "RTC",
                    what: format!("calendar (write at offset {offset:#05x})"),
                });
            }
        }
        Ok(())
    }

    /// Resets only the write permission; PWR sets it again.
    fn reset(&mut self, _: &mut Context<'_>) {
        self.writable = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Bench;

    #[test]
    fn backup_registers_outlive_a_reset_of_the_chip() {
        let (mut backup, mut bench) = (Backup::new(), Bench::default());
        backup.set_writable(true);
        // Register 0 holds the Arduino bootloader's request for DFU, register 8 its reset cause.
        bench.write(&mut backup, BKP0R, 0xDF59);
        bench.write(&mut backup, BKP0R + 4 * 8, 7);
        bench.write(&mut backup, BKP31R, 31);
        backup.reset(&mut bench.context());
        assert_eq!(bench.read(&mut backup, BKP0R), 0xDF59);
        assert_eq!((backup.register(8), backup.register(31), backup.register(32)), (Some(7), Some(31), None));
        backup.clear();
        assert_eq!(bench.read(&mut backup, BKP0R), 0);
        bench.assert_no_misuse();
    }

    #[test]
    fn without_dbp_nothing_is_written() {
        let (mut backup, mut bench) = (Backup::new(), Bench::default());
        bench.write(&mut backup, BKP0R, 1);
        assert_eq!(bench.read(&mut backup, BKP0R), 0);
        assert_eq!(bench.take_misuse().len(), 1);
    }

    #[test]
    fn the_calendar_ends_the_run_when_it_is_set() {
        let (mut backup, mut bench) = (Backup::new(), Bench::default());
        assert_eq!(bench.read(&mut backup, 0x10), 0x007F_00FF);
        assert!(bench.try_write(&mut backup, 0x0C, Size::Word, 1 << 7).is_err());
        assert!(bench.try_read(&mut backup, 0x28, Size::Word).is_err());
    }
}
