//! Valves and tubes that several bodies have.

use r4_world::Restriction;
use serde::Deserialize;

use crate::number::{not_negative, positive};

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FlowTable {
    #[serde(deserialize_with = "positive")]
    pub(super) conductance_m3_s_pa: f64,
    #[serde(deserialize_with = "not_negative")]
    pub(super) critical_ratio: f64,
}

impl From<FlowTable> for Restriction {
    fn from(FlowTable { conductance_m3_s_pa, critical_ratio }: FlowTable) -> Self {
        Self { conductance_m3_s_pa, critical_ratio }
    }
}
