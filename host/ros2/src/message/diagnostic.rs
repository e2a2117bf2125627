//! Messages of the topic `/diagnostics`.

use serde::{Deserialize, Serialize};

use super::Header;

/// Message `diagnostic_msgs/msg/DiagnosticArray`: state of all parts of a board.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// Time of the diagnosis; no frame.
    pub header: Header,
    /// One status for each part of the board.
    pub status: Vec<DiagnosticStatus>,
}

/// Message `diagnostic_msgs/msg/DiagnosticStatus`: state of one part.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// Severity, one of [`Level`].
    pub level: u8,
    /// Name of the robot and of its part, as in `openscout: motors`.
    pub name: String,
    /// State of the part, with advice where it is not as it should be.
    pub message: String,
    /// Name by which the board was opened.
    pub hardware_id: String,
    /// Details as keys and values.
    pub values: Vec<KeyValue>,
}

/// Message `diagnostic_msgs/msg/KeyValue`: one detail of a status.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Name of the detail.
    pub key: String,
    /// Value of the detail, as text.
    pub value: String,
}

/// Severity of a status, as `diagnostic_msgs/msg/DiagnosticStatus` numbers it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// The part works as it should.
    Ok = 0,
    /// The part works, but needs attention.
    Warn = 1,
    /// The part does not work.
    Error = 2,
}
