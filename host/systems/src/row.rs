//! One result of a study, as it is printed and written.

use serde::{Deserialize, Serialize};

use crate::{Limit, Source, Summary};

/// One metric of one arm over all seeds of a study.
///
/// Field names are a contract: more may be added.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the system.
    pub system: String,
    /// Name of the arm.
    pub arm: String,
    /// Name of the metric.
    pub metric: String,
    /// Unit of `value`, `lo` and `hi`.
    pub unit: String,
    /// Trials with a value.
    pub n: usize,
    /// Trials that could not be run; a row with any of them is not met.
    pub failed: usize,
    /// Statistic over all trials that have a value.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub lo: f64,
    /// Upper end of the 95 % interval.
    pub hi: f64,
    /// Name of the statistic and of the interval's method.
    pub method: String,
    /// Two-sided p-value of "no difference from the paper's arm" over the same seeds; absent for the paper's arm
    /// itself, and for studies without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paired_p: Option<f64>,
    /// Origin of the values.
    pub source: Source,
    /// Kind of the board: sim, emu, kinematic or link.
    pub board: String,
    /// First and last seed.
    pub seeds: [u64; 2],
    /// Limit that the value must keep; absent for a metric without a target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<Limit>,
    /// True when the value keeps the target and no trial failed; absent without a target.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub met: Option<bool>,
}

impl Row {
    /// Makes a row about the speed of this computer from `n` measured values, which no seed repeats.
    pub(crate) fn timed(
        [system, arm]: [&str; 2],
        [metric, unit]: [&str; 2],
        n: usize,
        seeds: [u64; 2],
        summary: Summary,
        target: Limit,
    ) -> Self {
        Self {
            system: system.to_owned(),
            arm: arm.to_owned(),
            metric: metric.to_owned(),
            unit: unit.to_owned(),
            n,
            failed: 0,
            value: summary.value,
            lo: summary.interval.low,
            hi: summary.interval.high,
            method: summary.method.to_owned(),
            paired_p: None,
            source: Source::Measured,
            board: "kinematic".to_owned(),
            seeds,
            target: Some(target),
            met: Some(target.is_held_by(summary.value)),
        }
    }
}
