//! Instructions beside an independent implementation of IEEE 754: LLVM's APFloat, as the crate `rustc_apfloat`.
//!
//! The standard leaves open, and DDI0403E A2.5 defines: which NaN results, the default NaN, flush to zero, that
//! underflow is detected before rounding, and that overflow is reported in each rounding mode. [`Reference`] adds these to
//! APFloat, from the manual. To tell underflow and overflow it computes a second time in quadruple precision, whose
//! exponents hold every result here. The alternative half precision is not in IEEE 754, nor here.

use std::cmp::Ordering;

use proptest::prelude::*;
use rustc_apfloat::{Float as _, FloatConvert, Round, Status, StatusAnd, ieee};

use super::format::{DOUBLE, HALF, SINGLE};
use super::integer::Fixed;
use super::status::{DN, DZC, FZ, IDC, IOC, IXC, OFC, RMODE, Rounding, UFC};
use super::tests::Core;
use super::*;

type Quad = ieee::Quad;

/// Format of the registers in APFloat.
trait Real: rustc_apfloat::Float + FloatConvert<Quad> {
    fn narrow(wide: Quad, round: Round) -> StatusAnd<Self>;
}

macro_rules! real {
    ($($type:ty),*) => {
        $(impl Real for $type {
            fn narrow(wide: Quad, round: Round) -> StatusAnd<Self> {
                wide.convert_r(round, &mut false)
            }
        })*
    };
}

real!(ieee::Half, ieee::Single, ieee::Double);

fn of<F: Real>(bits: u64) -> F {
    F::from_bits(bits.into())
}

/// The value in quadruple precision, which has all values of the smaller formats. No NaN is widened here.
fn wide<F: Real>(value: F) -> Quad {
    value.convert_r(Round::TowardZero, &mut false).value
}

fn round(rounding: Rounding) -> Round {
    match rounding {
        Rounding::Nearest => Round::NearestTiesToEven,
        Rounding::NearestAway => Round::NearestTiesToAway,
        Rounding::Up => Round::TowardPositive,
        Rounding::Down => Round::TowardNegative,
        Rounding::Zero => Round::TowardZero,
    }
}

/// Operation that IEEE 754 defines, on the first two values, or on all three.
#[derive(Clone, Copy, Debug)]
enum Basic {
    Add,
    Subtract,
    Multiply,
    Divide,
    /// The third plus the product of the others.
    Fused,
}

fn apply<F: rustc_apfloat::Float>(basic: Basic, [a, b, c]: [F; 3], round: Round) -> StatusAnd<F> {
    match basic {
        Basic::Add => a.add_r(b, round),
        Basic::Subtract => a.sub_r(b, round),
        Basic::Multiply => a.mul_r(b, round),
        Basic::Divide => a.div_r(b, round),
        Basic::Fused => a.mul_add_r(b, c, round),
    }
}

/// FPSCR of the reference, and what the manual adds to IEEE 754.
struct Reference {
    fpscr: u32,
}

impl Reference {
    fn is_on(&self, bit: u32) -> bool {
        self.fpscr & bit != 0
    }

    fn round(&self) -> Round {
        // The field's encoding is that of A2.5.3, written again.
        [Round::NearestTiesToEven, Round::TowardPositive, Round::TowardNegative, Round::TowardZero]
            [((self.fpscr & RMODE) >> 22) as usize]
    }

    /// Flushes a denormal operand to zero (FPUnpack); half precision has none of that.
    fn operand<F: Real>(&mut self, value: F) -> F {
        if self.is_on(FZ) && value.is_denormal() && F::BITS != 16 {
            self.fpscr |= IDC;
            return F::ZERO.copy_sign(value);
        }
        value
    }

    fn default_nan<F: Real>() -> F {
        F::qnan(None)
    }

    /// Returns the NaN that results from operands (FPProcessNaNs): a signalling one before a quiet one, each in order.
    fn nan<F: Real>(&mut self, operands: &[F]) -> Option<F> {
        let signalling = operands.iter().find(|value| value.is_signaling());
        let nan = *signalling.or_else(|| operands.iter().find(|value| value.is_nan()))?;
        if signalling.is_some() {
            self.fpscr |= IOC;
        }
        let quiet = 1 << (F::PRECISION - 2);
        Some(if self.is_on(DN) { Self::default_nan() } else { F::from_bits(nan.to_bits() | quiet) })
    }

    /// Finishes an operation (FPRound): `exact` is its result in quadruple precision, rounded to zero.
    fn finish<F: Real>(&mut self, exact: Quad, rounded: StatusAnd<F>) -> F {
        let StatusAnd { status, value } = rounded;
        if status.contains(Status::INVALID_OP) {
            self.fpscr |= IOC;
            return Self::default_nan();
        }
        if status.contains(Status::DIV_BY_ZERO) {
            self.fpscr |= DZC;
            return value;
        }
        let magnitude = exact.abs();
        let is_tiny = !magnitude.is_zero() && magnitude < wide(F::smallest_normalized());
        if is_tiny && self.is_on(FZ) && F::BITS != 16 {
            self.fpscr |= UFC;
            return F::ZERO.copy_sign(value);
        }
        if status.contains(Status::INEXACT) {
            self.fpscr |= if is_tiny { UFC | IXC } else { IXC };
        }
        // The first power of two beyond the format, from which on every mode overflows.
        let limit = Quad::from_u128(1).value.scalbn(F::MAX_EXP + 1);
        if status.contains(Status::OVERFLOW) || exact.is_finite() && magnitude >= limit {
            self.fpscr |= OFC | IXC;
        }
        value
    }

    fn basic<F: Real>(&mut self, basic: Basic, operands: [F; 3]) -> F {
        let is_fused = matches!(basic, Basic::Fused);
        let [a, b] = [operands[0], operands[1]].map(|value| self.operand(value));
        let c = if is_fused { self.operand(operands[2]) } else { F::ZERO };
        let undefined = a.is_infinite() && b.is_zero() || a.is_zero() && b.is_infinite();
        if is_fused && undefined && c.is_nan() && !c.is_signaling() {
            // Invalid, although the third is a NaN (FPMulAdd).
            self.fpscr |= IOC;
            return Self::default_nan();
        }
        let order = if is_fused { [c, a, b] } else { [a, b, c] };
        if let Some(nan) = self.nan(&order) {
            return nan;
        }
        let exact = apply(basic, [wide(a), wide(b), wide(c)], Round::TowardZero).value;
        self.finish(exact, apply(basic, [a, b, c], self.round()))
    }

    fn convert<F: Real + FloatConvert<G>, G: Real>(&mut self, value: F) -> G {
        let value = self.operand(value);
        if value.is_nan() {
            let StatusAnd { status, value } = value.convert_r(Round::TowardZero, &mut false);
            self.fpscr |= if status.contains(Status::INVALID_OP) { IOC } else { 0 };
            return if self.is_on(DN) { Self::default_nan() } else { value };
        }
        self.finish(wide(value), value.convert_r(self.round(), &mut false))
    }

    /// Converts to fixed point, extended to 64 bits by its sign (FPToFixed).
    fn fixed<F: Real>(&mut self, value: F, fixed: Fixed, round: Round) -> u64 {
        let value = self.operand(value);
        if value.is_nan() {
            self.fpscr |= IOC;
            return 0;
        }
        let (scaled, bits) = (wide(value).scalbn(fixed.fraction.into()), fixed.bits.into());
        let (status, value) = if fixed.signed {
            let StatusAnd { status, value } = scaled.to_i128_r(bits, round, &mut false);
            (status, value as u64)
        } else {
            let StatusAnd { status, value } = scaled.to_u128_r(bits, round, &mut false);
            (status, value as u64)
        };
        self.fpscr |= if status.contains(Status::INVALID_OP) { IOC } else { 0 };
        self.fpscr |= if status.contains(Status::INEXACT) { IXC } else { 0 };
        value
    }

    fn widened<F: Real>(&mut self, value: u32, fixed: Fixed, round: Round) -> F {
        let number: i128 = match (fixed.signed, fixed.bits) {
            (true, 16) => (value as i16).into(),
            (false, 16) => (value as u16).into(),
            (true, _) => (value as i32).into(),
            (false, _) => value.into(),
        };
        let exact = Quad::from_i128(number).value.scalbn(-i32::from(fixed.fraction));
        self.finish(exact, F::narrow(exact, round))
    }

    fn whole<F: Real>(&mut self, value: F, round: Round, exact: bool) -> F {
        let value = self.operand(value);
        if let Some(nan) = self.nan(&[value]) {
            return nan;
        }
        let StatusAnd { status, value } = value.round_to_integral(round);
        self.fpscr |= if exact && status.contains(Status::INEXACT) { IXC } else { 0 };
        value
    }

    fn compare<F: Real>(&mut self, a: F, b: F, signalling: bool) -> u32 {
        let (a, b) = (self.operand(a), self.operand(b));
        let invalid = a.is_signaling() || b.is_signaling() || signalling && (a.is_nan() || b.is_nan());
        self.fpscr |= if invalid { IOC } else { 0 };
        match a.partial_cmp(&b) {
            Some(Ordering::Less) => 0x8000_0000,
            Some(Ordering::Equal) => 0x6000_0000,
            Some(Ordering::Greater) => 0x2000_0000,
            None => 0x3000_0000,
        }
    }

    /// Selects the larger or the smaller (FPMaxNum, FPMinNum): a quiet NaN loses against a number.
    fn extreme<F: Real>(&mut self, a: F, b: F, largest: bool) -> F {
        let (a, b) = (self.operand(a), self.operand(b));
        let is_quiet = |value: F| value.is_nan() && !value.is_signaling();
        match (is_quiet(a), is_quiet(b)) {
            (true, false) if !b.is_nan() => return b,
            (false, true) if !a.is_nan() => return a,
            _ => {}
        }
        if let Some(nan) = self.nan(&[a, b]) {
            return nan;
        }
        if largest { a.maximum(b) } else { a.minimum(b) }
    }

    /// Executes an instruction of three registers; `old` is the destination's value.
    fn three<F: Real>(&mut self, three: Three, old: F, a: F, b: F) -> F {
        let mut basic = |basic, operands| self.basic(basic, operands);
        match three {
            Three::Add => basic(Basic::Add, [a, b, old]),
            Three::Subtract => basic(Basic::Subtract, [a, b, old]),
            Three::Multiply => basic(Basic::Multiply, [a, b, old]),
            Three::NegatedMultiply => -basic(Basic::Multiply, [a, b, old]),
            Three::MultiplyAdd => {
                let product = basic(Basic::Multiply, [a, b, old]);
                basic(Basic::Add, [old, product, old])
            }
            Three::MultiplySubtract => {
                let product = basic(Basic::Multiply, [a, b, old]);
                basic(Basic::Add, [old, -product, old])
            }
            Three::NegatedMultiplySubtract => {
                let product = basic(Basic::Multiply, [a, b, old]);
                basic(Basic::Add, [-old, product, old])
            }
            Three::NegatedMultiplyAdd => {
                let product = basic(Basic::Multiply, [a, b, old]);
                basic(Basic::Add, [-old, -product, old])
            }
            Three::Divide => basic(Basic::Divide, [a, b, old]),
            Three::FusedAdd => basic(Basic::Fused, [a, b, old]),
            Three::FusedSubtract => basic(Basic::Fused, [-a, b, old]),
            Three::NegatedFusedSubtract => basic(Basic::Fused, [a, b, -old]),
            Three::NegatedFusedAdd => basic(Basic::Fused, [-a, b, -old]),
            Three::Maximum => self.extreme(a, b, true),
            Three::Minimum => self.extreme(a, b, false),
        }
    }
}

const ALL: [Three; 15] = [
    Three::Add,
    Three::Subtract,
    Three::Multiply,
    Three::NegatedMultiply,
    Three::MultiplyAdd,
    Three::MultiplySubtract,
    Three::NegatedMultiplySubtract,
    Three::NegatedMultiplyAdd,
    Three::Divide,
    Three::FusedAdd,
    Three::FusedSubtract,
    Three::NegatedFusedSubtract,
    Three::NegatedFusedAdd,
    Three::Maximum,
    Three::Minimum,
];

const ROUNDINGS: [Rounding; 5] =
    [Rounding::Nearest, Rounding::NearestAway, Rounding::Up, Rounding::Down, Rounding::Zero];

/// Registers after `float` on these operands: the destination is 0, the others 2 and 4, halves of a double.
fn execute(float: Float, double: bool, operands: [u64; 3], fpscr: u32) -> (u64, u32) {
    let mut registers = Registers::default();
    registers.set_fpscr(fpscr);
    for (register, bits) in [0, 2, 4].into_iter().zip(operands) {
        registers.set_float(double, register, bits);
    }
    float.execute(&mut registers, &mut Core::default());
    (registers.float(double, 0), registers.fpscr)
}

fn bits<F: Real>(value: F) -> u64 {
    value.to_bits() as u64
}

/// Compares every instruction on floats of one width, with one result of that width or less.
fn check<F: Real>(double: bool, [old, a, b]: [u64; 3], fpscr: u32) -> Result<(), TestCaseError> {
    let expected = |reference: Reference, value: u64| (value, reference.fpscr);
    for operation in ALL {
        let mut reference = Reference { fpscr };
        let value = bits(reference.three(operation, of::<F>(old), of(a), of(b)));
        let got = execute(Float::Three { operation, double, d: 0, n: 2, m: 4 }, double, [old, a, b], fpscr);
        prop_assert_eq!(got, expected(reference, value), "{:?} {:#x} {:#x} {:#x} {:#x}", operation, old, a, b, fpscr);
    }
    for signalling in [false, true] {
        let mut reference = Reference { fpscr };
        let flags = reference.compare::<F>(of(old), of(a), signalling);
        let got = execute(Float::Compare { double, signalling, d: 0, m: 2 }, double, [old, a, b], fpscr);
        prop_assert_eq!(got.1, reference.fpscr & !NZCV | flags, "VCMP {:#x} {:#x} {:#x}", old, a, fpscr);
        let mut reference = Reference { fpscr };
        let flags = reference.compare::<F>(of(old), F::ZERO, signalling);
        let got = execute(Float::CompareZero { double, signalling, d: 0 }, double, [old, a, b], fpscr);
        prop_assert_eq!(got.1, reference.fpscr & !NZCV | flags, "VCMP #0 {:#x} {:#x}", old, fpscr);
    }
    let towards = ROUNDINGS.map(Toward::Fixed).into_iter().chain([Toward::Status]);
    let mode = |toward: Toward, reference: &Reference| match toward {
        Toward::Fixed(rounding) => round(rounding),
        Toward::Status => reference.round(),
    };
    for toward in towards {
        let mut reference = Reference { fpscr };
        let value = bits(reference.whole::<F>(of(a), mode(toward, &reference), false));
        let float = Float::Two { operation: Two::Whole(toward), double, d: 0, m: 2 };
        prop_assert_eq!(execute(float, double, [old, a, b], fpscr), expected(reference, value), "VRINT {:#x}", a);
        for signed in [false, true] {
            let mut reference = Reference { fpscr };
            let fixed = Fixed { signed, bits: 32, fraction: 0 };
            let value = reference.fixed::<F>(of(a), fixed, mode(toward, &reference)) as u32;
            let float = Float::ToInteger { double, signed, toward, d: 0, m: 2 };
            let got = execute(float, double, [old, a, b], fpscr);
            prop_assert_eq!((got.0 as u32, got.1), (value, reference.fpscr), "VCVT {:?} {:#x} {:#x}", toward, a, fpscr);
        }
    }
    let mut reference = Reference { fpscr };
    let value = bits(reference.whole::<F>(of(a), reference.round(), true));
    let float = Float::Two { operation: Two::WholeExact, double, d: 0, m: 2 };
    prop_assert_eq!(execute(float, double, [old, a, b], fpscr), expected(reference, value), "VRINTX {:#x}", a);
    // Conversions in place, of 16 and 32 bits, with `b` as the number of bits after the point.
    for (signed, width) in [(false, 16), (true, 16), (false, 32), (true, 32)] {
        let fixed = Fixed { signed, bits: width, fraction: (b % (u64::from(width) + 1)) as u8 };
        let mut reference = Reference { fpscr };
        let value = reference.fixed::<F>(of(a), fixed, Round::TowardZero);
        let value = if double { value } else { value & 0xFFFF_FFFF };
        let got = execute(Float::ToFixed { double, d: 0, fixed }, double, [a, a, b], fpscr);
        prop_assert_eq!(got, expected(reference, value), "VCVT {:?} {:#x} {:#x}", fixed, a, fpscr);
        let mut reference = Reference { fpscr };
        let value = bits(reference.widened::<F>(a as u32, fixed, Round::NearestTiesToEven));
        let got = execute(Float::FromFixed { double, d: 0, fixed }, double, [a, a, b], fpscr);
        prop_assert_eq!(got, expected(reference, value), "VCVT from {:?} {:#x} {:#x}", fixed, a, fpscr);
        let mut reference = Reference { fpscr };
        let integer = Fixed { signed, bits: 32, fraction: 0 };
        let value = bits(reference.widened::<F>(a as u32, integer, reference.round()));
        let got = execute(Float::FromInteger { double, signed, d: 0, m: 2 }, double, [old, a, b], fpscr);
        prop_assert_eq!(got, expected(reference, value), "VCVT from {} {:#x} {:#x}", signed, a as u32, fpscr);
    }
    Ok(())
}

/// Checks VSQRT, which APFloat has not: the square of the root, exact in quadruple precision, is on the right side of
/// the operand, and those of its neighbours on the other.
fn check_root<F: Real>(double: bool, a: u64, fpscr: u32) -> Result<(), TestCaseError> {
    let float = Float::Two { operation: Two::SquareRoot, double, d: 0, m: 2 };
    let (got, after) = execute(float, double, [0, a, 0], fpscr);
    let mut reference = Reference { fpscr };
    let value = reference.operand(of::<F>(a));
    let special = reference.nan(&[value]).or_else(|| {
        if value.is_zero() || value.is_pos_infinity() {
            return Some(value);
        }
        value.is_negative().then(|| {
            reference.fpscr |= IOC;
            Reference::default_nan()
        })
    });
    if let Some(special) = special {
        prop_assert_eq!((got, after), (bits(special), reference.fpscr), "VSQRT {:#x} {:#x}", a, fpscr);
        return Ok(());
    }
    let root = of::<F>(got);
    prop_assert!(root.is_finite_non_zero() && !root.is_negative(), "VSQRT {:#x} is {:#x}", a, got);
    let order = |root: Quad| {
        // A quadruple holds the square of 54 bits.
        let StatusAnd { status, value: square } = root.mul_r(root, Round::TowardZero);
        assert_eq!(status, Status::OK);
        square.partial_cmp(&wide(value))
    };
    let (down, up) = (wide(root.next_down().value), wide(root.next_up().value));
    let half = Quad::from_u128(1).value.scalbn(-1);
    let between = |other: Quad| wide(root).add_r(other, Round::TowardZero).value.mul_r(half, Round::TowardZero).value;
    let right = match reference.round() {
        Round::TowardPositive => order(down) == Some(Ordering::Less) && order(wide(root)) != Some(Ordering::Less),
        Round::TowardNegative | Round::TowardZero => {
            order(wide(root)) != Some(Ordering::Greater) && order(up) == Some(Ordering::Greater)
        }
        // No root lies in the middle of two floats: its square would have one bit too many.
        _ => order(between(down)) == Some(Ordering::Less) && order(between(up)) == Some(Ordering::Greater),
    };
    prop_assert!(right, "VSQRT {:#x} is {:#x} with {:#x}", a, got, fpscr);
    reference.fpscr |= if order(wide(root)) == Some(Ordering::Equal) { 0 } else { IXC };
    prop_assert_eq!(after, reference.fpscr, "VSQRT {:#x} {:#x}", a, fpscr);
    Ok(())
}

/// Bits of a float: any, or with an exponent at an end of the range, in its middle, or where products and squares reach
/// an end, and with a fraction at an end.
fn float(exponent_bits: u32, fraction_bits: u32) -> impl Strategy<Value = u64> {
    let (highest, one) = ((1_u64 << exponent_bits) - 1, 1_u64 << fraction_bits);
    let near = |exponent: u64| (0_u64..6).prop_map(move |more| (exponent + more).saturating_sub(3).min(highest));
    let exponent = prop_oneof![
        0..=highest,
        near(0),
        near(highest),
        near(highest / 2),
        near(highest / 4),
        near(highest * 3 / 4),
        // Integers and fixed point.
        near(highest / 2 + 16),
        near(highest / 2 + 31),
    ];
    let fraction = prop_oneof![
        0..one,
        0..one,
        Just(0),
        Just(1),
        Just(one - 1),
        Just(one / 2),
        (0..fraction_bits).prop_map(move |places| one - (1 << places)),
    ];
    (any::<bool>(), exponent, fraction).prop_map(move |(negative, exponent, fraction)| {
        u64::from(negative) << (exponent_bits + fraction_bits) | exponent << fraction_bits | fraction
    })
}

/// FPSCR with every mode but the alternative half precision; IXC, which opens the fast way, is as often set as not.
fn status() -> impl Strategy<Value = u32> {
    let flags = prop_oneof![Just(0), Just(IXC), Just(IXC | IOC | DZC | OFC | UFC | IDC), Just(OFC | IDC)];
    (0..4_u32, any::<bool>(), any::<bool>(), any::<u32>(), flags).prop_map(|(mode, flush, default, nzcv, flags)| {
        mode << 22 | if flush { FZ } else { 0 } | if default { DN } else { 0 } | nzcv & NZCV | flags
    })
}

proptest! {
    // Each case runs 50 instructions: 4 000 take a second in the tests' profile.
    #![proptest_config(ProptestConfig::with_cases(4_000))]

    #[test]
    fn single_precision_is_apfloats(operands in [float(8, 23), float(8, 23), float(8, 23)], fpscr in status()) {
        check::<ieee::Single>(false, operands, fpscr)?;
        check_root::<ieee::Single>(false, operands[1], fpscr)?;
    }

    #[test]
    fn double_precision_is_apfloats(operands in [float(11, 52), float(11, 52), float(11, 52)], fpscr in status()) {
        check::<ieee::Double>(true, operands, fpscr)?;
        check_root::<ieee::Double>(true, operands[1], fpscr)?;
    }

    #[test]
    fn conversions_of_width_are_apfloats(
        half in float(5, 10), single in float(8, 23), double in float(11, 52),
        near_half in float(5, 10), near_single in float(8, 23), lost in any::<u16>(), fpscr in status(),
    ) {
        // Values of the next smaller format with some bits more, which lie in its range and have to be rounded.
        let widened = |narrow: u64, from, to, lost: u64| format::convert(from, to, narrow, &mut 0) ^ lost;
        let singles = [single, widened(near_half, HALF, SINGLE, (lost & 0x1FFF).into())];
        let doubles = [
            double,
            widened(near_half, HALF, DOUBLE, u64::from(lost) << 26),
            widened(near_single, SINGLE, DOUBLE, u64::from(lost) << 13),
        ];
        for single in singles {
            let value = of::<ieee::Single>(single);
            let mut reference = Reference { fpscr };
            let expected = bits(reference.convert::<_, ieee::Double>(value));
            let mut registers = Registers::default();
            registers.set_fpscr(fpscr);
            registers.set_float(false, 2, single);
            Float::ToDouble { d: 0, m: 2 }.execute(&mut registers, &mut Core::default());
            prop_assert_eq!((registers.float(true, 0), registers.fpscr), (expected, reference.fpscr), "{:#x} {:#x}", single, fpscr);
            let mut reference = Reference { fpscr };
            let expected = bits(reference.convert::<_, ieee::Half>(value));
            let got = execute(Float::ToHalf { double: false, top: false, d: 0, m: 2 }, false, [0, single, 0], fpscr);
            prop_assert_eq!(got, (expected, reference.fpscr), "to half {:#x} {:#x}", single, fpscr);
        }
        for double in doubles {
            let value = of::<ieee::Double>(double);
            let mut reference = Reference { fpscr };
            let expected = bits(reference.convert::<_, ieee::Single>(value));
            let got = execute(Float::ToSingle { d: 0, m: 2 }, true, [0, double, 0], fpscr);
            prop_assert_eq!(got, (expected, reference.fpscr), "to single {:#x} {:#x}", double, fpscr);
            let mut reference = Reference { fpscr };
            let expected = bits(reference.convert::<_, ieee::Half>(value));
            let got = execute(Float::ToHalf { double: true, top: false, d: 0, m: 2 }, true, [0, double, 0], fpscr);
            prop_assert_eq!(got, (expected, reference.fpscr), "to half {:#x} {:#x}", double, fpscr);
        }
        let value = of::<ieee::Half>(half);
        let mut reference = Reference { fpscr };
        let expected = bits(reference.convert::<_, ieee::Single>(value));
        let got = execute(Float::FromHalf { double: false, top: false, d: 0, m: 2 }, false, [0, half, 0], fpscr);
        prop_assert_eq!(got, (expected, reference.fpscr), "from half {:#x} {:#x}", half, fpscr);
        let mut reference = Reference { fpscr };
        let expected = bits(reference.convert::<_, ieee::Double>(value));
        let got = execute(Float::FromHalf { double: true, top: false, d: 0, m: 2 }, true, [0, half, 0], fpscr);
        prop_assert_eq!(got, (expected, reference.fpscr), "from half {:#x} {:#x}", half, fpscr);
    }
}
