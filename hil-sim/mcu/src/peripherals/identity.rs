//! Engraved identity of the chip (RM0399, 64): the unique number and the size of the flash, from 0x1FF1_E800 on.

use crate::{Context, Peripheral, Size, Unmodelled, peripherals::access::part};

const UNIQUE: u32 = 0x00;
const UNIQUE_END: u32 = 0x0C;
const FLASH_SIZE: u32 = 0x80;

/// Size of the flash, KiB.
const FLASH_KIB: u32 = 2048;

/// Read-only registers with the identity.
pub struct Identity {
    unique: [u32; 3],
}

impl Identity {
    /// Makes the identity with this 96-bit unique number.
    #[must_use]
    pub fn new(unique: [u32; 3]) -> Self {
        Self { unique }
    }
}

impl Peripheral for Identity {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let at = offset & !3;
        let value = match at {
            UNIQUE..UNIQUE_END => self.unique[(at / 4) as usize],
            FLASH_SIZE => FLASH_KIB,
            _ => return Err(Unmodelled::register("identity", offset)),
        };
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, _: Size, _: u32, _: &mut Context<'_>) -> Result<(), Unmodelled> {
        Err(Unmodelled { peripheral: "identity", what: format!("a write to read-only memory at offset {offset:#05x}") })
    }

    fn reset(&mut self, _: &mut Context<'_>) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Bench;

    #[test]
    fn number_and_size_are_read_in_any_width() {
        let (mut identity, mut bench) = (Identity::new([0x0011_0022, 0x3030_510A, 0x3132_3334]), Bench::default());
        assert_eq!([0, 4, 8].map(|at| bench.read(&mut identity, at)), [0x0011_0022, 0x3030_510A, 0x3132_3334]);
        assert_eq!(bench.try_read(&mut identity, 5, Size::Byte), Ok(0x51));
        assert_eq!(bench.try_read(&mut identity, 0x80, Size::Half), Ok(2048));
        assert!(bench.try_write(&mut identity, 0, Size::Word, 0).is_err());
    }
}
