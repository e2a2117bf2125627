//! Sequences of states with timeouts.

use std::{future::Future, pin::pin};

use futures::future::{Either, select};

use crate::{Error, Session};

/// Sequence of a program's states: each has a name and a timeout.
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

/// A completed state of a sequence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Visit {
    /// Name of the state.
    pub state: &'static str,
    /// Start of the state, s on the host's clock.
    pub entered_s: f64,
    /// End of the state, s on the host's clock; also after an error or a timeout.
    pub left_s: f64,
}

impl<'s, 'b> Sequence<'s, 'b> {
    /// Creates a sequence before its first state.
    #[must_use]
    pub fn new(session: &'s Session<'b>) -> Self {
        Self { session, visits: Vec::new() }
    }

    /// Runs the work of a state. Work that reaches the timeout is dropped where it waits: its last set point stays in
    /// force, so that the caller's error path must stop it (the end of [`Session::armed`] does).
    ///
    /// # Errors
    /// The error of the work, or [`Error::StateTimedOut`].
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

    /// Completed states, in their order.
    #[must_use]
    pub fn visits(&self) -> &[Visit] {
        &self.visits
    }
}
