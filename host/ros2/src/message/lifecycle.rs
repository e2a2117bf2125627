//! Managed nodes.

use serde::{Deserialize, Serialize};

/// `lifecycle_msgs/msg/State`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LifecycleState {
    /// Number of the state.
    pub id: u8,
    /// Name of the state.
    pub label: String,
}

/// `lifecycle_msgs/msg/Transition`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LifecycleTransition {
    /// Number of the transition; passed over where there is a label.
    pub id: u8,
    /// Name of the transition.
    pub label: String,
}

/// `lifecycle_msgs/msg/TransitionEvent`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionEvent {
    /// When, ns.
    pub timestamp: u64,
    /// What happened.
    pub transition: LifecycleTransition,
    /// State before.
    pub start_state: LifecycleState,
    /// State after.
    pub goal_state: LifecycleState,
}

/// `lifecycle_msgs/msg/TransitionDescription`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TransitionDescription {
    /// The transition.
    pub transition: LifecycleTransition,
    /// State before.
    pub start_state: LifecycleState,
    /// State after, where it succeeds.
    pub goal_state: LifecycleState,
}

/// Request of the services that only ask: empty, which in IDL is one byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EmptyRequest {
    /// Means nothing.
    pub structure_needs_at_least_one_member: u8,
}

/// `lifecycle_msgs/srv/GetState_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetStateResponse {
    /// State now.
    pub current_state: LifecycleState,
}

/// `lifecycle_msgs/srv/ChangeState_Request`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeStateRequest {
    /// What is wanted.
    pub transition: LifecycleTransition,
}

/// `lifecycle_msgs/srv/ChangeState_Response`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeStateResponse {
    /// Whether the node is in the state that was wanted.
    pub success: bool,
}

/// `lifecycle_msgs/srv/GetAvailableStates_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetAvailableStatesResponse {
    /// All states.
    pub available_states: Vec<LifecycleState>,
}

/// `lifecycle_msgs/srv/GetAvailableTransitions_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GetAvailableTransitionsResponse {
    /// Those that can be asked for now.
    pub available_transitions: Vec<TransitionDescription>,
}
