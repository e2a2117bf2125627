//! Messages of the service type `std_srvs/srv/Trigger`.

use serde::{Deserialize, Serialize};

/// Request `std_srvs/srv/Trigger_Request`: it has no fields, which IDL encodes as one byte.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerRequest {
    /// Placeholder of IDL, without meaning.
    pub structure_needs_at_least_one_member: u8,
}

/// Response `std_srvs/srv/Trigger_Response` to a call.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TriggerResponse {
    /// True when the board has carried the request out.
    pub success: bool,
    /// Reason for a refusal; empty after success.
    pub message: String,
}
