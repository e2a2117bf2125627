//! Transitions of a managed node during a session.

use futures::{FutureExt, channel::oneshot};
use r4_driver::Error as DriverError;

use super::{Done, Report, Serving};
use crate::lifecycle::{Change, Transition};

/// Reason why a session ended without an error.
#[derive(Debug)]
pub enum Ended {
    /// All senders of orders are gone.
    Orders,
    /// This transition of a managed node ended the session; the board is disarmed.
    Session(Change),
}

impl<R: FnMut(Report) -> bool> Serving<'_, R> {
    /// Starts a transition. A transition that ends the session disarms the board first and is returned; `None` for the others.
    pub(super) async fn change(&mut self, change: Change) -> Option<Ended> {
        let Change { transition, answer } = change;
        let board = self.session.board;
        match transition {
            Transition::Activate if self.is_estop_engaged => {
                self.refuse("the node is not activated: the e-stop topic is engaged; release it first".into());
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
                // If this fails, the board trips as soon as the session's heartbeats end.
                let _ = board.disarm().await;
                return Some(Ended::Session(Change { transition, answer }));
            }
            // A session exists: the node is configured already.
            Transition::Configure => drop(answer.send(false)),
        }
        None
    }

    /// Handles the board's answer to arming or disarming.
    pub(super) fn changed(&mut self, to_active: bool, result: Result<(), DriverError>, answer: oneshot::Sender<bool>) {
        let is_made = result.is_ok();
        if let Err(error) = result {
            let what = if to_active { "activated" } else { "deactivated" };
            self.refuse(format!("the node is not {what}: {error}"));
        }
        self.is_active = to_active && is_made;
        // The caller may be gone by now.
        let _ = answer.send(is_made);
        self.look_at_safety();
    }

    /// Reports once that the board is no longer armed.
    pub(super) fn deactivated(&mut self) {
        if std::mem::take(&mut self.is_active) {
            self.publish(Report::Deactivated);
        }
    }
}
