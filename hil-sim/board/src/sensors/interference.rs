//! Interference on a digital line, as a loose wire beside a motor's leads or a broken shield couples it in.

/// A square wave that inverts a line in every other half period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SquareWave {
    /// Time of the first edge, ns.
    pub from_ns: u64,
    /// End of the interference, ns.
    pub until_ns: u64,
    /// Time between two edges, ns; 0 counts as 1.
    pub half_period_ns: u64,
}

impl SquareWave {
    /// True if the wave inverts the line at a time.
    #[must_use]
    pub const fn inverts(&self, at_ns: u64) -> bool {
        self.from_ns <= at_ns && at_ns < self.until_ns && self.halves(at_ns).is_multiple_of(2)
    }

    /// Time of the first edge after `after_ns`, ns; `None` if there is none.
    #[must_use]
    pub fn next_edge_ns(&self, after_ns: u64) -> Option<u64> {
        if self.until_ns <= self.from_ns || after_ns >= self.until_ns {
            return None;
        }
        if after_ns < self.from_ns {
            return Some(self.from_ns);
        }
        let next_ns = self.from_ns.saturating_add((self.halves(after_ns) + 1).saturating_mul(self.half_ns()));
        if next_ns < self.until_ns {
            return Some(next_ns);
        }
        // the end is an edge if it cuts an inverting half period short
        self.halves(self.until_ns - 1).is_multiple_of(2).then_some(self.until_ns)
    }

    /// Number of whole half periods since the first edge.
    const fn halves(&self, at_ns: u64) -> u64 {
        (at_ns - self.from_ns) / self.half_ns()
    }

    const fn half_ns(&self) -> u64 {
        if self.half_period_ns == 0 { 1 } else { self.half_period_ns }
    }
}

/// A wave on a line, followed edge by edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Followed {
    wave: SquareWave,
    next_ns: Option<u64>,
}

impl Followed {
    /// A wave whose edges up to `now_ns` are ignored.
    pub(super) fn new(wave: SquareWave, now_ns: u64) -> Self {
        Self { wave, next_ns: wave.next_edge_ns(now_ns) }
    }

    pub(super) const fn next_ns(&self) -> Option<u64> {
        self.next_ns
    }

    /// Advances the wave to `at_ns`.
    pub(super) fn advance(&mut self, at_ns: u64) {
        if self.next_ns.is_some_and(|next_ns| next_ns <= at_ns) {
            self.next_ns = self.wave.next_edge_ns(at_ns);
        }
    }

    /// True if the line is inverted at `at_ns`.
    pub(super) const fn inverts(&self, at_ns: u64) -> bool {
        self.wave.inverts(at_ns)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_half_that_is_cut_short_ends_in_time() {
        let wave = SquareWave { from_ns: 100, until_ns: 125, half_period_ns: 10 };
        let edges: Vec<_> = std::iter::successors(wave.next_edge_ns(0), |at_ns| wave.next_edge_ns(*at_ns)).collect();
        assert_eq!(edges, [100, 110, 120, 125]);
    }

    proptest! {
        /// Edges of the wave are exactly the changes of its level.
        #[test]
        fn edges_are_changes_of_level(from_ns in 0u64..50, length_ns in 0u64..200, half_period_ns in 0u64..40) {
            let wave = SquareWave { from_ns, until_ns: from_ns + length_ns, half_period_ns };
            let changes: Vec<_> = (1..300).filter(|at_ns| wave.inverts(*at_ns) != wave.inverts(at_ns - 1)).collect();
            let first = if wave.inverts(0) { Some(0) } else { wave.next_edge_ns(0) };
            let edges = std::iter::successors(first, |at_ns| wave.next_edge_ns(*at_ns));
            prop_assert_eq!(edges.filter(|at_ns| *at_ns > 0).collect::<Vec<_>>(), changes);
        }
    }
}
