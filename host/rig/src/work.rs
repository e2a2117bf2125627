//! Work of a session, behind one type: the code that holds a session is compiled once, and not again for each caller.

use futures::future::{FutureExt as _, LocalBoxFuture};

use crate::{Error, Session};

/// Work in a session, whatever the type of its result.
pub(crate) trait Work {
    /// Runs the work in a session to its end, and keeps its result aside.
    fn run<'w>(&'w mut self, session: &'w Session<'_>) -> LocalBoxFuture<'w, ()>;
}

/// Work that runs once.
pub(crate) struct Once<F, T, E> {
    work: Option<F>,
    /// Result of the work; `None` until it ends.
    result: Option<Result<T, E>>,
}

impl<F, T, E> Once<F, T, E> {
    pub(crate) fn new(work: F) -> Self {
        Self { work: Some(work), result: None }
    }

    /// Result of the work, if it ended, and of its session. The error of the work takes precedence.
    pub(crate) fn value(self, session: Result<(), Error>) -> Result<T, E>
    where
        E: From<Error>,
    {
        match (self.result, session) {
            (Some(Err(error)), _) => Err(error),
            (_, Err(error)) => Err(error.into()),
            (Some(Ok(value)), Ok(())) => Ok(value),
            // No session ends by itself before its work.
            (None, Ok(())) => Err(Error::Standstill.into()),
        }
    }
}

impl<T, E, F: AsyncFnOnce(&Session<'_>) -> Result<T, E>> Work for Once<F, T, E> {
    fn run<'w>(&'w mut self, session: &'w Session<'_>) -> LocalBoxFuture<'w, ()> {
        async {
            if let Some(work) = self.work.take() {
                self.result = Some(work(session).await);
            }
        }
        .boxed_local()
    }
}
