//! Conversions of numbers that take a Cortex-M7 fewer instructions than those of the library.

/// Converts to the nearest f64, like `as`. A Cortex-M7 converts 32-bit halves with one instruction, and calls a
/// function of 30 instructions for all 64 bits.
pub(super) fn to_f64(whole: u64) -> f64 {
    f64::from((whole >> 32) as u32) * 4_294_967_296.0 + f64::from(whole as u32)
}

/// Returns the integer nearest to `number`, and the remainder, -0.5..=0.5. Numbers that fit 32 bits are converted by an
/// instruction of the processor, others by the library.
pub(super) fn rounded(number: f64) -> (i64, f64) {
    if number.abs() < 2e9 {
        let whole = (number + 0.5f64.copysign(number)) as i32;
        (whole.into(), number - f64::from(whole))
    } else {
        let whole = libm::round(number);
        (whole as i64, number - whole)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::{rounded, to_f64};

    proptest! {
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
