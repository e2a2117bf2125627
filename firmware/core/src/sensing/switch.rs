//! Mechanical switch with debouncing.

use r4_protocol::config::SwitchConfig;

use super::periods;

/// Time for which a level must be steady to count, s: snap-action switches bounce for 1 to 3 ms.
pub const DEBOUNCE_S: f32 = 0.005;

/// Switch, sampled every period.
///
/// Both edges are reported [`DEBOUNCE_S`] late, by the same time on the way in and on the way out: the mean of both
/// passes is the true position of a home switch. A shorter disturbance is not reported at all.
#[derive(Clone, Debug)]
pub struct Switch {
    active_low: bool,
    debounce_periods: u32,
    /// State of the last samples, true for closed, and their number, up to `debounce_periods`.
    steady: (bool, u32),
    closed: Option<bool>,
}

impl Switch {
    /// Creates a switch that is sampled every `period_s`, s.
    #[must_use]
    pub fn new(config: &SwitchConfig, period_s: f32) -> Self {
        Self {
            active_low: config.active_low,
            debounce_periods: periods(DEBOUNCE_S, period_s),
            steady: (false, 0),
            closed: None,
        }
    }

    /// Takes the level of this period and returns true if the switch is closed; false until a first level was steady.
    pub fn update(&mut self, high: bool) -> bool {
        let closed = high != self.active_low;
        let samples = if closed == self.steady.0 { self.steady.1 + 1 } else { 1 };
        self.steady = (closed, samples.min(self.debounce_periods));
        if self.steady.1 == self.debounce_periods {
            self.closed = Some(closed);
        }
        self.closed == Some(true)
    }

    /// State of the switch, true for closed; `None` until a first level was steady.
    #[must_use]
    pub fn closed(&self) -> Option<bool> {
        self.closed
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelId, ChannelKind};

    use super::*;

    /// Number of 1 ms periods in [`DEBOUNCE_S`].
    const PERIODS: usize = 5;

    fn switch(active_low: bool) -> Switch {
        Switch::new(&SwitchConfig { id: ChannelId::new(ChannelKind::Switch, 0), active_low }, 1e-3)
    }

    fn hold(switch: &mut Switch, high: bool, periods: usize) -> bool {
        (0..periods).map(|_| switch.update(high)).last().expect("at least one period")
    }

    #[test]
    fn the_first_steady_level_is_where_it_starts() {
        for (active_low, high) in [(false, false), (false, true), (true, false), (true, true)] {
            let mut switch = switch(active_low);
            assert!(!hold(&mut switch, high, PERIODS - 1));
            assert_eq!(switch.closed(), None);
            let closed = switch.update(high);
            assert_eq!((closed, switch.closed()), (high != active_low, Some(high != active_low)));
        }
    }

    #[test]
    fn an_edge_is_told_after_the_bounce() {
        let mut switch = switch(true);
        hold(&mut switch, true, PERIODS);
        for high in [false, true, false, true, true, false, true] {
            assert!(!switch.update(high));
        }
        assert!(!hold(&mut switch, false, PERIODS - 1));
        assert!(switch.update(false));
        assert!(hold(&mut switch, true, PERIODS - 1));
        assert!(!switch.update(true));
    }

    #[test]
    fn the_time_is_the_same_at_every_control_period() {
        // Control periods from the shortest to the longest allowed; with one longer than the time, every sample counts.
        for (period_s, periods) in [(500e-6, 10), (1e-3, 5), (2e-3, 3), (20e-3, 1)] {
            let config = SwitchConfig { id: ChannelId::new(ChannelKind::Switch, 0), active_low: false };
            let mut switch = Switch::new(&config, period_s);
            let known_after = (1..=100).find(|_| switch.update(true));
            assert_eq!(known_after, Some(periods), "{period_s} s");
        }
    }

    proptest! {
        /// The state is that of the last run of equal samples that was long enough.
        #[test]
        fn it_follows_the_last_steady_level(runs in prop::collection::vec((any::<bool>(), 1usize..12), 1..60)) {
            let mut switch = switch(false);
            let (mut level, mut length, mut expected) = (None, 0, None);
            for (high, periods) in runs {
                for _ in 0..periods {
                    length = if level == Some(high) { length + 1 } else { 1 };
                    level = Some(high);
                    if length >= PERIODS {
                        expected = Some(high);
                    }
                    prop_assert_eq!(switch.update(high), expected == Some(true));
                    prop_assert_eq!(switch.closed(), expected);
                }
            }
        }
    }
}
