//! Recorded runs, read from files without interpolation or guessing.
//!
//! [`read`] takes CSV tables with a header, and the MCAP logs of `r4`, and makes [`Run`]s of them in SI units.
//! [`Recorded::notes`] says what was set aside, repaired or assumed. [`Recorded::alternate`] holds runs out;
//! [`check()`] finds what a model would miss.
//!
//! | module | subject |
//! | --- | --- |
//! | [`mod@unit`] | units, from the names of columns |
//! | `table`, `log` | one file as columns of numbers |
//! | `runs` | rows into runs: split columns, clocks that restart, rows out of order |
//! | `clean` | faults of the samples of a run, and their repair |
//! | [`mod@check`] | sufficiency of the data for a model |
//! | [`redundant`] | two sensors of one quantity: sign, scale, offset, lag |
//! | [`fault`] | faults that a series shows without a model: saturation, missing rows, wrong order |
//!
//! ```
//! use r4_identify::data::{Mapping, Options, read_bytes};
//!
//! let file = b"time_ms,duty,theta_deg\n0,0.5,0\n10,0.5,1.8\n20,0.5,\n30,0,5.4\n";
//! let roles = vec![Mapping::driving("input", "duty"), Mapping::measured("output", "theta_deg")];
//! let recorded = read_bytes("run.csv", file, &Options { roles, ..Options::default() })?;
//! let run = &recorded.runs[0];
//! assert_eq!(run.time_s, [0.0, 0.01, 0.02, 0.03]);
//! assert!(run.values("output").is_some_and(|angle| (angle[1] - 0.0314).abs() < 1e-4 && angle[2].is_nan()));
//! assert_eq!(recorded.notes[0].to_string(), "run.csv: theta_deg has no number in 1 of 4 rows; they are not compared");
//! # Ok::<(), r4_identify::data::DataError>(())
//! ```

use std::collections::BTreeMap;

pub mod check;
mod clean;
mod error;
pub mod fault;
#[cfg(test)]
mod generated;
mod log;
mod note;
mod read;
pub mod redundant;
mod runs;
mod table;
#[cfg(test)]
mod tests;
pub mod unit;

pub use check::{Need, check};
pub use error::{Columns, DataError};
pub use note::Note;
pub use read::{Holdout, Mapping, Options, Recorded, read, read_bytes};

/// Quantity that a column measures, as far as its unit shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Angle; its SI unit is rad.
    Angle,
    /// Angular speed; its SI unit is rad/s.
    AngularSpeed,
    /// Length; its SI unit is m.
    Length,
    /// Speed; its SI unit is m/s.
    Speed,
    /// Voltage; its SI unit is V.
    Voltage,
    /// Force; its SI unit is N.
    Force,
    /// Torque; its SI unit is N m.
    Torque,
    /// Current; its SI unit is A.
    Current,
    /// Temperature, which stays in °C.
    Temperature,
    /// Dimensionless number: a ratio, a count, a flag, or a column whose name has no unit.
    Number,
}

impl Quantity {
    /// Returns the SI unit; `1` for a dimensionless number.
    #[must_use]
    pub const fn si(self) -> &'static str {
        match self {
            Self::Angle => "rad",
            Self::AngularSpeed => "rad/s",
            Self::Length => "m",
            Self::Speed => "m/s",
            Self::Voltage => "V",
            Self::Force => "N",
            Self::Torque => "N m",
            Self::Current => "A",
            Self::Temperature => "°C",
            Self::Number => "1",
        }
    }
}

/// One column of a run in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// Name of the column in the file.
    pub column: String,
    /// Quantity that the column measures.
    pub quantity: Quantity,
    /// Values, one per sample; NaN where the file has none or an outlier was set aside.
    pub values: Vec<f64>,
}

/// One run: samples in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// Name of the file, and the values of the columns that split it into runs.
    pub name: String,
    /// Times in s, strictly increasing, the first is 0.
    pub time_s: Vec<f64>,
    /// Reading of the board's clock at the first sample, s since its power-up; `None` if the recording is not a
    /// board's log. The input of a log is sampled like its output, and linear interpolation between its samples is
    /// the best approximation. In other recordings the input is the command, which holds from its sample on
    /// (zero-order hold).
    pub origin_s: Option<f64>,
    /// Signals by role, such as `input`.
    pub signals: BTreeMap<String, Signal>,
}

impl Run {
    /// Returns the values of a role; `None` if no column was mapped to it.
    #[must_use]
    pub fn values(&self, role: &str) -> Option<&[f64]> {
        self.signals.get(role).map(|signal| &signal.values[..])
    }
}
