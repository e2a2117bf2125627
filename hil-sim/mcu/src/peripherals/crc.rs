//! CRC calculation unit (RM0399, chapter 22). On hardware each word written takes four AHB cycles, in which the bus
//! stalls; in this model a write takes no time.

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::access::{merged, part},
};

/// Offsets of the registers (22.4).
const DR: u32 = 0x00;
const IDR: u32 = 0x04;
const CR: u32 = 0x08;
const INIT: u32 = 0x10;
const POL: u32 = 0x14;

/// Fields of CR: RESET, POLYSIZE, REV_IN, REV_OUT (22.4.3).
const RESET: u32 = 1 << 0;
const POLYSIZE: u32 = 3;
const REV_IN: u32 = 5;
const REV_OUT: u32 = 1 << 7;

/// Values after a reset (22.4.1, 22.4.4, 22.4.5).
const ONES: u32 = u32::MAX;
const ETHERNET: u32 = 0x04C1_1DB7;

/// CRC unit with its settings.
pub struct Crc {
    /// Remainder of the calculation, right-aligned.
    remainder: u32,
    independent: u32,
    control: u32,
    initial: u32,
    polynomial: u32,
}

impl Default for Crc {
    fn default() -> Self {
        Self::new()
    }
}

impl Crc {
    /// Makes the unit in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self { remainder: ONES, independent: 0, control: 0, initial: ONES, polynomial: ETHERNET }
    }

    /// Returns the number of bits of the polynomial.
    fn width(&self) -> u32 {
        match self.control >> POLYSIZE & 3 {
            0 => 32,
            1 => 16,
            2 => 8,
            _ => 7,
        }
    }

    fn mask(&self) -> u32 {
        u32::MAX >> (32 - self.width())
    }

    /// Reverses the bits of input data in each byte, half-word or word (22.3.3).
    fn turned_in(&self, value: u32, bits: u32) -> u32 {
        let group = match self.control >> REV_IN & 3 {
            0 => return value,
            1 => 8,
            2 => 16.min(bits),
            _ => bits,
        };
        (0..bits / group).fold(0, |turned, index| {
            let part = value >> (index * group) & (u32::MAX >> (32 - group));
            turned | part.reverse_bits() >> (32 - group) << (index * group)
        })
    }

    /// Feeds data bit by bit, the highest first.
    fn feed(&mut self, value: u32, bits: u32) {
        let top = 1 << (self.width() - 1);
        for bit in (0..bits).rev() {
            let carry = self.remainder & top != 0;
            let data = value >> bit & 1 != 0;
            self.remainder = (self.remainder << 1) & self.mask();
            // The data bit meets the highest bit of the remainder, so no zeros need to follow the message.
            if carry != data {
                self.remainder ^= self.polynomial & self.mask();
            }
        }
    }

    fn value(&self, at: u32) -> Option<u32> {
        Some(match at {
            DR if self.control & REV_OUT != 0 => self.remainder.reverse_bits() >> (32 - self.width()),
            DR => self.remainder,
            IDR => self.independent,
            CR => self.control,
            INIT => self.initial,
            POL => self.polynomial,
            _ => return None,
        })
    }
}

impl Peripheral for Crc {
    fn read(&mut self, offset: u32, size: Size, _: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let value = self.value(offset & !3).ok_or_else(|| Unmodelled::register("CRC", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let at = offset & !3;
        let before = self.value(at).ok_or_else(|| Unmodelled::register("CRC", offset))?;
        let whole = merged(before, offset, size, value);
        match at {
            // The width of the access defines the width of the data (22.3.3).
            DR => {
                let bits = match size {
                    Size::Byte => 8,
                    Size::Half => 16,
                    Size::Word => 32,
                };
                let value = part(value, 0, size);
                self.feed(self.turned_in(value, bits), bits);
            }
            IDR => self.independent = whole,
            CR => {
                self.control = whole & (REV_OUT | 3 << REV_IN | 3 << POLYSIZE);
                if whole & RESET != 0 {
                    self.remainder = self.initial & self.mask();
                }
            }
            // Writing INIT also starts a calculation from it (22.4.4).
            INIT => {
                self.initial = whole;
                self.remainder = whole & self.mask();
            }
            _ => {
                if whole & 1 == 0 {
                    context.misuse("CRC", "an even polynomial, which the unit does not support (RM0399, 22.3.3)");
                }
                self.polynomial = whole;
            }
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

    /// Nine digits by which catalogues check CRCs (Ross Williams, *A Painless Guide to CRC Error Detection
    /// Algorithms*).
    const CHECK: &[u8] = b"123456789";

    fn digits(control: u32, polynomial: u32, initial: u32) -> u32 {
        let (mut crc, mut bench) = (Crc::new(), Bench::default());
        bench.write(&mut crc, POL, polynomial);
        bench.write(&mut crc, INIT, initial);
        bench.write(&mut crc, CR, control | RESET);
        for digit in CHECK {
            bench.try_write(&mut crc, DR, Size::Byte, (*digit).into()).expect("it has a data register");
        }
        bench.assert_no_misuse();
        bench.read(&mut crc, DR)
    }

    /// Published check values of CRC-32/MPEG-2, CRC-32/ISO-HDLC before its last step, CRC-16/IBM-3740, CRC-8/SMBUS,
    /// CRC-7/MMC.
    #[test]
    fn catalogued_crcs_have_their_check_values() {
        assert_eq!(digits(0, ETHERNET, ONES), 0x0376_E6E7);
        assert_eq!(!digits(1 << REV_IN | REV_OUT, ETHERNET, ONES), 0xCBF4_3926);
        assert_eq!(digits(1 << POLYSIZE, 0x1021, 0xFFFF), 0x29B1);
        assert_eq!(digits(2 << POLYSIZE, 0x07, 0), 0xF4);
        assert_eq!(digits(3 << POLYSIZE, 0x09, 0), 0x75);
    }

    /// A word reversed as a whole equals its four bytes, the lowest first, each reversed.
    #[test]
    fn words_are_bytes_in_little_endian_order_when_turned_round() {
        let (mut crc, mut bench) = (Crc::new(), Bench::default());
        bench.write(&mut crc, CR, 3 << REV_IN | REV_OUT | RESET);
        for word in [u32::from_le_bytes(*b"1234"), u32::from_le_bytes(*b"5678")] {
            bench.write(&mut crc, DR, word);
        }
        bench.try_write(&mut crc, DR, Size::Byte, b'9'.into()).expect("it has a data register");
        assert_eq!(!bench.read(&mut crc, DR), 0xCBF4_3926);
    }

    #[test]
    fn reset_and_the_initial_value_start_again_and_the_independent_register_stays() {
        let (mut crc, mut bench) = (Crc::new(), Bench::default());
        bench.write(&mut crc, IDR, 0x1234_5678);
        bench.write(&mut crc, DR, 1);
        assert_ne!(bench.read(&mut crc, DR), ONES);
        bench.write(&mut crc, CR, RESET);
        assert_eq!((bench.read(&mut crc, DR), bench.read(&mut crc, CR)), (ONES, 0), "RESET clears itself");
        bench.write(&mut crc, INIT, 7);
        assert_eq!((bench.read(&mut crc, DR), bench.read(&mut crc, IDR)), (7, 0x1234_5678));
        assert!(bench.try_read(&mut crc, 0x0C, Size::Word).is_err());
        bench.write(&mut crc, POL, 2);
        assert_eq!(bench.take_misuse().len(), 1);
    }
}
