//! Messages and services of managed nodes.

use serde::{Deserialize, Serialize};

/// Message `lifecycle_msgs/msg/State`: state of a managed node.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LifecycleState {
    /// Number of the state.
    pub id: u8,
    /// Name of the state.
    pub label: String,
}

/// Message `lifecycle_msgs/msg/Transition`: transition between two states.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LifecycleTransition {
    /// Number of the transition; ignored in a request with a label.
    pub id: u8,
    /// Name of the transition.
    pub label: String,
}

/// Message `lifecycle_msgs/msg/TransitionEvent`: one step of a transition.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionEvent {
    /// Time of the step on the machine's clock, ns since 1970.
    pub timestamp: u64,
    /// Transition of the step.
    pub transition: LifecycleTransition,
    /// State before the step.
    pub start_state: LifecycleState,
    /// State after the step.
    pub goal_state: LifecycleState,
}

/// Message `lifecycle_msgs/msg/TransitionDescription`: transition with its two states.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionDescription {
    /// Transition with its number and label.
    pub transition: LifecycleTransition,
    /// State from which the transition starts.
    pub start_state: LifecycleState,
    /// State to which the transition leads when it succeeds.
    pub goal_state: LifecycleState,
}

/// Request of the services that only query: it has no fields, which IDL encodes as one byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmptyRequest {
    /// Placeholder of IDL, without meaning.
    pub structure_needs_at_least_one_member: u8,
}

/// Response `lifecycle_msgs/srv/GetState_Response` of `~/get_state`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetStateResponse {
    /// Current state of the node.
    pub current_state: LifecycleState,
}

/// Request `lifecycle_msgs/srv/ChangeState_Request` of `~/change_state`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeStateRequest {
    /// Requested transition, by label or number.
    pub transition: LifecycleTransition,
}

/// Response `lifecycle_msgs/srv/ChangeState_Response` of `~/change_state`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeStateResponse {
    /// True when the node has reached the goal state of the requested transition.
    pub success: bool,
}

/// Response `lifecycle_msgs/srv/GetAvailableStates_Response` of `~/get_available_states`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetAvailableStatesResponse {
    /// All states between transitions.
    pub available_states: Vec<LifecycleState>,
}

/// Response `lifecycle_msgs/srv/GetAvailableTransitions_Response` of `~/get_available_transitions`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetAvailableTransitionsResponse {
    /// Transitions that can be requested in the current state.
    pub available_transitions: Vec<TransitionDescription>,
}
