//! Exact start times of PWM cycles.

use crate::chips::COUNTS;

/// A train of PWM cycles. A period is not a whole number of nanoseconds; the remainder is carried, so boundaries never
/// drift.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cycle {
    rate: Rate,
    /// Start of a past cycle: whole nanoseconds, and the remainder in 1 / `clock_hz` ns.
    start_ns: u64,
    start_rest: u64,
}

/// Clock frequency and prescaler.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rate {
    pub(super) prescale: u8,
    pub(super) clock_hz: u32,
}

impl Rate {
    /// Clock ticks of a cycle times 1e9; divided by the clock they give nanoseconds.
    const fn numerator(self) -> u64 {
        COUNTS as u64 * (self.prescale as u64 + 1) * 1_000_000_000
    }

    fn clock_hz(self) -> u64 {
        u64::from(self.clock_hz.max(1))
    }

    /// Period, rounded to the nearest nanosecond.
    pub(super) fn period_ns(self) -> u64 {
        (self.numerator() + self.clock_hz() / 2) / self.clock_hz()
    }
}

impl Cycle {
    pub(super) const fn new(start_ns: u64, rate: Rate) -> Self {
        Self { rate, start_ns, start_rest: 0 }
    }

    pub(super) const fn rate(&self) -> Rate {
        self.rate
    }

    /// Start of the first cycle after `at_ns`, rounded down to a nanosecond.
    ///
    /// Also moves the reference to the cycle that contains `at_ns`, which keeps the numbers small and the division
    /// short.
    pub(super) fn next_after(&mut self, at_ns: u64) -> u64 {
        let whole_ns = self.rate.numerator() / self.rate.clock_hz();
        let mut cycles = at_ns.saturating_sub(self.start_ns) / whole_ns;
        let mut start = self.after(cycles);
        // `cycles` was rounded up, because a period is longer than its whole nanoseconds: step down, never past the
        // answer
        while start.0 > at_ns && cycles > 0 {
            cycles -= ((start.0 - at_ns) / (whole_ns + 1)).clamp(1, cycles);
            start = self.after(cycles);
        }
        (self.start_ns, self.start_rest) = start;
        self.after(1).0
    }

    /// Start of the cycle `cycles` after the reference; saturates at `u64::MAX`.
    fn after(&self, cycles: u64) -> (u64, u64) {
        let clock_hz = self.rate.clock_hz();
        let numerator = u128::from(cycles) * u128::from(self.rate.numerator()) + u128::from(self.start_rest);
        let (ns, rest) = match u64::try_from(numerator) {
            Ok(short) => (u128::from(short / clock_hz), short % clock_hz),
            Err(_) => (numerator / u128::from(clock_hz), (numerator % u128::from(clock_hz)) as u64),
        };
        (u64::try_from(ns + u128::from(self.start_ns)).unwrap_or(u64::MAX), rest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn periods_of_the_datasheet() {
        // 7.3.5: 25 MHz / (4096 * (prescale + 1)): 1526 Hz, 200 Hz, 24 Hz
        for (prescale, expected_ns) in [(0x03, 655_360), (0x1E, 5_079_040), (0xFF, 41_943_040)] {
            assert_eq!(Rate { prescale, clock_hz: 25_000_000 }.period_ns(), expected_ns);
        }
    }

    proptest! {
        #[test]
        fn boundaries_are_multiples_of_the_exact_period(
            prescale in 3u8..,
            clock_hz in 1_000_000u32..50_000_000,
            start_ns in 0u64..1_000_000_000_000,
            steps in prop::collection::vec(0u64..10_000_000_000_000, 1..20),
        ) {
            let rate = Rate { prescale, clock_hz };
            let mut cycle = Cycle::new(start_ns, rate);
            let mut at_ns = start_ns;
            for step in steps {
                at_ns += step;
                let next = cycle.next_after(at_ns);
                // the same from the first cycle, in one division
                let numerator = u128::from(rate.numerator());
                let boundary = |k: u128| u128::from(start_ns) + k * numerator / u128::from(clock_hz);
                let mut k = u128::from(at_ns - start_ns) * u128::from(clock_hz) / numerator;
                while boundary(k) <= u128::from(at_ns) {
                    k += 1;
                }
                prop_assert_eq!(u128::from(next), boundary(k));
            }
        }

        #[test]
        fn never_overflows(prescale: u8, clock_hz: u32, start_ns: u64, at_ns: u64) {
            let mut cycle = Cycle::new(start_ns, Rate { prescale, clock_hz });
            let _ = cycle.next_after(at_ns);
            let _ = cycle.next_after(u64::MAX);
        }
    }
}
