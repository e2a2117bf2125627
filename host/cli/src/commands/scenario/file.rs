//! A scenario's file.

use r4_protocol::{ChannelId, Mode};
use serde::Deserialize;

/// What is done to one board.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Scenario {
    /// A built-in robot, or a file beside this one.
    pub(super) robot: String,
    /// In order of time.
    pub(super) steps: Vec<Step>,
}

/// One thing that is done.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Step {
    /// Since the host's session began; a step that comes while another still waits for its answer is done after that.
    pub(super) at_s: f64,
    /// What.
    #[serde(flatten)]
    pub(super) action: Action,
}

/// What a step does.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "do", rename_all = "kebab-case")]
pub(super) enum Action {
    /// Notes where everything is.
    Look,
    Arm,
    Disarm,
    /// Stop by the host.
    Stop,
    Clear,
    /// A set point; SI units.
    Set {
        channel: ChannelId,
        mode: Mode,
        value: f32,
    },
    /// The dead-man's handle.
    DeadMan {
        held: bool,
    },
    /// The auxiliary stop.
    AuxiliaryStop {
        pressed: bool,
    },
    /// What a range sensor sees; nothing without a distance.
    Distance {
        range: u8,
        distance_m: Option<f64>,
    },
    /// A rail's voltage without load.
    Supply {
        channel: ChannelId,
        emf_v: f64,
    },
    /// What a motor drives blocks, or turns again.
    Block {
        channel: ChannelId,
        blocked: bool,
    },
    /// The next transfers to an address on the board's bus are not acknowledged.
    BusNack {
        address: u8,
        transfers: u32,
    },
    /// The bus is held low from now on, for this long or until it is recovered.
    BusStuck {
        for_s: f64,
        persistent: bool,
    },
    /// The encoder's next edges are lost.
    LoseEdges {
        encoder: u8,
        count: u32,
    },
    /// The wire from the host is cut, or mended.
    HostCable {
        cut: bool,
    },
}
