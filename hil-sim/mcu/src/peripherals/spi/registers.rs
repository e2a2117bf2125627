//! Offsets and bits of the registers (RM0399, 53.11).

pub(super) const CR1: u32 = 0x00;
pub(super) const CR2: u32 = 0x04;
pub(super) const CFG1: u32 = 0x08;
pub(super) const CFG2: u32 = 0x0C;
pub(super) const IER: u32 = 0x10;
pub(super) const SR: u32 = 0x14;
pub(super) const IFCR: u32 = 0x18;
pub(super) const TXDR: u32 = 0x20;
pub(super) const RXDR: u32 = 0x30;
pub(super) const CRCPOLY: u32 = 0x40;
pub(super) const TXCRC: u32 = 0x44;
pub(super) const RXCRC: u32 = 0x48;
pub(super) const UDRDR: u32 = 0x4C;
pub(super) const I2SCFGR: u32 = 0x50;

/// Bits of the register CR1.
pub(super) mod cr1 {
    pub(crate) const SPE: u32 = 1 << 0;
    pub(crate) const MASRX: u32 = 1 << 8;
    pub(crate) const CSTART: u32 = 1 << 9;
    pub(crate) const CSUSP: u32 = 1 << 10;
    pub(crate) const SSI: u32 = 1 << 12;
    pub(crate) const IOLOCK: u32 = 1 << 16;
    pub(crate) const ALL: u32 = 0x0001_FF01;
}

/// Bits of the register CFG1.
pub(super) mod cfg1 {
    pub(crate) const DSIZE: u32 = 0x1F;
    pub(crate) const FTHLV_AT: u32 = 5;
    pub(crate) const RXDMAEN: u32 = 1 << 14;
    pub(crate) const TXDMAEN: u32 = 1 << 15;
    pub(crate) const CRCEN: u32 = 1 << 22;
    pub(crate) const MBR_AT: u32 = 28;
    pub(crate) const ALL: u32 = 0x705F_DFFF;
}

/// Bits of the register CFG2.
pub(super) mod cfg2 {
    pub(crate) const MSSI: u32 = 0xF;
    pub(crate) const MIDI_AT: u32 = 4;
    pub(crate) const COMM_AT: u32 = 17;
    pub(crate) const SP: u32 = 7 << 19;
    pub(crate) const MASTER: u32 = 1 << 22;
    pub(crate) const LSBFRST: u32 = 1 << 23;
    pub(crate) const SSM: u32 = 1 << 26;
    pub(crate) const SSIOP: u32 = 1 << 28;
    pub(crate) const SSOE: u32 = 1 << 29;
    pub(crate) const ALL: u32 = 0xF7FE_80FF;
}

/// Bits of SR; those of IER and IFCR are at the same places.
pub(super) mod sr {
    pub(crate) const RXP: u32 = 1 << 0;
    pub(crate) const TXP: u32 = 1 << 1;
    pub(crate) const DXP: u32 = 1 << 2;
    pub(crate) const EOT: u32 = 1 << 3;
    pub(crate) const TXTF: u32 = 1 << 4;
    pub(crate) const OVR: u32 = 1 << 6;
    pub(crate) const MODF: u32 = 1 << 9;
    pub(crate) const TSERF: u32 = 1 << 10;
    pub(crate) const SUSP: u32 = 1 << 11;
    pub(crate) const TXC: u32 = 1 << 12;
    pub(crate) const RXPLVL_AT: u32 = 13;
    pub(crate) const RXWNE: u32 = 1 << 15;
    pub(crate) const CTSIZE_AT: u32 = 16;
    /// Flags that IFCR clears.
    pub(crate) const CLEARED: u32 = 0xFF8;
}
