//! States of a goal as an action server of ROS 1 has them.
//!
//! # Source
//! actionlib, *Detailed description*, "Server description": <http://wiki.ros.org/actionlib/DetailedDescription>. `LOST` is a state of
//! clients only and is not here.

/// State of a goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum State {
    /// It waits for its robot.
    Pending,
    /// Its robot is on the way.
    Active,
    /// It was cancelled on the way, and its robot has not stopped yet.
    Preempting,
    /// It was cancelled while it waited, and the server has not confirmed yet.
    Recalling,
    /// It was refused.
    Rejected,
    /// It was cancelled on the way.
    Preempted,
    /// It was cancelled before its robot set off.
    Recalled,
    /// It was reached.
    Succeeded,
    /// It was given up by the robot.
    Aborted,
}

/// What happens to a goal: the first is a client's, the others are the server's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The client takes it back.
    Cancel,
    /// The robot sets off.
    Accept,
    /// The robot refuses.
    Reject,
    /// The robot has stopped, or never set off, after a cancel.
    Canceled,
    /// The robot is there.
    Succeed,
    /// The robot gives up.
    Abort,
}

/// An event that a goal in this state cannot have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a goal that is {state:?} cannot {event:?}: its server lost track of it")]
pub struct Impossible {
    /// The goal's state.
    pub state: State,
    /// The event.
    pub event: Event,
}

impl State {
    /// Whether nothing follows.
    #[must_use]
    pub fn is_terminal(self) -> bool {
        use State::{Aborted, Preempted, Recalled, Rejected, Succeeded};
        matches!(self, Rejected | Preempted | Recalled | Succeeded | Aborted)
    }

    /// State after `event`.
    ///
    /// A cancel of a goal that has ended, or that is being cancelled already, changes nothing: client and server cross on the way.
    ///
    /// # Errors
    /// [`Impossible`]
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
