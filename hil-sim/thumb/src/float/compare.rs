//! Comparison, maximum and minimum (DDI0403E A2.5, FPCompare, FPMaxNum, FPMinNum).

use std::cmp::Ordering;

use super::format::{Format, Value, process_nans, unpack};
use super::status::IOC;

/// Flags N, Z, C, V of the results less, equal, greater, and unordered.
const LESS: u32 = 0b1000 << 28;
const EQUAL: u32 = 0b0110 << 28;
const GREATER: u32 = 0b0010 << 28;
const UNORDERED: u32 = 0b0011 << 28;

/// Maps the numbers of a format to integers of the same order. Both zeros map to 0.
fn key(format: Format, bits: u64) -> i64 {
    let magnitude = format.absolute(bits) as i64;
    if format.negative(bits) { -magnitude } else { magnitude }
}

/// Returns the bits, or zero if FPSCR.FZ flushes them.
fn flushed(format: Format, bits: u64, value: Value) -> u64 {
    if let Value::Zero { negative } = value { format.zero(negative) } else { bits }
}

/// Compares two values; returns the flags (FPCompare). `signalling` is for VCMPE, for which a quiet NaN is invalid,
/// too.
pub(super) fn compare(format: Format, a: u64, b: u64, signalling: bool, fpscr: &mut u32) -> u32 {
    let (first, second) = (unpack(format, a, fpscr), unpack(format, b, fpscr));
    if first.is_nan() || second.is_nan() {
        if signalling || first == Value::Signalling || second == Value::Signalling {
            *fpscr |= IOC;
        }
        return UNORDERED;
    }
    flags(key(format, flushed(format, a, first)).cmp(&key(format, flushed(format, b, second))))
}

/// Returns the flags of two ordered values.
pub(super) fn flags(order: Ordering) -> u32 {
    match order {
        Ordering::Less => LESS,
        Ordering::Equal => EQUAL,
        Ordering::Greater => GREATER,
    }
}

/// Selects the larger or smaller value (FPMaxNum, FPMinNum); a number wins over a quiet NaN.
pub(super) fn extreme(format: Format, a: u64, b: u64, largest: bool, fpscr: &mut u32) -> u64 {
    let (first, second) = (unpack(format, a, fpscr), unpack(format, b, fpscr));
    match (first, second) {
        (Value::Quiet, Value::Quiet | Value::Signalling) | (Value::Signalling, _) | (_, Value::Signalling) => {
            process_nans(format, [(a, first), (b, second)], fpscr).unwrap_or(a)
        }
        (Value::Quiet, _) => flushed(format, b, second),
        (_, Value::Quiet) => flushed(format, a, first),
        (Value::Zero { negative }, Value::Zero { negative: other }) => {
            format.zero(if largest { negative && other } else { negative || other })
        }
        _ => {
            let (a, b) = (flushed(format, a, first), flushed(format, b, second));
            if (key(format, a) > key(format, b)) == largest { a } else { b }
        }
    }
}
