//! States with time-outs, for programs that go through one after the other.

use std::{future::Future, pin::pin};

use futures::future::{Either, select};

use crate::{Error, Session};

/// A program's states: each has a name and a time in which it must end.
///
/// ```
/// use r4_rig::{Error, Rig, Sequence};
///
/// let rig = Rig::new("sim:osmc-bench".parse()?);
/// let work = async |session: &r4_rig::Session<'_>| {
///     let mut sequence = Sequence::new(session);
///     sequence.state("settle", 1.0, async { Ok(session.board.sleep_s(0.2).await) }).await?;
///     let late = sequence.state("wait", 0.1, async { Ok(session.board.sleep_s(5.0).await) }).await;
///     assert!(matches!(late, Err(Error::StateTimedOut { state: "wait", .. })));
///     Ok::<_, Error>(sequence.visits().iter().map(|visit| visit.state).collect::<Vec<_>>())
/// };
/// assert_eq!(rig.run(None, work)?.0, ["settle", "wait"]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Sequence<'s, 'b> {
    session: &'s Session<'b>,
    visits: Vec<Visit>,
}

/// A state that a program was in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Visit {
    /// Name of the state.
    pub state: &'static str,
    /// When it began, s on the host's clock.
    pub entered_s: f64,
    /// When it ended, s; also where it failed or timed out.
    pub left_s: f64,
}

impl<'s, 'b> Sequence<'s, 'b> {
    /// A program that has been in no state yet.
    #[must_use]
    pub fn new(session: &'s Session<'b>) -> Self {
        Self { session, visits: Vec::new() }
    }

    /// Runs the work of a state. Work that is not done in time is dropped where it waits: what it commanded last stays in force, so
    /// the caller's error path has to stop it (the end of [`Session::armed`] does).
    ///
    /// # Errors
    /// That of the work, or [`Error::StateTimedOut`].
    pub async fn state<T>(
        &mut self,
        state: &'static str,
        at_most_s: f64,
        work: impl Future<Output = Result<T, Error>>,
    ) -> Result<T, Error> {
        let board = self.session.board;
        let entered_s = board.now_s();
        let ended = match select(pin!(work), pin!(board.sleep_s(at_most_s))).await {
            Either::Left((ended, _)) => ended,
            Either::Right(((), _)) => Err(Error::StateTimedOut { state, at_most_s }),
        };
        self.visits.push(Visit { state, entered_s, left_s: board.now_s() });
        ended
    }

    /// States so far, in order.
    #[must_use]
    pub fn visits(&self) -> &[Visit] {
        &self.visits
    }
}
