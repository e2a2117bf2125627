//! Notes on what the reader of a file set aside, repaired or assumed.

/// Note on the data that a user of the results should know.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Note {
    /// The sampling periods differ.
    #[error("{file}: irregular sampling, every {:.3} ms, one step in twenty more than {:.3} ms off", median_s * 1e3, jitter_s * 1e3)]
    Irregular {
        /// Name of the file.
        file: String,
        /// Median sampling period, s.
        median_s: f64,
        /// 95 % quantile of the deviation from the median period, s.
        jitter_s: f64,
    },
    /// Rows are missing while time goes on.
    #[error(
        "{file}: {gaps} gaps, about {samples} samples missing, the longest {longest_s:.3} s; nothing was put there"
    )]
    Gaps {
        /// Name of the file.
        file: String,
        /// Number of gaps in time.
        gaps: usize,
        /// Number of samples that would fill them.
        samples: usize,
        /// Longest time between two rows, s.
        longest_s: f64,
    },
    /// Values repeat while the quantity moves: a sample-and-hold whose source is slower than the file.
    #[error("{file}: {column} repeats its last value in {:.0} % of the samples, its own rate is about {rate_hz:.3} Hz", share * 100.0)]
    Held {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
        /// Share of samples that repeat while the quantity moves.
        share: f64,
        /// Sampling rate of the source, Hz.
        rate_hz: f64,
    },
    /// Several rows have the same time; the first is used.
    #[error("{file}: {rows} rows repeat the time of the row before and were left out")]
    Repeated {
        /// Name of the file.
        file: String,
        /// Number of repeated rows.
        rows: usize,
    },
    /// Time starts again, which begins another run.
    #[error("{file}: time starts again {times} times; each start is a run of its own")]
    Restarts {
        /// Name of the file.
        file: String,
        /// Number of restarts of the clock.
        times: usize,
    },
    /// Rows have no time.
    #[error("{file}: {rows} rows have no time and were left out")]
    NoStamp {
        /// Name of the file.
        file: String,
        /// Number of such rows.
        rows: usize,
    },
    /// Cells of a measured column are empty or not finite.
    #[error("{file}: {column} has no number in {cells} of {of} rows; they are not compared")]
    Missing {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
        /// Number of such cells.
        cells: usize,
        /// Number of rows in the file.
        of: usize,
    },
    /// Cells of an input are empty or not finite; the value before holds.
    #[error(
        "{file}: {column} has no number in {cells} of {of} rows; the value before holds there, and rows before its first are left out"
    )]
    Bridged {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
        /// Number of such cells.
        cells: usize,
        /// Number of rows in the file.
        of: usize,
    },
    /// Lone values lie far from both neighbours.
    #[error(
        "{file}: {samples} lone values of {column} far from both neighbours were set aside, the first at {first_s:.3} s"
    )]
    Outliers {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
        /// Number of such values.
        samples: usize,
        /// Time of the first of them in its run, s.
        first_s: f64,
    },
    /// An angle jumped by a turn and was unwrapped.
    #[error("{file}: {column} jumps by a turn {times} times; the turns were added up")]
    Unwrapped {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
        /// Number of jumps by a turn.
        times: usize,
    },
    /// An input does not change within some runs.
    #[error("{file}: {column} is {value} throughout {runs} of {of} runs; these tell nothing of what it does")]
    Constant {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
        /// Value in the first of these runs.
        value: f64,
        /// Number of these runs.
        runs: usize,
        /// Number of runs in the file.
        of: usize,
    },
    /// The name of the time column has no unit.
    #[error("{file}: {column} has no unit in its name and is taken as seconds: a step is {step_s} s")]
    TimeUnit {
        /// Name of the file.
        file: String,
        /// Name of the column.
        column: String,
        /// Median step, s, if the unit is the second.
        step_s: f64,
    },
    /// The file has no time column, and the model needs none.
    #[error("{file}: no time column; rows are numbered from 0")]
    Numbered {
        /// Name of the file.
        file: String,
    },
    /// The last line ends in the middle.
    #[error("{file}: the last line ends early and was left out")]
    CutLine {
        /// Name of the file.
        file: String,
    },
    /// A signal of a log has other sampling times than the output.
    #[error("{file}: {column} has moments of its own; at each sample of {base} its latest value is used")]
    Aligned {
        /// Name of the file.
        file: String,
        /// Name of the signal.
        column: String,
        /// Name of the signal whose sampling times are used.
        base: String,
    },
    /// Part of a log could not be read.
    #[error("{file}: {warning}")]
    Log {
        /// Name of the file.
        file: String,
        /// Warning of the log's reader.
        warning: r4_log::Warning,
    },
}
