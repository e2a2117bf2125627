//! FPSCR (DDI0403E B1.4.7; A2.5.3).

/// Bits that exist.
pub(super) const WRITABLE: u32 = 0xF7C0_009F;
/// N, Z, C, V of the last comparison.
pub(super) const NZCV: u32 = 0xF000_0000;
/// Alternative half precision.
pub(super) const AHP: u32 = 1 << 26;
/// Default NaN.
pub(super) const DN: u32 = 1 << 25;
/// Flush to zero.
pub(super) const FZ: u32 = 1 << 24;
/// Rounding mode.
pub(super) const RMODE: u32 = 3 << 22;
/// Input denormal, cumulative, as all that follow.
pub(super) const IDC: u32 = 1 << 7;
/// Inexact.
pub(super) const IXC: u32 = 1 << 4;
/// Underflow.
pub(super) const UFC: u32 = 1 << 3;
/// Overflow.
pub(super) const OFC: u32 = 1 << 2;
/// Division by zero.
pub(super) const DZC: u32 = 1 << 1;
/// Invalid operation.
pub(super) const IOC: u32 = 1 << 0;

/// How a number that a format does not have is rounded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rounding {
    /// To the nearest, halves to even.
    Nearest,
    /// To the nearest, halves away from zero.
    NearestAway,
    /// Towards plus infinity.
    Up,
    /// Towards minus infinity.
    Down,
    /// Towards zero.
    Zero,
}

impl Rounding {
    /// Of FPSCR.
    pub(super) fn of(fpscr: u32) -> Self {
        match (fpscr & RMODE) >> 22 {
            0 => Self::Nearest,
            1 => Self::Up,
            2 => Self::Down,
            _ => Self::Zero,
        }
    }
}
