//! System configuration (RM0399, 12 "SYSCFG"): port selection of EXTI lines, overdrive, I/O compensation cell.
//!
//! Fast-mode plus, analog switches and boosters are settings stored without effect. The user registers (option bytes
//! read back), package and compensation codes are not modelled.

use crate::{
    Context, Peripheral, Pin, Size, Unmodelled,
    peripherals::access::{merged, part},
};

const PMCR: u32 = 0x04;
const EXTICR1: u32 = 0x08;
const EXTICR4: u32 = 0x14;
const CCCSR: u32 = 0x20;
const CCCR: u32 = 0x28;
const PWRCR: u32 = 0x2C;

/// Reset value of PMCR: PA0SO to PC3SO, the switches to the `_C` pads are open.
const PMCR_AT_RESET: u32 = 0x0F00_0000;
/// Number of ports, A to K.
const PORTS: u32 = 11;

/// Registers of the SYSCFG.
pub struct Syscfg {
    pmcr: u32,
    exticr: [u32; 4],
    compensation: u32,
    codes: u32,
    overdrive: bool,
}

impl Default for Syscfg {
    fn default() -> Self {
        Self::new()
    }
}

impl Syscfg {
    /// Makes the unit in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self { pmcr: PMCR_AT_RESET, exticr: [0; 4], compensation: 0, codes: 0, overdrive: false }
    }

    /// Returns the pin that an EXTI line (0 to 15) is connected to.
    #[must_use]
    pub fn exti_pin(&self, line: u8) -> Pin {
        let port = self.exticr[usize::from(line / 4)] >> (4 * (line % 4)) & 0xF;
        Pin { port: port as u8, number: line }
    }

    /// Returns PWRCR.ODEN, for [`crate::peripherals::pwr::Pwr::set_overdrive`].
    #[must_use]
    pub fn overdrive(&self) -> bool {
        self.overdrive
    }

    fn value(&self, at: u32) -> Option<u32> {
        match at {
            PMCR => Some(self.pmcr),
            EXTICR1..=EXTICR4 => Some(self.exticr[((at - EXTICR1) / 4) as usize]),
            // RDY equals EN, without delay.
            CCCSR => Some(self.compensation | (self.compensation & 1) << 8),
            CCCR => Some(self.codes),
            PWRCR => Some(self.overdrive.into()),
            _ => None,
        }
    }
}

impl Peripheral for Syscfg {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let value = self.value(offset & !3).ok_or_else(|| Unmodelled::register("SYSCFG", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let at = offset & !3;
        let before = self.value(at).ok_or_else(|| Unmodelled::register("SYSCFG", offset))?;
        let value = merged(before, offset, size, value);
        match at {
            PMCR => self.pmcr = value & 0x0FE0_03FF,
            EXTICR1..=EXTICR4 => {
                if let Some(port) = (0..4).map(|line| value >> (4 * line) & 0xF).find(|port| *port >= PORTS) {
                    context.misuse("SYSCFG", format!("EXTICR chooses port {port}, which does not exist"));
                }
                self.exticr[((at - EXTICR1) / 4) as usize] = value & 0xFFFF;
            }
            CCCSR => self.compensation = value & 0x0001_0003,
            CCCR => self.codes = value & 0xFF,
            _ => self.overdrive = value & 1 != 0,
        }
        Ok(())
    }

    fn reset(&mut self, _: &mut Context<'_>) {
        *self = Self::new();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Bench;

    #[test]
    fn an_exti_line_is_on_the_chosen_port() {
        let (mut syscfg, mut bench) = (Syscfg::new(), Bench::default());
        assert_eq!(syscfg.exti_pin(10), Pin::new('A', 10));
        bench.modify(&mut syscfg, 0x10, 0xF << 8, 8 << 8);
        assert_eq!(syscfg.exti_pin(10), Pin::new('I', 10));
        assert_eq!(syscfg.exti_pin(11), Pin::new('A', 11));
        bench.assert_no_misuse();
        bench.write(&mut syscfg, 0x10, 0xB);
        assert_eq!(bench.take_misuse().len(), 1);
    }

    #[test]
    fn the_compensation_cell_is_ready_when_it_is_on() {
        let (mut syscfg, mut bench) = (Syscfg::new(), Bench::default());
        bench.modify(&mut syscfg, CCCSR, 0, 1);
        assert_eq!(bench.read(&mut syscfg, CCCSR), 1 << 8 | 1);
        bench.modify(&mut syscfg, CCCSR, 1, 0);
        assert_eq!(bench.read(&mut syscfg, CCCSR), 0);
    }

    #[test]
    fn overdrive_goes_with_a_reset() {
        let (mut syscfg, mut bench) = (Syscfg::new(), Bench::default());
        bench.modify(&mut syscfg, PWRCR, 0, 1);
        assert!(syscfg.overdrive());
        syscfg.reset(&mut bench.context());
        assert!(!syscfg.overdrive());
        assert!(bench.try_read(&mut syscfg, 0x300, Size::Word).is_err(), "user registers");
    }
}
