//! Overload protection: heat of a motor's winding, from its current.
//!
//! The winding is one thermal mass. Its heat, as a share of the permitted heat, follows `(current / rated)²` by a
//! first-order lag (the thermal replica of IEC 60255-149 with one time constant). So a constant current of `n` times
//! the rated one reaches the limit after `thermal_s ln((n² - h) / (n² - 1))` from the heat `h`; the rated current never
//! does.

use crc::{CRC_12_CDMA2000, Crc};
use r4_protocol::{ChannelId, Winding, config::WindingConfig};

/// Share of the permitted heat to which a winding must cool until its overload ends.
///
/// The heat is kept over a reset ([`Overload::resume`]). A board that was without power knows neither for how long nor
/// the motors' history, so every motor then starts with this heat: switching off and on gives a motor no more than a
/// cleared trip does. It may spare an operator the wait for that, 0.22 time constants, and never more. At half of it a
/// restart would forget three times as much heat; at 1 no motor could start before it has cooled.
pub const COOLED: f64 = 0.8;

/// Share of the permitted heat above which hosts are warned. Far enough above [`COOLED`], with which every motor
/// starts, that a cold motor's first movements give no warning: with 3 times its rated current it takes 1.2 % of its
/// time constant to rise from the one to the other, a third of a second for 30 s.
pub const HOT: f64 = 0.9;

/// Share of the permitted heat below which a warning ends: 6 % of a time constant of cooling between two warnings.
pub const HOT_ENDS: f64 = 0.85;

/// Checksum over a kept word, with its channel: it detects every burst of up to 12 damaged bits, and other damage
/// except in 1 of 4096 cases.
static CHECKSUM: Crc<u16> = Crc::<u16>::new(&CRC_12_CDMA2000);
/// Version of the layout of a kept word.
const LAYOUT: u8 = 1;
/// Position of the value in a kept word. From the top: 19 bits of heat, the overload flag, 12 bits of checksum.
const VALUE_SHIFT: u32 = 12;
/// Number of mantissa bits of an `f32` that are not kept.
const DROPPED: u32 = 12;

/// Heat in one motor's winding, stepped whether or not the board is armed.
#[derive(Clone, Debug)]
pub struct Overload {
    winding: WindingConfig,
    /// Share of the difference to the settled heat that one period covers.
    share: f64,
    /// Heat as a share of the permitted heat. 64 bits: a period of 1 ms changes the heat of a large motor by less than
    /// an ulp of an `f32`.
    heat: f64,
    present: bool,
    hot: bool,
    /// Value in the last word that was returned for keeping.
    kept: Option<u32>,
}

impl Overload {
    /// Creates a winding at [`COOLED`], stepped every `period_s`, s.
    #[must_use]
    pub fn new(winding: WindingConfig, period_s: f32) -> Self {
        let share = -libm::expm1(-f64::from(period_s) / f64::from(winding.thermal_s));
        Self { winding, share, heat: COOLED, present: false, hot: false, kept: None }
    }

    /// Restores heat and overload from the `word` kept for `channel` before a reset; if it is not one of
    /// [`Overload::word`]'s, keeps [`COOLED`]. The restored heat is never less than before the reset, and at most 0.05
    /// % more.
    ///
    /// The kept heat is in A², so that a changed `rated_a` gives another share of the permitted heat now.
    #[must_use]
    pub fn resume(mut self, channel: ChannelId, word: u32) -> Self {
        let value = word >> VALUE_SHIFT;
        let heat_a2 = f64::from(f32::from_bits((value >> 1) << DROPPED));
        if checked(channel, value) == word && heat_a2.is_finite() {
            self.heat = heat_a2 / self.rated_a2();
            self.present = value & 1 != 0 && self.heat >= COOLED;
            self.hot = self.heat > HOT_ENDS;
        }
        self
    }

    /// Returns the word to keep over a reset for `channel` if it differs from the last one returned. Each word has its
    /// own checksum: a reset between two writes damages none.
    pub fn word(&mut self, channel: ChannelId) -> Option<u32> {
        // Rounded up by a step, so that dropped bits lose no heat; never to infinity.
        let magnitude = (((self.heat * self.rated_a2()) as f32).to_bits() >> DROPPED) + 1;
        let value = magnitude.min((f32::INFINITY.to_bits() >> DROPPED) - 1) << 1 | u32::from(self.present);
        (self.kept.replace(value) != Some(value)).then(|| checked(channel, value))
    }

    fn rated_a2(&self) -> f64 {
        f64::from(self.winding.rated_a) * f64::from(self.winding.rated_a)
    }

    /// Status for hosts. The percentage is rounded down: it shows 100 only where the limit is reached.
    #[must_use]
    pub fn status(&self) -> Winding {
        Winding { heat_percent: (self.heat * 100.0) as u8, hot: self.hot }
    }

    /// Configuration of the winding.
    #[must_use]
    pub fn winding(&self) -> &WindingConfig {
        &self.winding
    }

    /// Heat as a share of the permitted heat.
    #[must_use]
    pub fn heat(&self) -> f64 {
        self.heat
    }

    /// Returns true while the motor is overloaded.
    #[must_use]
    pub fn is_present(&self) -> bool {
        self.present
    }

    /// Takes the current of one step, A, of either sign, and returns true if the motor is overloaded.
    pub fn step(&mut self, current_a: f32) -> bool {
        let ratio = f64::from(current_a / self.winding.rated_a);
        self.heat += (ratio * ratio - self.heat) * self.share;
        self.present = self.heat >= if self.present { COOLED } else { 1.0 };
        self.hot = if self.hot { self.heat >= HOT_ENDS } else { self.heat > HOT };
        self.present
    }
}

/// Kept word: `value` with its checksum.
fn checked(channel: ChannelId, value: u32) -> u32 {
    // Bytes in the word's order, so that the guarantee for bursts holds.
    let [_, a, b, c] = value.to_be_bytes();
    value << VALUE_SHIFT | u32::from(CHECKSUM.checksum(&[LAYOUT, channel.kind as u8, channel.index, a, b, c]))
}

/// Mean current of a motor, A: positive where it drives forwards.
///
/// `duty` is what the bridge applies, `speed` in rad/s or m/s at the output, `supply_v` at the bridge. Between pulses
/// both bridges short the motor, so its current does not stop and the mean voltage is the duty's share of the supply.
///
/// Limited to twice the stall current at `supply_v`, which full reverse at full speed takes: a false speed from a
/// faulty encoder must not heat the model beyond the capability of the supply.
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
    use r4_protocol::ChannelKind;

    use super::*;

    const CHANNEL: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);

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
        // Limited to twice the stall current of 6 A, whatever speed a jumping encoder shows.
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
        // Cooling takes thermal_s ln(1 / 0.8) = 4.463 s, and the last step went beyond 1.
        assert!((4463..=4475).contains(&cooling), "{cooling} ms");
    }

    #[test]
    fn a_warning_comes_before_the_limit_and_ends_below_where_it_began() {
        let mut motor = Overload::new(WINDING, 1e-3);
        assert_eq!(motor.status(), Winding { heat_percent: 80, hot: false });
        while !motor.status().hot {
            assert!(motor.heat() <= HOT && !motor.step(6.0));
        }
        while motor.status().hot {
            assert!(motor.heat() >= HOT_ENDS * 0.999);
            motor.step(0.0);
        }
        assert_eq!(motor.status().heat_percent, 84);
        // In between the state is kept: no current of 0.87 of the limit's heat gives another warning.
        let between = (0.87f32).sqrt() * WINDING.rated_a;
        assert!((0..100_000).all(|_| !motor.step(between) && !motor.status().hot));
        while !motor.step(6.0) {
            assert!(motor.heat() <= HOT || motor.status().hot);
        }
        assert_eq!(motor.status(), Winding { heat_percent: 100, hot: true });
    }

    /// Contents of a backup register that was never written, or that has failed.
    #[test]
    fn words_that_nobody_kept_are_not_taken() {
        for word in [0, u32::MAX, 0x8000_0000, 1] {
            assert_eq!(Overload::new(WINDING, 1e-3).resume(CHANNEL, word).heat(), COOLED, "{word:#010x}");
        }
    }

    #[test]
    fn a_word_is_given_out_only_when_it_changes() {
        let mut motor = Overload::new(WINDING, 1e-3);
        assert!(motor.word(CHANNEL).is_some());
        assert_eq!(motor.word(CHANNEL), None);
        while !motor.step(6.0) {}
        assert!(motor.word(CHANNEL).is_some());
    }

    #[test]
    fn a_reset_does_not_clear_an_overload() {
        let mut motor = Overload::new(WINDING, 1e-3);
        while !motor.step(6.0) {}
        while motor.heat() > 0.9 {
            motor.step(0.0);
        }
        let word = motor.word(CHANNEL).expect("it has changed");
        let mut resumed = Overload::new(WINDING, 1e-3).resume(CHANNEL, word);
        assert!(resumed.step(0.0), "it has not cooled to {COOLED}");
        // A hot motor below the limit has no overload.
        let mut motor = Overload::new(WINDING, 1e-3);
        while motor.heat() < 0.9 {
            motor.step(6.0);
        }
        let word = motor.word(CHANNEL).expect("it has changed");
        assert!(!Overload::new(WINDING, 1e-3).resume(CHANNEL, word).step(0.0));
    }

    /// A warning survives a reset where the heat may not have been less; below the end of warnings there is none.
    #[test]
    fn a_warning_outlives_a_reset() {
        for (heat, hot) in [(0.86, true), (0.84, false)] {
            let mut motor = Overload { heat, ..Overload::new(WINDING, 1e-3) };
            let word = motor.word(CHANNEL).expect("the first");
            assert_eq!(Overload::new(WINDING, 1e-3).resume(CHANNEL, word).status().hot, hot, "{heat}");
        }
    }

    /// A heat beyond an `f32`, as from a broken current sensor, is kept as the greatest finite value.
    #[test]
    fn heat_without_end_is_kept_as_much() {
        let mut motor = Overload::new(WINDING, 1e-3);
        motor.step(1e22);
        let word = motor.word(CHANNEL).expect("the first");
        let resumed = Overload::new(WINDING, 1e-3).resume(CHANNEL, word);
        assert!(resumed.heat() > 1e38 && resumed.heat() < motor.heat(), "{}", resumed.heat());
    }

    proptest! {
        /// For any heat and any rated current before and after, the restored heat is at least the old one, within a
        /// step of 2^-11.
        #[test]
        fn heat_is_never_less_after_a_reset(
            currents in prop::collection::vec(-20.0f32..20.0, 0..100),
            rated_a in [0.05f32..200.0, 0.05f32..200.0],
        ) {
            let with = |rated_a| WindingConfig { rated_a, ..WINDING };
            let mut before = Overload::new(with(rated_a[0]), 1e-2);
            for current in currents {
                before.step(current);
            }
            let word = before.word(CHANNEL).expect("the first");
            let after = Overload::new(with(rated_a[1]), 1e-2).resume(CHANNEL, word);
            let expected = before.heat() * (f64::from(rated_a[0]) / f64::from(rated_a[1])).powi(2);
            prop_assert!(after.heat() >= expected * (1.0 - 1e-12), "{} of {}", after.heat(), expected);
            prop_assert!(after.heat() <= expected * (1.0 + 1.0 / 2048.0) + 1e-30, "{} of {}", after.heat(), expected);
        }

        /// Any burst of up to twelve wrong bits of a word is detected; so is the word of another channel.
        #[test]
        fn damaged_words_are_not_taken(heat_current in 0.0f32..3.0, at in 0u32..32, burst in 1u32..0x1000, other in 1u8..8) {
            let mut motor = Overload::new(WINDING, 1e-2);
            for _ in 0..500 {
                motor.step(heat_current);
            }
            let word = motor.word(CHANNEL).expect("the first");
            let fresh = || Overload::new(WINDING, 1e-2);
            let damaged = word ^ burst.checked_shl(at).unwrap_or(0);
            if damaged != word {
                prop_assert_eq!(fresh().resume(CHANNEL, damaged).heat(), COOLED);
            }
            prop_assert_eq!(fresh().resume(ChannelId::new(ChannelKind::Osmc, other), word).heat(), COOLED);
            prop_assert_eq!(fresh().resume(ChannelId::new(ChannelKind::Dhb, 0), word).heat(), COOLED);
        }

        /// For any time constant, period and constant current it trips in the period in which the closed form reaches
        /// 1, within one period for rounding, and at the rated current never.
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

        /// Heat never decays faster than by the time constant, and stays between zero and the hottest value driven to.
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
