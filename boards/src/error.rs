//! What can be wrong with a file, and where.

use std::{fmt, io};

use r4_protocol::channel::ChannelId;

/// A place in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Location {
    /// The file, as it was named.
    pub file: String,
    /// The line, from 1.
    pub line: usize,
    /// The field's path, as in `osmc[0].encoder.input`; empty for the file itself.
    pub field: String,
}

impl fmt::Display for Location {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file, self.line)?;
        if self.field.is_empty() { Ok(()) } else { write!(f, ": {}", self.field) }
    }
}

/// Why a robot or a carrier was not loaded. The text names file, line and field, and what is asked for.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BoardError {
    /// No built-in file has that name.
    #[error("there is no {what} `{name}`: write {}, or the path of a .toml file", known.join(", "))]
    UnknownName {
        /// Robot or carrier.
        what: &'static str,
        /// The name asked for.
        name: String,
        /// The names there are.
        known: Vec<&'static str>,
    },
    /// The file named by the caller cannot be read.
    #[error("{path}: cannot be read")]
    NotReadable {
        /// The path, as it was given.
        path: String,
        /// What the system says.
        source: io::Error,
    },
    /// A file that this file names cannot be read, and is not built in either.
    #[error("{at}: `{path}` cannot be read")]
    MissingFile {
        /// Where it is named.
        at: Location,
        /// The path, as it is looked for.
        path: String,
        /// What the system says.
        source: io::Error,
    },
    /// Not TOML, a field that is unknown, missing or of the wrong type, or a number out of its range.
    #[error("{at}: {problem}")]
    Malformed {
        /// Where.
        at: Location,
        /// What is wrong, and what is expected.
        problem: String,
    },
    /// A reference to something that is not there.
    #[error("{at}: there is no {what} `{asked}`, write {known}")]
    NoSuch {
        /// Where.
        at: Location,
        /// The kind of thing.
        what: &'static str,
        /// The one asked for.
        asked: String,
        /// The ones there are.
        known: String,
    },
    /// Something that can be used once is used again.
    #[error("{at}: {what} `{name}` is already used in line {first_line}, each can be used once")]
    UsedTwice {
        /// The second use.
        at: Location,
        /// The kind of thing.
        what: &'static str,
        /// Which one.
        name: String,
        /// The first use.
        first_line: usize,
    },
    /// A sensor of the robot names a field that its world does not have.
    #[error(transparent)]
    NoField(crate::NoSuchField),
    /// A rule between fields, or of the firmware ([`r4_protocol::config::BoardConfig::validate`]), does not hold.
    #[error("{at}: {}{rule}", channel.map(|id| format!("{id}: ")).unwrap_or_default())]
    Rule {
        /// Where; the channel's table if the rule is about several of its fields.
        at: Location,
        /// The channel it is about, if any.
        channel: Option<ChannelId>,
        /// What must hold.
        rule: &'static str,
    },
}
