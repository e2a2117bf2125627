//! Address map of the peripherals (RM0399, 2.3.2, table 7, as the Cortex-M7 sees it).

/// Peripheral of the chip, by its place in [`super::Soc`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub(super) enum Id {
    Rcc,
    Pwr,
    Gpio,
    Exti,
    Syscfg,
    Flash,
    Iwdg,
    Backup,
    Dbgmcu,
    Usb,
    Fmc,
    Crs,
    Identity,
    Dma,
    Bdma,
    Tim1,
    Tim2,
    Tim3,
    Tim4,
    Tim5,
    Tim6,
    Tim7,
    Tim8,
    Tim12,
    Tim13,
    Tim14,
    Tim15,
    Tim16,
    Tim17,
    Adc12,
    Dac1,
    Usart1,
    Usart2,
    Usart3,
    Uart4,
    Uart5,
    Usart6,
    Uart7,
    Uart8,
    I2c1,
    I2c2,
    I2c3,
    I2c4,
    Fdcan,
    Spi1,
    Rng,
    Crc,
}

/// Map entries: first address, number of 1 KiB blocks, peripheral.
const MAP: &[(u32, u32, Id)] = &[
    (IDENTITY, 1, Id::Identity),
    (0x4000_0000, 1, Id::Tim2),
    (0x4000_0400, 1, Id::Tim3),
    (0x4000_0800, 1, Id::Tim4),
    (0x4000_0C00, 1, Id::Tim5),
    (0x4000_1000, 1, Id::Tim6),
    (0x4000_1400, 1, Id::Tim7),
    (0x4000_1800, 1, Id::Tim12),
    (0x4000_1C00, 1, Id::Tim13),
    (0x4000_2000, 1, Id::Tim14),
    (0x4000_4400, 1, Id::Usart2),
    (0x4000_4800, 1, Id::Usart3),
    (0x4000_4C00, 1, Id::Uart4),
    (0x4000_5000, 1, Id::Uart5),
    (0x4000_5400, 1, Id::I2c1),
    (0x4000_5800, 1, Id::I2c2),
    (0x4000_5C00, 1, Id::I2c3),
    (0x4000_7400, 1, Id::Dac1),
    (0x4000_7800, 1, Id::Uart7),
    (0x4000_7C00, 1, Id::Uart8),
    (0x4000_8400, 1, Id::Crs),
    // FDCAN1, FDCAN2, their clock calibration unit and the message RAM.
    (0x4000_A000, 13, Id::Fdcan),
    (0x4001_0000, 1, Id::Tim1),
    (0x4001_0400, 1, Id::Tim8),
    (0x4001_1000, 1, Id::Usart1),
    (0x4001_1400, 1, Id::Usart6),
    (0x4001_3000, 1, Id::Spi1),
    (0x4001_4000, 1, Id::Tim15),
    (0x4001_4400, 1, Id::Tim16),
    (0x4001_4800, 1, Id::Tim17),
    // DMA1, DMA2, DMAMUX1.
    (0x4002_0000, 3, Id::Dma),
    (0x4002_2000, 1, Id::Adc12),
    // OTG2, full speed.
    (0x4008_0000, 256, Id::Usb),
    (0x4802_1800, 1, Id::Rng),
    (0x5200_2000, 4, Id::Flash),
    (0x5200_4000, 4, Id::Fmc),
    (0x5800_0000, 1, Id::Exti),
    (0x5800_0400, 1, Id::Syscfg),
    (0x5800_1C00, 1, Id::I2c4),
    (0x5800_4000, 1, Id::Backup),
    (0x5800_4800, 1, Id::Iwdg),
    // GPIOA to GPIOK.
    (0x5802_0000, 11, Id::Gpio),
    (0x5802_4400, 1, Id::Rcc),
    (0x5802_4800, 1, Id::Pwr),
    (0x5802_4C00, 1, Id::Crc),
    // BDMA, DMAMUX2.
    (0x5802_5400, 2, Id::Bdma),
    (0x5C00_1000, 1, Id::Dbgmcu),
];

impl Id {
    /// Number of peripherals in the map.
    pub(super) const COUNT: usize = Self::Crc as usize + 1;

    /// Iterates over all peripherals in order of their discriminants.
    #[cfg(test)]
    fn all() -> impl Iterator<Item = Self> {
        let mut all: Vec<Self> = MAP.iter().map(|(_, _, id)| *id).collect();
        all.sort_unstable();
        all.into_iter()
    }
}

/// Returns the first address of each peripheral, by place.
pub(super) fn bases() -> [u32; Id::COUNT] {
    let mut bases = [0; Id::COUNT];
    MAP.iter().for_each(|(base, _, id)| bases[*id as usize] = *base);
    bases
}

/// Returns the name of each peripheral, by place.
pub(super) fn names() -> [String; Id::COUNT] {
    let mut names = [const { String::new() }; Id::COUNT];
    MAP.iter().for_each(|(_, _, id)| names[*id as usize] = format!("{id:?}"));
    names
}

/// Returns the address of each word in the map, in no order.
#[cfg(test)]
pub(super) fn words() -> impl Iterator<Item = u32> {
    MAP.iter().flat_map(|(base, count, _)| (*base..base + (count << 10)).step_by(4))
}

/// Fast map from an address to a peripheral: one byte for each KiB of peripheral space.
pub(super) struct AddressMap(Box<[u8]>);

const FIRST: u32 = 0x4000_0000;
/// Address block of the engraved identity, which is outside the peripheral space.
const IDENTITY: u32 = 0x1FF1_E800;
const END: u32 = 0x5C00_2000;
const NOTHING: u8 = u8::MAX;

impl AddressMap {
    pub(super) fn new() -> Self {
        let mut blocks = vec![NOTHING; ((END - FIRST) >> 10) as usize].into_boxed_slice();
        for (base, count, id) in MAP.iter().filter(|(base, _, _)| *base != IDENTITY) {
            let first = ((base - FIRST) >> 10) as usize;
            blocks[first..first + *count as usize].fill(*id as u8);
        }
        Self(blocks)
    }

    /// Returns the place of the peripheral, the value of its [`Id`]; `None` outside all peripherals.
    #[inline]
    pub(super) fn find(&self, address: u32) -> Option<usize> {
        if address & !0x3FF == IDENTITY {
            return Some(Id::Identity as usize);
        }
        let block = address.checked_sub(FIRST)? >> 10;
        self.0.get(block as usize).map(|index| usize::from(*index)).filter(|index| *index < Id::COUNT)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_peripheral_has_one_row_and_no_two_share_a_block() {
        let all: Vec<_> = Id::all().collect();
        assert_eq!(all.len(), Id::COUNT);
        assert!(all.iter().enumerate().all(|(index, id)| *id as usize == index));
        let mut rows: Vec<_> = MAP.iter().map(|(base, count, _)| (*base, base + (count << 10))).collect();
        rows.sort_unstable();
        assert!(rows.windows(2).all(|pair| pair[0].1 <= pair[1].0));
    }

    #[test]
    fn addresses_are_found_to_the_last_byte() {
        let map = AddressMap::new();
        assert_eq!(map.find(0x5802_4400), Some(Id::Rcc as usize));
        assert_eq!(map.find(0x5802_2BFF), Some(Id::Gpio as usize));
        assert_eq!(map.find(0x5802_2C00), None);
        assert_eq!(map.find(0x4000_0000), Some(Id::Tim2 as usize));
        assert_eq!(map.find(0x3FFF_FFFF), None);
        assert_eq!(map.find(0x5C00_1004), Some(Id::Dbgmcu as usize));
        assert_eq!(map.find(0xFFFF_FFFF), None);
    }
}
