//! Offsets and bits of the registers (RM0399, 59.5).

pub(super) const CREL: u32 = 0x00;
pub(super) const ENDN: u32 = 0x04;
pub(super) const DBTP: u32 = 0x0C;
pub(super) const TEST: u32 = 0x10;
pub(super) const RWD: u32 = 0x14;
pub(super) const CCCR: u32 = 0x18;
pub(super) const NBTP: u32 = 0x1C;
pub(super) const TSCC: u32 = 0x20;
pub(super) const TSCV: u32 = 0x24;
pub(super) const TOCC: u32 = 0x28;
pub(super) const TOCV: u32 = 0x2C;
pub(super) const ECR: u32 = 0x40;
pub(super) const PSR: u32 = 0x44;
pub(super) const TDCR: u32 = 0x48;
pub(super) const IR: u32 = 0x50;
pub(super) const IE: u32 = 0x54;
pub(super) const ILS: u32 = 0x58;
pub(super) const ILE: u32 = 0x5C;
pub(super) const GFC: u32 = 0x80;
pub(super) const SIDFC: u32 = 0x84;
pub(super) const XIDFC: u32 = 0x88;
pub(super) const XIDAM: u32 = 0x90;
pub(super) const HPMS: u32 = 0x94;
pub(super) const NDAT1: u32 = 0x98;
pub(super) const NDAT2: u32 = 0x9C;
pub(super) const RXF0C: u32 = 0xA0;
pub(super) const RXF0S: u32 = 0xA4;
pub(super) const RXF0A: u32 = 0xA8;
pub(super) const RXBC: u32 = 0xAC;
pub(super) const RXF1C: u32 = 0xB0;
pub(super) const RXF1S: u32 = 0xB4;
pub(super) const RXF1A: u32 = 0xB8;
pub(super) const RXESC: u32 = 0xBC;
pub(super) const TXBC: u32 = 0xC0;
pub(super) const TXFQS: u32 = 0xC4;
pub(super) const TXESC: u32 = 0xC8;
pub(super) const TXBRP: u32 = 0xCC;
pub(super) const TXBAR: u32 = 0xD0;
pub(super) const TXBCR: u32 = 0xD4;
pub(super) const TXBTO: u32 = 0xD8;
pub(super) const TXBCF: u32 = 0xDC;
pub(super) const TXBTIE: u32 = 0xE0;
pub(super) const TXBCIE: u32 = 0xE4;
pub(super) const TXEFC: u32 = 0xF0;
pub(super) const TXEFS: u32 = 0xF4;
pub(super) const TXEFA: u32 = 0xF8;

/// Values of CREL and ENDN: release 3.2.1 of 2014-12-18.
pub(super) const CREL_VALUE: u32 = 0x3214_1218;
pub(super) const ENDN_VALUE: u32 = 0x8765_4321;

/// Registers with a reset value other than 0.
pub(super) const RESET_VALUES: [(u32, u32); 5] =
    [(DBTP, 0x0000_0A33), (CCCR, cccr::INIT), (NBTP, 0x0600_0A03), (TOCC, 0xFFFF_0000), (XIDAM, 0x1FFF_FFFF)];

/// Registers that are writable only while CCE and INIT are 1, with their bits.
pub(super) const PROTECTED: [(u32, u32); 17] = [
    (DBTP, 0x009F_1FFF),
    (RWD, 0x0000_00FF),
    (NBTP, 0xFFFF_FF7F),
    (TSCC, 0x000F_0003),
    (TOCC, 0xFFFF_0007),
    (TDCR, 0x0000_7F7F),
    (GFC, 0x0000_003F),
    (SIDFC, 0x00FF_FFFC),
    (XIDFC, 0x00FF_FFFC),
    (XIDAM, 0x1FFF_FFFF),
    (RXF0C, 0xFF7F_FFFC),
    (RXBC, 0x0000_FFFC),
    (RXF1C, 0xFF7F_FFFC),
    (RXESC, 0x0000_0777),
    (TXBC, 0x7F3F_FFFC),
    (TXESC, 0x0000_0007),
    (TXEFC, 0x3F3F_FFFC),
];

/// Bits of the register CCCR.
pub(super) mod cccr {
    pub(crate) const INIT: u32 = 1 << 0;
    pub(crate) const CCE: u32 = 1 << 1;
    pub(crate) const ASM: u32 = 1 << 2;
    pub(crate) const CSA: u32 = 1 << 3;
    pub(crate) const CSR: u32 = 1 << 4;
    pub(crate) const MON: u32 = 1 << 5;
    pub(crate) const DAR: u32 = 1 << 6;
    pub(crate) const TEST: u32 = 1 << 7;
    pub(crate) const FDOE: u32 = 1 << 8;
    pub(crate) const BRSE: u32 = 1 << 9;
    pub(crate) const PXHD: u32 = 1 << 12;
    pub(crate) const EFBI: u32 = 1 << 13;
    pub(crate) const TXP: u32 = 1 << 14;
    pub(crate) const NISO: u32 = 1 << 15;
    /// Bits that change only while CCE and INIT are 1.
    pub(crate) const PROTECTED: u32 = DAR | FDOE | BRSE | PXHD | EFBI | TXP | NISO;
    /// Bits that are set only while CCE and INIT are 1, and cleared at any time.
    pub(crate) const SET_PROTECTED: u32 = ASM | MON | TEST;
}

/// Bits of the register TEST.
pub(super) mod test {
    pub(crate) const LBCK: u32 = 1 << 4;
    pub(crate) const TX: u32 = 3 << 5;
    pub(crate) const RX: u32 = 1 << 7;
}

/// Bits of the register PSR.
pub(super) mod psr {
    pub(crate) const ACT_AT: u32 = 3;
    pub(crate) const EP: u32 = 1 << 5;
    pub(crate) const EW: u32 = 1 << 6;
    pub(crate) const BO: u32 = 1 << 7;
    pub(crate) const DLEC_AT: u32 = 8;
    pub(crate) const RESI: u32 = 1 << 11;
    pub(crate) const RBRS: u32 = 1 << 12;
    pub(crate) const REDL: u32 = 1 << 13;
    pub(crate) const PXE: u32 = 1 << 14;
    pub(crate) const TDCV_AT: u32 = 16;
}

/// Bits of IR; those of IE and ILS are at the same places.
pub(super) mod ir {
    /// Rx FIFO 0: new message, watermark, full, lost; those of FIFO 1 are four places higher.
    pub(crate) const RF0N: u32 = 1 << 0;
    pub(crate) const RF0W: u32 = 1 << 1;
    pub(crate) const RF0F: u32 = 1 << 2;
    pub(crate) const RF0L: u32 = 1 << 3;
    pub(crate) const HPM: u32 = 1 << 8;
    pub(crate) const TC: u32 = 1 << 9;
    pub(crate) const TCF: u32 = 1 << 10;
    pub(crate) const TFE: u32 = 1 << 11;
    pub(crate) const TEFN: u32 = 1 << 12;
    pub(crate) const TEFW: u32 = 1 << 13;
    pub(crate) const TEFF: u32 = 1 << 14;
    pub(crate) const TEFL: u32 = 1 << 15;
    pub(crate) const TSW: u32 = 1 << 16;
    pub(crate) const DRX: u32 = 1 << 19;
    pub(crate) const ELO: u32 = 1 << 22;
    pub(crate) const EP: u32 = 1 << 23;
    pub(crate) const EW: u32 = 1 << 24;
    pub(crate) const BO: u32 = 1 << 25;
    pub(crate) const PEA: u32 = 1 << 27;
    pub(crate) const PED: u32 = 1 << 28;
    pub(crate) const ALL: u32 = 0x3FCF_FFFF;
}

/// Fields of the register TXBC.
pub(super) mod txbc {
    pub(crate) const NDTB_AT: u32 = 16;
    pub(crate) const TFQS_AT: u32 = 24;
    pub(crate) const TFQM: u32 = 1 << 30;
}
