//! Calls.

use serde::{Deserialize, Serialize};

/// `std_srvs/srv/Trigger_Request`: empty, which in IDL is one byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// Means nothing.
    pub structure_needs_at_least_one_member: u8,
}

/// `std_srvs/srv/Trigger_Response`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// Whether it was done.
    pub success: bool,
    /// Why not.
    pub message: String,
}
