//! Memory protection unit (DDI0403E B3.5): its registers, and the accesses that they forbid.
//!
//! Accesses are judged as privileged, also in unprivileged mode, as everywhere in this model. Attributes (cacheability,
//! shareability) have no effect.

/// Number of regions in the chip's Cortex-M7 (RM0399 2.1: 16).
const REGIONS: usize = 16;

const ENABLE: u32 = 1;
const IN_FAULT_HANDLERS: u32 = 1 << 1;
const DEFAULT_MAP: u32 = 1 << 2;

/// First address of the system space, where the default map always applies.
const SYSTEM: u32 = 0xE000_0000;

/// Purpose of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Load of data by an instruction.
    Load,
    /// Store of data by an instruction.
    Store,
    /// Fetch of an instruction.
    Fetch,
}

/// Permissions of one enabled region.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Rule {
    base: u32,
    /// Last address of the region.
    last: u32,
    /// SRD: disabled eighths of the region.
    without: u32,
    /// Size of the blocks with uniform permissions, as a power of 2, bytes.
    granule: u32,
    load: bool,
    store: bool,
    fetch: bool,
}

impl Rule {
    fn new(base: u32, attributes: u32) -> Option<Self> {
        if attributes & 1 == 0 {
            return None;
        }
        // The minimum is 32 bytes; smaller sizes are reserved.
        let bits = (attributes >> 1 & 0x1F).max(4) + 1;
        let mask = ((1_u64 << bits) - 1) as u32;
        let divided = bits >= 8;
        let (load, store) = match attributes >> 24 & 7 {
            1..=3 => (true, true),
            5..=7 => (true, false),
            _ => (false, false),
        };
        Some(Self {
            base: base & !mask,
            last: base | mask,
            without: if divided { attributes >> 8 & 0xFF } else { 0 },
            granule: if divided { bits - 3 } else { bits },
            load,
            store,
            fetch: load && attributes >> 28 & 1 == 0,
        })
    }

    fn holds(&self, address: u32) -> bool {
        let eighth = address.wrapping_sub(self.base) >> self.granule;
        (self.base..=self.last).contains(&address) && self.without >> (eighth & 7) & 1 == 0
    }
}

/// Accesses allowed while the unit is on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Protection {
    /// Regions in order of precedence, the highest number first.
    rules: Vec<Rule>,
    default_map: bool,
}

impl Protection {
    /// Returns true if a privileged program may access the byte at `address` for `purpose`.
    #[must_use]
    pub fn allows(&self, address: u32, purpose: Purpose) -> bool {
        if address >= SYSTEM {
            return purpose != Purpose::Fetch;
        }
        match self.rules.iter().find(|rule| rule.holds(address)) {
            Some(rule) => match purpose {
                Purpose::Load => rule.load,
                Purpose::Store => rule.store,
                Purpose::Fetch => rule.fetch,
            },
            // Code is never executed from peripherals and devices (B3.1).
            None => {
                let never = matches!(address, 0x4000_0000..0x6000_0000 | 0xA000_0000..);
                self.default_map && (purpose != Purpose::Fetch || !never)
            }
        }
    }

    /// Checks an access of `bytes`; returns the first address for which it is not allowed.
    #[must_use]
    pub fn refuses(&self, address: u32, bytes: u32, purpose: Purpose) -> Option<u32> {
        let last = address.wrapping_add(bytes.wrapping_sub(1));
        [address, last].into_iter().find(|address| !self.allows(*address, purpose))
    }

    /// Returns true if an aligned block of 2^`bits` bytes has uniform permissions.
    #[must_use]
    pub fn is_uniform(&self, address: u32, bits: u32) -> bool {
        let last = address | ((1_u64 << bits) - 1) as u32;
        self.rules.iter().all(|rule| rule.granule >= bits || last < rule.base || address > rule.last)
    }
}

/// Registers of the memory protection unit.
#[derive(Clone, Debug, Default)]
pub struct Mpu {
    control: u32,
    number: u32,
    base: [u32; REGIONS],
    attributes: [u32; REGIONS],
}

impl Mpu {
    /// Reads a register, offset from 0xE000_ED90; `None` where none exists.
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

    /// Writes a register; `None` where none exists.
    pub fn write(&mut self, offset: u32, value: u32) -> Option<()> {
        match offset {
            0x04 => self.control = value & 7,
            0x08 => self.number = ((value & 0xFF) as usize).min(REGIONS - 1) as u32,
            0x0C | 0x14 | 0x1C | 0x24 => {
                // With VALID, the low bits select the region.
                if value & 0x10 != 0 {
                    self.number = value & 15;
                }
                self.base[self.number as usize] = value & !0x1F;
            }
            0x10 | 0x18 | 0x20 | 0x28 => self.attributes[self.number as usize] = value & 0x173F_FF3F,
            _ => return None,
        }
        Some(())
    }

    /// Returns MPU_CTRL.ENABLE: protection is on.
    #[must_use]
    pub fn is_on(&self) -> bool {
        self.control & ENABLE != 0
    }

    /// Returns MPU_CTRL.HFNMIENA: protection also at negative execution priority.
    #[must_use]
    pub fn is_on_in_fault_handlers(&self) -> bool {
        self.control & IN_FAULT_HANDLERS != 0
    }

    /// Returns the allowed accesses while the unit is on.
    #[must_use]
    pub fn protection(&self) -> Protection {
        let regions = self.base.iter().zip(&self.attributes).rev();
        let rules = regions.filter_map(|(base, attributes)| Rule::new(*base, *attributes)).collect();
        Protection { rules, default_map: self.control & DEFAULT_MAP != 0 }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_region_is_written_by_number_or_with_its_base() {
        let mut mpu = Mpu::default();
        assert_eq!(mpu.read(0), Some(0x1000));
        mpu.write(0x0C, 0x3000_0000 | 0x10 | 3).unwrap();
        // Attributes: normal memory, not cacheable, full access, 512 KiB.
        mpu.write(0x10, 0x1308_0025).unwrap();
        assert_eq!((mpu.read(0x08), mpu.read(0x0C), mpu.read(0x10)), (Some(3), Some(0x3000_0003), Some(0x1308_0025)));
        mpu.write(0x08, 0).unwrap();
        assert_eq!(mpu.read(0x10), Some(0));
        mpu.write(0x04, 5).unwrap();
        assert_eq!(mpu.read(0x04), Some(5));
    }

    fn region(mpu: &mut Mpu, number: u32, base: u32, attributes: u32) {
        mpu.write(0x0C, base | 0x10 | number).unwrap();
        mpu.write(0x10, attributes).unwrap();
    }

    #[test]
    fn the_region_with_the_highest_number_decides_and_eighths_can_be_left_out() {
        let mut mpu = Mpu::default();
        mpu.write(0x04, ENABLE | DEFAULT_MAP).unwrap();
        // Regions: 32 bytes at 0 without access; 64 KiB of DTCM read-only and not executable, with the second eighth
        // disabled; in the first eighth 1 KiB with full access.
        region(&mut mpu, 0, 0, 4 << 1 | 1);
        region(&mut mpu, 1, 0x2000_0000, 1 << 28 | 5 << 24 | 0b10 << 8 | 15 << 1 | 1);
        region(&mut mpu, 2, 0x2000_0400, 3 << 24 | 9 << 1 | 1);
        let protection = mpu.protection();
        let allowed = |address| {
            [Purpose::Load, Purpose::Store, Purpose::Fetch].map(|purpose| protection.allows(address, purpose))
        };
        for (address, expected) in [
            (0x0000_0000, [false; 3]),
            (0x0000_001F, [false; 3]),
            (0x0000_0020, [true; 3]),
            (0x2000_03FF, [true, false, false]),
            (0x2000_0400, [true; 3]),
            (0x2000_07FF, [true; 3]),
            (0x2000_0800, [true, false, false]),
            (0x2000_1FFF, [true, false, false]),
            (0x2000_2000, [true; 3]),
            (0x2000_3FFF, [true; 3]),
            (0x2000_4000, [true, false, false]),
            (0x2000_FFFF, [true, false, false]),
            (0x2001_0000, [true; 3]),
            (0x4000_0000, [true, true, false]),
            (0xE000_ED94, [true, true, false]),
        ] {
            assert_eq!(allowed(address), expected, "{address:#010x}");
        }
        assert_eq!(protection.refuses(0x2000_03FE, 4, Purpose::Store), Some(0x2000_03FE));
        assert_eq!(protection.refuses(0x2000_07FE, 4, Purpose::Store), Some(0x2000_0801));
        assert_eq!(protection.refuses(0x2000_07FC, 4, Purpose::Store), None);
        // Without the default map only the system space remains besides the regions.
        mpu.write(0x04, ENABLE).unwrap();
        let protection = mpu.protection();
        assert!(!protection.allows(0x0800_0000, Purpose::Fetch) && protection.allows(0xE000_ED94, Purpose::Store));
    }

    proptest! {
        #[test]
        fn a_uniform_block_is_the_same_at_each_of_its_bytes(
            regions in proptest::collection::vec((0..0x40_u32, 0..0x20_u32, 0..8_u32, any::<u8>()), 1..6), block in 0..0x40_u32, offset in 0..0x400_u32,
        ) {
            let mut mpu = Mpu::default();
            mpu.write(0x04, ENABLE | DEFAULT_MAP).unwrap();
            for (number, (base, size, access, without)) in (0..).zip(regions) {
                region(&mut mpu, number, 0x2000_0000 + base * 0x100, access << 24 | u32::from(without) << 8 | size << 1 | 1);
            }
            let (protection, block) = (mpu.protection(), 0x2000_0000 + block * 0x400);
            prop_assume!(protection.is_uniform(block, 10));
            for purpose in [Purpose::Load, Purpose::Store, Purpose::Fetch] {
                prop_assert_eq!(protection.allows(block, purpose), protection.allows(block + offset, purpose));
            }
        }
    }
}
