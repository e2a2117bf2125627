//! Steppers: paths, pulse times, axes, and the enable they share.

pub mod axis;
mod bank;
pub mod generator;
pub mod scurve;
pub mod steps;

#[cfg(test)]
mod tests;

pub use bank::{Bank, MAX_STEPPERS, NotTaken};
pub use r4_protocol::config::{HomingConfig as Homing, StepperConfig};

/// The nearest number to `whole`, as `as` gives it. A Cortex-M7 converts halves by itself, and calls a function of 30 instructions
/// for the whole.
fn to_f64(whole: u64) -> f64 {
    f64::from((whole >> 32) as u32) * 4_294_967_296.0 + f64::from(whole as u32)
}

/// The whole number nearest to `number`, and the remainder, -0.5..=0.5. Numbers that fit 32 bits are converted by an instruction of
/// the processor, others by the library.
fn rounded(number: f64) -> (i64, f64) {
    if number.abs() < 2e9 {
        let whole = (number + 0.5f64.copysign(number)) as i32;
        (whole.into(), number - f64::from(whole))
    } else {
        let whole = libm::round(number);
        (whole as i64, number - whole)
    }
}

/// The square root, within 2 units in the last place; 0 below the smallest normal number. A path to a position needs some ten of
/// them, and the library's, made for processors without floating point, takes six times as many instructions as this.
///
/// Newton's method for the reciprocal of the root (no division), from a first guess that halves the exponent: relative errors
/// of 3.5e-2, 1.8e-3, 4.8e-6, 3.5e-11, 1.8e-21.
fn sqrt(number: f64) -> f64 {
    // NaN goes on and stays.
    if number < f64::MIN_POSITIVE {
        return if number < 0.0 { f64::NAN } else { 0.0 };
    }
    if number == f64::INFINITY {
        return number;
    }
    // C. Lomont, "Fast inverse square root" (2003), for 64 bits.
    let mut reciprocal = f64::from_bits(0x5FE6_EB50_C7B5_37A9 - (number.to_bits() >> 1));
    let half = 0.5 * number;
    for _ in 0..4 {
        reciprocal *= 1.5 - half * reciprocal * reciprocal;
    }
    let root = number * reciprocal;
    // What rounding has cost, once more.
    root + 0.5 * reciprocal * (number - root * root)
}

#[cfg(test)]
mod conversions {
    use proptest::prelude::*;

    use super::{rounded, sqrt, to_f64};

    #[test]
    fn roots_of_what_is_no_ordinary_number_are_those_of_the_library() {
        for number in [0.0, -0.0, 1.0, f64::INFINITY] {
            assert_eq!(sqrt(number), libm::sqrt(number), "{number}");
        }
        assert!(sqrt(-f64::MIN_POSITIVE).is_nan() && sqrt(-1.0).is_nan() && sqrt(f64::NAN).is_nan());
        assert_eq!(sqrt(f64::from_bits(1)), 0.0);
    }

    proptest! {
        #[test]
        fn roots_are_those_of_the_library(bits in f64::MIN_POSITIVE.to_bits()..f64::INFINITY.to_bits(), near in 0.25..4.0f64) {
            for number in [f64::from_bits(bits), near, f64::MIN_POSITIVE, f64::MAX] {
                let (ours, theirs) = (sqrt(number), libm::sqrt(number));
                prop_assert!(ours.to_bits().abs_diff(theirs.to_bits()) <= 2, "{number}: {ours} {theirs}");
            }
        }

        #[test]
        fn they_are_those_of_the_library(whole: u64, number in -1e10f64..1e10, halves in -9_000_000_000i64..9_000_000_000) {
            prop_assert_eq!(to_f64(whole), whole as f64);
            for number in [number, number * 1e-9, halves as f64 / 2.0] {
                let nearest = libm::round(number);
                prop_assert_eq!(rounded(number), (nearest as i64, number - nearest));
            }
        }
    }
}
