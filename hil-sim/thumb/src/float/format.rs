//! Floating-point formats: unpacking, rounding and packing (DDI0403E A2.5, FPUnpack and FPRound).

use super::status::{AHP, DN, FZ, IDC, IOC, IXC, OFC, Rounding, UFC};

/// Format of IEEE 754: sign, exponent and fraction, from the highest bit down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Format {
    exponent_bits: u32,
    pub(super) fraction_bits: u32,
}

/// Half precision, 16 bits. With FPSCR.AHP the highest exponent is an ordinary one.
pub(super) const HALF: Format = Format { exponent_bits: 5, fraction_bits: 10 };
/// Single precision, 32 bits.
pub(super) const SINGLE: Format = Format { exponent_bits: 8, fraction_bits: 23 };
/// Double precision, 64 bits.
pub(super) const DOUBLE: Format = Format { exponent_bits: 11, fraction_bits: 52 };

impl Format {
    fn is_half(self) -> bool {
        self.exponent_bits == HALF.exponent_bits
    }

    /// Returns true for half precision in its alternative form, which FPSCR.AHP selects.
    fn is_alternative(self, fpscr: u32) -> bool {
        self.is_half() && fpscr & AHP != 0
    }

    fn sign_bit(self) -> u64 {
        1 << (self.exponent_bits + self.fraction_bits)
    }

    fn fraction(self) -> u64 {
        (1 << self.fraction_bits) - 1
    }

    /// Returns the exponent field of all ones.
    fn highest(self) -> u64 {
        (1 << self.exponent_bits) - 1
    }

    /// Returns the exponent of the smallest normal number.
    fn smallest(self) -> i32 {
        2 - (1 << (self.exponent_bits - 1))
    }

    fn quiet(self) -> u64 {
        1 << (self.fraction_bits - 1)
    }

    pub(super) fn negative(self, bits: u64) -> bool {
        bits & self.sign_bit() != 0
    }

    fn signed(self, negative: bool, magnitude: u64) -> u64 {
        if negative { magnitude | self.sign_bit() } else { magnitude }
    }

    pub(super) fn zero(self, negative: bool) -> u64 {
        self.signed(negative, 0)
    }

    pub(super) fn infinity(self, negative: bool) -> u64 {
        self.signed(negative, self.highest() << self.fraction_bits)
    }

    /// Returns the default NaN: positive, quiet, other bits zero (FPDefaultNaN).
    pub(super) fn default_nan(self) -> u64 {
        self.infinity(false) | self.quiet()
    }

    /// Returns the largest finite number.
    fn largest(self, negative: bool) -> u64 {
        self.infinity(negative) - 1
    }

    pub(super) fn negate(self, bits: u64) -> u64 {
        bits ^ self.sign_bit()
    }

    pub(super) fn absolute(self, bits: u64) -> u64 {
        bits & !self.sign_bit()
    }
}

/// Number other than zero: `significand` times 2 to the `exponent`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Number {
    pub(super) negative: bool,
    pub(super) exponent: i32,
    pub(super) significand: u128,
}

/// Unpacked value of a format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Value {
    Zero { negative: bool },
    Finite(Number),
    Infinity { negative: bool },
    Quiet,
    Signalling,
}

impl Value {
    pub(super) fn is_nan(self) -> bool {
        matches!(self, Self::Quiet | Self::Signalling)
    }

    pub(super) fn is_zero(self) -> bool {
        matches!(self, Self::Zero { .. })
    }

    pub(super) fn is_infinite(self) -> bool {
        matches!(self, Self::Infinity { .. })
    }
}

/// Unpacks a value (FPUnpack). With FPSCR.FZ, a denormal number counts as zero, except in half precision.
pub(super) fn unpack(format: Format, bits: u64, fpscr: &mut u32) -> Value {
    let negative = format.negative(bits);
    let field = bits >> format.fraction_bits & format.highest();
    let fraction = bits & format.fraction();
    let lowest = format.smallest() - format.fraction_bits as i32;
    if field == 0 {
        if fraction == 0 {
            Value::Zero { negative }
        } else if *fpscr & FZ != 0 && !format.is_half() {
            *fpscr |= IDC;
            Value::Zero { negative }
        } else {
            Value::Finite(Number { negative, exponent: lowest, significand: fraction.into() })
        }
    } else if field == format.highest() && !format.is_alternative(*fpscr) {
        match fraction {
            0 => Value::Infinity { negative },
            _ if fraction & format.quiet() != 0 => Value::Quiet,
            _ => Value::Signalling,
        }
    } else {
        let significand = u128::from(fraction | 1 << format.fraction_bits);
        Value::Finite(Number { negative, exponent: lowest + (field as i32 - 1), significand })
    }
}

/// Drops the lowest `bits` bits of `value`; returns the rest, and how the dropped part compares with half a unit. The
/// lowest bit of `value` may represent any smaller nonzero part (sticky bit).
pub(super) fn dropped(value: u128, bits: u32) -> (u128, Part) {
    if bits == 0 {
        return (value, Part::None);
    }
    if bits > 127 {
        return (0, if value == 0 { Part::None } else { Part::BelowHalf });
    }
    let (rest, half) = (value & ((1 << bits) - 1), 1 << (bits - 1));
    let part = match rest.cmp(&half) {
        _ if rest == 0 => Part::None,
        std::cmp::Ordering::Less => Part::BelowHalf,
        std::cmp::Ordering::Equal => Part::Half,
        std::cmp::Ordering::Greater => Part::AboveHalf,
    };
    (value >> bits, part)
}

/// Dropped part of a unit, relative to one half.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    None,
    BelowHalf,
    Half,
    AboveHalf,
}

impl Part {
    /// Returns true if a magnitude with this dropped part is rounded up.
    pub(super) fn rounds_up(self, rounding: Rounding, negative: bool, odd: bool) -> bool {
        if self == Self::None {
            return false;
        }
        match rounding {
            Rounding::Nearest => self == Self::AboveHalf || self == Self::Half && odd,
            Rounding::NearestAway => matches!(self, Self::Half | Self::AboveHalf),
            Rounding::Up => !negative,
            Rounding::Down => negative,
            Rounding::Zero => false,
        }
    }
}

/// Rounds and packs a number (FPRound). Its significand is not zero. Its lowest bit may represent any smaller nonzero
/// part (sticky bit), if the format has at least two bits fewer.
pub(super) fn round(format: Format, number: Number, rounding: Rounding, fpscr: &mut u32) -> u64 {
    let Number { negative, exponent, significand } = number;
    let top = exponent + 127 - significand.leading_zeros() as i32;
    if top < format.smallest() && *fpscr & FZ != 0 && !format.is_half() {
        *fpscr |= UFC;
        return format.zero(negative);
    }
    let unit = top.max(format.smallest()) - format.fraction_bits as i32;
    let (whole, part) = match u32::try_from(unit - exponent) {
        Ok(bits) => dropped(significand, bits),
        Err(_) => (significand << (exponent - unit), Part::None),
    };
    let whole = whole as u64;
    if top < format.smallest() && part != Part::None {
        *fpscr |= UFC;
    }
    // Exponent and fraction form one number: a carry out of the fraction increments the exponent. The leading one of a
    // normal number counts as one in the exponent.
    let field = (top - format.smallest()).max(0) as u64;
    let rounded = whole + u64::from(part.rounds_up(rounding, negative, whole & 1 != 0));
    let magnitude = (field << format.fraction_bits) + rounded;
    if format.is_alternative(*fpscr) {
        if magnitude >= format.sign_bit() {
            *fpscr |= IOC;
            return format.signed(negative, format.sign_bit() - 1);
        }
    } else if magnitude >= format.infinity(false) {
        *fpscr |= OFC | IXC;
        let infinite = match rounding {
            Rounding::Nearest | Rounding::NearestAway => true,
            Rounding::Up => !negative,
            Rounding::Down => negative,
            Rounding::Zero => false,
        };
        return if infinite { format.infinity(negative) } else { format.largest(negative) };
    }
    if part != Part::None {
        *fpscr |= IXC;
    }
    format.signed(negative, magnitude)
}

/// Returns the operand as a quiet NaN, or the default NaN (FPProcessNaN).
pub(super) fn process_nan(format: Format, bits: u64, value: Value, fpscr: &mut u32) -> u64 {
    if value == Value::Signalling {
        *fpscr |= IOC;
    }
    if *fpscr & DN != 0 { format.default_nan() } else { bits | format.quiet() }
}

/// Selects the first signalling operand, else the first quiet one, in the order given (FPProcessNaNs).
pub(super) fn process_nans<const N: usize>(
    format: Format,
    operands: [(u64, Value); N],
    fpscr: &mut u32,
) -> Option<u64> {
    let first = |value| operands.into_iter().find(|operand| operand.1 == value);
    let (bits, value) = first(Value::Signalling).or_else(|| first(Value::Quiet))?;
    Some(process_nan(format, bits, value, fpscr))
}

/// Converts a NaN to another format, with the highest bits of its fraction (FPConvertNaN, and the like for half
/// precision).
pub(super) fn convert_nan(from: Format, to: Format, bits: u64, value: Value, fpscr: &mut u32) -> u64 {
    if value == Value::Signalling {
        *fpscr |= IOC;
    }
    if to.is_alternative(*fpscr) {
        // The alternative half precision has no NaN: the result is zero.
        *fpscr |= IOC;
        return to.zero(from.negative(bits));
    }
    if *fpscr & DN != 0 {
        return to.default_nan();
    }
    let fraction = (bits & from.fraction()) << (DOUBLE.fraction_bits - from.fraction_bits);
    let fraction = fraction >> (DOUBLE.fraction_bits - to.fraction_bits);
    to.infinity(from.negative(bits)) | to.quiet() | fraction
}

/// Converts between formats (FPSingleToDouble, FPDoubleToSingle, FPHalfToSingle and so on).
pub(super) fn convert(from: Format, to: Format, bits: u64, fpscr: &mut u32) -> u64 {
    match unpack(from, bits, fpscr) {
        Value::Zero { negative } => to.zero(negative),
        Value::Infinity { negative } if to.is_alternative(*fpscr) => {
            *fpscr |= IOC;
            to.signed(negative, to.sign_bit() - 1)
        }
        Value::Infinity { negative } => to.infinity(negative),
        Value::Finite(number) => round(to, number, Rounding::of(*fpscr), fpscr),
        nan => convert_nan(from, to, bits, nan, fpscr),
    }
}
