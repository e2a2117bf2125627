//! Offsets and bits of the registers (RM0399, section 51.8, USART registers).

pub(super) const CR1: u32 = 0x00;
pub(super) const CR2: u32 = 0x04;
pub(super) const CR3: u32 = 0x08;
pub(super) const BRR: u32 = 0x0C;
pub(super) const RTOR: u32 = 0x14;
pub(super) const RQR: u32 = 0x18;
pub(super) const ISR: u32 = 0x1C;
pub(super) const ICR: u32 = 0x20;
pub(super) const RDR: u32 = 0x24;
pub(super) const TDR: u32 = 0x28;
pub(super) const PRESC: u32 = 0x2C;

/// Bits of the register CR1.
pub(super) mod cr1 {
    pub(crate) const UE: u32 = 1 << 0;
    pub(crate) const RE: u32 = 1 << 2;
    pub(crate) const TE: u32 = 1 << 3;
    pub(crate) const IDLEIE: u32 = 1 << 4;
    pub(crate) const RXNEIE: u32 = 1 << 5;
    pub(crate) const TCIE: u32 = 1 << 6;
    pub(crate) const TXEIE: u32 = 1 << 7;
    pub(crate) const PEIE: u32 = 1 << 8;
    pub(crate) const PS: u32 = 1 << 9;
    pub(crate) const PCE: u32 = 1 << 10;
    pub(crate) const WAKE: u32 = 1 << 11;
    pub(crate) const M0: u32 = 1 << 12;
    pub(crate) const MME: u32 = 1 << 13;
    pub(crate) const CMIE: u32 = 1 << 14;
    pub(crate) const OVER8: u32 = 1 << 15;
    pub(crate) const DEDT_DEAT: u32 = 0x3FF << 16;
    pub(crate) const RTOIE: u32 = 1 << 26;
    pub(crate) const M1: u32 = 1 << 28;
    pub(crate) const FIFOEN: u32 = 1 << 29;
    pub(crate) const TXFEIE: u32 = 1 << 30;
    pub(crate) const RXFFIE: u32 = 1 << 31;

    /// Bits that are writable only while UE is 0.
    pub(crate) const LOCKED: u32 = PS | PCE | WAKE | M0 | OVER8 | DEDT_DEAT | M1 | FIFOEN;
}

/// Bits of the register CR2.
pub(super) mod cr2 {
    pub(crate) const STOP_AT: u32 = 12;
    pub(crate) const RTOEN: u32 = 1 << 23;
    pub(crate) const ADD_AT: u32 = 24;
    /// Modelled bits: STOP, RTOEN, ADD; the bits of synchronous, slave, LIN and inverted modes and of baud-rate
    /// detection are not. CPHA, CPOL, LBCL, LBDL, ADDM7 and ABRMOD have no effect alone.
    pub(crate) const MODELLED: u32 = 3 << STOP_AT | RTOEN | 0xFF << ADD_AT | 0b11 << 21 | 0b111 << 8 | 0b11 << 4;
    /// Bits that are writable only while UE is 0.
    pub(crate) const LOCKED: u32 = 0x006F_FF39;
}

/// Bits of the register CR3.
pub(super) mod cr3 {
    pub(crate) const EIE: u32 = 1 << 0;
    pub(crate) const DMAR: u32 = 1 << 6;
    pub(crate) const DMAT: u32 = 1 << 7;
    pub(crate) const ONEBIT: u32 = 1 << 11;
    pub(crate) const OVRDIS: u32 = 1 << 12;
    pub(crate) const DDRE: u32 = 1 << 13;
    pub(crate) const TXFTIE: u32 = 1 << 23;
    pub(crate) const RXFTCFG_AT: u32 = 25;
    pub(crate) const RXFTIE: u32 = 1 << 28;
    pub(crate) const TXFTCFG_AT: u32 = 29;
    /// Modelled bits; half duplex, IrDA, Smartcard, flow control, driver enable and wake-up are not. DEP has no effect
    /// alone.
    pub(crate) const MODELLED: u32 =
        EIE | DMAR | DMAT | ONEBIT | OVRDIS | DDRE | 1 << 15 | TXFTIE | 7 << RXFTCFG_AT | RXFTIE | 7 << TXFTCFG_AT;
    /// Bits that are writable only while UE is 0.
    pub(crate) const LOCKED: u32 = 0x0030_FB3E;
}

/// Bits of the register RQR.
pub(super) mod rqr {
    pub(crate) const RXFRQ: u32 = 1 << 3;
    pub(crate) const TXFRQ: u32 = 1 << 4;
    pub(crate) const ALL: u32 = 0x1F;
}

/// Bits of ISR; those of ICR are at the same places, except `TXFECF`.
pub(super) mod isr {
    pub(crate) const PE: u32 = 1 << 0;
    pub(crate) const FE: u32 = 1 << 1;
    pub(crate) const NE: u32 = 1 << 2;
    pub(crate) const ORE: u32 = 1 << 3;
    pub(crate) const IDLE: u32 = 1 << 4;
    pub(crate) const RXNE: u32 = 1 << 5;
    pub(crate) const TC: u32 = 1 << 6;
    pub(crate) const TXE: u32 = 1 << 7;
    pub(crate) const RTOF: u32 = 1 << 11;
    pub(crate) const BUSY: u32 = 1 << 16;
    pub(crate) const CMF: u32 = 1 << 17;
    pub(crate) const TEACK: u32 = 1 << 21;
    pub(crate) const REACK: u32 = 1 << 22;
    pub(crate) const TXFE: u32 = 1 << 23;
    pub(crate) const RXFF: u32 = 1 << 24;
    pub(crate) const RXFT: u32 = 1 << 26;
    pub(crate) const TXFT: u32 = 1 << 27;

    /// Flags that stay until ICR clears them; all others follow from the state.
    pub(crate) const KEPT: u32 = PE | FE | NE | ORE | IDLE | TC | RTOF | CMF;
    /// Bit of ICR that clears TXFE.
    pub(crate) const TXFECF: u32 = 1 << 5;
}
