//! Fixed-point formatting of numbers.

use core::fmt::{Display, Formatter, Result};

/// Number formatted like `{value:.digits$}` or `{value:+.digits$}`. The standard library's code takes 6 KB of flash,
/// for numbers of any size.
pub(super) struct Fixed {
    pub(super) value: f32,
    /// Number of decimals, at most 2, for numbers up to 42 million; greater ones are shown as that.
    pub(super) digits: u8,
}

impl Display for Fixed {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> Result {
        let Self { value, digits } = *self;
        if value.is_nan() {
            return formatter.write_str("NaN");
        }
        if value.is_sign_negative() {
            formatter.write_str("-")?;
        } else if formatter.sign_plus() {
            formatter.write_str("+")?;
        }
        if value.is_infinite() {
            return formatter.write_str("inf");
        }
        let scale = 10u32.pow(digits.into());
        // Exact, like the remainder below: a product of 24 and 7 bits.
        let exact = f64::from(value.abs()) * f64::from(scale);
        let below = exact as u32;
        let left = exact - f64::from(below);
        // Half-way values round to even.
        let up = left > 0.5 || left == 0.5 && !below.is_multiple_of(2);
        let number = below.saturating_add(up.into());
        write!(formatter, "{}.{:0width$}", number / scale, number % scale, width = digits.into())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use proptest::prelude::*;
    use std::format;

    use super::*;

    #[track_caller]
    fn as_the_standard_library(value: f32) {
        for digits in 1..=2 {
            let (ours, width) = (Fixed { value, digits }, usize::from(digits));
            assert_eq!(format!("{ours}"), format!("{value:.width$}"));
            assert_eq!(format!("{ours:+}"), format!("{value:+.width$}"));
        }
    }

    #[test]
    fn half_ways_signs_and_what_is_no_number_are_as_in_the_standard_library() {
        for value in [0.0, 0.004, 0.05, 0.125, 0.25, 0.375, 0.75, 0.995, 9.995, 24.05, 1e6, f32::INFINITY] {
            as_the_standard_library(value);
            as_the_standard_library(-value);
        }
        as_the_standard_library(f32::NAN);
    }

    #[test]
    fn a_number_that_is_too_large_is_shown_as_the_largest() {
        assert_eq!(format!("{}", Fixed { value: 1e30, digits: 2 }), "42949672.95");
    }

    proptest! {
        #[test]
        fn any_number_is_as_in_the_standard_library(value in -4e7f32..4e7) {
            as_the_standard_library(value);
        }

        #[test]
        fn small_numbers_too(value in -2f32..2.0) {
            as_the_standard_library(value);
        }
    }
}
