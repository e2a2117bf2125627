//! How things are.

use serde::{Deserialize, Serialize};

use super::Header;

/// `diagnostic_msgs/msg/DiagnosticArray`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticArray {
    /// When.
    pub header: Header,
    /// One for each part.
    pub status: Vec<DiagnosticStatus>,
}

/// `diagnostic_msgs/msg/DiagnosticStatus`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticStatus {
    /// A [`Level`].
    pub level: u8,
    /// Of the part.
    pub name: String,
    /// How it is, and what to do about it.
    pub message: String,
    /// The board.
    pub hardware_id: String,
    /// Details.
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/msg/KeyValue`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyValue {
    /// Of what.
    pub key: String,
    /// As text.
    pub value: String,
}

/// How bad it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Level {
    /// As it should be.
    Ok = 0,
    /// Someone should look at it.
    Warn = 1,
    /// It does not work.
    Error = 2,
}
