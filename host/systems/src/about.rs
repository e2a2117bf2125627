//! What a system is about.

use serde::{Deserialize, Serialize};

use crate::Statistic;

/// A system's paper, arms and metrics.
#[derive(Debug)]
pub struct About {
    /// Short name, as in `r4 system run NAME`.
    pub name: &'static str,
    /// The paper.
    pub paper: Paper,
    /// What it asks, in one sentence.
    pub question: &'static str,
    /// Robot whose board it runs on unless another is named: a built-in name.
    pub robot: &'static str,
    /// What a seed decides: each quantity with its range and unit.
    pub sampled: &'static [&'static str],
    /// Ways to answer the question.
    pub arms: &'static [Arm],
    /// What is measured of the answers.
    pub metrics: &'static [Metric],
}

/// A published paper.
#[derive(Debug)]
pub struct Paper {
    /// Its title.
    pub title: &'static str,
    /// Where and when it was published.
    pub published: &'static str,
}

/// One way to answer a system's question.
#[derive(Debug)]
pub struct Arm {
    /// `paper`, `ours`, or a name behind `baseline:`, `ablation:` or `blind:`.
    pub name: &'static str,
    /// What it does, in one sentence.
    pub does: &'static str,
    /// It drives the body by perfect actuators, without a board.
    pub is_kinematic: bool,
}

/// A number that is measured of each trial.
#[derive(Debug)]
pub struct Metric {
    /// Name with its unit as a suffix, as in `c_long_error` or `excursion_m`.
    pub name: &'static str,
    /// Unit; `1` for a share.
    pub unit: &'static str,
    /// How the trials' values make a row's.
    pub statistic: Statistic,
    /// Where its values come from.
    pub source: Source,
    /// What it must reach.
    pub targets: &'static [Target],
}

/// What a metric of an arm must reach.
#[derive(Debug)]
pub struct Target {
    /// The arm.
    pub arm: &'static str,
    /// The limit.
    pub limit: Limit,
    /// Where the limit comes from: printed in the paper, or set by this project.
    pub from: &'static str,
}

/// A limit on a value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    /// Held by values up to it.
    AtMost(f64),
    /// Held by values from it on.
    AtLeast(f64),
}

/// Where the numbers of a metric come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// A simulation.
    Simulated,
    /// A model that was fitted to measurements.
    Fitted,
    /// Measurements on a real machine.
    Measured,
    /// The paper.
    Printed,
}

impl About {
    /// The arm with this name.
    #[must_use]
    pub fn arm(&self, name: &str) -> Option<&'static Arm> {
        self.arms.iter().find(|arm| arm.name == name)
    }
}

impl Metric {
    /// What it must reach in an arm, if anything.
    #[must_use]
    pub fn target(&self, arm: &str) -> Option<&'static Target> {
        self.targets.iter().find(|target| target.arm == arm)
    }
}

impl Limit {
    /// Whether a value holds it. A value that is no number holds none.
    #[must_use]
    pub fn is_held_by(self, value: f64) -> bool {
        match self {
            Self::AtMost(limit) => value <= limit,
            Self::AtLeast(limit) => value >= limit,
        }
    }
}
