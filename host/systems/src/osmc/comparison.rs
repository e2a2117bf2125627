//! Comparison of the paper as printed, its plain controller and our loops over the blind plants, as `r4 evaluate osmc`
//! prints it.

use serde::Serialize;

use super::{
    BLIND, OURS, PAPER,
    bench::{self, Bench},
};
use crate::{Limit, Metric, Record};

/// One line of the comparison.
///
/// Field names are a contract: more may be added.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the motor, with the set point where the metric has one.
    pub case: String,
    /// Name of the metric; definitions: [`super::response`].
    pub metric: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Value as printed for the gains 10, 4, 3, or in Tables 1 and 2; absent where nothing is printed.
    pub paper: Option<f64>,
    /// Median of the plain controller at these gains, on the same plants.
    pub plain_pid: Option<f64>,
    /// Worst value of the plain controller on the same plants.
    pub plain_pid_worst: Option<f64>,
    /// Median of our arm, or for a share the mean.
    pub ours_median: Option<f64>,
    /// Worst value of our arm, or for a share the mean.
    pub ours_worst: Option<f64>,
    /// Number of plants with a value of our arm.
    pub plants: usize,
    /// Limit that our arm must keep in the worst plant.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<Limit>,
    /// True when our arm keeps it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub met: Option<bool>,
    /// Seeds of the plants in which our arm misses it.
    pub failing: Vec<u64>,
}

/// Printed value of a metric: from Tables 1 and 2, or from the row 10, 4, 3 of Table 5, which is taken to be of the
/// geared motor.
fn printed(bench: &Bench, metric: &str) -> Option<f64> {
    if let Some(rest) = metric.strip_prefix("error_") {
        let places = bench.set_points.iter().zip(bench.printed);
        let found = places.clone().find(|(set, _)| rest == format!("{set}_{}", bench.unit()));
        return found.map(|(set, observed)| (observed - set).abs());
    }
    match (bench.name, metric) {
        ("geared", "rise_s") => Some(2.81),
        // Printed in deg by our reading, of a step of 270.
        ("geared", "overshoot_percent") => Some(100.0 * 5.0 / bench::STEP_DEG),
        ("geared", "steady_deg") => Some(0.0),
        _ => None,
    }
}

/// Computes the lines of the comparison from the records of a study, in the order of the metrics.
#[must_use]
pub fn rows(records: &[Record]) -> Vec<Comparison> {
    let mut rows = Vec::new();
    for bench in bench::ALL {
        for metric in super::METRICS.iter().filter(|metric| metric.name.starts_with(bench.name)) {
            rows.extend(row(&bench, metric, records));
        }
    }
    rows
}

fn row(bench: &Bench, metric: &'static Metric, records: &[Record]) -> Option<Comparison> {
    let of = |arm: &str| -> Vec<(u64, f64)> {
        let mine = records.iter().filter(|record| record.arm == arm);
        mine.filter_map(|record| Some((record.seed, *record.values.get(metric.name)?))).collect()
    };
    let (paper, mut ours) = (of(PAPER), of(OURS));
    if ours.is_empty() {
        ours = of(BLIND);
    }
    if ours.is_empty() && paper.is_empty() {
        return None;
    }
    let arm = if metric.target(BLIND).is_some() { BLIND } else { OURS };
    let limit = metric.target(arm).map(|target| target.limit);
    let is_share = metric.unit == "1" && matches!(metric.statistic, crate::Statistic::Share);
    let middle = |values: &[(u64, f64)]| {
        let values: Vec<f64> = values.iter().map(|(_, value)| *value).collect();
        if is_share {
            r4_maths::statistics::mean(&values).ok()
        } else {
            r4_maths::statistics::quantile(&values, 0.5, r4_maths::statistics::QuantileRule::Linear).ok()
        }
    };
    let worst = |values: &[(u64, f64)]| {
        if is_share { middle(values) } else { values.iter().map(|(_, value)| *value).reduce(f64::max) }
    };
    let name = metric.name.strip_prefix(bench.name)?.strip_prefix('_')?;
    let point = bench.set_points.iter().find(|set| name == format!("error_{set}_{}", bench.unit()));
    let case = match point {
        Some(set) => format!("{} {set} {}", bench.name, bench.unit()),
        None => bench.name.to_owned(),
    };
    // A share is 1 or 0 in one plant: each 0 is a failure by itself.
    let single = limit.map(|limit| if is_share { Limit::AtLeast(1.0) } else { limit });
    let failing = |(seed, value): &(u64, f64)| single.is_some_and(|limit| !limit.is_held_by(*value)).then_some(*seed);
    let met = limit.and_then(|limit| Some(limit.is_held_by(worst(&ours)?)));
    Some(Comparison {
        case,
        metric: if point.is_some() { "error" } else { name },
        unit: metric.unit,
        paper: printed(bench, name),
        plain_pid: middle(&paper),
        plain_pid_worst: worst(&paper),
        ours_median: middle(&ours),
        ours_worst: worst(&ours),
        plants: ours.len(),
        target: limit,
        met,
        failing: ours.iter().filter_map(failing).collect(),
    })
}
