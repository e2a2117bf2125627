//! Flexible memory controller (RM0399, 23). Only BCR1 is modelled, so that a program can disable bank 1, which is
//! enabled after a reset.
//!
//! The model has no external memory: any other access ends the run.

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::access::{merged, part},
};

const BCR1: u32 = 0x00;
/// Reset value of BCR1: MBKEN, MTYP = NOR, MWID = 16 bits, WREN, WAITEN and others.
const BCR1_AT_RESET: u32 = 0x0000_30DB;
/// Bits of BCR1 that exist.
const BCR1_BITS: u32 = 0x833F_FB7F;
const MBKEN: u32 = 1;

/// Registers of the FMC.
pub struct Fmc {
    bcr1: u32,
}

impl Default for Fmc {
    fn default() -> Self {
        Self::new()
    }
}

impl Fmc {
    /// Makes the controller in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self { bcr1: BCR1_AT_RESET }
    }

    /// Returns true while bank 1 (at 0x6000_0000) is enabled. The processor may then read there speculatively, and
    /// stall.
    #[must_use]
    pub fn bank_1_on(&self) -> bool {
        self.bcr1 & MBKEN != 0
    }
}

impl Peripheral for Fmc {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        if offset & !3 == BCR1 { Ok(part(self.bcr1, offset, size)) } else { Err(Unmodelled::register("FMC", offset)) }
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, _: &mut Context<'_>) -> Result<(), Unmodelled> {
        if offset & !3 != BCR1 {
            return Err(Unmodelled::register("FMC", offset));
        }
        let value = merged(self.bcr1, offset, size, value);
        if value & MBKEN != 0 && !self.bank_1_on() {
            return Err(Unmodelled { peripheral: "FMC", what: "external memory (BCR1.MBKEN)".into() });
        }
        // Bit 7 is reserved and reads as 1.
        self.bcr1 = value & BCR1_BITS | BCR1_AT_RESET & !BCR1_BITS;
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
    fn bank_1_is_on_until_it_is_turned_off() {
        let (mut fmc, mut bench) = (Fmc::new(), Bench::default());
        assert!(fmc.bank_1_on());
        bench.modify(&mut fmc, BCR1, MBKEN, 0);
        assert!(!fmc.bank_1_on());
        assert!(bench.try_write(&mut fmc, BCR1, Size::Word, BCR1_AT_RESET).is_err());
        assert!(bench.try_write(&mut fmc, 0x140, Size::Word, 0).is_err(), "SDRAM");
        fmc.reset(&mut bench.context());
        assert!(fmc.bank_1_on());
    }
}
