//! Fields of FPSCR (DDI0403E B1.4.7; A2.5.3).

/// Mask of the bits that exist.
pub(super) const WRITABLE: u32 = 0xF7C0_009F;
/// Flags N, Z, C, V of the last comparison.
pub(super) const NZCV: u32 = 0xF000_0000;
/// AHP: alternative half precision.
pub(super) const AHP: u32 = 1 << 26;
/// DN: default NaN mode.
pub(super) const DN: u32 = 1 << 25;
/// FZ: flush denormals to zero.
pub(super) const FZ: u32 = 1 << 24;
/// RMode: rounding mode field.
pub(super) const RMODE: u32 = 3 << 22;
/// IDC: input denormal, cumulative, as all that follow.
pub(super) const IDC: u32 = 1 << 7;
/// IXC: cumulative inexact flag.
pub(super) const IXC: u32 = 1 << 4;
/// UFC: cumulative underflow flag.
pub(super) const UFC: u32 = 1 << 3;
/// OFC: cumulative overflow flag.
pub(super) const OFC: u32 = 1 << 2;
/// DZC: cumulative division-by-zero flag.
pub(super) const DZC: u32 = 1 << 1;
/// IOC: cumulative invalid-operation flag.
pub(super) const IOC: u32 = 1 << 0;

/// Rounding of a number that the format cannot represent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rounding {
    /// To the nearest, ties to even.
    Nearest,
    /// To the nearest, ties away from zero.
    NearestAway,
    /// Rounds towards plus infinity.
    Up,
    /// Rounds towards minus infinity.
    Down,
    /// Rounds towards zero (truncation).
    Zero,
}

impl Rounding {
    /// Returns the rounding mode in FPSCR.
    pub(super) fn of(fpscr: u32) -> Self {
        match (fpscr & RMODE) >> 22 {
            0 => Self::Nearest,
            1 => Self::Up,
            2 => Self::Down,
            _ => Self::Zero,
        }
    }
}
