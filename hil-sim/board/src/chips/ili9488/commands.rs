//! Commands (Ilitek ILI9488 datasheet, chapter 5), bits and times, and nothing else.

pub(super) const NOP: u8 = 0x00;
/// Software reset.
pub(super) const SWRESET: u8 = 0x01;
/// Read display identification: three bytes.
pub(super) const RDDID: u8 = 0x04;
/// Read display power mode.
pub(super) const RDDPM: u8 = 0x0A;
/// Read display MADCTL.
pub(super) const RDDMADCTL: u8 = 0x0B;
/// Read display pixel format.
pub(super) const RDDCOLMOD: u8 = 0x0C;
pub(super) const SLPIN: u8 = 0x10;
pub(super) const SLPOUT: u8 = 0x11;
/// Normal display mode on.
pub(super) const NORON: u8 = 0x13;
pub(super) const INVOFF: u8 = 0x20;
pub(super) const INVON: u8 = 0x21;
pub(super) const DISPOFF: u8 = 0x28;
pub(super) const DISPON: u8 = 0x29;
/// Column address set.
pub(super) const CASET: u8 = 0x2A;
/// Page address set.
pub(super) const PASET: u8 = 0x2B;
/// Memory write, from the start of the window.
pub(super) const RAMWR: u8 = 0x2C;
/// Memory access control.
pub(super) const MADCTL: u8 = 0x36;
/// Interface pixel format.
pub(super) const COLMOD: u8 = 0x3A;
/// Memory write, from where the last one ended.
pub(super) const RAMWRC: u8 = 0x3C;
/// Read ID4: the controller's name.
pub(super) const RDID4: u8 = 0xD3;

/// Commands of panel makers, with their parameters: interface mode, frame rates, inversion, blanking, display function,
/// entry mode, power, VCOM, gamma, adjustments. They change what the glass needs, and no memory.
pub(super) const PANEL: [(u8, usize); 17] = [
    (0xB0, 1),
    (0xB1, 2),
    (0xB2, 2),
    (0xB3, 2),
    (0xB4, 1),
    (0xB5, 4),
    (0xB6, 3),
    (0xB7, 1),
    (0xC0, 2),
    (0xC1, 1),
    (0xC2, 1),
    (0xC5, 4),
    (0xE0, 15),
    (0xE1, 15),
    (0xE9, 1),
    (0xF7, 4),
    (0x51, 1),
];

/// MADCTL: pages run backwards.
pub(super) const MY: u8 = 0x80;
/// MADCTL: columns run backwards.
pub(super) const MX: u8 = 0x40;
/// MADCTL: the window's columns are the memory's pages.
pub(super) const MV: u8 = 0x20;
/// MADCTL: red and blue change places on the way to the glass.
pub(super) const BGR: u8 = 0x08;

/// COLMOD: 18 bits per pixel for RGB and MCU interface; the value after a reset.
pub(super) const FORMAT_18: u8 = 0x66;
/// COLMOD, bits of the MCU interface.
pub(super) const FORMAT_MCU: u8 = 0x07;

/// Shortest reset pulse (17.3, tRESW).
pub(super) const RESET_LOW_NS: u64 = 10_000;
/// Pulses up to this are filtered out (17.3).
pub(super) const RESET_FILTERED_NS: u64 = 5_000;
/// From a reset, or from SLPOUT or SLPIN, to the next command.
pub(super) const SETTLE_NS: u64 = 5_000_000;
/// From a reset to SLPOUT, and between SLPIN and SLPOUT.
pub(super) const SLEEP_NS: u64 = 120_000_000;
/// Eight cycles of the serial clock, 50 ns each when writing (17.4.3).
pub(super) const BYTE_NS: u64 = 400;
