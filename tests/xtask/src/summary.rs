//! What became of each step.

use std::{fmt, time::Duration};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Outcome {
    Ok(Duration),
    Failed(Duration),
    /// A step before it failed.
    NotRun,
}

/// One row for each step, in the order they were run.
#[derive(Default)]
pub(crate) struct Summary {
    rows: Vec<(&'static str, Outcome)>,
}

impl Summary {
    pub(crate) fn add(&mut self, step: &'static str, outcome: Outcome) {
        self.rows.push((step, outcome));
    }

    /// The step that failed, if one did.
    pub(crate) fn failed(&self) -> Option<&'static str> {
        self.rows.iter().find(|(_, outcome)| matches!(outcome, Outcome::Failed(_))).map(|(step, _)| *step)
    }
}

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{:<12}{:>9}  result", "step", "seconds")?;
        for (step, outcome) in &self.rows {
            let (took, word) = match outcome {
                Outcome::Ok(took) => (Some(took), "ok"),
                Outcome::Failed(took) => (Some(took), "FAILED"),
                Outcome::NotRun => (None, "not run"),
            };
            let seconds = took.map_or("-".into(), |took| format!("{:.1}", took.as_secs_f64()));
            writeln!(f, "{step:<12}{seconds:>9}  {word}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_a_row_for_each_step() {
        let mut summary = Summary::default();
        summary.add("format", Outcome::Ok(Duration::from_millis(1240)));
        assert_eq!(summary.failed(), None);
        summary.add("lints", Outcome::Failed(Duration::from_secs(75)));
        summary.add("tests", Outcome::NotRun);
        assert_eq!(summary.failed(), Some("lints"));
        assert_eq!(
            summary.to_string(),
            "step          seconds  result\n\
             format            1.2  ok\n\
             lints            75.0  FAILED\n\
             tests               -  not run\n"
        );
    }
}
