//! Assignment of the bits of the enable and reset registers (RM0399, 9.7); each block has the same place in both.

/// Number of register groups: AHB3, AHB1, AHB2, AHB4, APB3, APB1L, APB1H, APB2, APB4, in the order of the registers.
pub(super) const GROUPS: usize = 9;

const AHB3: usize = 0;
const AHB1: usize = 1;
const AHB2: usize = 2;
const AHB4: usize = 3;
const APB3: usize = 4;
const APB1L: usize = 5;
const APB1H: usize = 6;
const APB2: usize = 7;
const APB4: usize = 8;

/// Base addresses of peripherals and memories with a clock of their own, with the group and the bits; any one of these
/// bits enables the clock.
#[rustfmt::skip]
const TABLE: [(u32, usize, u32); 88] = [
    (0x5200_0000, AHB3, 1 << 0), // MDMA
    (0x5200_1000, AHB3, 1 << 4), // DMA2D
    (0x5200_3000, AHB3, 1 << 5), // JPEG
    (0x5200_4000, AHB3, 1 << 12), // FMC
    (0x5200_5000, AHB3, 1 << 14), // QUADSPI
    (0x5200_7000, AHB3, 1 << 16), // SDMMC1
    (0x4002_0000, AHB1, 1 << 0), // DMA1
    (0x4002_0400, AHB1, 1 << 1), // DMA2
    (0x4002_0800, AHB1, 0b11), // DMAMUX1
    (0x4002_2000, AHB1, 1 << 5), // ADC1 and ADC2
    (0x4002_4400, AHB1, 1 << 14), // ART
    (0x4002_8000, AHB1, 1 << 15), // ETH
    (0x4004_0000, AHB1, 1 << 25), // OTG_HS
    (0x4008_0000, AHB1, 1 << 27), // OTG_FS
    (0x4802_0000, AHB2, 1 << 0), // DCMI
    (0x4802_1800, AHB2, 1 << 6), // RNG
    (0x4802_2400, AHB2, 1 << 9), // SDMMC2
    (0x3000_0000, AHB2, 1 << 29), // SRAM1
    (0x3002_0000, AHB2, 1 << 30), // SRAM2
    (0x3004_0000, AHB2, 1 << 31), // SRAM3
    (0x5802_0000, AHB4, 1 << 0), // GPIOA
    (0x5802_0400, AHB4, 1 << 1),
    (0x5802_0800, AHB4, 1 << 2),
    (0x5802_0C00, AHB4, 1 << 3),
    (0x5802_1000, AHB4, 1 << 4),
    (0x5802_1400, AHB4, 1 << 5),
    (0x5802_1800, AHB4, 1 << 6),
    (0x5802_1C00, AHB4, 1 << 7),
    (0x5802_2000, AHB4, 1 << 8),
    (0x5802_2400, AHB4, 1 << 9),
    (0x5802_2800, AHB4, 1 << 10), // GPIOK
    (0x5802_4C00, AHB4, 1 << 19), // CRC
    (0x5802_5400, AHB4, 1 << 21), // BDMA
    (0x5802_5800, AHB4, 1 << 21), // DMAMUX2
    (0x5802_6000, AHB4, 1 << 24), // ADC3
    (0x5802_6400, AHB4, 1 << 25), // HSEM
    (0x3880_0000, AHB4, 1 << 28), // backup SRAM
    (0x5000_1000, APB3, 1 << 3), // LTDC
    (0x5000_0000, APB3, 1 << 4), // DSI
    (0x5000_3000, APB3, 1 << 6), // WWDG1
    (0x4000_0000, APB1L, 1 << 0), // TIM2
    (0x4000_0400, APB1L, 1 << 1),
    (0x4000_0800, APB1L, 1 << 2),
    (0x4000_0C00, APB1L, 1 << 3),
    (0x4000_1000, APB1L, 1 << 4),
    (0x4000_1400, APB1L, 1 << 5), // TIM7
    (0x4000_1800, APB1L, 1 << 6), // TIM12
    (0x4000_1C00, APB1L, 1 << 7),
    (0x4000_2000, APB1L, 1 << 8), // TIM14
    (0x4000_2400, APB1L, 1 << 9), // LPTIM1
    (0x4000_3800, APB1L, 1 << 14), // SPI2
    (0x4000_3C00, APB1L, 1 << 15), // SPI3
    (0x4000_4400, APB1L, 1 << 17), // USART2
    (0x4000_4800, APB1L, 1 << 18), // USART3
    (0x4000_4C00, APB1L, 1 << 19), // UART4
    (0x4000_5000, APB1L, 1 << 20), // UART5
    (0x4000_5400, APB1L, 1 << 21), // I2C1
    (0x4000_5800, APB1L, 1 << 22), // I2C2
    (0x4000_5C00, APB1L, 1 << 23), // I2C3
    (0x4000_7400, APB1L, 1 << 29), // DAC1
    (0x4000_7800, APB1L, 1 << 30), // UART7
    (0x4000_7C00, APB1L, 1 << 31), // UART8
    (0x4000_8400, APB1H, 1 << 1), // CRS
    (0x4000_9000, APB1H, 1 << 4), // OPAMP
    (0x4000_A000, APB1H, 1 << 8), // FDCAN1
    (0x4000_A400, APB1H, 1 << 8), // FDCAN2
    (0x4000_A800, APB1H, 1 << 8), // clock calibration unit of the FDCANs
    (0x4000_AC00, APB1H, 1 << 8), // message RAM of the FDCANs
    (0x4001_0000, APB2, 1 << 0), // TIM1
    (0x4001_0400, APB2, 1 << 1), // TIM8
    (0x4001_1000, APB2, 1 << 4), // USART1
    (0x4001_1400, APB2, 1 << 5), // USART6
    (0x4001_3000, APB2, 1 << 12), // SPI1
    (0x4001_3400, APB2, 1 << 13), // SPI4
    (0x4001_4000, APB2, 1 << 16), // TIM15
    (0x4001_4400, APB2, 1 << 17), // TIM16
    (0x4001_4800, APB2, 1 << 18), // TIM17
    (0x4001_5000, APB2, 1 << 20), // SPI5
    (0x5800_0400, APB4, 1 << 1), // SYSCFG
    (0x5800_0C00, APB4, 1 << 3), // LPUART1
    (0x5800_1400, APB4, 1 << 5), // SPI6
    (0x5800_1C00, APB4, 1 << 7), // I2C4
    (0x5800_2400, APB4, 1 << 9), // LPTIM2
    (0x5800_2800, APB4, 1 << 10),
    (0x5800_2C00, APB4, 1 << 11),
    (0x5800_3000, APB4, 1 << 12), // LPTIM5
    (0x5800_3C00, APB4, 1 << 15), // VREFBUF
    (0x5800_4000, APB4, 1 << 16), // RTC
];

/// Returns the group and bits of a base address; `None` for blocks without a clock enable.
pub(super) fn bits_of(base: u32) -> Option<(usize, u32)> {
    TABLE.iter().find(|(address, ..)| *address == base).map(|(_, group, bits)| (*group, *bits))
}

/// Returns the base addresses of the blocks that the bits of a reset register reset.
pub(super) fn bases_of(group: usize, bits: u32) -> impl Iterator<Item = u32> {
    // The RTC, the window watchdogs and memories have an enable bit but no reset bit: WRITABLE keeps those out of
    // `bits`.
    TABLE
        .iter()
        .filter(move |(base, in_group, of)| *in_group == group && *base != 0x4002_0800 && of & bits != 0)
        .map(|(base, ..)| *base)
}

/// Masks of the bits that exist in the enable registers.
pub(super) const ENABLES: [u32; GROUPS] = [
    0xF001_5131,
    0x1E03_C023,
    0xE000_0271,
    0x1328_07FF,
    0x0000_0058,
    0xE8FF_CBFF,
    0x0000_0136,
    0x31D7_3033,
    0x0021_DEAA,
];

/// Masks of the bits that exist in the reset registers.
pub(super) const RESETS: [u32; GROUPS] = [
    0x0001_5031,
    0x0A00_C023,
    0x0000_0271,
    0x0328_07FF,
    0x0000_0018,
    0xE8FF_C3FF,
    0x0000_0136,
    0x31D7_3033,
    0x0020_DEAA,
];

/// Enable registers after a reset: RTCAPBEN is set.
pub(super) const ENABLES_AT_RESET: [u32; GROUPS] = [0, 0, 0, 0, 0, 0, 0, 0, 1 << 16];
