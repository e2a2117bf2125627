//! Description of a system: its paper, its arms and the metrics that compare them.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::Statistic;

/// Seeds of reported results of most systems: constants are set on lower ones.
pub const REPORTED: Range<u64> = 1001..1101;

/// A system's paper, arms and metrics.
#[derive(Debug)]
pub struct About {
    /// Short name, as in `r4 system run NAME`.
    pub name: &'static str,
    /// Paper that the system reproduces.
    pub paper: Paper,
    /// Question of the paper, in one sentence.
    pub question: &'static str,
    /// Built-in name of the robot whose board the system runs on unless the caller names another.
    pub robot: &'static str,
    /// Quantities that a seed decides, each with its range and unit.
    pub sampled: &'static [&'static str],
    /// Seeds of `r4 bench systems`, on which no constant was set; few where a trial takes tens of seconds.
    pub reported: Range<u64>,
    /// Methods that answer the question, compared with each other.
    pub arms: &'static [Arm],
    /// Quantities measured in each trial.
    pub metrics: &'static [Metric],
}

/// A published paper, as cited in reports.
#[derive(Debug)]
pub struct Paper {
    /// Title of the paper.
    pub title: &'static str,
    /// Venue and year of publication.
    pub published: &'static str,
}

/// One way to answer a system's question.
#[derive(Debug)]
pub struct Arm {
    /// `paper`, `ours`, or a name behind `baseline:`, `ablation:` or `blind:`.
    pub name: &'static str,
    /// Method of the arm, in one sentence.
    pub does: &'static str,
    /// True when perfect actuators move the body, without a board.
    pub is_kinematic: bool,
}

/// A number measured in each trial.
#[derive(Debug)]
pub struct Metric {
    /// Name with its unit as a suffix, as in `c_long_error` or `excursion_m`.
    pub name: &'static str,
    /// Unit; `1` for a share.
    pub unit: &'static str,
    /// Statistic that makes one row of the values of all trials.
    pub statistic: Statistic,
    /// Origin of the values.
    pub source: Source,
    /// Limits on the row's value, by arm; empty for a metric that is only reported.
    pub targets: &'static [Target],
}

/// Limit that a metric must keep in one arm.
#[derive(Debug)]
pub struct Target {
    /// Name of the arm that the limit applies to.
    pub arm: &'static str,
    /// Limit on the row's value, in the metric's unit.
    pub limit: Limit,
    /// Origin of the limit: printed in the paper, or set by this project.
    pub from: &'static str,
}

/// A limit on a value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// Upper limit of the value, inclusive.
    AtMost(f64),
    /// Lower limit of the value, inclusive.
    AtLeast(f64),
}

/// Origin of a metric's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// Values measured in a simulation.
    Simulated,
    /// A model that was fitted to measurements.
    Fitted,
    /// Measurements on a real machine.
    Measured,
    /// Values printed in the paper.
    Printed,
}

impl About {
    /// Returns the arm with this name, if the system has it.
    #[must_use]
    pub fn arm(&self, name: &str) -> Option<&'static Arm> {
        self.arms.iter().find(|arm| arm.name == name)
    }
}

impl Metric {
    /// Returns the target of the metric in an arm; `None` where it has none.
    #[must_use]
    pub fn target(&self, arm: &str) -> Option<&'static Target> {
        self.targets.iter().find(|target| target.arm == arm)
    }
}

impl Limit {
    /// Returns true when the value keeps the limit; NaN keeps none.
    #[must_use]
    pub fn is_held_by(self, value: f64) -> bool {
        match self {
            Self::AtMost(limit) => value <= limit,
            Self::AtLeast(limit) => value >= limit,
        }
    }
}
