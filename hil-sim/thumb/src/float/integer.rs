//! Conversions between floating point and integers (DDI0403E A2.5, FPToFixed, FixedToFP, FPRoundInt).

use super::format::{Format, Number, Part, Value, dropped, process_nan, round, unpack};
use super::status::{IOC, IXC, Rounding};

/// Format of an integer or fixed-point number in a register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fixed {
    pub(super) signed: bool,
    /// Width in bits, 16 or 32.
    pub(super) bits: u8,
    /// Number of its bits after the binary point.
    pub(super) fraction: u8,
}

/// Returns the magnitude in units of 2 to the `-fraction`, rounded down, at most 2 to the 64, and the dropped part.
fn whole(number: Number, fraction: u8) -> (u128, Part) {
    let exponent = number.exponent + i32::from(fraction);
    match u32::try_from(-exponent) {
        Ok(bits) => dropped(number.significand, bits),
        Err(_) if exponent > 64 => (1 << 64, Part::None),
        Err(_) => ((number.significand << exponent).min(1 << 64), Part::None),
    }
}

/// Converts to fixed point with saturation, extended to 64 bits according to its sign (FPToFixed).
pub(super) fn to_fixed(format: Format, bits: u64, fixed: Fixed, rounding: Rounding, fpscr: &mut u32) -> u64 {
    let value_bits = u32::from(fixed.bits);
    let (lowest, highest) = if fixed.signed {
        (-(1 << (value_bits - 1)), (1 << (value_bits - 1)) - 1)
    } else {
        (0, (1_i128 << value_bits) - 1)
    };
    let (value, part) = match unpack(format, bits, fpscr) {
        Value::Zero { .. } => return 0,
        Value::Infinity { negative } => (if negative { i128::MIN } else { i128::MAX }, Part::None),
        Value::Finite(number) => {
            let (magnitude, part) = whole(number, fixed.fraction);
            let up = part.rounds_up(rounding, number.negative, magnitude & 1 != 0);
            let magnitude = (magnitude + u128::from(up)) as i128;
            (if number.negative { -magnitude } else { magnitude }, part)
        }
        Value::Quiet | Value::Signalling => {
            *fpscr |= IOC;
            return 0;
        }
    };
    let saturated = value.clamp(lowest, highest);
    if saturated != value {
        *fpscr |= IOC;
    } else if part != Part::None {
        *fpscr |= IXC;
    }
    saturated as u64
}

/// Converts the low bits of `register` from fixed point (FixedToFP).
pub(super) fn from_fixed(format: Format, register: u32, fixed: Fixed, rounding: Rounding, fpscr: &mut u32) -> u64 {
    let value = match (fixed.bits, fixed.signed) {
        (16, true) => i64::from(register as i16),
        (16, false) => i64::from(register as u16),
        (_, true) => i64::from(register as i32),
        (_, false) => i64::from(register),
    };
    if value == 0 {
        return format.zero(false);
    }
    let exponent = -i32::from(fixed.fraction);
    let number = Number { negative: value < 0, exponent, significand: value.unsigned_abs().into() };
    round(format, number, rounding, fpscr)
}

/// Rounds to an integer in the same format (FPRoundInt). With `exact`, FPSCR records an inexact result.
pub(super) fn round_to_whole(format: Format, bits: u64, rounding: Rounding, exact: bool, fpscr: &mut u32) -> u64 {
    match unpack(format, bits, fpscr) {
        Value::Zero { negative } => format.zero(negative),
        Value::Infinity { negative } => format.infinity(negative),
        // The number is an integer already: all of its bits are before the binary point.
        Value::Finite(Number { exponent: 0.., .. }) => bits,
        Value::Finite(number) => {
            let (magnitude, part) = whole(number, 0);
            if exact && part != Part::None {
                *fpscr |= IXC;
            }
            let up = part.rounds_up(rounding, number.negative, magnitude & 1 != 0);
            let significand = magnitude + u128::from(up);
            if significand == 0 {
                return format.zero(number.negative);
            }
            // This is exact, because the result has no more bits than the operand.
            round(format, Number { exponent: 0, significand, ..number }, rounding, fpscr)
        }
        nan => process_nan(format, bits, nan, fpscr),
    }
}
