//! What was asked of a board and is not answered yet.

use std::{future::pending, pin::pin};

use futures::{
    FutureExt, StreamExt,
    future::{Either, LocalBoxFuture, select},
    stream::FuturesUnordered,
};
use r4_driver::Error;

/// Requests under way, none of which keeps anybody from asking for the next: a stop does not wait for an arming.
pub(crate) struct Commands<'b, N> {
    waiting: FuturesUnordered<LocalBoxFuture<'b, (N, Result<(), Error>)>>,
}

impl<N> Default for Commands<'_, N> {
    fn default() -> Self {
        Self { waiting: FuturesUnordered::new() }
    }
}

impl<'b, N: 'b> Commands<'b, N> {
    /// Begins a request, which is sent when the next are waited for.
    pub(crate) fn begin(&self, name: N, request: impl Future<Output = Result<(), Error>> + 'b) {
        self.waiting.push(request.map(|result| (name, result)).boxed_local());
    }

    pub(crate) fn len(&self) -> usize {
        self.waiting.len()
    }

    /// The next that ends before `time` does.
    pub(crate) async fn until(&mut self, time: impl Future<Output = ()>) -> Option<(N, Result<(), Error>)> {
        let ended = async {
            match self.waiting.next().await {
                Some(ended) => ended,
                None => pending().await,
            }
        };
        match select(pin!(ended), pin!(time)).await {
            Either::Left((ended, _)) => Some(ended),
            Either::Right(((), _)) => None,
        }
    }
}
