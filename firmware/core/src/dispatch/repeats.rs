//! Requests that a host sends again because an answer did not come: done once, answered each time.

use heapless::Deque;
use r4_protocol::{Refusal, Reply, Request, version::REPEATS};

/// What was asked for last, with what was answered.
#[derive(Default)]
pub(crate) struct Repeats(Deque<(u16, Request, Result<(), Refusal>), { REPEATS.remembered }>);

impl Repeats {
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// The answer to a request that has been answered before.
    pub(crate) fn answer(&self, seq: u16, request: &Request) -> Option<Result<Reply, Refusal>> {
        let found = self.0.iter().find(|(known, before, _)| *known == seq && before == request);
        found.map(|(_, _, result)| result.map(|()| Reply::Done))
    }

    /// Remembers an answer, of each number only the last.
    pub(crate) fn remember(&mut self, seq: u16, request: Request, result: &Result<Reply, Refusal>) {
        if self.0.is_full() {
            self.0.pop_front();
        }
        // There is room now.
        let _ = self.0.push_back((seq, request, result.as_ref().map(|_| ()).map_err(|refusal| *refusal)));
    }

    /// Forgets what was asked with a number: something else has been by now.
    pub(crate) fn forget(&mut self, seq: u16) {
        self.0.retain(|(known, ..)| *known != seq);
    }
}
