//! Work of a session, behind one type: the code that holds a session is compiled once, and not again for each caller.

use futures::future::{FutureExt as _, LocalBoxFuture};
use r4_driver::Error as DriverError;

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
        value(self.result, session)
    }
}

fn value<T, E: From<Error>>(work: Option<Result<T, E>>, session: Result<(), Error>) -> Result<T, E> {
    match (work, session) {
        (Some(Err(error)), _) => Err(error),
        (_, Err(error)) => Err(error.into()),
        (Some(Ok(value)), Ok(())) => Ok(value),
        // No session ends by itself before its work.
        (None, Ok(())) => Err(Error::Standstill.into()),
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

/// Work that runs again in the next session when its link was lost.
pub(crate) trait Repeated: Work {
    /// Takes the end of a session.
    ///
    /// # Errors
    /// When work or session ended with an error: that of the link, if the error comes from there.
    fn end(&mut self, session: Result<(), Error>) -> Result<(), Option<DriverError>>;
}

/// Work that runs in each session.
pub(crate) struct Again<F, L, T, E> {
    work: F,
    /// Extracts the error of a lost link.
    lost: L,
    /// Result of the work in the last session; `None` until it ends.
    result: Option<Result<T, E>>,
}

impl<F, L, T, E: From<Error>> Again<F, L, T, E> {
    pub(crate) fn new(work: F, lost: L) -> Self {
        Self { work, lost, result: None }
    }

    /// Result of the last session.
    pub(crate) fn value(self) -> Result<T, E> {
        value(self.result, Ok(()))
    }
}

impl<T, E, L, F: AsyncFnMut(&Session<'_>) -> Result<T, E>> Work for Again<F, L, T, E> {
    fn run<'w>(&'w mut self, session: &'w Session<'_>) -> LocalBoxFuture<'w, ()> {
        // The error that ended the session before: work that is interrupted has no result.
        self.result = None;
        async { self.result = Some((self.work)(session).await) }.boxed_local()
    }
}

impl<T, E, L, F> Repeated for Again<F, L, T, E>
where
    E: From<Error>,
    L: Fn(&E) -> Option<&DriverError>,
    F: AsyncFnMut(&Session<'_>) -> Result<T, E>,
{
    fn end(&mut self, session: Result<(), Error>) -> Result<(), Option<DriverError>> {
        let result = value(self.result.take(), session);
        self.result.insert(result).as_ref().map(|_| ()).map_err(|error| (self.lost)(error).cloned())
    }
}
