//! Commands and bits (Microchip DS22187E, sections 5.4 to 5.6).

/// Command of the first byte after the address: C2 C1 C0, and W1 W0 where C is 010 (table 5-1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Command {
    /// 00X: codes and power-down bits of A, B, C, D in order (figure 5-7).
    FastWrite,
    /// 010 00: input registers, each with its channel (figure 5-8).
    MultiWrite,
    /// 010 10: input registers and EEPROM, from a channel up to D (figure 5-9).
    SequentialWrite,
    /// 010 11: one input register and its EEPROM (figure 5-10).
    SingleWrite,
    /// 011: address bits (figure 5-11).
    Address,
    /// 100: reference of all channels (figure 5-12).
    Reference,
    /// 101: power-down of all channels, in two bytes (figure 5-13).
    PowerDown,
    /// 110: gain of all channels (figure 5-14).
    Gain,
}

impl Command {
    /// Command of a byte; `None` for 010 01 and 111, which the table does not define.
    pub(super) const fn decode(byte: u8) -> Option<Self> {
        match (byte >> 5, byte >> 3 & 0b11) {
            (0b000 | 0b001, _) => Some(Self::FastWrite),
            (0b010, 0b00) => Some(Self::MultiWrite),
            (0b010, 0b10) => Some(Self::SequentialWrite),
            (0b010, 0b11) => Some(Self::SingleWrite),
            (0b011, _) => Some(Self::Address),
            (0b100, _) => Some(Self::Reference),
            (0b101, _) => Some(Self::PowerDown),
            (0b110, _) => Some(Self::Gain),
            _ => None,
        }
    }
}

/// Channel bits DAC1 DAC0 of a multi-write, sequential or single write.
pub(super) const fn channel(byte: u8) -> usize {
    (byte >> 1 & 0b11) as usize
}

/// UDAC bit of a multi-write, sequential or single write: 0 also updates the output of the channel (table 4-5).
pub(super) const fn updates_output(byte: u8) -> bool {
    byte & 0b1 == 0
}

/// Second byte of a general call (5.4).
pub(super) mod general_call {
    /// Loads the EEPROM into input and output registers (5.4.1).
    pub(in super::super) const RESET: u8 = 0x06;
    /// Copies input into output registers (5.4.3).
    pub(in super::super) const UPDATE: u8 = 0x08;
    /// Clears the power-down bits (5.4.2).
    pub(in super::super) const WAKE_UP: u8 = 0x09;
    /// Reads the address bits, together with LDAC (5.4.4).
    pub(in super::super) const READ_ADDRESS: u8 = 0x0C;
}

/// Bits of a channel's 16-bit setting.
pub(super) mod setting {
    /// Reference: 1 internal, 0 the supply.
    pub(in super::super) const VREF: u16 = 0x8000;
    /// Power-down: 00 is normal operation, otherwise the output is loaded with 1, 100 or 500 kOhm (table 4-7).
    pub(in super::super) const PD: u16 = 0x6000;
    /// Gain: 1 doubles the internal reference.
    pub(in super::super) const GX: u16 = 0x1000;
    /// Twelve-bit code of the output.
    pub(in super::super) const CODE: u16 = 0x0FFF;
}

/// First byte of every three in a read (figure 5-15); DAC1 DAC0 are bits 5 and 4, A2 A1 A0 bits 2 to 0.
pub(super) mod status {
    /// RDY/BSY: 0 during a write of the EEPROM.
    pub(in super::super) const READY: u8 = 0x80;
    /// Power-on reset: 1 while powered.
    pub(in super::super) const POR: u8 = 0x40;
}

/// Fixed address bits: `1100`, then A2 A1 A0 (5.3).
pub(super) const ADDRESS: u8 = 0x60;
/// Address bits stored in the EEPROM.
pub(super) const ADDRESS_BITS: u8 = 0x07;
/// Voltage of the internal reference, V (1.0, electrical characteristics).
pub(super) const INTERNAL_REFERENCE_V: f64 = 2.048;
/// Number of codes of an output (4.9).
pub(super) const CODES: f64 = 4096.0;
/// Shortest low pulse of LDAC that updates the outputs for certain, ns (1.0, electrical characteristics).
pub(super) const LDAC_LOW_NS: u64 = 210;
