//! States and transitions of a managed node: a configured node has a session with its board, and an active node's board is armed.
//!
//! # Source
//! States, transitions and their numbers: `lifecycle_msgs` 2.0.3 and the article "Managed nodes" of the ROS 2 design pages.

use futures::channel::oneshot;

use crate::message::{LifecycleState, LifecycleTransition, TransitionDescription};

/// State of a managed node between transitions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// The node has no session with the board.
    #[default]
    Unconfigured,
    /// The node has a session, but has not armed the board.
    Inactive,
    /// The node has armed the board, and the board is still armed.
    Active,
    /// The node is shut down for good.
    Finalized,
}

/// Transition that a caller can request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transition {
    /// Opens a session with the board.
    Configure,
    /// Disarms the board and closes the session.
    Cleanup,
    /// Arms the session's board.
    Activate,
    /// Disarms the session's board.
    Deactivate,
    /// Disarms the board, if there is a session, and ends the node.
    Shutdown,
}

/// Requested transition that is possible in the node's state.
#[derive(Debug)]
pub struct Change {
    /// Transition to carry out.
    pub transition: Transition,
    /// Sender of the answer: true when the transition has succeeded.
    pub answer: oneshot::Sender<bool>,
}

/// Transition that the node makes by itself, without a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unasked {
    /// The board of an active node is no longer armed: it has tripped or was disarmed.
    Disarmed,
    /// The session has ended with an error.
    Failed,
}

/// Number and label of the transition state `ErrorProcessing`.
const ERROR_PROCESSING: (u8, &str) = (15, "errorprocessing");

impl State {
    /// All states between transitions.
    pub const ALL: [Self; 4] = [Self::Unconfigured, Self::Inactive, Self::Active, Self::Finalized];

    fn named(self) -> (u8, &'static str) {
        match self {
            Self::Unconfigured => (1, "unconfigured"),
            Self::Inactive => (2, "inactive"),
            Self::Active => (3, "active"),
            Self::Finalized => (4, "finalized"),
        }
    }

    /// Returns the state as a message.
    #[must_use]
    pub fn message(self) -> LifecycleState {
        state(self.named())
    }

    /// Returns the transitions that can be requested in this state.
    #[must_use]
    pub fn transitions(self) -> &'static [Transition] {
        match self {
            Self::Unconfigured => &[Transition::Configure, Transition::Shutdown],
            Self::Inactive => &[Transition::Cleanup, Transition::Activate, Transition::Shutdown],
            Self::Active => &[Transition::Deactivate, Transition::Shutdown],
            Self::Finalized => &[],
        }
    }

    /// Returns the transition that a request names by its label, or by its number if the label is empty; `None` when it is not possible in
    /// this state.
    #[must_use]
    pub fn asked(self, LifecycleTransition { id, label }: &LifecycleTransition) -> Option<Transition> {
        let is_meant = |transition: &&Transition| match label.as_str() {
            "" => transition.id(self) == *id,
            label => transition.label() == label,
        };
        self.transitions().iter().find(is_meant).copied()
    }

    /// Returns descriptions of the transitions that can be requested in this state.
    #[must_use]
    pub fn descriptions(self) -> Vec<TransitionDescription> {
        let describe = |transition: &Transition| TransitionDescription {
            transition: transition.message(self),
            start_state: self.message(),
            goal_state: transition.goal().message(),
        };
        self.transitions().iter().map(describe).collect()
    }
}

impl Transition {
    fn id(self, from: State) -> u8 {
        match self {
            Self::Configure => 1,
            Self::Cleanup => 2,
            Self::Activate => 3,
            Self::Deactivate => 4,
            // 5 from unconfigured, 6 from inactive, 7 from active.
            Self::Shutdown => 4 + from.named().0,
        }
    }

    fn label(self) -> &'static str {
        match self {
            Self::Configure => "configure",
            Self::Cleanup => "cleanup",
            Self::Activate => "activate",
            Self::Deactivate => "deactivate",
            Self::Shutdown => "shutdown",
        }
    }

    /// Returns the state after a successful transition.
    #[must_use]
    pub fn goal(self) -> State {
        match self {
            Self::Configure | Self::Deactivate => State::Inactive,
            Self::Cleanup => State::Unconfigured,
            Self::Activate => State::Active,
            Self::Shutdown => State::Finalized,
        }
    }

    /// Returns the state during the transition, as a message.
    #[must_use]
    pub fn under_way(self) -> LifecycleState {
        state(match self {
            Self::Configure => (10, "configuring"),
            Self::Cleanup => (11, "cleaningup"),
            Self::Shutdown => (12, "shuttingdown"),
            Self::Activate => (13, "activating"),
            Self::Deactivate => (14, "deactivating"),
        })
    }

    /// Returns the transition from the state `from` as a message.
    #[must_use]
    pub fn message(self, from: State) -> LifecycleTransition {
        LifecycleTransition { id: self.id(from), label: self.label().to_owned() }
    }

    /// Returns the end of the transition as a message: success, or failure when `is_made` is false.
    #[must_use]
    pub fn ended(self, is_made: bool) -> LifecycleTransition {
        // lifecycle_msgs numbers the ends 10 to 52: tens for the transition, ones for success, failure and error.
        let tens = match self {
            Self::Configure => 10,
            Self::Cleanup => 20,
            Self::Activate => 30,
            Self::Deactivate => 40,
            Self::Shutdown => 50,
        };
        let (ones, label) = if is_made { (0, "transition_success") } else { (1, "transition_failure") };
        LifecycleTransition { id: tens + ones, label: label.to_owned() }
    }
}

impl Unasked {
    /// Returns the steps of the transition, each with the states before and after it, and the final state.
    #[must_use]
    pub fn steps(self, from: State) -> (Vec<(LifecycleTransition, LifecycleState, LifecycleState)>, State) {
        match self {
            Self::Disarmed => {
                let transition = Transition::Deactivate;
                let during = transition.under_way();
                let begun = (transition.message(from), from.message(), during.clone());
                (vec![begun, (transition.ended(true), during, State::Inactive.message())], State::Inactive)
            }
            Self::Failed => {
                let during = state(ERROR_PROCESSING);
                let named = |id, label: &str| LifecycleTransition { id, label: label.to_owned() };
                let begun = (named(99, "transition_error"), from.message(), during.clone());
                let ended = (named(60, "transition_success"), during, State::Unconfigured.message());
                (vec![begun, ended], State::Unconfigured)
            }
        }
    }
}

fn state((id, label): (u8, &str)) -> LifecycleState {
    LifecycleState { id, label: label.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares all states and numbers with the table of `lifecycle_msgs/msg/Transition`.
    #[test]
    fn each_state_takes_its_transitions_and_no_others() {
        use State::{Active, Finalized, Inactive, Unconfigured};
        let table = [
            (Unconfigured, 1, "configure", Inactive),
            (Unconfigured, 5, "shutdown", Finalized),
            (Inactive, 2, "cleanup", Unconfigured),
            (Inactive, 3, "activate", Active),
            (Inactive, 6, "shutdown", Finalized),
            (Active, 4, "deactivate", Inactive),
            (Active, 7, "shutdown", Finalized),
        ];
        for from in State::ALL {
            for id in 0..=u8::MAX {
                let asked = from.asked(&LifecycleTransition { id, label: String::new() });
                let expected = table.iter().find(|(state, number, ..)| (*state, *number) == (from, id));
                assert_eq!(asked.map(Transition::goal), expected.map(|(.., goal)| *goal), "{from:?} {id}");
            }
            for label in ["configure", "cleanup", "activate", "deactivate", "shutdown", "create"] {
                // A label has priority over any number.
                let asked = from.asked(&LifecycleTransition { id: 1, label: label.into() });
                let expected = table.iter().find(|(state, _, named, _)| (*state, *named) == (from, label));
                assert_eq!(asked.map(Transition::goal), expected.map(|(.., goal)| *goal), "{from:?} {label}");
            }
        }
    }

    #[test]
    fn what_nobody_asked_for_is_told_in_steps_that_follow_each_other() {
        for (unasked, from) in [(Unasked::Disarmed, State::Active), (Unasked::Failed, State::Inactive)] {
            let (steps, to) = unasked.steps(from);
            assert_eq!(steps.first().map(|(_, start, _)| start.clone()), Some(from.message()));
            assert_eq!(steps.last().map(|(.., goal)| goal.clone()), Some(to.message()));
            assert!(steps.windows(2).all(|pair| pair[0].2 == pair[1].1));
        }
    }
}
