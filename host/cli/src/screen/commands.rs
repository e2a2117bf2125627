//! Requests to a board whose answers are outstanding.

use std::{future::pending, pin::pin};

use futures::{
    FutureExt, StreamExt,
    future::{Either, LocalBoxFuture, select},
    stream::FuturesUnordered,
};
use r4_driver::Error;

/// Outstanding requests, none of which blocks the next: a stop does not wait for an arming.
pub(crate) struct Commands<'b, N> {
    waiting: FuturesUnordered<LocalBoxFuture<'b, (N, Result<(), Error>)>>,
}

impl<N> Default for Commands<'_, N> {
    fn default() -> Self {
        Self { waiting: FuturesUnordered::new() }
    }
}

impl<'b, N: 'b> Commands<'b, N> {
    /// Begins a request; it is sent when [`until`](Self::until) is awaited.
    pub(crate) fn begin(&self, name: N, request: impl Future<Output = Result<(), Error>> + 'b) {
        self.waiting.push(request.map(|result| (name, result)).boxed_local());
    }

    pub(crate) fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Next answer that arrives before `time` ends.
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
