//! What goes to stdout: results, and nothing else.

use std::{
    fmt::Display,
    io::{self, Write},
};

use serde::Serialize;

/// Standard output cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the output")]
pub(crate) struct OutputError(#[from] io::Error);

impl OutputError {
    /// Whether the reader has simply seen enough, as `head` does.
    pub(crate) fn is_closed_pipe(&self) -> bool {
        self.0.kind() == io::ErrorKind::BrokenPipe
    }
}

/// Prints one line.
pub(crate) fn line(text: impl Display) -> Result<(), OutputError> {
    Ok(writeln!(io::stdout().lock(), "{text}")?)
}

/// Prints what is a text of its own, with its ends of lines.
pub(crate) fn bytes(text: &[u8]) -> Result<(), OutputError> {
    Ok(io::stdout().lock().write_all(text)?)
}

/// Prints `value` as the one JSON object of a command.
pub(crate) fn json(value: &impl Serialize) -> anyhow::Result<()> {
    Ok(line(serde_json::to_string(value)?)?)
}
