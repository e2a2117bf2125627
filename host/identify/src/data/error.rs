//! Errors of reading data, with advice on what to do.

use std::{fmt, io, path::PathBuf};

use r4_log::LogError;

/// Names of a file's columns, for messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns(pub Vec<String>);

/// Largest number of names that a message lists.
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

/// Reason why data cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DataError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {why}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        why: io::Error,
    },
    /// No file was given.
    #[error("no file was given: name at least one recording, as CSV with a header or as a log of `r4`")]
    NoFile,
    /// The file has no content.
    #[error("{file} is empty: record again, or copy it again")]
    Empty {
        /// Name of the file.
        file: String,
    },
    /// The file is not a table.
    #[error(
        "{file} is neither a table nor a log of `r4`: give CSV, with a header that has units, as in `time_s,duty,theta_rad`"
    )]
    NotText {
        /// Name of the file.
        file: String,
    },
    /// The first line has numbers instead of names.
    #[error(
        "{file} has no header: its first line has numbers only; begin it with the columns' names and units, as in `time_s,duty,theta_rad`"
    )]
    NoHeader {
        /// Name of the file.
        file: String,
    },
    /// The file has a header and no rows.
    #[error("{file} has a header and no rows: the recording never began; record again")]
    HeaderOnly {
        /// Name of the file.
        file: String,
    },
    /// A log has no sample of the requested signal.
    #[error("{file} has no samples of {signal}: subscribe to the channel while recording, as `r4 log record` does")]
    NoSamples {
        /// Name of the file.
        file: String,
        /// Name of the signal.
        signal: String,
    },
    /// A row has too few or too many cells.
    #[error(
        "{file}, line {line}: {found} cells where the header has {expected} columns; mend the line, or take it out"
    )]
    RowLength {
        /// Name of the file.
        file: String,
        /// Number of the line, from 1.
        line: u64,
        /// Number of cells in the line.
        found: usize,
        /// Number of columns in the header.
        expected: usize,
    },
    /// A cell has text instead of a number.
    #[error(
        "{file}, line {line}, column {column}: `{text}` is not a number; leave the cell empty if nothing was measured, and write decimals with a point"
    )]
    Text {
        /// Name of the file.
        file: String,
        /// Number of the line, from 1.
        line: u64,
        /// Name of the column.
        column: String,
        /// Text in the cell, cut to a readable length.
        text: String,
    },
    /// The file has no column of this name.
    #[error("{file} has no column `{column}`{}; it has: {columns}", nearest.as_ref().map_or(String::new(), |name| format!(" (did you mean `{name}`?)")))]
    NoColumn {
        /// Name of the file.
        file: String,
        /// Name of the requested column.
        column: String,
        /// Most similar name in the file, if any is similar.
        nearest: Option<String>,
        /// Columns in the file.
        columns: Columns,
    },
    /// Several columns have this name.
    #[error("{file} has more than one column `{column}`: give each a name of its own{}", one_of.as_ref().map_or(String::new(), |names| format!(", or name one of: {names}")))]
    Ambiguous {
        /// Name of the file.
        file: String,
        /// Name that is not unique.
        column: String,
        /// Full names, if the short name of a log's signal was given.
        one_of: Option<Columns>,
    },
    /// No column looks like time.
    #[error(
        "{file} has no time column: name it with `--time COLUMN`, one of: {columns}; a recording without times shows no motion, record it again with them"
    )]
    NoTime {
        /// Name of the file.
        file: String,
        /// Columns in the file.
        columns: Columns,
    },
    /// Time decreases from one row to the next.
    #[error(
        "{file}, line {line}: time goes back from {before_s} s to {time_s} s; sort the rows by time, or name the columns that tell the runs apart with `--run COLUMN`"
    )]
    Backwards {
        /// Name of the file.
        file: String,
        /// Number of the line, from 1.
        line: u64,
        /// Time in the row before, s.
        before_s: f64,
        /// Time in this row, s.
        time_s: f64,
    },
    /// A column has no number at all.
    #[error("{file}: {column} has no number at all; was the sensor connected? Name another column, or record again")]
    AllMissing {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
    },
    /// Two columns were given for one role.
    #[error("two columns were given for `{role}`: name one")]
    RoleTwice {
        /// Name of the role.
        role: String,
    },
    /// One column was given for two roles.
    #[error(
        "column `{column}` was given for both `{first}` and `{second}`: a model cannot be compared with itself; name two columns"
    )]
    ColumnTwice {
        /// Name of the column.
        column: String,
        /// First of the two roles.
        first: String,
        /// Second of the two roles.
        second: String,
    },
    /// A log has no columns to be split by.
    #[error("{file} is a log, which is one run: leave `--run` out, and give several logs")]
    SplitLog {
        /// Name of the file.
        file: String,
    },
    /// The argument for held-out runs is not understood.
    #[error("`{text}` is no way to hold out runs: give files, or `every:2` for every second run (`every:N`, N from 2)")]
    Holdout {
        /// Argument as it was given.
        text: String,
    },
    /// There are too few runs to hold any out.
    #[error(
        "{found} run cannot be shared between fitting and testing as every:{every}: record it a second time and give that file to `--holdout`, or name the columns that tell its runs apart with `--run COLUMN`"
    )]
    OneRun {
        /// Number of runs found.
        found: usize,
        /// Number `N` in `every:N`.
        every: usize,
    },
    /// The file is no readable log.
    #[error("{file}: {why}")]
    Log {
        /// Name of the file.
        file: String,
        /// Error of the log's reader.
        why: LogError,
    },
    /// No column is mapped to a role that the model requires.
    #[error("nothing was given for `{role}` ({what}): name its column with `--map {role}=COLUMN`")]
    NoRole {
        /// Name of the role.
        role: String,
        /// Meaning of the role.
        what: String,
    },
    /// A column has no unit, or the wrong one.
    #[error("`{column}` cannot be `{role}`: {problem}; {cure}")]
    Unit {
        /// Name of the column.
        column: String,
        /// Name of the role.
        role: String,
        /// Problem with the unit.
        problem: String,
        /// Advice on how to correct it.
        cure: String,
    },
    /// A column has too few samples.
    #[error(
        "{samples} samples of `{column}` ({role}) are too few, {needed} are needed: record at least {needed}, of starts, stops and both directions, and more if what moves is slow"
    )]
    TooShort {
        /// Name of the role.
        role: String,
        /// Name of the column.
        column: String,
        /// Number of finite samples.
        samples: usize,
        /// Number of samples that the model requires.
        needed: usize,
    },
    /// The input is constant.
    #[error(
        "`{column}` ({role}) is {value} all the time, so its effect cannot be identified: record steps to several values in both directions, with rests between"
    )]
    ConstantInput {
        /// Name of the role.
        role: String,
        /// Name of the column.
        column: String,
        /// Constant value of the column, SI units.
        value: f64,
    },
    /// The output is constant.
    #[error(
        "`{column}` ({role}) is {value} all the time: either nothing moved (armed, and driven by more than friction holds?) or this is not its column; record again with a larger input"
    )]
    ConstantOutput {
        /// Name of the role.
        role: String,
        /// Name of the column.
        column: String,
        /// Constant value of the column, SI units.
        value: f64,
    },
}
