//! Outcome of each step, as a table, beside the processor time that the step took when its figure was committed.

use std::{collections::BTreeMap, fmt, fs, path::Path, time::Duration};

use crate::meter::Cost;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Outcome {
    Ok(Cost),
    Failed(Cost),
    /// A step before it has failed.
    NotRun,
}

/// File with the committed figures: processor time of each step in s, from an empty target folder.
const FIGURES: &str = "tests/xtask/figures.toml";
/// A step whose processor time exceeds its figure by this factor is named. Our choice: how much two runs of one step differ
/// was not measured.
const FACTOR: f64 = 1.3;
/// Shorter steps are not compared, s.
const SHORT_S: f64 = 10.0;

/// Summary with one row for each step, in the order in which they ran.
#[derive(Default)]
pub(crate) struct Summary {
    rows: Vec<(&'static str, Outcome)>,
    /// Committed processor time by step, s.
    before: BTreeMap<String, f64>,
}

impl Summary {
    /// Makes a summary that compares with the committed figures.
    ///
    /// # Errors
    /// The file of figures cannot be read.
    pub(crate) fn compared(root: &Path) -> Result<Self, String> {
        let text = fs::read_to_string(root.join(FIGURES)).map_err(|error| format!("{FIGURES}: {error}"))?;
        let before = toml::from_str(&text).map_err(|error| format!("{FIGURES}: {error}"))?;
        Ok(Self { before, ..Self::default() })
    }

    /// Returns the measured processor times in the format of the committed figures.
    pub(crate) fn figures(&self) -> String {
        self.rows
            .iter()
            .filter_map(|&(step, outcome)| Some(format!("{step:?} = {:.0}\n", processor_s(outcome)?)))
            .collect()
    }

    /// Returns the steps that took clearly more processor time than their committed figures, or have none.
    fn heavier(&self) -> Vec<String> {
        let compare = |&(step, outcome): &(&'static str, Outcome)| {
            let now = processor_s(outcome).filter(|&now| now > SHORT_S)?;
            match self.before.get(step) {
                None => Some(format!("{step}: {now:.0} s, and no figure in {FIGURES}")),
                Some(before) => {
                    (now > FACTOR * before.max(SHORT_S)).then(|| format!("{step}: {now:.0} s for {before:.0} s"))
                }
            }
        };
        self.rows.iter().filter_map(compare).collect()
    }

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
        writeln!(f, "{:<21}{:>8}{:>13}{:>8}  result", "step", "time, s", "processor, s", "before")?;
        let mut sum = Cost { processor: Some(Duration::ZERO), ..Cost::default() };
        for (step, outcome) in &self.rows {
            let (cost, word) = match *outcome {
                Outcome::Ok(cost) => (Some(cost), "ok"),
                Outcome::Failed(cost) => (Some(cost), "FAILED"),
                Outcome::NotRun => (None, "not run"),
            };
            row(f, step, cost, self.before.get(*step).copied(), word)?;
            if let Some(cost) = cost {
                sum += cost;
            }
        }
        // Of the steps in this run only, so that the sums of a part of a run are of the same steps.
        let before = self.rows.iter().filter_map(|(step, _)| self.before.get(*step)).copied().reduce(|sum, s| sum + s);
        row(f, "together", Some(sum), before, "")?;
        let heavier = self.heavier();
        if !self.before.is_empty() && !heavier.is_empty() {
            writeln!(f, "\nMore processor time than committed ({FIGURES}):")?;
            heavier.iter().try_for_each(|line| writeln!(f, "  {line}"))?;
        }
        Ok(())
    }
}

/// Processor time of a step that succeeded, s.
fn processor_s(outcome: Outcome) -> Option<f64> {
    match outcome {
        Outcome::Ok(cost) => cost.processor.map(|time| time.as_secs_f64()),
        Outcome::Failed(_) | Outcome::NotRun => None,
    }
}

fn row(f: &mut fmt::Formatter<'_>, step: &str, cost: Option<Cost>, before_s: Option<f64>, word: &str) -> fmt::Result {
    let seconds = |time: Option<Duration>| time.map_or("-".into(), |time| format!("{:.1}", time.as_secs_f64()));
    let (wall, processor) = (seconds(cost.map(|cost| cost.wall)), seconds(cost.and_then(|cost| cost.processor)));
    let before = before_s.map_or("-".into(), |before| format!("{before:.0}"));
    writeln!(f, "{}", format!("{step:<21}{wall:>8}{processor:>13}{before:>8}  {word}").trim_end())
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
            "step                  time, s processor, s  before  result\n\
             format                    1.2          2.0       -  ok\n\
             lints                    75.0        140.5       -  FAILED\n\
             tests                       -            -       -  not run\n\
             together                 76.2        142.5       -\n"
        );
    }

    #[test]
    fn steps_are_compared_with_their_figures() {
        let before = [
            ("format".to_owned(), 1.0),
            ("lints".to_owned(), 100.0),
            ("tests".to_owned(), 50.0),
            ("docs".to_owned(), 60.0),
        ];
        let before = before.into();
        let mut summary = Summary { before, ..Summary::default() };
        summary.add("format", Outcome::Ok(cost(9_000, 9_900)));
        summary.add("lints", Outcome::Ok(cost(75_000, 140_500)));
        summary.add("tests", Outcome::Ok(cost(30_000, 64_000)));
        summary.add("peers", Outcome::Ok(cost(30_000, 20_000)));
        assert_eq!(
            summary.heavier(),
            ["lints: 140 s for 100 s", "peers: 20 s, and no figure in tests/xtask/figures.toml"]
        );
        assert!(summary.to_string().contains("\ntogether                144.0        234.4     151\n"), "{summary}");
        let read: BTreeMap<String, f64> = toml::from_str(&summary.figures()).expect("the format of the committed file");
        assert_eq!(read["lints"], 140.0);
    }
}
