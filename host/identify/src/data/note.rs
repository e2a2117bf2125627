//! What reading a file set aside, repaired, or took to be so.

/// Something a reader of the results should know about the data.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Note {
    /// The steps of time differ.
    #[error("{file}: irregular sampling, every {:.3} ms, one step in twenty more than {:.3} ms off", median_s * 1e3, jitter_s * 1e3)]
    Irregular {
        /// Which file.
        file: String,
        /// Median step.
        median_s: f64,
        /// 95 % of the steps are within this of it.
        jitter_s: f64,
    },
    /// Time goes on, rows do not.
    #[error(
        "{file}: {gaps} gaps, about {samples} samples missing, the longest {longest_s:.3} s; nothing was put there"
    )]
    Gaps {
        /// Which file.
        file: String,
        /// How many.
        gaps: usize,
        /// Samples that would fill them.
        samples: usize,
        /// The longest step.
        longest_s: f64,
    },
    /// Values repeat while what is measured moves: the source is slower than the file.
    #[error("{file}: {column} repeats its last value in {:.0} % of the samples, its own rate is about {rate_hz:.3} Hz", share * 100.0)]
    Held {
        /// Which file.
        file: String,
        /// Which column.
        column: String,
        /// Share of samples that repeat, while it moves.
        share: f64,
        /// Of the source.
        rate_hz: f64,
    },
    /// Several rows have the same time: the first is used.
    #[error("{file}: {rows} rows repeat the time of the row before and were left out")]
    Repeated {
        /// Which file.
        file: String,
        /// How many.
        rows: usize,
    },
    /// Time began anew: another run.
    #[error("{file}: time starts again {times} times; each start is a run of its own")]
    Restarts {
        /// Which file.
        file: String,
        /// How often.
        times: usize,
    },
    /// Rows without a time.
    #[error("{file}: {rows} rows have no time and were left out")]
    NoStamp {
        /// Which file.
        file: String,
        /// How many.
        rows: usize,
    },
    /// Cells of a measured column that are empty, or no finite number.
    #[error("{file}: {column} has no number in {cells} of {of} rows; they are not compared")]
    Missing {
        /// Which file.
        file: String,
        /// Which column.
        column: String,
        /// How many.
        cells: usize,
        /// Rows.
        of: usize,
    },
    /// Such cells of a column that drives the model.
    #[error(
        "{file}: {column} has no number in {cells} of {of} rows; the value before holds there, and rows before its first are left out"
    )]
    Bridged {
        /// Which file.
        file: String,
        /// Which column.
        column: String,
        /// How many.
        cells: usize,
        /// Rows.
        of: usize,
    },
    /// Lone values far from both neighbours.
    #[error(
        "{file}: {samples} lone values of {column} far from both neighbours were set aside, the first at {first_s:.3} s"
    )]
    Outliers {
        /// Which file.
        file: String,
        /// Which column.
        column: String,
        /// How many.
        samples: usize,
        /// Time of the first in its run.
        first_s: f64,
    },
    /// An angle that jumped by a turn.
    #[error("{file}: {column} jumps by a turn {times} times; the turns were added up")]
    Unwrapped {
        /// Which file.
        file: String,
        /// Which column.
        column: String,
        /// How often.
        times: usize,
    },
    /// A column that drives the model does not change.
    #[error("{file}: {column} is {value} throughout {runs} of {of} runs; these tell nothing of what it does")]
    Constant {
        /// Which file.
        file: String,
        /// Which column.
        column: String,
        /// Its value in the first of them.
        value: f64,
        /// How many.
        runs: usize,
        /// Runs of the file.
        of: usize,
    },
    /// The name of the time column has no unit.
    #[error("{file}: {column} has no unit in its name and is taken as seconds: a step is {step_s} s")]
    TimeUnit {
        /// Which file.
        file: String,
        /// Which column.
        column: String,
        /// Median step.
        step_s: f64,
    },
    /// No time column, and none is needed.
    #[error("{file}: no time column; rows are numbered from 0")]
    Numbered {
        /// Which file.
        file: String,
    },
    /// The last line ends in the middle.
    #[error("{file}: the last line ends early and was left out")]
    CutLine {
        /// Which file.
        file: String,
    },
    /// A signal of a recording with moments of its own.
    #[error("{file}: {column} has moments of its own; at each sample of {base} its latest value is used")]
    Aligned {
        /// Which file.
        file: String,
        /// Which signal.
        column: String,
        /// The one whose moments are used.
        base: String,
    },
    /// Something in a recording could not be read.
    #[error("{file}: {warning}")]
    Log {
        /// Which file.
        file: String,
        /// What.
        warning: r4_log::Warning,
    },
}
