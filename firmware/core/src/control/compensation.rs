//! Supply compensation: loops compute duties for the supply they were tuned at, and the bridge gives a share of the one there
//! is. Without it, 14 V instead of 12 V raise the gain of every loop by a sixth.

use crate::within::Within;

/// No supply is further from the nominal one than this factor or its inverse: a divider or a rail configured wrong must not
/// change a duty by more. It is a quarter, as a lead-acid battery has from 10.5 to 14.8 V, 0.88 to 1.23 times 12 V.
const FARTHEST: f32 = 1.25;

/// What a loop's duty is multiplied with. `supply_v` is filtered over 10 ms, longer than a rail takes to sag and shorter than
/// a battery to run down; `None` where it is not measured or cannot be relied on, which changes nothing.
#[must_use]
pub fn factor(nominal_v: f32, supply_v: Option<f32>) -> f32 {
    match supply_v {
        Some(supply_v) if supply_v > 0.0 => (nominal_v / supply_v).within(1.0 / FARTHEST, FARTHEST),
        _ => 1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn duties_are_scaled_to_the_supply_within_limits() {
        let factor = |supply_v| factor(12.0, supply_v);
        assert_eq!([None, Some(12.0), Some(15.0), Some(10.0)].map(factor), [1.0, 1.0, 0.8, 1.2]);
        assert_eq!([Some(30.0), Some(3.0), Some(0.0), Some(-1.0)].map(factor), [0.8, 1.25, 1.0, 1.0]);
        assert_eq!([Some(f32::NAN), Some(f32::INFINITY)].map(factor), [1.0, 0.8]);
    }
}
