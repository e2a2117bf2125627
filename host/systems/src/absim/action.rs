//! States of a goal, those of an action server of ROS 1.
//!
//! # Source
//! actionlib, *Detailed description*, "Server description": <http://wiki.ros.org/actionlib/DetailedDescription>. `LOST` is a state of
//! clients only and is not here.

/// State of a goal in the server's state machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// The goal waits for its robot.
    Pending,
    /// Its robot drives to it.
    Active,
    /// Cancelled while its robot drove; the robot has not stopped yet.
    Preempting,
    /// Cancelled while it waited; the server has not confirmed yet.
    Recalling,
    /// Terminal: the robot refused it.
    Rejected,
    /// Terminal: cancelled while its robot drove, which has stopped.
    Preempted,
    /// Terminal: cancelled before its robot started.
    Recalled,
    /// Terminal: the robot reached it.
    Succeeded,
    /// Terminal: the robot gave it up.
    Aborted,
}

/// Event of a goal: [`Event::Cancel`] comes from the client, the others from the server.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The client cancels the goal.
    Cancel,
    /// The robot starts to drive.
    Accept,
    /// The robot refuses the goal.
    Reject,
    /// After a cancel: the robot has stopped, or never started.
    Canceled,
    /// The robot has reached the goal.
    Succeed,
    /// The robot gives the goal up.
    Abort,
}

/// Error of an event that is not valid in the goal's state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a goal that is {state:?} cannot {event:?}: its server lost track of it")]
pub struct Impossible {
    /// State of the goal before the event.
    pub state: State,
    /// Event that the state does not allow.
    pub event: Event,
}

impl State {
    /// Returns true for a state that no event changes.
    #[must_use]
    pub fn is_terminal(self) -> bool {
        use State::{Aborted, Preempted, Recalled, Rejected, Succeeded};
        matches!(self, Rejected | Preempted | Recalled | Succeeded | Aborted)
    }

    /// State after `event`.
    ///
    /// A cancel of a goal that has ended, or that is being cancelled already, changes nothing: the messages of client
    /// and server may cross.
    ///
    /// # Errors
    /// [`Impossible`] for an event that the state does not allow.
    pub fn after(self, event: Event) -> Result<Self, Impossible> {
        use Event::{Abort, Accept, Cancel, Canceled, Reject, Succeed};
        use State::{Aborted, Active, Pending, Preempted, Preempting, Recalled, Recalling, Rejected, Succeeded};
        Ok(match (self, event) {
            (Pending, Cancel) => Recalling,
            (Active, Cancel) => Preempting,
            (state, Cancel) => state,
            (Pending, Accept) => Active,
            (Recalling, Accept) => Preempting,
            (Pending | Recalling, Reject) => Rejected,
            (Pending | Recalling, Canceled) => Recalled,
            (Active | Preempting, Canceled) => Preempted,
            (Active | Preempting, Succeed) => Succeeded,
            (Active | Preempting, Abort) => Aborted,
            (state, event) => return Err(Impossible { state, event }),
        })
    }
}
