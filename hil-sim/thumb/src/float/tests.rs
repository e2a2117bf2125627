//! Tests against the host's IEEE 754 floats, against exact integers, and against values computed by hand.

use proptest::prelude::*;

use super::arithmetic;
use super::format::{DOUBLE, HALF, SINGLE, convert};
use super::integer::{Fixed, round_to_whole, to_fixed};
use super::status::{AHP, DN, DZC, FZ, IDC, IOC, IXC, OFC, Rounding, UFC};
use super::*;

const MODES: [u32; 4] = [0, 1 << 22, 2 << 22, 3 << 22];

#[derive(Default)]
pub(super) struct Core {
    r: [u32; 16],
    flags: u32,
}

impl CoreRegisters for Core {
    fn get(&self, register: u8) -> u32 {
        self.r[usize::from(register)]
    }
    fn set(&mut self, register: u8, value: u32) {
        self.r[usize::from(register)] = value;
    }
    fn nzcv(&self) -> u32 {
        self.flags
    }
    fn set_nzcv(&mut self, flags: u32) {
        self.flags = flags;
    }
}

/// Generates bits of a float, with special values and neighbours of powers of two as likely as others.
fn single() -> impl Strategy<Value = u32> {
    prop_oneof![
        any::<u32>(),
        (any::<bool>(), 0_u32..256, prop_oneof![Just(0), Just(1), Just(0x40_0000), Just(0x7F_FFFF)])
            .prop_map(|(sign, exponent, fraction)| u32::from(sign) << 31 | exponent << 23 | fraction),
        (-300..300_i32, 0_u32..6).prop_map(|(number, places)| (number as f32 / (1 << places) as f32).to_bits()),
    ]
}

fn double() -> impl Strategy<Value = u64> {
    prop_oneof![
        any::<u64>(),
        (any::<bool>(), 0_u64..2048, prop_oneof![Just(0), Just(1), Just(1 << 51), Just((1 << 52) - 1)])
            .prop_map(|(sign, exponent, fraction)| u64::from(sign) << 63 | exponent << 52 | fraction),
        (-300..300_i32, 0_u32..6).prop_map(|(number, places)| (f64::from(number) / f64::from(1 << places)).to_bits()),
        single().prop_map(|bits| f64::from(f32::from_bits(bits)).to_bits()),
    ]
}

/// Returns true for equal bits, or two NaNs: the architecture defines which NaN results, IEEE 754 does not.
fn same32(ours: u64, theirs: f32) -> bool {
    ours as u32 == theirs.to_bits() || theirs.is_nan() && f32::from_bits(ours as u32).is_nan()
}

fn same64(ours: u64, theirs: f64) -> bool {
    ours == theirs.to_bits() || theirs.is_nan() && f64::from_bits(ours).is_nan()
}

proptest! {
    #[test]
    fn single_results_are_ieee_754s(a in single(), b in single(), c in single()) {
        let [x, y, z] = [a, b, c].map(f32::from_bits);
        let [a, b, c] = [a, b, c].map(u64::from);
        let mut fpscr = 0;
        prop_assert!(same32(arithmetic::add(SINGLE, a, b, &mut fpscr), x + y));
        prop_assert!(same32(arithmetic::subtract(SINGLE, a, b, &mut fpscr), x - y));
        prop_assert!(same32(arithmetic::multiply(SINGLE, a, b, &mut fpscr), x * y));
        prop_assert!(same32(arithmetic::divide(SINGLE, a, b, &mut fpscr), x / y));
        prop_assert!(same32(arithmetic::fused(SINGLE, c, a, b, &mut fpscr), x.mul_add(y, z)));
        prop_assert!(same32(arithmetic::square_root(SINGLE, a, &mut fpscr), x.sqrt()));
        prop_assert!(same64(convert(SINGLE, DOUBLE, a, &mut fpscr), f64::from(x)));
    }

    #[test]
    fn double_results_are_ieee_754s(a in double(), b in double(), c in double()) {
        let [x, y, z] = [a, b, c].map(f64::from_bits);
        let mut fpscr = 0;
        prop_assert!(same64(arithmetic::add(DOUBLE, a, b, &mut fpscr), x + y));
        prop_assert!(same64(arithmetic::subtract(DOUBLE, a, b, &mut fpscr), x - y));
        prop_assert!(same64(arithmetic::multiply(DOUBLE, a, b, &mut fpscr), x * y));
        prop_assert!(same64(arithmetic::divide(DOUBLE, a, b, &mut fpscr), x / y));
        prop_assert!(same64(arithmetic::fused(DOUBLE, c, a, b, &mut fpscr), x.mul_add(y, z)));
        prop_assert!(same64(arithmetic::square_root(DOUBLE, a, &mut fpscr), x.sqrt()));
        prop_assert!(same32(convert(DOUBLE, SINGLE, a, &mut fpscr), x as f32));
    }

    /// The fast path with the host's floats gives the results of the integers, FPSCR included.
    #[test]
    fn the_fast_way_is_the_exact_one(a in double(), b in double(), c in double(), mode in 0_usize..4, more in any::<u32>()) {
        let before = MODES[mode] | more & (FZ | DN | IXC | IOC | UFC | OFC | IDC);
        for (first, second, third) in [(a, b, c), (a, b, DOUBLE.negate(a))] {
            let mut both = [before; 2];
            let [exact, quick] = &mut both;
            let (x, y, z) = (first, second, third);
            prop_assert_eq!(fast::add::<f64>(x, y, quick), arithmetic::add(DOUBLE, x, y, exact));
            prop_assert_eq!(fast::subtract::<f64>(x, y, quick), arithmetic::subtract(DOUBLE, x, y, exact));
            prop_assert_eq!(fast::multiply::<f64>(x, y, quick), arithmetic::multiply(DOUBLE, x, y, exact));
            prop_assert_eq!(fast::divide::<f64>(x, y, quick), arithmetic::divide(DOUBLE, x, y, exact));
            prop_assert_eq!(fast::fused::<f64>(z, x, y, quick), arithmetic::fused(DOUBLE, z, x, y, exact));
            prop_assert_eq!(fast::square_root::<f64>(x, quick), arithmetic::square_root(DOUBLE, x, exact));
            for signed in [false, true] {
                let fixed = Fixed { signed, bits: 32, fraction: 0 };
                prop_assert_eq!(
                    fast::to_integer::<f64>(x, signed, Rounding::Zero, quick),
                    to_fixed(DOUBLE, x, fixed, Rounding::Zero, exact) as u32
                );
                prop_assert_eq!(
                    fast::extreme::<f64>(x, y, signed, quick),
                    compare::extreme(DOUBLE, x, y, signed, exact)
                );
                prop_assert_eq!(
                    fast::compare::<f64>(x, y, signed, quick),
                    compare::compare(DOUBLE, x, y, signed, exact)
                );
            }
            prop_assert_eq!(fast::to_single(x, quick), convert(DOUBLE, SINGLE, x, exact));
            let (x, y, z) = (x >> 32, y >> 32, z >> 32);
            prop_assert_eq!(fast::to_double(x, quick), convert(SINGLE, DOUBLE, x, exact));
            prop_assert_eq!(fast::add::<f32>(x, y, quick), arithmetic::add(SINGLE, x, y, exact));
            prop_assert_eq!(fast::subtract::<f32>(x, y, quick), arithmetic::subtract(SINGLE, x, y, exact));
            prop_assert_eq!(fast::multiply::<f32>(x, y, quick), arithmetic::multiply(SINGLE, x, y, exact));
            prop_assert_eq!(fast::divide::<f32>(x, y, quick), arithmetic::divide(SINGLE, x, y, exact));
            prop_assert_eq!(fast::fused::<f32>(z, x, y, quick), arithmetic::fused(SINGLE, z, x, y, exact));
            prop_assert_eq!(fast::square_root::<f32>(x, quick), arithmetic::square_root(SINGLE, x, exact));
            prop_assert_eq!(both[0], both[1]);
        }
    }

    /// Rounding modes for a sum or product of floats, which doubles hold exactly: down is not above it, up not below,
    /// they are neighbours or equal, towards zero is one of them, and IXC is set if they differ.
    #[test]
    fn rounding_modes_enclose_the_exact_result(a in single(), b in single(), multiply in any::<bool>()) {
        let (x, y) = (f64::from(f32::from_bits(a)), f64::from(f32::from_bits(b)));
        prop_assume!(x.is_finite() && y.is_finite());
        // Sums of floats of very different magnitude do not fit into a double.
        let near = x == 0.0 || y == 0.0 || (x.abs().log2() - y.abs().log2()).abs() < 28.0;
        let multiply = multiply || !near;
        let exact = if multiply { x * y } else { x + y };
        let results = MODES.map(|mode| {
            let mut fpscr = mode;
            let operation = if multiply { arithmetic::multiply } else { arithmetic::add };
            let bits = operation(SINGLE, a.into(), b.into(), &mut fpscr) as u32;
            (f32::from_bits(bits), fpscr & IXC != 0)
        });
        let [(nearest, inexact), (up, _), (down, _), (zero, _)] = results;
        prop_assert!(f64::from(down) <= exact && exact <= f64::from(up));
        prop_assert!(down == up || down.next_up() == up, "{down:e} {up:e}");
        prop_assert_eq!(inexact, down != up);
        prop_assert!(results.iter().all(|result| result.1 == inexact));
        prop_assert_eq!(zero, if exact < 0.0 { up } else { down });
        prop_assert!(nearest == down || nearest == up);
        if down.is_finite() && up.is_finite() {
            let (below, above) = (exact - f64::from(down), f64::from(up) - exact);
            prop_assert!(below == above || (nearest == down) == (below < above) || !inexact);
        }
    }

    #[test]
    fn integers_are_converted_as_rust_does(bits in double(), value in any::<u32>(), fraction in 0_u8..=32) {
        let x = f64::from_bits(bits);
        let fixed = |signed, bits, fraction| Fixed { signed, bits, fraction };
        let mut fpscr = 0;
        let scaled = x * 2_f64.powi(fraction.into());
        let convert = |fixed, fpscr: &mut u32| to_fixed(DOUBLE, bits, fixed, Rounding::Zero, fpscr);
        prop_assert_eq!(convert(fixed(true, 32, fraction), &mut fpscr), i64::from(scaled as i32) as u64);
        prop_assert_eq!(convert(fixed(false, 32, fraction), &mut fpscr), u64::from(scaled as u32));
        let fraction = fraction / 2;
        let scaled = x * 2_f64.powi(fraction.into());
        prop_assert_eq!(convert(fixed(true, 16, fraction), &mut fpscr), i64::from(scaled as i16) as u64);
        prop_assert_eq!(convert(fixed(false, 16, fraction), &mut fpscr), u64::from(scaled as u16));
        let mut registers = Registers::default();
        registers.s[3] = value;
        for (signed, expected) in [(true, value as i32 as f32), (false, value as f32)] {
            for fpscr in [0, IXC] {
                registers.fpscr = fpscr;
                registers.set_from_integer(false, signed, 0, 3);
                prop_assert_eq!(registers.s[0], expected.to_bits());
                let exact = f64::from(expected) == if signed { f64::from(value as i32) } else { f64::from(value) };
                prop_assert_eq!(registers.fpscr, fpscr | if exact { 0 } else { IXC });
            }
        }
    }

    #[test]
    fn whole_numbers_are_rusts(bits in double()) {
        let x = f64::from_bits(bits);
        let mut fpscr = 0;
        for (rounding, expected) in [
            (Rounding::Nearest, x.round_ties_even()),
            (Rounding::NearestAway, x.round()),
            (Rounding::Up, x.ceil()),
            (Rounding::Down, x.floor()),
            (Rounding::Zero, x.trunc()),
        ] {
            prop_assert!(same64(round_to_whole(DOUBLE, bits, rounding, false, &mut fpscr), expected));
            prop_assert_eq!(fpscr & !IOC, 0);
        }
        round_to_whole(DOUBLE, bits, Rounding::Zero, true, &mut fpscr);
        prop_assert_eq!(fpscr & IXC != 0, !x.is_nan() && x.trunc() != x);
    }

    #[test]
    fn comparisons_are_rusts(a in double(), b in double()) {
        let mut fpscr = 0;
        for (first, second) in [(a, b), (a, a), (a, DOUBLE.negate(a))] {
            let flags = compare::compare(DOUBLE, first, second, false, &mut fpscr) >> 28;
            let expected = match f64::from_bits(first).partial_cmp(&f64::from_bits(second)) {
                Some(std::cmp::Ordering::Less) => 0b1000,
                Some(std::cmp::Ordering::Equal) => 0b0110,
                Some(std::cmp::Ordering::Greater) => 0b0010,
                None => 0b0011,
            };
            prop_assert_eq!(flags, expected);
        }
    }

    #[test]
    fn any_word_decodes_or_does_not_and_executes(first in 0xEC00_u16.., second in any::<u16>(), fpscr in any::<u32>()) {
        if let Some(float) = decode(first, second & 0xF1FF | 0x0A00) {
            let mut registers = Registers::default();
            registers.set_fpscr(fpscr);
            float.execute(&mut registers, &mut Core::default());
            if let Some(transfer) = float.transfer() {
                prop_assert!((1..=32).contains(&transfer.words) && transfer.first + transfer.words <= 32);
            }
        }
    }
}

#[test]
fn every_half_survives_the_way_to_single_and_back() {
    for half in 0..=0xFFFF_u64 {
        for fpscr in [0, AHP] {
            let mut fpscr = fpscr;
            let wide = convert(HALF, SINGLE, half, &mut fpscr);
            let wider = convert(HALF, DOUBLE, half, &mut fpscr);
            assert!(same64(wider, f64::from(f32::from_bits(wide as u32))), "{half:#x}");
            let nan = fpscr & AHP == 0 && half & 0x7C00 == 0x7C00 && half & 0x3FF != 0;
            let expected = if nan { half | 0x200 } else { half };
            assert_eq!(convert(SINGLE, HALF, wide, &mut fpscr), expected, "{half:#x}");
            assert_eq!(convert(DOUBLE, HALF, wider, &mut fpscr), expected, "{half:#x}");
        }
    }
    // The largest value of each kind, and one that rounds to infinity.
    assert_eq!(f32::from_bits(convert(HALF, SINGLE, 0x7BFF, &mut 0) as u32), 65504.0);
    assert_eq!(f32::from_bits(convert(HALF, SINGLE, 0x7FFF, &mut { AHP }) as u32), 131008.0);
    let mut fpscr = 0;
    assert_eq!((convert(SINGLE, HALF, 65520_f32.to_bits().into(), &mut fpscr), fpscr), (0x7C00, OFC | IXC));
    let mut fpscr = AHP;
    assert_eq!((convert(SINGLE, HALF, f32::INFINITY.to_bits().into(), &mut fpscr), fpscr), (0x7FFF, AHP | IOC));
}

#[test]
fn a_double_becomes_a_half_with_one_rounding() {
    // 1 + 2^-11 + 2^-40: rounded to a float first, it would be a tie, and go down.
    let x = 1.0 + 2_f64.powi(-11) + 2_f64.powi(-40);
    assert_eq!(convert(DOUBLE, HALF, x.to_bits(), &mut 0), 0x3C01);
}

#[test]
fn special_cases_raise_what_they_should() {
    let bits = |value: f32| u64::from(value.to_bits());
    let (zero, one, infinity) = (bits(0.0), bits(1.0), bits(f32::INFINITY));
    let (signalling, quiet) = (0x7F80_0001, 0xFFC0_1234);
    type Operation = fn(u64, u64, &mut u32) -> u64;
    let add: Operation = |a, b, fpscr| arithmetic::add(SINGLE, a, b, fpscr);
    let multiply: Operation = |a, b, fpscr| arithmetic::multiply(SINGLE, a, b, fpscr);
    let divide: Operation = |a, b, fpscr| arithmetic::divide(SINGLE, a, b, fpscr);
    let tiny = bits(f32::MIN_POSITIVE);
    for (operation, a, b, before, result, raised) in [
        (add, infinity, SINGLE.negate(infinity), 0, 0x7FC0_0000, IOC),
        (add, quiet, signalling, 0, 0x7FC0_0001, IOC),
        (add, quiet, one, 0, quiet, 0),
        (add, one, quiet, DN, 0x7FC0_0000, 0),
        (add, one, SINGLE.negate(one), 0, zero, 0),
        (add, one, SINGLE.negate(one), 2 << 22, SINGLE.negate(zero), 0),
        (multiply, zero, infinity, 0, 0x7FC0_0000, IOC),
        (multiply, tiny, bits(0.5), 0, tiny >> 1, 0),
        (multiply, tiny, bits(0.3), 0, bits(f32::MIN_POSITIVE * 0.3), UFC | IXC),
        (multiply, tiny, bits(0.5), FZ, zero, UFC),
        (multiply, 1, one, FZ, zero, IDC),
        // Underflow is detected before rounding, which makes the smallest normal number of this.
        (multiply, tiny, bits(1.0_f32.next_down()), 0, tiny, UFC | IXC),
        (multiply, bits(f32::MAX), bits(2.0), 0, infinity, OFC | IXC),
        (multiply, bits(f32::MAX), bits(2.0), 3 << 22, bits(f32::MAX), OFC | IXC),
        (divide, one, zero, 0, infinity, DZC),
        (divide, zero, zero, 0, 0x7FC0_0000, IOC),
        (divide, infinity, zero, 0, infinity, 0),
        (divide, one, bits(3.0), 0, bits(1.0 / 3.0), IXC),
        (divide, one, bits(4.0), 0, bits(0.25), 0),
    ] {
        let mut fpscr = before;
        let got = operation(a, b, &mut fpscr);
        assert_eq!((got, fpscr), (result, before | raised), "{a:#x} {b:#x} {before:#x}");
    }
    // The sign of a NaN stays in a difference; zero times infinity overrides a quiet addend, not a signalling one.
    assert_eq!(arithmetic::subtract(SINGLE, one, quiet, &mut 0), quiet);
    assert_eq!(arithmetic::fused(SINGLE, quiet, zero, infinity, &mut 0), 0x7FC0_0000);
    assert_eq!(arithmetic::fused(SINGLE, signalling, zero, infinity, &mut 0), 0x7FC0_0001);
    assert_eq!(arithmetic::square_root(SINGLE, bits(-0.0), &mut 0), bits(-0.0));
    assert_eq!(arithmetic::square_root(SINGLE, bits(-1.0), &mut 0), 0x7FC0_0000);
}

#[test]
fn the_larger_and_the_smaller_pass_over_a_quiet_nan() {
    let [one, two] = [1.0_f32, 2.0].map(|value| u64::from(value.to_bits()));
    let nan = 0x7FC0_0007;
    let pick = |a, b, largest| compare::extreme(SINGLE, a, b, largest, &mut 0);
    assert_eq!((pick(one, two, true), pick(one, two, false)), (two, one));
    assert_eq!((pick(nan, one, true), pick(one, nan, false)), (one, one));
    assert_eq!((pick(0x7F80_0001, one, true), pick(nan, 0x7F80_0001, true)), (0x7FC0_0001, 0x7FC0_0001));
    let minus = SINGLE.zero(true);
    assert_eq!((pick(0, minus, true), pick(minus, 0, false)), (0, minus));
}

/// Encodings are those of an assembler.
#[test]
fn known_encodings_are_decoded() {
    for ((first, second), expected) in [
        // vadd.f32 s1,s2,s3; vsub.f64 d1,d2,d3; vdiv.f32 s0,s0,s1; vfnma.f64 d0,d1,d2
        ((0xEE71, 0x0A21), Float::Three { operation: Three::Add, double: false, d: 1, n: 2, m: 3 }),
        ((0xEE32, 0x1B43), Float::Three { operation: Three::Subtract, double: true, d: 2, n: 4, m: 6 }),
        ((0xEE80, 0x0A20), Float::Three { operation: Three::Divide, double: false, d: 0, n: 0, m: 1 }),
        ((0xEE91, 0x0B42), Float::Three { operation: Three::NegatedFusedAdd, double: true, d: 0, n: 2, m: 4 }),
        // vmov.f32 s0,#1.0; vmov.f64 d1,#-0.5; vmov.f32 s2,#31.0
        ((0xEEB7, 0x0A00), Float::Immediate { double: false, d: 0, highest: 0x3F80 }),
        ((0xEEBE, 0x1B00), Float::Immediate { double: true, d: 2, highest: 0xBFE0 }),
        ((0xEEB3, 0x1A0F), Float::Immediate { double: false, d: 2, highest: 0x41F8 }),
        // vcmp.f32 s0,s1; vcmpe.f64 d0,#0
        ((0xEEB4, 0x0A60), Float::Compare { double: false, signalling: false, d: 0, m: 1 }),
        ((0xEEB5, 0x0BC0), Float::CompareZero { double: true, signalling: true, d: 0 }),
        // vcvt.s32.f32 s0,s0; vcvtr.u32.f64 s1,d2; vcvt.f64.u32 d0,s3; vcvta.s32.f32 s0,s1
        (
            (0xEEBD, 0x0AC0),
            Float::ToInteger { double: false, signed: true, toward: Toward::Fixed(Rounding::Zero), d: 0, m: 0 },
        ),
        ((0xEEFC, 0x0B42), Float::ToInteger { double: true, signed: false, toward: Toward::Status, d: 1, m: 4 }),
        ((0xEEB8, 0x0B61), Float::FromInteger { double: true, signed: false, d: 0, m: 3 }),
        (
            (0xFEBC, 0x0AE0),
            Float::ToInteger { double: false, signed: true, toward: Toward::Fixed(Rounding::NearestAway), d: 0, m: 1 },
        ),
        // vcvt.f32.s16 s0,s0,#8; vcvt.u32.f64 d0,d0,#31
        (
            (0xEEBA, 0x0A44),
            Float::FromFixed { double: false, d: 0, fixed: Fixed { signed: true, bits: 16, fraction: 8 } },
        ),
        (
            (0xEEBF, 0x0BE0),
            Float::ToFixed { double: true, d: 0, fixed: Fixed { signed: false, bits: 32, fraction: 31 } },
        ),
        // vcvt.f32.f64 s0,d0; vcvt.f64.f32 d0,s1; vcvtt.f16.f32 s0,s1
        ((0xEEB7, 0x0BC0), Float::ToSingle { d: 0, m: 0 }),
        ((0xEEB7, 0x0AE0), Float::ToDouble { d: 0, m: 1 }),
        ((0xEEB3, 0x0AE0), Float::ToHalf { double: false, top: true, d: 0, m: 1 }),
        // vseleq.f32 s0,s1,s2; vminnm.f64 d0,d1,d2; vrintz.f32 s0,s0
        ((0xFE00, 0x0A81), Float::Select { condition: 0, double: false, d: 0, n: 1, m: 2 }),
        ((0xFE81, 0x0B42), Float::Three { operation: Three::Minimum, double: true, d: 0, n: 2, m: 4 }),
        (
            (0xEEB6, 0x0AC0),
            Float::Two { operation: Two::Whole(Toward::Fixed(Rounding::Zero)), double: false, d: 0, m: 0 },
        ),
        // vmov r2,s1; vmov d1[1],r3; vmov r0,r1,d2; vmov s2,s3,r4,r5
        ((0xEE10, 0x2A90), Float::ToCore { core: 2, single: 1 }),
        ((0xEE21, 0x3B10), Float::FromCore { core: 3, single: 3 }),
        ((0xEC51, 0x0B12), Float::PairToCore { low: 0, high: 1, first: 4 }),
        ((0xEC45, 0x4A11), Float::PairFromCore { low: 4, high: 5, first: 2 }),
        // vmrs APSR_nzcv,fpscr; vmrs r1,fpscr; vmsr fpscr,r2
        ((0xEEF1, 0xFA10), Float::StatusToFlags),
        ((0xEEF1, 0x1A10), Float::StatusToCore { core: 1 }),
        ((0xEEE1, 0x2A10), Float::StatusFromCore { core: 2 }),
    ] {
        assert_eq!(decode(first, second), Some(expected), "{first:04x} {second:04x}");
    }
    let transfer = |first, second| decode(first, second).and_then(|float| float.transfer());
    for ((first, second), (load, base, register, words, offset, write_back)) in [
        // vldr s1,[r0,#-8]; vstr d1,[sp,#16]; vpush {d8-d15}; vpop {s16}; vldmia r1,{s0-s3}
        ((0xED50, 0x0A02), (true, 0, 1, 1, -8, 0)),
        ((0xED8D, 0x1B04), (false, 13, 2, 2, 16, 0)),
        ((0xED2D, 0x8B10), (false, 13, 16, 16, -64, -64)),
        ((0xECBD, 0x8A01), (true, 13, 16, 1, 0, 4)),
        ((0xEC91, 0x0A04), (true, 1, 0, 4, 0, 0)),
        // fldmiax r1!,{d0-d1}: the base advances by five words, four are transferred.
        ((0xECB1, 0x0B05), (true, 1, 0, 4, 0, 20)),
    ] {
        let expected = Transfer { load, base, first: register, words, offset, write_back };
        assert_eq!(transfer(first, second), Some(expected), "{first:04x} {second:04x}");
    }
    // Undefined: D16; a list past S31; an empty one; another coprocessor; vdiv with bit 6; VMRS of another register.
    for (first, second) in [
        (0xEE71, 0x0B01),
        (0xECB1, 0xFA03),
        (0xECB1, 0x0A00),
        (0xEE31, 0x0E01),
        (0xEE81, 0x0A42),
        (0xEEF0, 0x1A10),
        (0xED80, 0x0F00),
    ] {
        assert_eq!(decode(first, second), None, "{first:04x} {second:04x}");
    }
}

#[test]
fn registers_move_and_flags_are_kept() {
    let mut registers = Registers::default();
    let mut core = Core { flags: 4 << 28, ..Core::default() };
    core.r[2] = 0x3FF0_0000;
    core.r[3] = u32::MAX;
    let mut execute = |first, second, core: &mut Core| {
        if let Some(float) = decode(first, second) {
            float.execute(&mut registers, core);
        }
        registers.clone()
    };
    // vmov d1[1],r2; vcmp.f64 d1,#0; vmrs APSR_nzcv,fpscr
    assert_eq!(execute(0xEE21, 0x2B10, &mut core).s[3], 0x3FF0_0000);
    assert_eq!(execute(0xEEB5, 0x1B40, &mut core).fpscr, 2 << 28);
    execute(0xEEF1, 0xFA10, &mut core);
    assert_eq!(core.flags, 2 << 28);
    // vselgt.f64 d0,d1,d2 now takes d1; vmsr fpscr,r3
    assert_eq!(execute(0xFE31, 0x0B02, &mut core).s[1], 0x3FF0_0000);
    assert_eq!(execute(0xEEE1, 0x3A10, &mut core).fpscr, 0xF7C0_009F);
    assert!(size_of::<Float>() <= 10);
}
