//! Overload protection: the heat of a motor's winding, from its current.
//!
//! The winding is one thermal mass. Its heat, as a share of what it withstands, follows `(current / rated)²` by a first-order
//! lag (the thermal replica of IEC 60255-149 with one time constant). So a constant current of `n` times the rated one
//! reaches the limit after `thermal_s ln((n² - h) / (n² - 1))` from the heat `h`; the rated current never does.

use r4_protocol::config::WindingConfig;

/// A winding that has reached its limit stays an overload until it has cooled to this share.
///
/// A board does not know how long it was off and what its motors did before, so this is also the heat every motor starts
/// with: a restart leaves a motor no more than a trip leaves it that has been cleared. It may spare an operator the wait for
/// that, 0.22 time constants, and never more. At half of it a restart would forget three times as much heat; at 1 no motor
/// could start before it has cooled.
pub const COOLED: f64 = 0.8;

/// The heat in one motor's winding, stepped each control period, whether or not the board is armed.
#[derive(Clone, Debug)]
pub struct Overload {
    winding: WindingConfig,
    /// Share of the way to the settled heat that a period goes.
    share: f64,
    /// Share of what the winding withstands. 64 bit: a period of 1 ms changes the heat of a large motor by less than an ulp
    /// of an `f32`.
    heat: f64,
    present: bool,
}

impl Overload {
    /// A winding at [`COOLED`], stepped every `period_s`.
    #[must_use]
    pub fn new(winding: WindingConfig, period_s: f32) -> Self {
        let share = -libm::expm1(-f64::from(period_s) / f64::from(winding.thermal_s));
        Self { winding, share, heat: COOLED, present: false }
    }

    /// What it was configured with.
    #[must_use]
    pub fn winding(&self) -> &WindingConfig {
        &self.winding
    }

    /// Share of what the winding withstands.
    #[must_use]
    pub fn heat(&self) -> f64 {
        self.heat
    }

    /// Takes the current of one period, A, of either sign, and returns whether the motor is overloaded.
    pub fn step(&mut self, current_a: f32) -> bool {
        let ratio = f64::from(current_a / self.winding.rated_a);
        self.heat += (ratio * ratio - self.heat) * self.share;
        self.present = self.heat >= if self.present { COOLED } else { 1.0 };
        self.present
    }
}

/// Mean current of a motor, A: positive where it drives forwards.
///
/// `duty` is what the bridge applies, `speed` in rad/s or m/s at the output, `supply_v` at the bridge. Between pulses both
/// bridges short the motor, so its current does not stop and the mean voltage is the duty's share of the supply.
///
/// Never more than twice the stall current at `supply_v`, which is what full reverse at full speed takes: a speed that an
/// encoder's fault makes up must not heat the model beyond what the supply can do.
#[must_use]
pub fn current_a(winding: &WindingConfig, duty: f32, speed: f32, supply_v: f32) -> f32 {
    let effective = (duty.abs() - winding.dead_duty).max(0.0);
    let most_a = 2.0 * supply_v.abs() / winding.resistance_ohm;
    let current_a = (libm::copysignf(effective * supply_v, duty) - winding.back_emf * speed) / winding.resistance_ohm;
    current_a.clamp(-most_a, most_a)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const WINDING: WindingConfig = WindingConfig {
        supply: None,
        nominal_v: 12.0,
        dead_duty: 0.1,
        resistance_ohm: 2.0,
        back_emf: 1.5,
        rated_a: 1.5,
        thermal_s: 20.0,
        current_sense: None,
    };

    #[test]
    fn current_is_ohms_law_behind_the_dead_zone_and_the_back_emf() {
        let current = |duty, speed| current_a(&WINDING, duty, speed, 12.0);
        assert_eq!(current(0.6, 0.0), 3.0);
        assert_eq!(current(-0.6, 0.0), -3.0);
        assert_eq!(current(0.6, 2.0), 1.5);
        // Backwards against the motion, both add up; in the dead zone the bridge shorts the motor.
        assert_eq!(current(-0.6, 2.0), -4.5);
        assert_eq!(current(0.1, 2.0), -1.5);
        assert_eq!(current(0.0, 0.0), 0.0);
        // Twice the stall current of 6 A, whatever speed an encoder that jumps makes up.
        assert_eq!((current(0.5, -1e6), current(-0.5, 1e6)), (12.0, -12.0));
    }

    #[test]
    fn a_start_is_no_better_than_a_cleared_trip() {
        let mut motor = Overload::new(WINDING, 1e-3);
        assert_eq!(motor.heat(), COOLED);
        while !motor.step(6.0) {}
        let mut cooling = 1u32;
        while motor.step(0.0) {
            cooling += 1;
        }
        assert!(motor.heat() < COOLED && motor.heat() > 0.999 * COOLED);
        // thermal_s ln(1 / 0.8) = 4.463 s, and the last step went beyond 1.
        assert!((4463..=4475).contains(&cooling), "{cooling} ms");
    }

    proptest! {
        /// Whatever time constant, period and constant current: it trips in the period in which the closed form reaches 1,
        /// within one of it for rounding, and at the rated current never.
        #[test]
        fn it_trips_when_the_closed_form_does(
            thermal_s in 0.1f32..200.0,
            period_us in 500u32..20_000,
            ratio in 1.02f32..8.0,
            backwards in any::<bool>(),
        ) {
            let period_s = period_us as f32 * 1e-6;
            let winding = WindingConfig { thermal_s, ..WINDING };
            let current = winding.rated_a * if backwards { -ratio } else { ratio };
            let settled = f64::from(current / winding.rated_a).powi(2);
            let expected_s = f64::from(thermal_s) * ((settled - COOLED) / (settled - 1.0)).ln();
            let expected = (expected_s / f64::from(period_s)).ceil();
            let mut motor = Overload::new(winding, period_s);
            let mut periods = 1.0;
            while !motor.step(current) {
                periods += 1.0;
                prop_assert!(periods <= expected + 1.0, "not tripped after {} of {} periods", periods, expected);
            }
            prop_assert!((periods - expected).abs() <= 1.0, "{} of {} periods", periods, expected);

            let mut rated = Overload::new(winding, period_s);
            prop_assert!((0..10_000).all(|_| !rated.step(winding.rated_a)));
        }

        /// Heat is never forgotten faster than by the time constant, and never below nothing or above the hottest it was
        /// driven to.
        #[test]
        fn heat_stays_within_what_was_put_in(currents in prop::collection::vec(-20.0f32..20.0, 1..200)) {
            let mut motor = Overload::new(WINDING, 1e-2);
            let hottest = currents.iter().map(|a| f64::from(a / WINDING.rated_a).powi(2)).fold(COOLED, f64::max);
            for current in currents {
                let before = motor.heat();
                motor.step(current);
                prop_assert!(motor.heat() >= before * (-1e-2f64 / 20.0).exp() * (1.0 - 1e-12));
                prop_assert!(motor.heat() <= hottest * (1.0 + 1e-12));
            }
        }
    }
}
