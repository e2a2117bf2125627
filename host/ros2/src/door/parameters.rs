//! Calls of parameter services, one after the other: each works on what the one before has left.

use futures::FutureExt;

use super::{Done, Report, Serving};
use crate::parameters::{ParameterCall, ParameterStore};

impl<R: FnMut(Report) -> bool> Serving<'_, R> {
    /// Takes a call, which waits for those before it.
    pub(super) fn parameter_call(&mut self, call: ParameterCall) {
        self.parameter_calls.push_back(call);
        if let Some(store) = self.parameters.take() {
            self.next_parameter_call(store);
        }
    }

    /// Carries out the next call that waits.
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
