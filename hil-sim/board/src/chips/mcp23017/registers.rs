//! Registers, their addresses and bits (Microchip DS20001952D, sections 3.2 and 3.5).

use super::Port;

/// Registers of a port, in the order of their addresses (tables 3-2 to 3-5).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Register {
    /// Direction (3.5.1): 1 is an input.
    Iodir,
    /// Input polarity (3.5.2): 1 inverts the value of GPIO.
    Ipol,
    /// Interrupt-on-change enable (3.5.3): 1 enables a pin.
    Gpinten,
    /// Default levels for comparison where INTCON is 1 (3.5.4).
    Defval,
    /// Interrupt control (3.5.5): 1 compares with DEFVAL, 0 with the previous level.
    Intcon,
    /// Configuration (3.5.6); one register at two addresses.
    Iocon,
    /// Pull-up resistors of the inputs, 100 kOhm (3.5.7).
    Gppu,
    /// Interrupt flags (3.5.8); read-only.
    Intf,
    /// Captured GPIO at the time of the interrupt (3.5.9); read-only.
    Intcap,
    /// Levels of the pins (3.5.10); a write goes to OLAT.
    Gpio,
    /// Output latches (3.5.11): levels of the outputs.
    Olat,
}

const ALL: [Register; 11] = [
    Register::Iodir,
    Register::Ipol,
    Register::Gpinten,
    Register::Defval,
    Register::Intcon,
    Register::Iocon,
    Register::Gppu,
    Register::Intf,
    Register::Intcap,
    Register::Gpio,
    Register::Olat,
];

/// Bits of IOCON. All 0 after reset.
pub(super) mod iocon {
    /// Registers of the ports in two blocks, from 00h and from 10h, instead of in pairs.
    pub(in super::super) const BANK: u8 = 0x80;
    /// Both INT pins signal both ports.
    pub(in super::super) const MIRROR: u8 = 0x40;
    /// Byte mode: the address pointer does not increment.
    pub(in super::super) const SEQOP: u8 = 0x20;
    /// INT pins are open drain; overrides INTPOL.
    pub(in super::super) const ODR: u8 = 0x04;
    /// INT pins are active high.
    pub(in super::super) const INTPOL: u8 = 0x02;
    /// Writable bits. Bit 0 is not implemented. DISSLW (bit 4, slew rate of SDA) and HAEN (bit 3, of the SPI variant)
    /// are stored without effect.
    pub(in super::super) const WRITABLE: u8 = 0xFE;
}

/// IODIR after reset: all pins are inputs. Every other register is 0.
pub(super) const IODIR_RESET: u8 = 0xFF;

/// Fixed address bits: `0100`, then A2 A1 A0.
pub(super) const ADDRESS: u8 = 0x20;
/// Address bits given by the pins.
pub(super) const ADDRESS_PINS: u8 = 0x07;

/// Register and port at an address; `None` if there is none.
pub(super) fn decode(address: u8, bank: bool) -> Option<(Register, Port)> {
    let (index, second) = if bank { (address & 0xEF, address & 0x10 != 0) } else { (address >> 1, address & 1 != 0) };
    let register = *ALL.get(usize::from(index))?;
    Some((register, if second { Port::B } else { Port::A }))
}

/// Next pointer in sequential mode; it wraps from the last register to 0 (3.2.1).
pub(super) const fn after(address: u8, bank: bool) -> u8 {
    let last = if bank { 0x1A } else { 0x15 };
    if address == last { 0 } else { address.wrapping_add(1) }
}
