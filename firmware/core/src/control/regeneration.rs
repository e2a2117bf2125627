//! Limit of regeneration: a braking motor feeds its supply, and the voltage of a supply that takes nothing back rises
//! until the board trips.
//!
//! A motor feeds back while its mean voltage is below its back-EMF and of the same sign. Above the configured voltage
//! its duty is therefore moved towards the one without current, by a share that grows with the voltage. Braking gets
//! weaker; shorting the motor (duty 0) and driving it backwards stay as they are, as neither feeds the supply.

use r4_protocol::config::{SupplyConfig, WindingConfig};

/// Point between `regeneration_v` and the highest voltage at which regeneration ends, as a share of the distance: our
/// choice. The rest is for the energy that a motor still feeds back until a new duty takes effect, some 2 ms: the
/// measuring period and a PWM period.
const ENDS_AT: f32 = 0.5;

/// Share of a motor's regeneration that its supply accepts at `measured_v`: 1 up to `regeneration_v`, then falling to
/// 0.
#[must_use]
pub fn share(supply: &SupplyConfig, measured_v: f32) -> f32 {
    let Some(begins_v) = supply.regeneration_v.filter(|begins_v| measured_v > *begins_v) else { return 1.0 };
    let width_v = (supply.range_v.max - begins_v) * ENDS_AT;
    (1.0 - (measured_v - begins_v) / width_v).clamp(0.0, 1.0)
}

/// Returns `duty`, or, where that feeds back more than `share`, the duty that does not.
#[must_use]
pub fn limit(winding: &WindingConfig, duty: f32, speed: f32, supply_v: f32, share: f32) -> f32 {
    if share >= 1.0 || duty * speed <= 0.0 || duty.abs() <= winding.dead_duty {
        return duty;
    }
    let without_current = (winding.back_emf * speed).abs() / supply_v.max(1e-3) + winding.dead_duty;
    if duty.abs() >= without_current {
        return duty;
    }
    let limited = without_current + share * (duty.abs() - without_current);
    libm::copysignf(limited.min(1.0), duty)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelId, ChannelKind, Range};

    use super::{
        super::overload::{self, current_a},
        *,
    };

    const SUPPLY: SupplyConfig = SupplyConfig {
        id: ChannelId::new(ChannelKind::Supply, 0),
        analog: 0,
        volts_per_code: 1e-3,
        range_v: Range::new(20.0, 30.0),
        regeneration_v: Some(26.0),
    };
    const WINDING: WindingConfig = WindingConfig {
        supply: Some(0),
        nominal_v: 24.0,
        dead_duty: 0.1,
        resistance_ohm: 0.5,
        back_emf: 1.0,
        rated_a: 5.0,
        thermal_s: 30.0,
        current_sense: None,
    };

    #[test]
    fn regeneration_ends_half_way_to_the_trip() {
        for (volts, expected) in [(20.0, 1.0), (26.0, 1.0), (27.0, 0.5), (28.0, 0.0), (31.0, 0.0)] {
            assert_eq!(share(&SUPPLY, volts), expected, "{volts} V");
        }
        assert_eq!(share(&SupplyConfig { regeneration_v: None, ..SUPPLY }, 31.0), 1.0);
    }

    /// Mean current that a motor takes from its supply, A: its current times the share of time that the bridge connects
    /// it.
    fn supply_a(duty: f32, speed: f32, supply_v: f32) -> f32 {
        (duty.abs() - WINDING.dead_duty).max(0.0) * current_a(&WINDING, duty, speed, supply_v) * duty.signum()
    }

    proptest! {
        /// For any duty, the fed back current stays within the share of the unlimited one, driving is unchanged, and no
        /// duty changes its sign.
        #[test]
        fn only_regeneration_is_limited(
            duty in -0.98f32..0.98,
            speed in -30.0f32..30.0,
            supply_v in 20.0f32..30.0,
            share in 0.0f32..=1.0,
        ) {
            let limited = limit(&WINDING, duty, speed, supply_v, share);
            let (before, after) = (supply_a(duty, speed, supply_v), supply_a(limited, speed, supply_v));
            if before >= 0.0 || share >= 1.0 {
                prop_assert_eq!(limited, duty);
            } else {
                prop_assert!(limited.abs() >= duty.abs() && limited * duty > 0.0);
                // The current shrinks to its share; 1e-3 A are rounding errors of 60 A.
                let (was, is) = [duty, limited].map(|duty| overload::current_a(&WINDING, duty, speed, supply_v)).into();
                let share_of = (share * was).abs();
                prop_assert!((is.abs() <= share_of + 1e-3) || limited.abs() == 1.0, "{was} A became {is} A");
                prop_assert!(is * was.signum() >= -1e-3, "{was} A became {is} A, which drives");
                prop_assert!(share > 0.0 || after.abs() < 1e-3 || limited.abs() == 1.0, "{after} A are fed back");
            }
        }
    }
}
