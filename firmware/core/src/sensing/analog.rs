//! Analog inputs and supply rails: converter codes to volts, and their plausibility.

use r4_protocol::{
    Quality, Range,
    config::{AnalogConfig, SupplyConfig},
};

use super::{filter::LowPass, periods};

/// Time constant of the filter, s: smooths noise, and a rail's dips in single PWM periods.
const FILTER_S: f32 = 0.01;
/// Hysteresis of a range as a share of its width: a value outside counts as inside again only this far within.
const HYSTERESIS: f32 = 0.02;
/// Time for which codes must agree before the quality of a source changes, s.
pub const PERSISTENCE_S: f32 = 0.02;
/// Codes this near to either end of the converter count as the end: 0.1 % of it, for offset and noise of a 16-bit
/// converter.
const END_CODES: u16 = 64;

/// Quality of `volts` against `range`, with hysteresis by the quality `before`.
fn judge(range: Range, before: Quality, volts: f32) -> Quality {
    let margin = (range.max - range.min) * HYSTERESIS;
    let low = range.min + if before == Quality::Low { margin } else { 0.0 };
    let high = range.max - if before == Quality::High { margin } else { 0.0 };
    if volts > high {
        Quality::High
    } else if volts >= low {
        Quality::Good
    } else {
        Quality::Low
    }
}

/// Analog input behind a divider.
///
/// Each code is judged by itself: at an end of the converter it is shorted or clamped, elsewhere it is compared with
/// the plausible range of the source. Only good codes pass to the filter, so the volts of a failing source keep their
/// last good value. The quality follows once [`PERSISTENCE_S`] of codes agree that the source is good, or that it is
/// not.
#[derive(Clone, Debug)]
pub struct Analog {
    config: AnalogConfig,
    filter: LowPass,
    quality: Quality,
    /// Verdict on the last codes (true for good), and their number, up to `persistence_periods`.
    streak: (bool, u32),
    persistence_periods: u32,
    period_s: f32,
    age_s: f32,
}

/// Reading of an analog input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnalogReading {
    /// Voltage at the input; the last good one where `quality` is not [`Quality::Good`], 0 before the first good one.
    pub volts: f32,
    /// Time since the last good code, ms; saturates.
    pub age_ms: u16,
    /// Quality of the voltage.
    pub quality: Quality,
}

impl Analog {
    /// Creates an input that is read every `period_s`, s.
    #[must_use]
    pub fn new(config: &AnalogConfig, period_s: f32) -> Self {
        Self {
            config: *config,
            filter: LowPass::new(FILTER_S, period_s),
            quality: Quality::None,
            streak: (false, 0),
            persistence_periods: periods(PERSISTENCE_S, period_s),
            period_s,
            // No value was ever taken: report the greatest age.
            age_s: f32::INFINITY,
        }
    }

    /// Voltage at the input as of the last [`Analog::update`]; `None` when its quality is not good.
    #[must_use]
    pub fn good_volts(&self) -> Option<f32> {
        (self.quality == Quality::Good).then(|| self.filter.value())
    }

    /// Takes the code of this period. The first code sets the quality at once.
    pub fn update(&mut self, code: u16) -> AnalogReading {
        let volts = f32::from(code) * self.config.volts_per_code + self.config.offset_v;
        let judged = if code <= END_CODES {
            Quality::Low
        } else if code >= u16::MAX - END_CODES {
            Quality::High
        } else {
            judge(self.config.plausible_v, self.quality, volts)
        };
        let good = judged == Quality::Good;
        let first = self.quality == Quality::None;
        let again = good != self.streak.0;
        let codes = if again { 1 } else { self.streak.1 + 1 };
        self.streak = (good, codes.min(self.persistence_periods));
        let believed = self.quality == Quality::Good;
        if first || self.streak.1 == self.persistence_periods {
            self.quality = judged;
        }
        if !good {
            self.age_s += self.period_s;
        } else {
            self.age_s = 0.0;
            if first || again && !believed {
                self.filter.reset(volts);
            } else {
                self.filter.step(volts);
            }
        }
        // The cast saturates, also for infinity.
        AnalogReading { volts: self.filter.value(), age_ms: (self.age_s * 1e3) as u16, quality: self.quality }
    }
}

/// Supply rail: its filtered voltage, always, and, without delay, whether that lies in its range.
#[derive(Clone, Debug)]
pub struct Supply {
    config: SupplyConfig,
    filter: LowPass,
    quality: Quality,
    measured_v: f32,
}

impl Supply {
    /// Creates a rail that is read every `period_s`, s.
    #[must_use]
    pub fn new(config: &SupplyConfig, period_s: f32) -> Self {
        Self { config: *config, filter: LowPass::new(FILTER_S, period_s), quality: Quality::None, measured_v: 0.0 }
    }

    /// Number of the rail's analog input.
    #[must_use]
    pub fn analog(&self) -> u8 {
        self.config.analog
    }

    /// Filtered voltage as of the last [`Supply::update`], V.
    #[must_use]
    pub fn volts(&self) -> f32 {
        self.filter.value()
    }

    /// Configuration of the rail.
    #[must_use]
    pub fn config(&self) -> &SupplyConfig {
        &self.config
    }

    /// Unfiltered voltage of the last [`Supply::update`], V.
    #[must_use]
    pub fn measured_v(&self) -> f32 {
        self.measured_v
    }

    /// Takes the code of this period; returns the filtered voltage, V, and true if it is in range.
    pub fn update(&mut self, code: u16) -> (f32, bool) {
        let measured_v = f32::from(code) * self.config.volts_per_code;
        self.measured_v = measured_v;
        if self.quality == Quality::None {
            self.filter.reset(measured_v);
        }
        let volts = self.filter.step(measured_v);
        self.quality = judge(self.config.range_v, self.quality, volts);
        (volts, self.quality == Quality::Good)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelId, ChannelKind};

    use super::*;

    /// Number of 1 ms periods in [`PERSISTENCE_S`].
    const PERIODS: usize = 20;
    /// Sensor of 0.5 to 4.5 V on a divider with 10 V full scale.
    const CONFIG: AnalogConfig = AnalogConfig {
        id: ChannelId::new(ChannelKind::Analog, 0),
        volts_per_code: 10.0 / 65_535.0,
        offset_v: 0.05,
        plausible_v: Range::new(0.5, 4.5),
    };

    fn analog() -> Analog {
        Analog::new(&CONFIG, 1e-3)
    }

    fn code(volts: f32) -> u16 {
        libm::roundf((volts - CONFIG.offset_v) / CONFIG.volts_per_code) as u16
    }

    fn hold(analog: &mut Analog, code: u16, periods: usize) -> AnalogReading {
        (0..periods).map(|_| analog.update(code)).last().expect("at least one period")
    }

    #[test]
    fn volts_follow_scale_and_offset_through_the_filter() {
        let mut analog = analog();
        // Rounding of half a code in each of two places.
        let tolerance = CONFIG.volts_per_code;
        let first = analog.update(code(2.0));
        assert!((first.volts - 2.0).abs() < tolerance && first.quality == Quality::Good && first.age_ms == 0);
        // Backward Euler after one time constant of ten periods: 1 - (1 + 1/10)^-10 = 0.6145 of the step.
        let after_tau = hold(&mut analog, code(3.0), 10);
        assert!((after_tau.volts - 2.6145).abs() < 2.0 * tolerance, "{after_tau:?}");
    }

    #[test]
    fn the_first_code_is_judged_at_once() {
        let unknown = |quality| AnalogReading { volts: 0.0, age_ms: u16::MAX, quality };
        assert_eq!(analog().update(code(0.4)), unknown(Quality::Low));
        assert_eq!(analog().update(code(4.6)), unknown(Quality::High));
        assert_eq!(analog().update(code(0.6)).quality, Quality::Good);
    }

    #[test]
    fn the_ends_of_the_converter_are_never_good() {
        // This range would accept every code.
        let config = AnalogConfig { plausible_v: Range::new(-1.0, 11.0), ..CONFIG };
        let judged = |code| Analog::new(&config, 1e-3).update(code).quality;
        assert_eq!([0, 64, 65, 65_470, 65_471, u16::MAX].map(judged), {
            use Quality::{Good, High, Low};
            [Low, Low, Good, Good, High, High]
        });
    }

    #[test]
    fn a_fault_is_told_after_it_has_lasted_and_the_good_value_stays() {
        let mut analog = analog();
        hold(&mut analog, code(2.0), 100);
        let good = analog.update(code(2.0));
        let before = hold(&mut analog, 0, PERIODS - 1);
        assert_eq!((before.volts, before.age_ms, before.quality), (good.volts, 19, Quality::Good));
        let told = analog.update(0);
        assert_eq!((told.volts, told.age_ms, told.quality), (good.volts, 20, Quality::Low));
        // A change from one fault to another needs no persistence.
        assert_eq!(analog.update(u16::MAX).quality, Quality::High);
        // The return takes as long, and starts at the new value without traces of the old one.
        assert_eq!(hold(&mut analog, code(4.0), PERIODS - 1).quality, Quality::High);
        let back = analog.update(code(4.0));
        assert!(back.quality == Quality::Good && (back.volts - 4.0).abs() < CONFIG.volts_per_code, "{back:?}");
    }

    #[test]
    fn faults_that_take_turns_are_a_fault() {
        let mut analog = analog();
        analog.update(code(2.0));
        let told = (0..PERIODS).map(|period| analog.update(if period % 2 == 0 { 0 } else { u16::MAX })).last();
        assert_eq!(told.map(|reading| reading.quality), Some(Quality::High));
    }

    #[test]
    fn a_crackle_shorter_than_the_persistence_is_bridged() {
        let mut analog = analog();
        let good = analog.update(code(2.0));
        for _ in 0..10 {
            assert_eq!(hold(&mut analog, 0, PERIODS - 1).quality, Quality::Good);
            // Equal to the last bit of f32: a filter at rest stays at rest.
            assert_eq!(analog.update(code(2.0)), good);
        }
        hold(&mut analog, 0, PERIODS - 1);
        // The filter continues from there: 1/11 of the step.
        let next = analog.update(code(3.1));
        assert!((next.volts - 2.1).abs() < 2.0 * CONFIG.volts_per_code, "{next:?}");
    }

    #[test]
    fn the_edge_of_the_range_has_hysteresis() {
        // Hysteresis is 2 % of 4 V: back from 0.58 V and from 4.42 V on.
        for (outside, still_outside, inside) in [(0.49, 0.57, 0.59), (4.51, 4.43, 4.41)] {
            let mut analog = analog();
            let bad = analog.update(code(outside)).quality;
            assert_ne!(bad, Quality::Good);
            assert_eq!(hold(&mut analog, code(still_outside), 1000).quality, bad);
            assert_eq!(hold(&mut analog, code(inside), PERIODS).quality, Quality::Good);
            assert_eq!(hold(&mut analog, code(still_outside), 1000).quality, Quality::Good);
        }
    }

    #[test]
    fn a_rail_is_out_of_range_at_once_and_back_with_hysteresis() {
        let config = SupplyConfig {
            id: ChannelId::new(ChannelKind::Supply, 0),
            analog: 3,
            volts_per_code: 50.0 / 65_535.0,
            range_v: Range::new(20.0, 30.0),
            regeneration_v: None,
        };
        let code = |volts: f32| libm::roundf(volts / config.volts_per_code) as u16;
        assert!(!Supply::new(&config, 1e-3).update(code(19.9)).1, "a flat battery is told from the start");
        let mut rail = Supply::new(&config, 1e-3);
        assert_eq!(rail.analog(), 3);
        assert!(rail.update(code(24.0)).1);
        // From 24 V towards 0 by a tenth of the remaining distance (1 - 1/11 each period): below 19.8 V in the third
        // period.
        let out_after = (1..=10).find(|_| !rail.update(0).1);
        assert_eq!(out_after, Some(2), "24 (10/11)^2 = 19.83 V");
        let settle = |rail: &mut Supply, volts| (0..1000).map(|_| rail.update(code(volts))).last().expect("stepped");
        let (volts, in_range) = settle(&mut rail, 0.0);
        // The voltage is the rail's, also when the rail is gone.
        assert!(volts.abs() < 1e-3 && !in_range, "{volts}");
        assert!(!settle(&mut rail, 20.15).1);
        assert!(settle(&mut rail, 20.25).1);
        assert!(settle(&mut rail, 20.05).1);
        assert!(!settle(&mut rail, 30.05).1);
        assert!(!settle(&mut rail, 29.85).1);
        assert!(settle(&mut rail, 29.75).1);
    }

    proptest! {
        /// For any codes, good volts lie in the plausible range, and the quality changes no faster than documented.
        #[test]
        fn good_volts_are_plausible(codes in prop::collection::vec((any::<u16>(), 1usize..40), 1..60)) {
            let mut analog = analog();
            let mut last = analog.update(code(1.0));
            let mut held = PERIODS;
            for (code, periods) in codes {
                for _ in 0..periods {
                    let reading = analog.update(code);
                    // Rounding of the filter: one ulp of 4.5 V.
                    let plausible = Range::new(CONFIG.plausible_v.min - 1e-6, CONFIG.plausible_v.max + 1e-6);
                    prop_assert!(plausible.contains(reading.volts), "{reading:?}");
                    let changed = (reading.quality == Quality::Good) != (last.quality == Quality::Good);
                    prop_assert!(!changed || held >= PERIODS - 1, "after {held} periods");
                    held = if changed { 0 } else { held + 1 };
                    last = reading;
                }
            }
        }
    }
}
