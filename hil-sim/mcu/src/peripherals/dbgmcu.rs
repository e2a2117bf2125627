//! Debug unit (RM0399, 63.5.8): identity of the chip, and settings for debuggers. Without a debugger the settings have
//! no effect.

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::access::{merged, part},
};

const IDC: u32 = 0x00;
const CR: u32 = 0x04;
/// Offset of APB3FZ1, the first of the freeze registers.
const FREEZE: u32 = 0x34;
const FREEZE_END: u32 = 0x5C;
/// Bits that exist, of APB3FZ1, APB1LFZ1, APB1HFZ1, APB2FZ1 and APB4FZ1, each followed by the one for the Cortex-M4.
const FREEZE_BITS: [u32; ((FREEZE_END - FREEZE) / 4) as usize] =
    [1 << 6, 1 << 6, 0x00E0_0BFF, 0x00E0_0BFF, 1 << 8, 1 << 8, 0x2007_0003, 0x2007_0003, 0x000D_1E80, 0x000D_1E80];

/// Identity: device 0x450, revision V.
const IDENTITY: u32 = 0x2003_6450;
const CR_BITS: u32 = 0x1070_01BF;

/// Registers of DBGMCU. Only power-on resets them.
pub struct Dbgmcu {
    control: u32,
    freeze: [u32; ((FREEZE_END - FREEZE) / 4) as usize],
}

impl Default for Dbgmcu {
    fn default() -> Self {
        Self::new()
    }
}

impl Dbgmcu {
    /// Makes the registers after power-on.
    #[must_use]
    pub fn new() -> Self {
        Self { control: 0, freeze: [0; ((FREEZE_END - FREEZE) / 4) as usize] }
    }

    fn value(&self, at: u32) -> Option<u32> {
        match at {
            IDC => Some(IDENTITY),
            CR => Some(self.control),
            FREEZE..FREEZE_END => Some(self.freeze[((at - FREEZE) / 4) as usize]),
            _ => None,
        }
    }
}

impl Peripheral for Dbgmcu {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let value = self.value(offset & !3).ok_or_else(|| Unmodelled::register("DBGMCU", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, _: &mut Context<'_>) -> Result<(), Unmodelled> {
        let at = offset & !3;
        let before = self.value(at).ok_or_else(|| Unmodelled::register("DBGMCU", offset))?;
        let value = merged(before, offset, size, value);
        match at {
            IDC => {}
            CR => self.control = value & CR_BITS,
            _ => {
                let index = ((at - FREEZE) / 4) as usize;
                self.freeze[index] = value & FREEZE_BITS[index];
            }
        }
        Ok(())
    }

    /// A reset of the chip leaves the registers unchanged.
    fn reset(&mut self, _: &mut Context<'_>) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Bench;

    #[test]
    fn it_is_an_stm32h747_of_revision_v() {
        let (mut dbgmcu, mut bench) = (Dbgmcu::new(), Bench::default());
        let identity = bench.read(&mut dbgmcu, IDC);
        assert_eq!((identity & 0xFFF, identity >> 16), (0x450, 0x2003));
    }

    #[test]
    fn settings_are_kept_through_a_reset() {
        let (mut dbgmcu, mut bench) = (Dbgmcu::new(), Bench::default());
        bench.modify(&mut dbgmcu, CR, 0, 1 << 21 | 1);
        bench.write(&mut dbgmcu, 0x54, 1 << 18);
        dbgmcu.reset(&mut bench.context());
        assert_eq!(bench.read(&mut dbgmcu, CR), 1 << 21 | 1);
        assert_eq!(bench.read(&mut dbgmcu, 0x54), 1 << 18);
        assert!(bench.try_read(&mut dbgmcu, 0x5C, Size::Word).is_err());
    }
}
