//! Clock recovery of HSI48 from USB's start of frame (RM0399, 10). The model has no USB host, so no frame comes:
//! settings are stored, the trimming stays, and no flag is ever set.

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::access::{merged, part},
};

const CR: u32 = 0x00;
const CFGR: u32 = 0x04;
const ISR: u32 = 0x08;
const ICR: u32 = 0x0C;

/// Reset value of CR: TRIM in the middle.
const CR_AT_RESET: u32 = 0x2000;
const CFGR_AT_RESET: u32 = 0x2022_BB7F;
const SWSYNC: u32 = 1 << 7;

/// Registers of the CRS.
pub struct Crs {
    control: u32,
    configuration: u32,
}

impl Default for Crs {
    fn default() -> Self {
        Self::new()
    }
}

impl Crs {
    /// Makes the unit in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self { control: CR_AT_RESET, configuration: CFGR_AT_RESET }
    }

    fn value(&self, at: u32) -> Option<u32> {
        match at {
            CR => Some(self.control),
            CFGR => Some(self.configuration),
            ISR | ICR => Some(0),
            _ => None,
        }
    }
}

impl Peripheral for Crs {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let value = self.value(offset & !3).ok_or_else(|| Unmodelled::register("CRS", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let at = offset & !3;
        let value = merged(self.value(at).ok_or_else(|| Unmodelled::register("CRS", offset))?, offset, size, value);
        match at {
            CR if value & SWSYNC != 0 => {
                return Err(Unmodelled { peripheral: "CRS", what: "synchronisation by software (CR.SWSYNC)".into() });
            }
            CR => self.control = value & 0x3FEF,
            CFGR if self.control & 1 << 5 != 0 && value != self.configuration => {
                context.misuse("CRS", "CFGR is written while the counter is on; the chip ignores it (CRS_CFGR)");
            }
            CFGR => self.configuration = value & 0xB7FF_FFFF,
            _ => {}
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
    fn settings_are_kept_while_the_counter_is_off() {
        let (mut crs, mut bench) = (Crs::new(), Bench::default());
        bench.modify(&mut crs, CFGR, 0b11 << 28, 0b10 << 28);
        bench.modify(&mut crs, CR, 0, 0b11 << 5);
        assert_eq!(bench.read(&mut crs, CR), 0x2060);
        assert_eq!(bench.read(&mut crs, ISR), 0);
        bench.assert_no_misuse();
        bench.modify(&mut crs, CFGR, 0b11 << 28, 0);
        assert_eq!(bench.take_misuse().len(), 1);
        assert_eq!(bench.read(&mut crs, CFGR) >> 28 & 3, 0b10);
        assert!(bench.try_write(&mut crs, CR, Size::Word, SWSYNC).is_err());
    }
}
