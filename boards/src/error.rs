//! Errors of a robot or carrier file, with their place in it.

use std::{fmt, io};

use r4_protocol::channel::ChannelId;

/// Place in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// Name of the file, as the caller or another file gave it.
    pub file: String,
    /// Number of the line, from 1.
    pub line: usize,
    /// Path of the field, as in `osmc[0].encoder.input`; empty for the file itself.
    pub field: String,
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file, self.line)?;
        if self.field.is_empty() { Ok(()) } else { write!(f, ": {}", self.field) }
    }
}

/// Reason why a robot or a carrier was not loaded. The text names file, line and field, and what is expected.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// No built-in file has that name.
    #[error("there is no {what} `{name}`: write {}, or the path of a .toml file", known.join(", "))]
    UnknownName {
        /// Kind of file: robot or carrier.
        what: &'static str,
        /// Name that was asked for.
        name: String,
        /// Names of the built-in files.
        known: Vec<&'static str>,
    },
    /// The file that the caller names cannot be read.
    #[error("{path}: cannot be read")]
    NotReadable {
        /// Path as the caller gave it.
        path: String,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A file that this file names cannot be read, and is not built in either.
    #[error("{at}: `{path}` cannot be read")]
    MissingFile {
        /// Place at which the file is named.
        at: Location,
        /// Path at which it is looked for.
        path: String,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The text is not TOML, a field is unknown, missing or of the wrong type, or a number is out of its range.
    #[error("{at}: {problem}")]
    Malformed {
        /// Place of the problem.
        at: Location,
        /// Description of the problem, and of what is expected.
        problem: String,
    },
    /// A reference names something that does not exist.
    #[error("{at}: there is no {what} `{asked}`, write {known}")]
    NoSuch {
        /// Place of the reference.
        at: Location,
        /// Kind of thing that it refers to.
        what: &'static str,
        /// Name in the reference.
        asked: String,
        /// Names that exist, as a list.
        known: String,
    },
    /// Something that can be used only once is used again.
    #[error("{at}: {what} `{name}` is already used in line {first_line}, each can be used once")]
    UsedTwice {
        /// Place of the second use.
        at: Location,
        /// Kind of thing that is used.
        what: &'static str,
        /// Name of the thing.
        name: String,
        /// Line of the first use, from 1.
        first_line: usize,
    },
    /// A sensor of the robot names a field that its world does not have.
    #[error(transparent)]
    NoField(crate::NoSuchField),
    /// A rule between fields, or one of the firmware ([`r4_protocol::config::BoardConfig::validate`]), does not hold.
    #[error("{at}: {}{rule}", channel.map(|id| format!("{id}: ")).unwrap_or_default())]
    Rule {
        /// Place of the rule; the channel's table if the rule is about several of its fields.
        at: Location,
        /// Channel of the rule, if any.
        channel: Option<ChannelId>,
        /// Rule that does not hold.
        rule: &'static str,
    },
}
