//! Why data cannot be used, and what to do about it.

use std::{fmt, io, path::PathBuf};

use r4_log::LogError;

/// The columns of a file, for messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns(pub Vec<String>);

/// How many names a message lists.
const LISTED: usize = 40;

impl fmt::Display for Columns {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = &self.0[..self.0.len().min(LISTED)];
        f.write_str(&shown.join(", "))?;
        match self.0.len() - shown.len() {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}

/// Why data cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {why}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the operating system says.
        why: io::Error,
    },
    /// No file was given.
    #[error("no file was given: name at least one recording, as CSV with a header or as a log of `r4`")]
    NoFile,
    /// There is nothing in the file.
    #[error("{file} is empty: record again, or copy it again")]
    Empty {
        /// Which.
        file: String,
    },
    /// Not a table.
    #[error(
        "{file} is neither a table nor a log of `r4`: give CSV, with a header that has units, as in `time_s,duty,theta_rad`"
    )]
    NotText {
        /// Which.
        file: String,
    },
    /// The first line has numbers.
    #[error(
        "{file} has no header: its first line has numbers only; begin it with the columns' names and units, as in `time_s,duty,theta_rad`"
    )]
    NoHeader {
        /// Which.
        file: String,
    },
    /// Nothing below the header.
    #[error("{file} has a header and no rows: the recording never began; record again")]
    HeaderOnly {
        /// Which.
        file: String,
    },
    /// A log has no sample of what was asked for.
    #[error("{file} has no samples of {signal}: subscribe to the channel while recording, as `r4 log record` does")]
    NoSamples {
        /// Which.
        file: String,
        /// Which signal.
        signal: String,
    },
    /// A row has too few or too many cells.
    #[error(
        "{file}, line {line}: {found} cells where the header has {expected} columns; mend the line, or take it out"
    )]
    RowLength {
        /// Which file.
        file: String,
        /// From 1.
        line: u64,
        /// Cells.
        found: usize,
        /// Columns.
        expected: usize,
    },
    /// A cell has text.
    #[error(
        "{file}, line {line}, column {column}: `{text}` is not a number; leave the cell empty if nothing was measured, and write decimals with a point"
    )]
    Text {
        /// Which file.
        file: String,
        /// From 1.
        line: u64,
        /// Which.
        column: String,
        /// What is there, cut to a readable length.
        text: String,
    },
    /// No such column.
    #[error("{file} has no column `{column}`{}; it has: {columns}", nearest.as_ref().map_or(String::new(), |name| format!(" (did you mean `{name}`?)")))]
    NoColumn {
        /// Which file.
        file: String,
        /// What was asked for.
        column: String,
        /// The most similar name.
        nearest: Option<String>,
        /// What there is.
        columns: Columns,
    },
    /// Two columns of this name.
    #[error("{file} has more than one column `{column}`: give each a name of its own{}", one_of.as_ref().map_or(String::new(), |names| format!(", or name one of: {names}")))]
    Ambiguous {
        /// Which file.
        file: String,
        /// The name.
        column: String,
        /// The full names, where the short one of a log's signal was given.
        one_of: Option<Columns>,
    },
    /// Nothing looks like time.
    #[error(
        "{file} has no time column: name it with `--time COLUMN`, one of: {columns}; a recording without times shows no motion, record it again with them"
    )]
    NoTime {
        /// Which file.
        file: String,
        /// What there is.
        columns: Columns,
    },
    /// Time runs backwards.
    #[error(
        "{file}, line {line}: time goes back from {before_s} s to {time_s} s; sort the rows by time, or name the columns that tell the runs apart with `--run COLUMN`"
    )]
    Backwards {
        /// Which file.
        file: String,
        /// From 1.
        line: u64,
        /// Of the row before.
        before_s: f64,
        /// Of this row.
        time_s: f64,
    },
    /// A column without any number.
    #[error("{file}: {column} has no number at all; was the sensor connected? Name another column, or record again")]
    AllMissing {
        /// Which file.
        file: String,
        /// Which.
        column: String,
    },
    /// A role was given twice.
    #[error("two columns were given for `{role}`: name one")]
    RoleTwice {
        /// Which.
        role: String,
    },
    /// A column was given for two roles.
    #[error(
        "column `{column}` was given for both `{first}` and `{second}`: a model cannot be compared with itself; name two columns"
    )]
    ColumnTwice {
        /// Which.
        column: String,
        /// One role.
        first: String,
        /// The other.
        second: String,
    },
    /// A log has no columns to be split by.
    #[error("{file} is a log, which is one run: leave `--run` out, and give several logs")]
    SplitLog {
        /// Which file.
        file: String,
    },
    /// The hold-out is not understood.
    #[error("`{text}` is no way to hold out runs: give files, or `every:2` for every second run (`every:N`, N from 2)")]
    Holdout {
        /// What was given.
        text: String,
    },
    /// There are too few runs to hold any out.
    #[error(
        "{found} run cannot be shared between fitting and testing as every:{every}: record it a second time and give that file to `--holdout`, or name the columns that tell its runs apart with `--run COLUMN`"
    )]
    OneRun {
        /// How many there are.
        found: usize,
        /// What was asked for.
        every: usize,
    },
    /// Not a recording.
    #[error("{file}: {why}")]
    Log {
        /// Which file.
        file: String,
        /// Why.
        why: LogError,
    },
    /// Nothing is mapped to a role the model needs.
    #[error("nothing was given for `{role}` ({what}): name its column with `--map {role}=COLUMN`")]
    NoRole {
        /// Which.
        role: String,
        /// What it is.
        what: String,
    },
    /// A column has no unit, or the wrong one.
    #[error("`{column}` cannot be `{role}`: {problem}; {cure}")]
    Unit {
        /// Which column.
        column: String,
        /// What for.
        role: String,
        /// What its name says of it.
        problem: String,
        /// How to mend it.
        cure: String,
    },
    /// Too little data.
    #[error(
        "{samples} samples of `{column}` ({role}) are too few, {needed} are needed: record at least {needed}, of starts, stops and both directions, and more if what moves is slow"
    )]
    TooShort {
        /// What for.
        role: String,
        /// Which column.
        column: String,
        /// How many there are.
        samples: usize,
        /// How many it takes.
        needed: usize,
    },
    /// The input is the same all the time.
    #[error(
        "`{column}` ({role}) is {value} all the time, so its effect cannot be identified: record steps to several values in both directions, with rests between"
    )]
    ConstantInput {
        /// What for.
        role: String,
        /// Which column.
        column: String,
        /// Its only value.
        value: f64,
    },
    /// The output is the same all the time.
    #[error(
        "`{column}` ({role}) is {value} all the time: either nothing moved (armed, and driven by more than friction holds?) or this is not its column; record again with a larger input"
    )]
    ConstantOutput {
        /// What for.
        role: String,
        /// Which column.
        column: String,
        /// Its only value.
        value: f64,
    },
}
