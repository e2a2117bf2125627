//! Standard output: results only.

use std::{
    fmt::Display,
    io::{self, Write},
};

use serde::Serialize;

/// Error of writing to standard output.
#[derive(Debug, thiserror::Error)]
#[error("cannot write the output")]
pub(crate) struct OutputError(#[from] io::Error);

impl OutputError {
    /// True if the reader closed the pipe, as `head` does.
    pub(crate) fn is_closed_pipe(&self) -> bool {
        self.0.kind() == io::ErrorKind::BrokenPipe
    }
}

/// Prints one line to standard output.
pub(crate) fn line(text: impl Display) -> Result<(), OutputError> {
    Ok(writeln!(io::stdout().lock(), "{text}")?)
}

/// Prints a complete text with its own line ends.
pub(crate) fn bytes(text: &[u8]) -> Result<(), OutputError> {
    Ok(io::stdout().lock().write_all(text)?)
}

/// Prints `value` as the one JSON object of a command.
pub(crate) fn json(value: &impl Serialize) -> anyhow::Result<()> {
    Ok(line(serde_json::to_string(value)?)?)
}
