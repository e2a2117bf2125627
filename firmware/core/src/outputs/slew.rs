//! Slew limit of a value.

/// Returns `value` moved towards `target` by at most `change`; a negative or NaN `change` counts as 0.
pub(super) fn towards(value: f32, target: f32, change: f32) -> f32 {
    let change = change.max(0.0);
    if (target - value).abs() <= change { target } else { value + libm::copysignf(change, target - value) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrives_exactly_and_never_passes() {
        assert_eq!(towards(0.0, 1.0, 0.25), 0.25);
        assert_eq!(towards(0.0, -1.0, 0.25), -0.25);
        assert_eq!(towards(0.3, 0.1, 0.25), 0.1);
        assert_eq!(towards(0.3, 1.0, -1.0), 0.3);
        assert_eq!(towards(0.3, 1.0, f32::NAN), 0.3);
        assert_eq!(towards(0.3, 1.0, f32::INFINITY), 1.0);
    }
}
