//! Evaluation of an echo's edges in a capture unit.

use super::pulse::Pulses;
use crate::platform::{EchoState, Pulse};

/// Echo line since it was cleared, built from its levels and the times of their changes.
///
/// Times are ticks of a 32-bit clock that wraps; a level that lasts longer than one wrap is indistinguishable from a
/// shorter one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Echo {
    high: bool,
    cleared: u32,
    rose: Option<u32>,
    /// Ticks from the rising to the falling edge.
    width: Option<u32>,
    pulses: Pulses,
}

impl Echo {
    /// Creates an echo cleared at `now`, when the line was `high`.
    #[must_use]
    pub const fn new(high: bool, now: u32) -> Self {
        Self { high, cleared: now, rose: None, width: None, pulses: Pulses::new(high) }
    }

    /// Records that the line is `high` since `at`. Without a change of level nothing happened, and `at` is not called.
    pub fn level(&mut self, high: bool, at: impl FnOnce() -> u32) {
        if high == self.high {
            return;
        }
        let at = at();
        self.high = high;
        self.pulses.level(high, at);
        match (high, self.rose) {
            (true, None) => self.rose = Some(at),
            (false, Some(rose)) if self.width.is_none() => self.width = Some(at.wrapping_sub(rose)),
            _ => {}
        }
    }

    /// Result of [`PulseInputs::pulse`](crate::platform::PulseInputs::pulse) at `now`, for a clock of at least 10 MHz.
    #[must_use]
    pub fn pulse(&self, now: u32, ticks_per_us: u32) -> Option<Pulse> {
        self.pulses.newest(now, (ticks_per_us / 10).max(1))
    }

    /// Result of [`Ranging::echo`](crate::platform::Ranging::echo) at `now`.
    #[must_use]
    pub fn state(&self, now: u32, ticks_per_us: u32) -> EchoState {
        match self.width {
            Some(width) => EchoState::Done { width_us: width / ticks_per_us },
            None if self.high => {
                let since = now.wrapping_sub(self.rose.unwrap_or(self.cleared));
                EchoState::High { since_us: since / ticks_per_us }
            }
            None => EchoState::Idle,
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Ticks in a microsecond.
    const PER_US: u32 = 10;

    proptest! {
        /// Decodes the first complete pulse in the captured edges; without one, returns the line level.
        #[test]
        fn the_first_whole_pulse_is_told(
            start: u32, high: bool, gaps in prop::collection::vec(1..1_000_000u32, 0..6), last in 0..1_000_000u32,
        ) {
            let mut echo = Echo::new(high, start);
            let (mut at, mut level, mut edges) = (start, high, [0; 6]);
            for (gap, edge) in gaps.iter().zip(&mut edges) {
                at = at.wrapping_add(*gap);
                level = !level;
                echo.level(level, || at);
                // Repeated, as by an interrupt that comes for another line.
                echo.level(level, || at.wrapping_add(1));
                *edge = at;
            }
            let now = at.wrapping_add(last);
            // The first edge is a rise only if the line was low.
            let rise = usize::from(high);
            let expected = match gaps.len() {
                edges if edges >= rise + 2 => EchoState::Done { width_us: gaps[rise + 1] / PER_US },
                edges if edges == rise + 1 => EchoState::High { since_us: last / PER_US },
                0 if high => EchoState::High { since_us: last / PER_US },
                _ => EchoState::Idle,
            };
            prop_assert_eq!(echo.state(now, PER_US), expected);
        }
    }
}
