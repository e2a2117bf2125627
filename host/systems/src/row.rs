//! A result of a study, as it is printed and written.

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
    /// Its unit.
    pub unit: String,
    /// Trials with a value.
    pub n: usize,
    /// Trials that could not be run; a row with any of them is not met.
    pub failed: usize,
    /// The statistic of all trials.
    pub value: f64,
    /// Lower end of the 95 % interval.
    pub lo: f64,
    /// Upper end of the 95 % interval.
    pub hi: f64,
    /// Statistic, and method of the interval.
    pub method: String,
    /// Two-sided p-value of "no difference from the paper's arm", over the same seeds; absent for that arm, and without it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub paired_p: Option<f64>,
    /// Where the values come from.
    pub source: Source,
    /// Kind of the board: sim, emu, kinematic or link.
    pub board: String,
    /// First and last seed.
    pub seeds: [u64; 2],
    /// What the value must reach, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<Limit>,
    /// Whether it does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub met: Option<bool>,
}

impl Row {
    /// A row of a system's own arm about this machine's speed, over `n` values, which no seed repeats.
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
