//! Commands (Ilitek ILI9488 datasheet, chapter 5), bits and times.

pub(super) const NOP: u8 = 0x00;
/// Software reset command (SWRESET).
pub(super) const SWRESET: u8 = 0x01;
/// Read display identification: three bytes.
pub(super) const RDDID: u8 = 0x04;
/// Read display power mode (RDDPM): one byte.
pub(super) const RDDPM: u8 = 0x0A;
/// Read display MADCTL (RDDMADCTL): one byte.
pub(super) const RDDMADCTL: u8 = 0x0B;
/// Read display pixel format (RDDCOLMOD): one byte.
pub(super) const RDDCOLMOD: u8 = 0x0C;
pub(super) const SLPIN: u8 = 0x10;
pub(super) const SLPOUT: u8 = 0x11;
/// Normal display mode on.
pub(super) const NORON: u8 = 0x13;
pub(super) const INVOFF: u8 = 0x20;
pub(super) const INVON: u8 = 0x21;
pub(super) const DISPOFF: u8 = 0x28;
pub(super) const DISPON: u8 = 0x29;
/// Column address set: first and last column of the window.
pub(super) const CASET: u8 = 0x2A;
/// Page address set: first and last page of the window.
pub(super) const PASET: u8 = 0x2B;
/// Memory write, from the start of the window.
pub(super) const RAMWR: u8 = 0x2C;
/// Memory access control: scan directions and colour order.
pub(super) const MADCTL: u8 = 0x36;
/// Interface pixel format: bits per pixel.
pub(super) const COLMOD: u8 = 0x3A;
/// Memory write that continues at the end of the last one.
pub(super) const RAMWRC: u8 = 0x3C;
/// Read ID4: the controller's name.
pub(super) const RDID4: u8 = 0xD3;

/// Commands of panel makers, with their number of parameters: interface mode, frame rates, inversion, blanking, display
/// function, entry mode, power, VCOM, gamma, adjustments. They configure the glass and have no effect on the memory.
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

/// MADCTL: pages in reverse order.
pub(super) const MY: u8 = 0x80;
/// MADCTL: columns in reverse order.
pub(super) const MX: u8 = 0x40;
/// MADCTL: pages and columns exchanged.
pub(super) const MV: u8 = 0x20;
/// MADCTL: red and blue exchanged on the way to the glass.
pub(super) const BGR: u8 = 0x08;

/// COLMOD: 18 bits per pixel for RGB and MCU interface; the value after a reset.
pub(super) const FORMAT_18: u8 = 0x66;
/// COLMOD: bits of the MCU interface.
pub(super) const FORMAT_MCU: u8 = 0x07;

/// Shortest reset pulse, ns (17.3, tRESW).
pub(super) const RESET_LOW_NS: u64 = 10_000;
/// Longest pulse that is filtered out, ns (17.3).
pub(super) const RESET_FILTERED_NS: u64 = 5_000;
/// Time from a reset, SLPOUT or SLPIN to the next command, ns.
pub(super) const SETTLE_NS: u64 = 5_000_000;
/// Time from a reset to SLPOUT, and between SLPIN and SLPOUT, ns.
pub(super) const SLEEP_NS: u64 = 120_000_000;
/// Eight cycles of the serial clock, ns, each 50 ns when writing (17.4.3).
pub(super) const BYTE_NS: u64 = 400;
