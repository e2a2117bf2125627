//! Arithmetic with the host's floating-point unit, where its result cannot differ (both follow IEEE 754): rounding to
//! nearest, no flush to zero, and a result that is an ordinary number. The only possible side effect is IXC, so this
//! path is taken only when IXC is set already, which it is after the first few operations of most programs.
//! `arithmetic` handles everything else.
//!
//! An ordinary result has an exponent neither of the lowest two nor the highest: so it is no NaN, not infinite and no
//! underflow, and no operand was NaN or infinite except a divisor. A sum of zero is exact. A denormal operand matters
//! with FZ only.

use super::format::{DOUBLE, Format, SINGLE, convert};
use super::integer::{self, Fixed};
use super::status::{FZ, IXC, RMODE, Rounding};
use super::{arithmetic, compare};

/// Returns true if an operation with an ordinary result has no effect but the result.
#[inline]
pub(super) fn applies(fpscr: u32) -> bool {
    fpscr & (RMODE | FZ | IXC) == IXC
}

/// Host float that corresponds to a format of the program's registers.
pub(super) trait Native: Copy + PartialOrd + Into<f64> {
    const FORMAT: Format;
    fn of(bits: u64) -> Self;
    fn bits(self) -> u64;
    fn is_ordinary(self) -> bool;
    fn is_zero(self) -> bool;
    fn add(self, other: Self) -> Self;
    fn subtract(self, other: Self) -> Self;
    fn multiply(self, other: Self) -> Self;
    fn divide(self, other: Self) -> Self;
    fn fused(self, a: Self, b: Self) -> Self;
    fn square_root(self) -> Self;
}

macro_rules! native {
    ($float:ty, $bits:ty, $format:expr, $fraction:literal, $exponent:literal) => {
        impl Native for $float {
            const FORMAT: Format = $format;
            #[inline]
            fn of(bits: u64) -> Self {
                Self::from_bits(bits as $bits)
            }
            #[inline]
            fn bits(self) -> u64 {
                self.to_bits().into()
            }
            #[inline]
            fn is_ordinary(self) -> bool {
                let field = self.to_bits() >> $fraction & $exponent;
                (2..$exponent).contains(&field)
            }
            #[inline]
            fn is_zero(self) -> bool {
                self == 0.0
            }
            #[inline]
            fn add(self, other: Self) -> Self {
                self + other
            }
            #[inline]
            fn subtract(self, other: Self) -> Self {
                self - other
            }
            #[inline]
            fn multiply(self, other: Self) -> Self {
                self * other
            }
            #[inline]
            fn divide(self, other: Self) -> Self {
                self / other
            }
            #[inline]
            fn fused(self, a: Self, b: Self) -> Self {
                a.mul_add(b, self)
            }
            #[inline]
            fn square_root(self) -> Self {
                self.sqrt()
            }
        }
    };
}

native!(f32, u32, SINGLE, 23, 0xFF);
native!(f64, u64, DOUBLE, 52, 0x7FF);

#[inline]
pub(super) fn add<F: Native>(a: u64, b: u64, fpscr: &mut u32) -> u64 {
    if applies(*fpscr) {
        let sum = F::of(a).add(F::of(b));
        if sum.is_ordinary() || sum.is_zero() {
            return sum.bits();
        }
    }
    arithmetic::add(F::FORMAT, a, b, fpscr)
}

#[inline]
pub(super) fn subtract<F: Native>(a: u64, b: u64, fpscr: &mut u32) -> u64 {
    if applies(*fpscr) {
        let difference = F::of(a).subtract(F::of(b));
        if difference.is_ordinary() || difference.is_zero() {
            return difference.bits();
        }
    }
    arithmetic::subtract(F::FORMAT, a, b, fpscr)
}

#[inline]
pub(super) fn multiply<F: Native>(a: u64, b: u64, fpscr: &mut u32) -> u64 {
    if applies(*fpscr) {
        let product = F::of(a).multiply(F::of(b));
        if product.is_ordinary() {
            return product.bits();
        }
    }
    arithmetic::multiply(F::FORMAT, a, b, fpscr)
}

#[inline]
pub(super) fn divide<F: Native>(a: u64, b: u64, fpscr: &mut u32) -> u64 {
    if applies(*fpscr) {
        let quotient = F::of(a).divide(F::of(b));
        if quotient.is_ordinary() {
            return quotient.bits();
        }
    }
    arithmetic::divide(F::FORMAT, a, b, fpscr)
}

#[inline]
pub(super) fn fused<F: Native>(addend: u64, a: u64, b: u64, fpscr: &mut u32) -> u64 {
    if applies(*fpscr) {
        let sum = F::of(addend).fused(F::of(a), F::of(b));
        if sum.is_ordinary() {
            return sum.bits();
        }
    }
    arithmetic::fused(F::FORMAT, addend, a, b, fpscr)
}

#[inline]
pub(super) fn square_root<F: Native>(a: u64, fpscr: &mut u32) -> u64 {
    if applies(*fpscr) {
        let root = F::of(a).square_root();
        if root.is_ordinary() {
            return root.bits();
        }
    }
    arithmetic::square_root(F::FORMAT, a, fpscr)
}

/// Compares two values (FPCompare), as [`compare::compare`] does.
#[inline]
pub(super) fn compare<F: Native>(a: u64, b: u64, signalling: bool, fpscr: &mut u32) -> u32 {
    match F::of(a).partial_cmp(&F::of(b)) {
        Some(order) if *fpscr & FZ == 0 => compare::flags(order),
        _ => compare::compare(F::FORMAT, a, b, signalling, fpscr),
    }
}

/// Converts to a 32-bit integer (FPToFixed without fraction).
#[inline]
pub(super) fn to_integer<F: Native>(bits: u64, signed: bool, rounding: Rounding, fpscr: &mut u32) -> u32 {
    let value: f64 = F::of(bits).into();
    if rounding == Rounding::Zero && *fpscr & FZ == 0 {
        const LIMIT: f64 = 2_147_483_648.0;
        let whole = if signed { f64::from(value as i32) } else { f64::from(value as u32) };
        let fits = if signed { value.abs() < LIMIT } else { (0.0..2.0 * LIMIT).contains(&value) };
        if fits && (whole == value || *fpscr & IXC != 0) {
            return whole as i64 as u32;
        }
    }
    integer::to_fixed(F::FORMAT, bits, Fixed { signed, bits: 32, fraction: 0 }, rounding, fpscr) as u32
}

/// Converts single to double, which is exact (FPSingleToDouble).
#[inline]
pub(super) fn to_double(bits: u64, fpscr: &mut u32) -> u64 {
    let value = <f32 as Native>::of(bits);
    if value.is_ordinary() { f64::from(value).to_bits() } else { convert(SINGLE, DOUBLE, bits, fpscr) }
}

/// Converts double to single (FPDoubleToSingle).
#[inline]
pub(super) fn to_single(bits: u64, fpscr: &mut u32) -> u64 {
    let single = <f64 as Native>::of(bits) as f32;
    if applies(*fpscr) && single.is_ordinary() { single.bits() } else { convert(DOUBLE, SINGLE, bits, fpscr) }
}

/// Selects the larger or smaller value (FPMaxNum, FPMinNum).
#[inline]
pub(super) fn extreme<F: Native>(a: u64, b: u64, largest: bool, fpscr: &mut u32) -> u64 {
    let (first, second) = (F::of(a), F::of(b));
    if first.is_ordinary() && second.is_ordinary() {
        return if (first > second) == largest { a } else { b };
    }
    compare::extreme(F::FORMAT, a, b, largest, fpscr)
}
