//! Interrupt storms: the budget of edges of a line, and the masking of its interrupt.
//!
//! Edges of encoder 3 and of the echoes come by interrupts above the supervisor. A loose wire beside a motor's leads
//! can make millions of edges per second, and nothing below would run. So each line has a budget of edges per
//! millisecond. The interrupt masks a line that has spent it; the control loop raises
//! [`Cause::InterruptStorm`](r4_protocol::Cause::InterruptStorm), as edges are lost, and tries the line again after a
//! while.

use r4_protocol::config::ENCODER_3_COUNTS_PER_MS;

/// Budget of encoder 3, edges per millisecond. A configuration may ask for half of it; the fastest encoder of a robot
/// in `boards/` makes 8.7 (a wheel of openscout, 5760 counts, 9.5 rad/s). The cost of all budgets together is in
/// `docs/performance.md`; at half of it, fast shafts would have to move to encoders 0 to 2, which timers count.
pub const ENCODER_EDGES_PER_MS: u32 = 2 * ENCODER_3_COUNTS_PER_MS;
/// Budget of an echo, edges per millisecond: our choice. A ping has two, and another follows after 60 ms; the rest is
/// for an echo that bounces. At half of it, five bounces within a millisecond would be a storm.
pub const ECHO_EDGES_PER_MS: u32 = 20;
/// Time until a masked line is tried again, ms: a storm that still lasts costs one budget per second.
const RETRY_MS: u32 = 1000;

/// State of a line's interrupt.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Open,
    Masked,
    /// Open again, in its first millisecond.
    Trial,
}

/// Result of the control loop's check of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Verdict {
    /// The line has to be unmasked.
    pub unmask: bool,
    /// Edges are lost, or may be lost again.
    pub storm: bool,
}

/// Edge budget of one line: spent by its interrupt, checked by the control loop.
///
/// It counts by time and not by control periods, so that a late loop, or one that sets up chips, does not take a
/// turning shaft for a storm. Times are ticks of a clock that wraps.
#[derive(Clone, Copy, Debug)]
pub struct EdgeBudget {
    state: State,
    edges: u32,
    ticks_per_ms: u32,
    spent: u32,
    /// Start of the millisecond being counted, or of the mask.
    since: u32,
}

impl EdgeBudget {
    /// Creates an open line with a budget of `edges_per_ms`, on a clock of `ticks_per_ms`.
    #[must_use]
    pub const fn new(edges_per_ms: u32, ticks_per_ms: u32) -> Self {
        Self { state: State::Open, edges: edges_per_ms, ticks_per_ms, spent: 0, since: 0 }
    }

    /// Takes an edge at `now`; returns true when the line must be masked at once. Called by the line's interrupt.
    pub const fn edge(&mut self, now: u32) -> bool {
        if now.wrapping_sub(self.since) >= self.ticks_per_ms {
            // A whole millisecond has passed without a storm.
            self.state = State::Open;
            (self.spent, self.since) = (0, now);
        }
        self.spent += 1;
        if self.spent <= self.edges {
            return false;
        }
        (self.state, self.since) = (State::Masked, now);
        true
    }

    /// Returns true while the line is masked.
    #[must_use]
    pub const fn is_masked(&self) -> bool {
        matches!(self.state, State::Masked)
    }

    /// Checks the line at `now`; call it every control period.
    pub const fn look(&mut self, now: u32) -> Verdict {
        let since = now.wrapping_sub(self.since);
        match self.state {
            State::Masked if since >= RETRY_MS * self.ticks_per_ms => {
                *self = Self { state: State::Trial, spent: 0, since: now, ..*self };
                Verdict { unmask: true, storm: true }
            }
            State::Masked => Verdict { unmask: false, storm: true },
            State::Trial if since >= self.ticks_per_ms => {
                self.state = State::Open;
                Verdict { unmask: false, storm: false }
            }
            State::Trial => Verdict { unmask: false, storm: true },
            State::Open => Verdict { unmask: false, storm: false },
        }
    }
}

/// Number of illegal transitions (both tracks at once) within [`ILLEGAL_S`] that trips: our choice. Each loses two
/// counts, so a motor is stopped before twenty counts are wrong, 1.3 degrees of a wheel of openscout. Dirt on a disc
/// makes one per turn; shorted tracks, a dead track beside the other's edges and a shaft that is too fast make
/// hundreds. At half of it, five in a row trip.
const ILLEGAL_LIMIT: u32 = 10;
/// Window over which illegal transitions are counted, s.
const ILLEGAL_S: f32 = 0.1;

/// Rate of illegal quadrature transitions of one encoder.
#[derive(Clone, Copy, Debug)]
pub struct IllegalRate {
    last: Option<u32>,
    window_periods: u32,
    periods: u32,
    seen: u32,
    implausible: bool,
}

impl IllegalRate {
    /// Creates the rate check of an encoder whose counter is read every `period_s`, s.
    #[must_use]
    pub fn new(period_s: f32) -> Self {
        Self {
            last: None,
            window_periods: super::periods(ILLEGAL_S, period_s),
            periods: 0,
            seen: 0,
            implausible: false,
        }
    }

    /// Takes the number of illegal transitions so far, wrapping. Returns true from the transition that exceeds the
    /// limit until a whole window had fewer.
    pub fn update(&mut self, illegal: u32) -> bool {
        let since = illegal.wrapping_sub(self.last.replace(illegal).unwrap_or(illegal));
        self.seen = self.seen.saturating_add(since);
        self.implausible |= self.seen >= ILLEGAL_LIMIT;
        self.periods += 1;
        if self.periods >= self.window_periods {
            self.implausible = self.seen >= ILLEGAL_LIMIT;
            (self.periods, self.seen) = (0, 0);
        }
        self.implausible
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    /// Ticks per millisecond of a clock of 1 MHz.
    const MS: u32 = 1000;
    const EDGES: u32 = 100;
    const CALM: Verdict = Verdict { unmask: false, storm: false };
    const MASKED: Verdict = Verdict { unmask: false, storm: true };

    /// Feeds `edges` edges at `now`; returns the number taken until the line is masked, that one included.
    fn burst(line: &mut EdgeBudget, now: u32, edges: u32) -> u32 {
        (1..=edges).find(|_| line.edge(now)).unwrap_or(edges)
    }

    #[test]
    fn a_storm_is_masked_at_once_and_tried_again_after_a_second() {
        // The clock wraps during the test.
        let begin = u32::MAX - 500 * MS;
        let at = |ms: u32| begin.wrapping_add(ms * MS);
        let mut line = EdgeBudget::new(EDGES, MS);
        assert_eq!((burst(&mut line, at(0), 1000), line.is_masked()), (EDGES + 1, true));
        assert!((1..1000).all(|ms| line.look(at(ms)) == MASKED));
        assert_eq!((line.look(at(1000)), line.is_masked()), (Verdict { unmask: true, storm: true }, false));
        // The storm continues: masked again, and every check in between reports it.
        assert_eq!(burst(&mut line, at(1000), 1000), EDGES + 1);
        assert!((1001..2000).all(|ms| line.look(at(ms)) == MASKED));
        assert!(line.look(at(2000)).unmask);
        // The storm is over.
        assert_eq!(burst(&mut line, at(2000), EDGES), EDGES);
        assert_eq!([line.look(at(2000)), line.look(at(2001)), line.look(at(2002))], [MASKED, CALM, CALM]);
    }

    #[test]
    fn a_fast_shaft_is_no_storm_however_seldom_the_loop_looks() {
        let mut line = EdgeBudget::new(EDGES, MS);
        // A shaft of 100 counts per millisecond, for ten seconds.
        assert!((0..1_000_000).all(|edge: u32| !line.edge(edge * (MS / EDGES))));
        assert_eq!(line.look(10_000 * MS), CALM);
    }

    /// Windows of 100 periods follow each other: one in 5 gives ten within the first, one in 10 gives nine in the first
    /// and ten in the second, one in 11 gives nine in each of ten.
    #[test]
    fn illegal_transitions_are_summed_over_a_window() {
        for (one_in, trips) in [(1, Some(10)), (5, Some(50)), (10, Some(190)), (11, None)] {
            let mut rate = IllegalRate::new(1e-3);
            assert_eq!((0..1000u32).find(|period| rate.update(period / one_in)), trips, "one in {one_in}");
        }
    }

    proptest! {
        /// For any edges, no millisecond has more interrupts than two budgets plus the two that mask, and there is a
        /// cause from the mask until a millisecond after the line was tried again.
        #[test]
        fn the_supervisor_is_never_starved(start: u32, gaps in prop::collection::vec(0u32..40, 1..4000)) {
            let mut line = EdgeBudget::new(EDGES, MS);
            let (mut taken, mut next_look) = (Vec::new(), 1);
            let (mut elapsed, mut storm_until) = (0u64, 0);
            let at = |elapsed: u64| start.wrapping_add(elapsed as u32);
            for gap in gaps {
                // Long gaps are included too.
                elapsed += if gap == 39 { u64::from(300 * MS) } else { u64::from(gap.max(1)) };
                while next_look <= elapsed {
                    let masked = line.is_masked();
                    let verdict = line.look(at(next_look));
                    prop_assert!(verdict.storm || next_look >= storm_until);
                    prop_assert!(!verdict.unmask || masked);
                    if verdict.unmask {
                        storm_until = next_look + u64::from(MS);
                    }
                    next_look += u64::from(MS);
                }
                if !line.is_masked() {
                    taken.push(elapsed);
                    if line.edge(at(elapsed)) {
                        storm_until = elapsed + u64::from(RETRY_MS * MS);
                    }
                }
            }
            let most = 2 * EDGES as usize + 2;
            prop_assert!(taken.windows(most + 1).all(|edges| edges[most] - edges[0] >= u64::from(MS)));
        }

        /// Fewer than the limit in any window never trips; as many at once always trips, and for at most two windows.
        #[test]
        fn illegal_transitions_trip_by_their_rate(start in any::<u32>(), burst in 0u32..40) {
            let mut rate = IllegalRate::new(1e-3);
            prop_assert!(!rate.update(start));
            let tripped = rate.update(start.wrapping_add(burst));
            prop_assert_eq!(tripped, burst >= ILLEGAL_LIMIT);
            let last = (0..200).map(|_| rate.update(start.wrapping_add(burst))).last();
            prop_assert_eq!(last, Some(false));
        }
    }
}
