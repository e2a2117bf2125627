//! Calls of parameter services. They run one after the other, because each may change the values that the next one reads.

use futures::FutureExt;

use super::{Done, Report, Serving};
use crate::parameters::{ParameterCall, ParameterStore};

impl<R: FnMut(Report) -> bool> Serving<'_, R> {
    /// Queues a call behind those before it.
    pub(super) fn parameter_call(&mut self, call: ParameterCall) {
        self.parameter_calls.push_back(call);
        if let Some(store) = self.parameters.take() {
            self.next_parameter_call(store);
        }
    }

    /// Starts the next queued call, or returns the store to its place when none is queued.
    pub(super) fn next_parameter_call(&mut self, mut store: ParameterStore) {
        let Some(call) = self.parameter_calls.pop_front() else {
            self.parameters = Some(store);
            return;
        };
        let board = self.session.board;
        let work = async move {
            store.handle(board, call).await;
            Done::Parameters(store)
        };
        self.work.push(work.boxed_local());
    }
}
