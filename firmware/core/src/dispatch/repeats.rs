//! Repeated requests, which a host sends again when an answer did not come: carried out once, answered each time.

use heapless::Deque;
use r4_protocol::{Refusal, Reply, Request, version::REPEATS};

/// Latest requests with their answers.
#[derive(Default)]
pub(crate) struct Repeats(Deque<(u16, Request, Result<(), Refusal>), { REPEATS.remembered }>);

impl Repeats {
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// Returns the answer to a request that has been answered before; `None` for a new one.
    pub(crate) fn answer(&self, seq: u16, request: &Request) -> Option<Result<Reply, Refusal>> {
        let found = self.0.iter().find(|(known, before, _)| *known == seq && before == request);
        found.map(|(_, _, result)| result.map(|()| Reply::Done))
    }

    /// Stores an answer; of each sequence number only the last is kept.
    pub(crate) fn remember(&mut self, seq: u16, request: Request, result: &Result<Reply, Refusal>) {
        if self.0.is_full() {
            self.0.pop_front();
        }
        // There is always room: the oldest entry has been removed.
        let _ = self.0.push_back((seq, request, result.as_ref().map(|_| ()).map_err(|refusal| *refusal)));
    }

    /// Removes the entry of a sequence number that is now used for another request.
    pub(crate) fn forget(&mut self, seq: u16) {
        self.0.retain(|(known, ..)| *known != seq);
    }
}
