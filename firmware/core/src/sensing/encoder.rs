//! Quadrature encoder: extends a 16-bit counter to 32 bits, and computes speed from counts and the time between them.

use super::filter::LowPass;
use crate::within::Within;

/// Position and speed of a shaft with a quadrature encoder.
///
/// Speed is Δcounts / Δt between the last two periods in which the counter moved (the M/T method at the resolution of
/// the control period), so that it is exact at high speed and still moves by single counts at low speed; between counts
/// it falls with the elapsed time.
#[derive(Clone, Debug)]
pub struct Encoder {
    inverted: bool,
    last_raw: Option<u16>,
    position: i32,
    /// Periods since the last count, up to the number at which the shaft counts as still; it starts as still.
    periods_since_count: u32,
    still_after_periods: u32,
    period_s: f32,
    filter: LowPass,
    /// Counts of the last update.
    delta: i32,
    /// Periods over which the counts of the last update were made: from the previous count up to it.
    delta_periods: u32,
}

/// Time without a count after which the shaft counts as still, s.
const STANDSTILL_S: f32 = 0.5;

impl Encoder {
    /// Creates an encoder that is read every `period_s`, with a low-pass of `filter_s` on its speed.
    #[must_use]
    pub fn new(inverted: bool, period_s: f32, filter_s: f32) -> Self {
        let still_after_periods = ((STANDSTILL_S / period_s) as u32).max(1);
        Self {
            inverted,
            last_raw: None,
            position: 0,
            periods_since_count: still_after_periods,
            still_after_periods,
            period_s,
            filter: LowPass::new(filter_s, period_s),
            delta: 0,
            delta_periods: still_after_periods,
        }
    }

    /// Counts of the last update, and the number of periods since the count before, this one included.
    #[must_use]
    pub fn last(&self) -> (i32, u32) {
        (self.delta, self.delta_periods)
    }

    /// Returns true once the time without a count is so long that the shaft counts as still.
    #[must_use]
    pub fn is_still(&self) -> bool {
        self.periods_since_count == self.still_after_periods
    }

    /// Takes the counter as read this period and returns position (counts) and speed (counts/s).
    ///
    /// Correct while the shaft moves less than 32768 counts in a period. The first reading is position 0.
    pub fn update(&mut self, raw: u16) -> (i32, f32) {
        let last = self.last_raw.replace(raw).unwrap_or(raw);
        let up = i32::from(raw.wrapping_sub(last).cast_signed());
        let delta = if self.inverted { -up } else { up };
        self.position = self.position.wrapping_add(delta);
        self.periods_since_count = (self.periods_since_count + 1).min(self.still_after_periods);
        (self.delta, self.delta_periods) = (delta, self.periods_since_count);
        let periods = self.periods_since_count as f32;
        if delta != 0 {
            // Each interval is weighted with its duration: held into the next one, the mean would be too high.
            let counts_per_s = delta as f32 / (periods * self.period_s);
            match self.periods_since_count {
                1 => self.filter.step(counts_per_s),
                periods => self.filter.step_times(counts_per_s, periods),
            };
            self.periods_since_count = 0;
        } else {
            // Less than one count in all this time, so the speed is at most one count over it.
            let still = self.periods_since_count == self.still_after_periods;
            let most = if still { 0.0 } else { 1.0 / (periods * self.period_s) };
            self.filter.reset(self.filter.value().within(-most, most));
        }
        (self.position, self.filter.value())
    }

    /// Position at which the counter read `raw`, which must be less than 32768 counts from its last reading.
    #[must_use]
    pub fn position_at(&self, raw: u16) -> i32 {
        let up = i32::from(raw.wrapping_sub(self.last_raw.unwrap_or(raw)).cast_signed());
        self.position.wrapping_add(if self.inverted { -up } else { up })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Any walk of less than half the counter's range per period is followed exactly, over any number of wraps.
        #[test]
        fn position_follows_any_walk(start: u16, steps in prop::collection::vec(-32_767i32..=32_767, 1..200)) {
            for inverted in [false, true] {
                let mut encoder = Encoder::new(inverted, 1e-3, 0.0);
                encoder.update(start);
                let mut total = 0i32;
                for step in &steps {
                    total += step;
                    let raw = i32::from(start).wrapping_add(total) as u16;
                    let expected = if inverted { -total } else { total };
                    prop_assert_eq!(encoder.update(raw).0, expected);
                }
            }
        }
    }

    /// Measured speed, counts/s, of a shaft at constant speed, from whole counts as a counter shows them.
    fn measured(counts_per_ms: f64, periods: u32) -> f32 {
        let mut encoder = Encoder::new(false, 1e-3, 0.02);
        let mut speed = 0.0;
        for period in 0..periods {
            let count = (counts_per_ms * f64::from(period) + 0.5).floor() as i64;
            speed = encoder.update(count as u16).1;
        }
        speed
    }

    #[test]
    fn speed_is_right_from_a_tenth_to_a_thousand_counts_per_ms() {
        for counts_per_ms in [0.1, 0.37, 1.0, 7.3, 100.0, 999.7] {
            let speed = f64::from(measured(counts_per_ms, 1000));
            // For intervals of a whole number of periods: a ripple of one period in the filter's 20 ms, and one count
            // more or less in the periods averaged over.
            let tolerance = counts_per_ms * 1000.0 * 0.03 + 1.0;
            assert!((speed - counts_per_ms * 1000.0).abs() <= tolerance, "{counts_per_ms} counts/ms: {speed}");
        }
    }

    /// A shaft counts as still half a second after the last count, and not before.
    #[test]
    fn a_shaft_stands_still_after_half_a_second() {
        let mut encoder = Encoder::new(false, 1.0 / 1024.0, 0.0);
        encoder.update(0);
        encoder.update(1);
        for period in 1..600 {
            assert_eq!(encoder.update(1).1 == 0.0, period >= 512, "{period}");
        }
    }

    #[test]
    fn a_stopped_shaft_reads_zero() {
        let mut encoder = Encoder::new(false, 1e-3, 0.02);
        for count in 0..100u16 {
            encoder.update(count * 10);
        }
        // Half a second until standstill, then five filter time constants to 1 %, more to below a count.
        let speed = (0..1500).map(|_| encoder.update(990).1).last().expect("stepped");
        assert!(speed.abs() < 1e-3, "{speed}");
    }
}
