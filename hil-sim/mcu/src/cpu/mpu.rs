//! The memory protection unit (DDI0403E B3.5): its registers.
//!
//! Regions are kept and read back. What they would change for a privileged program's loads and stores is not modelled:
//! switching on a configuration that forbids some of them is refused. Attributes (cacheability) change nothing here.

/// Regions of the chip's Cortex-M7 (RM0399 2.1: 16).
const REGIONS: usize = 16;

/// Why a write is refused.
pub(super) const NOT_MODELLED: &str =
    "MPU: only regions with full access for privileged code, and PRIVDEFENA, are modelled";

const ENABLE: u32 = 1;
const DEFAULT_MAP: u32 = 1 << 2;

/// Registers.
#[derive(Clone, Debug, Default)]
pub struct Mpu {
    control: u32,
    number: u32,
    base: [u32; REGIONS],
    attributes: [u32; REGIONS],
}

impl Mpu {
    /// Reads a register, offset from 0xE000_ED90.
    #[must_use]
    pub fn read(&self, offset: u32) -> Option<u32> {
        let region = self.number as usize;
        Some(match offset {
            0x00 => (REGIONS as u32) << 8,
            0x04 => self.control,
            0x08 => self.number,
            0x0C | 0x14 | 0x1C | 0x24 => self.base[region] | self.number,
            0x10 | 0x18 | 0x20 | 0x28 => self.attributes[region],
            _ => return None,
        })
    }

    /// Writes a register; `None` where none is, or for what is not modelled.
    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        let mut next = self.clone();
        match offset {
            0x04 => next.control = value & 7,
            0x08 => next.number = ((value & 0xFF) as usize).min(REGIONS - 1) as u32,
            0x0C | 0x14 | 0x1C | 0x24 => {
                // VALID: the region's number is in the low bits.
                if value & 0x10 != 0 {
                    next.number = value & 15;
                }
                next.base[next.number as usize] = value & !0x1F;
            }
            0x10 | 0x18 | 0x20 | 0x28 => next.attributes[next.number as usize] = value & 0x173F_FF3F,
            _ => return None,
        }
        if next.restricts() {
            return None;
        }
        *self = next;
        Some(())
    }

    fn restricts(&self) -> bool {
        // AP: 1, 2 and 3 let privileged code read and write (B3.5.9).
        let forbids = |attributes: &u32| attributes & 1 != 0 && !matches!(attributes >> 24 & 7, 1..=3);
        let enabled = self.control & ENABLE != 0;
        enabled && (self.control & DEFAULT_MAP == 0 || self.attributes.iter().any(forbids))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_region_is_written_by_number_or_with_its_base() {
        let mut mpu = Mpu::default();
        assert_eq!(mpu.read(0), Some(0x1000));
        mpu.write(0x0C, 0x3000_0000 | 0x10 | 3).unwrap();
        // Normal, not cacheable, full access, 512 KiB.
        mpu.write(0x10, 0x1308_0025).unwrap();
        assert_eq!((mpu.read(0x08), mpu.read(0x0C), mpu.read(0x10)), (Some(3), Some(0x3000_0003), Some(0x1308_0025)));
        mpu.write(0x08, 0).unwrap();
        assert_eq!(mpu.read(0x10), Some(0));
        mpu.write(0x04, 5).unwrap();
        assert_eq!(mpu.read(0x04), Some(5));
    }

    #[test]
    fn what_would_forbid_an_access_is_refused() {
        let mut mpu = Mpu::default();
        assert_eq!(mpu.write(0x04, 1), None, "no default map");
        mpu.write(0x04, 5).unwrap();
        assert_eq!(mpu.write(0x10, 0x0000_0011), None, "no access");
        assert_eq!(mpu.write(0x10, 0x0500_0011), None, "read-only");
        assert_eq!(mpu.read(0x10), Some(0));
        mpu.write(0x10, 0x0000_0010).unwrap();
    }
}
