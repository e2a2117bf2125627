//! Recorded runs, read from files without inventing anything.

use std::collections::BTreeMap;

/// What a column measures, as far as its unit tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// rad.
    Angle,
    /// rad/s.
    AngularSpeed,
    /// m.
    Length,
    /// m/s.
    Speed,
    /// V.
    Voltage,
    /// N.
    Force,
    /// N m.
    Torque,
    /// A.
    Current,
    /// °C.
    Temperature,
    /// A share, a count, a flag, or a column whose name has no unit.
    Number,
}

/// One column of a run in SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// As the file calls it.
    pub column: String,
    /// What it measures.
    pub quantity: Quantity,
    /// One per sample; NaN where the file has none or an outlier was set aside.
    pub values: Vec<f64>,
}

/// One run: samples in the order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// File, and the values of the columns that split it into runs.
    pub name: String,
    /// Seconds, strictly increasing, the first is 0.
    pub time_s: Vec<f64>,
    /// By role, such as `input`.
    pub signals: BTreeMap<String, Signal>,
}

impl Run {
    /// The values of a role; `None` if nothing was mapped to it.
    #[must_use]
    pub fn values(&self, role: &str) -> Option<&[f64]> {
        self.signals.get(role).map(|signal| &signal.values[..])
    }
}
