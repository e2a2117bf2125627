//! Queue of timed events, ordered by time and, at the same time, by the events themselves.

use std::{cmp::Reverse, collections::BinaryHeap};

/// Event queue. Events of the same time come out in the order of `E`, not in that of their insertion, so that the order
/// of computation changes nothing.
#[derive(Clone, Debug)]
pub struct Queue<E>(BinaryHeap<Reverse<(u64, E)>>);

impl<E: Ord> Default for Queue<E> {
    fn default() -> Self {
        Self(BinaryHeap::new())
    }
}

impl<E: Ord> Queue<E> {
    /// Schedules `event` at `at_us` on the event clock.
    pub fn push(&mut self, at_us: u64, event: E) {
        self.0.push(Reverse((at_us, event)));
    }

    /// Time of the next event, µs; `None` when the queue is empty.
    #[must_use]
    pub fn next_us(&self) -> Option<u64> {
        self.0.peek().map(|Reverse((at_us, _))| *at_us)
    }

    /// Removes the next event and returns it with its time, if that is at most `now_us`.
    pub fn pop_due(&mut self, now_us: u64) -> Option<(u64, E)> {
        if self.next_us()? > now_us {
            return None;
        }
        self.0.pop().map(|Reverse(entry)| entry)
    }
}
