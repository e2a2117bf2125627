//! Transitions of a managed node that has a session.

use futures::{FutureExt, channel::oneshot};
use r4_driver::Error as DriverError;

use super::{Done, Report, Serving};
use crate::lifecycle::{Change, Transition};

/// Why a node is no longer served, where nothing failed.
#[derive(Debug)]
pub enum Ended {
    /// Nobody can give orders any more.
    Orders,
    /// A managed node ends its session, whose board is disarmed, by this transition.
    Session(Change),
}

impl<R: FnMut(Report) -> bool> Serving<'_, R> {
    /// Begins a transition; returns the one that ends the session, once the board is disarmed.
    pub(super) async fn change(&mut self, change: Change) -> Option<Ended> {
        let Change { transition, answer } = change;
        let board = self.session.board;
        match transition {
            Transition::Activate if self.is_estop_engaged => {
                self.refuse("it is not activated: the e-stop topic is engaged; release it first".into());
                let _ = answer.send(false);
            }
            Transition::Activate => {
                let work = async move { Done::Changed { to_active: true, result: board.arm().await, answer } };
                self.work.push(work.boxed_local());
            }
            Transition::Deactivate => {
                self.drop_trajectory();
                self.is_active = false;
                let work = async move { Done::Changed { to_active: false, result: board.disarm().await, answer } };
                self.work.push(work.boxed_local());
            }
            Transition::Cleanup | Transition::Shutdown => {
                self.drop_trajectory();
                // Where this fails, the board trips as soon as the session's heartbeats end.
                let _ = board.disarm().await;
                return Some(Ended::Session(Change { transition, answer }));
            }
            // It has a session.
            Transition::Configure => drop(answer.send(false)),
        }
        None
    }

    /// Takes what the board says to being armed or disarmed.
    pub(super) fn changed(&mut self, to_active: bool, result: Result<(), DriverError>, answer: oneshot::Sender<bool>) {
        let is_made = result.is_ok();
        if let Err(error) = result {
            let what = if to_active { "activated" } else { "deactivated" };
            self.refuse(format!("it is not {what}: {error}"));
        }
        self.is_active = to_active && is_made;
        // Who asked may be gone by now.
        let _ = answer.send(is_made);
        self.look_at_safety();
    }

    /// Takes note that the board is no longer armed.
    pub(super) fn deactivated(&mut self) {
        if std::mem::take(&mut self.is_active) {
            self.publish(Report::Deactivated);
        }
    }
}
