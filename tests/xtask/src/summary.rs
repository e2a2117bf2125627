//! Outcome of each step, as a table.

use std::{fmt, time::Duration};

use crate::meter::Cost;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Outcome {
    Ok(Cost),
    Failed(Cost),
    /// A step before it has failed.
    NotRun,
}

/// Summary with one row for each step, in the order in which they ran.
#[derive(Default)]
pub(crate) struct Summary {
    rows: Vec<(&'static str, Outcome)>,
}

impl Summary {
    pub(crate) fn add(&mut self, step: &'static str, outcome: Outcome) {
        self.rows.push((step, outcome));
    }

    /// Returns the step that failed, if one did.
    pub(crate) fn failed(&self) -> Option<&'static str> {
        self.rows.iter().find(|(_, outcome)| matches!(outcome, Outcome::Failed(_))).map(|(step, _)| *step)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<15}{:>8}{:>13}  result", "step", "time, s", "processor, s")?;
        let mut sum = Cost { processor: Some(Duration::ZERO), ..Cost::default() };
        for (step, outcome) in &self.rows {
            let (cost, word) = match *outcome {
                Outcome::Ok(cost) => (Some(cost), "ok"),
                Outcome::Failed(cost) => (Some(cost), "FAILED"),
                Outcome::NotRun => (None, "not run"),
            };
            row(f, step, cost, word)?;
            if let Some(cost) = cost {
                sum += cost;
            }
        }
        row(f, "together", Some(sum), "")
    }
}

fn row(f: &mut fmt::Formatter<'_>, step: &str, cost: Option<Cost>, word: &str) -> fmt::Result {
    let seconds = |time: Option<Duration>| time.map_or("-".into(), |time| format!("{:.1}", time.as_secs_f64()));
    let (wall, processor) = (seconds(cost.map(|cost| cost.wall)), seconds(cost.and_then(|cost| cost.processor)));
    writeln!(f, "{}", format!("{step:<15}{wall:>8}{processor:>13}  {word}").trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(wall_ms: u64, processor_ms: u64) -> Cost {
        Cost { wall: Duration::from_millis(wall_ms), processor: Some(Duration::from_millis(processor_ms)) }
    }

    #[test]
    fn a_table_has_a_row_for_each_step() {
        let mut summary = Summary::default();
        summary.add("format", Outcome::Ok(cost(1_240, 2_000)));
        assert_eq!(summary.failed(), None);
        summary.add("lints", Outcome::Failed(cost(75_000, 140_500)));
        summary.add("tests", Outcome::NotRun);
        assert_eq!(summary.failed(), Some("lints"));
        assert_eq!(
            summary.to_string(),
            "step            time, s processor, s  result\n\
             format              1.2          2.0  ok\n\
             lints              75.0        140.5  FAILED\n\
             tests                 -            -  not run\n\
             together           76.2        142.5\n"
        );
    }
}
