//! Limiting of numbers to an interval.

/// Replacement for `f32::clamp` and `f64::clamp`. Their panic prints the bounds, and brings all of the printing of
/// floating-point numbers into the image, 14 KB.
pub(crate) trait Within: Copy + PartialOrd {
    /// Limits `self` to `low`..=`high`; NaN stays NaN.
    ///
    /// # Panics
    /// If `low` is above `high`, or either is NaN.
    fn within(self, low: Self, high: Self) -> Self {
        assert!(low <= high);
        if self < low {
            low
        } else if self > high {
            high
        } else {
            self
        }
    }
}

impl Within for f32 {}
impl Within for f64 {}

#[cfg(test)]
mod tests {
    use super::*;

    /// Equal to the bit, also for bounds that are zeros of either sign.
    #[test]
    fn numbers_are_kept_as_the_standard_library_keeps_them() {
        for (low, high) in [(-1.0, 1.0), (0.0, 1.0), (-0.0, 1.0), (-1.0, 0.0), (-1.0, -0.0), (-0.0, 0.0), (0.25, 0.25)]
        {
            for value in [f32::NEG_INFINITY, -1.5, -1.0, -0.0, 0.0, 0.25, 1.0, 1.5, f32::INFINITY, f32::NAN] {
                let expected = value.clamp(low, high);
                assert_eq!(value.within(low, high).to_bits(), expected.to_bits(), "{value} in {low}..={high}");
            }
        }
    }

    #[test]
    #[should_panic(expected = "low <= high")]
    fn a_bound_that_is_no_number_is_no_bound() {
        let _ = 0.0f64.within(f64::NAN, 1.0);
    }
}
