//! Offsets and bits of the registers (RM0399, 50.7).

pub(super) const CR1: u32 = 0x00;
pub(super) const CR2: u32 = 0x04;
pub(super) const OAR1: u32 = 0x08;
pub(super) const OAR2: u32 = 0x0C;
pub(super) const TIMINGR: u32 = 0x10;
pub(super) const TIMEOUTR: u32 = 0x14;
pub(super) const ISR: u32 = 0x18;
pub(super) const ICR: u32 = 0x1C;
pub(super) const PECR: u32 = 0x20;
pub(super) const RXDR: u32 = 0x24;
pub(super) const TXDR: u32 = 0x28;

/// Bits of the register CR1.
pub(super) mod cr1 {
    pub(crate) const PE: u32 = 1 << 0;
    pub(crate) const TXIE: u32 = 1 << 1;
    pub(crate) const RXIE: u32 = 1 << 2;
    pub(crate) const NACKIE: u32 = 1 << 4;
    pub(crate) const STOPIE: u32 = 1 << 5;
    pub(crate) const TCIE: u32 = 1 << 6;
    pub(crate) const ERRIE: u32 = 1 << 7;
    pub(crate) const DNF_AT: u32 = 8;
    pub(crate) const ANFOFF: u32 = 1 << 12;
    pub(crate) const TXDMAEN: u32 = 1 << 14;
    pub(crate) const RXDMAEN: u32 = 1 << 15;
    pub(crate) const NOSTRETCH: u32 = 1 << 17;
    /// Bits of target mode and SMBus: SBC, WUPEN, GCEN, SMBHEN, SMBDEN, ALERTEN, PECEN.
    pub(crate) const UNMODELLED: u32 = 1 << 16 | 0x3F << 18;
    /// Bits that are writable only while PE is 0.
    pub(crate) const LOCKED: u32 = 0xF << DNF_AT | ANFOFF | NOSTRETCH;
    pub(crate) const ALL: u32 = 0x00FF_DFFF;
}

/// Bits of the register CR2.
pub(super) mod cr2 {
    pub(crate) const SADD: u32 = 0x3FF;
    pub(crate) const RD_WRN: u32 = 1 << 10;
    pub(crate) const ADD10: u32 = 1 << 11;
    pub(crate) const HEAD10R: u32 = 1 << 12;
    pub(crate) const START: u32 = 1 << 13;
    pub(crate) const STOP: u32 = 1 << 14;
    pub(crate) const NACK: u32 = 1 << 15;
    pub(crate) const NBYTES_AT: u32 = 16;
    pub(crate) const NBYTES: u32 = 0xFF << NBYTES_AT;
    pub(crate) const RELOAD: u32 = 1 << 24;
    pub(crate) const AUTOEND: u32 = 1 << 25;
    pub(crate) const PECBYTE: u32 = 1 << 26;
    /// Bits set by writing 1, and cleared by the hardware only.
    pub(crate) const SET_ONLY: u32 = START | STOP | NACK;
    /// Bits that must not change while START is set.
    pub(crate) const FIXED_BY_START: u32 = SADD | RD_WRN | ADD10 | HEAD10R | NBYTES;
    pub(crate) const ALL: u32 = 0x07FF_FFFF;
}

/// Bits of the register TIMEOUTR.
pub(super) mod timeoutr {
    pub(crate) const TIMEOUTA: u32 = 0xFFF;
    pub(crate) const TIDLE: u32 = 1 << 12;
    pub(crate) const TIMOUTEN: u32 = 1 << 15;
    pub(crate) const TEXTEN: u32 = 1 << 31;
    /// All bits that exist.
    pub(crate) const ALL: u32 = 0x8FFF_9FFF;
}

/// Bits of ISR; those of ICR are at the same places.
pub(super) mod isr {
    pub(crate) const TXE: u32 = 1 << 0;
    pub(crate) const TXIS: u32 = 1 << 1;
    pub(crate) const RXNE: u32 = 1 << 2;
    pub(crate) const ADDR: u32 = 1 << 3;
    pub(crate) const NACKF: u32 = 1 << 4;
    pub(crate) const STOPF: u32 = 1 << 5;
    pub(crate) const TC: u32 = 1 << 6;
    pub(crate) const TCR: u32 = 1 << 7;
    pub(crate) const BERR: u32 = 1 << 8;
    pub(crate) const ARLO: u32 = 1 << 9;
    pub(crate) const OVR: u32 = 1 << 10;
    pub(crate) const PECERR: u32 = 1 << 11;
    pub(crate) const TIMEOUT: u32 = 1 << 12;
    pub(crate) const ALERT: u32 = 1 << 13;
    pub(crate) const BUSY: u32 = 1 << 15;
    /// Flags of the error interrupt.
    pub(crate) const ERRORS: u32 = BERR | ARLO | OVR | PECERR | TIMEOUT | ALERT;
    /// Flags that ICR clears.
    pub(crate) const CLEARED_BY_ICR: u32 = NACKF | STOPF | ERRORS;
}
