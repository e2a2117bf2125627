//! Addition, multiplication, division and square root (DDI0403E A2.5, FPAdd to FPSqrt): exact, and rounded once.
//!
//! All results and cumulative flags are computed with integers here, in every rounding mode. For ordinary values the
//! host's floating-point unit gives the same results faster: see `fast`.

use super::format::{Format, Number, Value, process_nan, process_nans, round, unpack};
use super::status::{DZC, IOC, Rounding};

fn invalid(format: Format, fpscr: &mut u32) -> u64 {
    *fpscr |= IOC;
    format.default_nan()
}

/// Adds two values (FPAdd).
pub(super) fn add(format: Format, a: u64, b: u64, fpscr: &mut u32) -> u64 {
    let (first, second) = (unpack(format, a, fpscr), unpack(format, b, fpscr));
    if let Some(nan) = process_nans(format, [(a, first), (b, second)], fpscr) {
        return nan;
    }
    sum(format, first, second, fpscr)
}

/// Subtracts two values (FPSub). Not the sum with the second negated, because a NaN keeps its sign.
pub(super) fn subtract(format: Format, a: u64, b: u64, fpscr: &mut u32) -> u64 {
    let (first, second) = (unpack(format, a, fpscr), unpack(format, b, fpscr));
    if let Some(nan) = process_nans(format, [(a, first), (b, second)], fpscr) {
        return nan;
    }
    let negated = match second {
        Value::Zero { negative } => Value::Zero { negative: !negative },
        Value::Infinity { negative } => Value::Infinity { negative: !negative },
        Value::Finite(number) => Value::Finite(Number { negative: !number.negative, ..number }),
        nan => nan,
    };
    sum(format, first, negated, fpscr)
}

/// Adds two values that are not NaN.
fn sum(format: Format, first: Value, second: Value, fpscr: &mut u32) -> u64 {
    let rounding = Rounding::of(*fpscr);
    match (first, second) {
        (Value::Infinity { negative }, Value::Infinity { negative: other }) if negative != other => {
            invalid(format, fpscr)
        }
        (Value::Infinity { negative }, _) | (_, Value::Infinity { negative }) => format.infinity(negative),
        (Value::Zero { negative }, Value::Zero { negative: other }) if negative == other => format.zero(negative),
        (Value::Finite(number), Value::Zero { .. }) | (Value::Zero { .. }, Value::Finite(number)) => {
            round(format, number, rounding, fpscr)
        }
        (Value::Finite(first), Value::Finite(second)) => match exact_sum(first, second) {
            Some(number) => round(format, number, rounding, fpscr),
            // An exact difference of zero is +0, or -0 when rounding down (IEEE 754, 6.3).
            None => format.zero(rounding == Rounding::Down),
        },
        _ => format.zero(rounding == Rounding::Down),
    }
}

/// Adds two numbers without rounding, except that the lowest bit may represent a smaller part (sticky bit); `None` is
/// zero.
///
/// Each significand has at most 106 bits and is shifted up to 126. So where bits of the smaller one are lost, it is
/// smaller by at least 20 places, and the sum keeps more bits than any format has.
fn exact_sum(first: Number, second: Number) -> Option<Number> {
    let (first, second) = (raised(first), raised(second));
    let order = (first.exponent, first.significand) >= (second.exponent, second.significand);
    let (large, small) = if order { (first, second) } else { (second, first) };
    let places = (large.exponent - small.exponent) as u32;
    let kept = small.significand.checked_shr(places).unwrap_or(0);
    // The lost part becomes a sticky bit, which keeps the rounding correct.
    let lost = kept.checked_shl(places).unwrap_or(0) != small.significand;
    let moved = kept | u128::from(lost);
    let significand =
        if large.negative == small.negative { large.significand + moved } else { large.significand - moved };
    (significand != 0).then_some(Number { significand, ..large })
}

/// Normalises the number to bit 125 as its highest bit.
fn raised(number: Number) -> Number {
    let places = number.significand.leading_zeros() - 2;
    Number { exponent: number.exponent - places as i32, significand: number.significand << places, ..number }
}

fn product(first: Number, second: Number) -> Number {
    Number {
        negative: first.negative != second.negative,
        exponent: first.exponent + second.exponent,
        significand: first.significand * second.significand,
    }
}

fn sign(value: Value) -> bool {
    match value {
        Value::Zero { negative } | Value::Infinity { negative } => negative,
        Value::Finite(number) => number.negative,
        Value::Quiet | Value::Signalling => false,
    }
}

/// Multiplies two values (FPMul).
pub(super) fn multiply(format: Format, a: u64, b: u64, fpscr: &mut u32) -> u64 {
    let (first, second) = (unpack(format, a, fpscr), unpack(format, b, fpscr));
    if let Some(nan) = process_nans(format, [(a, first), (b, second)], fpscr) {
        return nan;
    }
    let negative = sign(first) != sign(second);
    match (first, second) {
        (Value::Finite(first), Value::Finite(second)) => {
            round(format, product(first, second), Rounding::of(*fpscr), fpscr)
        }
        _ if first.is_infinite() && second.is_zero() || first.is_zero() && second.is_infinite() => {
            invalid(format, fpscr)
        }
        _ if first.is_infinite() || second.is_infinite() => format.infinity(negative),
        _ => format.zero(negative),
    }
}

/// Computes `addend + a * b`, rounded once (FPMulAdd).
pub(super) fn fused(format: Format, addend: u64, a: u64, b: u64, fpscr: &mut u32) -> u64 {
    let third = unpack(format, addend, fpscr);
    let (first, second) = (unpack(format, a, fpscr), unpack(format, b, fpscr));
    let undefined = first.is_infinite() && second.is_zero() || first.is_zero() && second.is_infinite();
    // Zero times infinity is invalid even with a quiet NaN as addend; a signalling one has priority (FPMulAdd).
    if undefined && third == Value::Quiet {
        return invalid(format, fpscr);
    }
    if let Some(nan) = process_nans(format, [(addend, third), (a, first), (b, second)], fpscr) {
        return nan;
    }
    if undefined {
        return invalid(format, fpscr);
    }
    let negative = sign(first) != sign(second);
    let product = match (first, second) {
        (Value::Finite(first), Value::Finite(second)) => Value::Finite(product(first, second)),
        _ if first.is_infinite() || second.is_infinite() => Value::Infinity { negative },
        _ => Value::Zero { negative },
    };
    sum(format, third, product, fpscr)
}

/// Divides two values (FPDiv).
pub(super) fn divide(format: Format, a: u64, b: u64, fpscr: &mut u32) -> u64 {
    let (first, second) = (unpack(format, a, fpscr), unpack(format, b, fpscr));
    if let Some(nan) = process_nans(format, [(a, first), (b, second)], fpscr) {
        return nan;
    }
    let negative = sign(first) != sign(second);
    match (first, second) {
        (Value::Finite(first), Value::Finite(second)) => {
            // The quotient of 126 bits by at most 53 has 73 or more, enough for one rounding.
            let first = raised(first);
            let quotient = first.significand / second.significand;
            let rest = quotient * second.significand != first.significand;
            let number = Number {
                negative,
                exponent: first.exponent - second.exponent - 1,
                significand: quotient << 1 | u128::from(rest),
            };
            round(format, number, Rounding::of(*fpscr), fpscr)
        }
        _ if first.is_infinite() && second.is_infinite() || first.is_zero() && second.is_zero() => {
            invalid(format, fpscr)
        }
        (Value::Infinity { .. }, _) => format.infinity(negative),
        (_, Value::Zero { .. }) => {
            *fpscr |= DZC;
            format.infinity(negative)
        }
        _ => format.zero(negative),
    }
}

/// Takes the square root of a value (FPSqrt).
pub(super) fn square_root(format: Format, a: u64, fpscr: &mut u32) -> u64 {
    match unpack(format, a, fpscr) {
        Value::Zero { negative } => format.zero(negative),
        Value::Infinity { negative: false } => format.infinity(false),
        Value::Finite(number) if !number.negative => {
            // With an even exponent and 125 or 126 bits, the root has 63 bits.
            let mut number = raised(number);
            if number.exponent & 1 != 0 {
                number.significand >>= 1;
                number.exponent += 1;
            }
            let root = number.significand.isqrt();
            let rest = root * root != number.significand;
            let number = Number {
                negative: false,
                exponent: number.exponent / 2 - 1,
                significand: root << 1 | u128::from(rest),
            };
            round(format, number, Rounding::of(*fpscr), fpscr)
        }
        value if value.is_nan() => process_nan(format, a, value, fpscr),
        _ => invalid(format, fpscr),
    }
}
