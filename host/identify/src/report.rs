//! What `report.json` holds, and what the report's plots are drawn of.

use std::collections::BTreeMap;

use serde::Serialize;

/// The report, as written to `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Name of the base model.
    pub model: String,
    /// Unit of every RMSE.
    pub unit: String,
    /// The base model alone.
    pub baseline: Scores,
    /// What was added, in this order.
    pub effects: Vec<EffectReport>,
    /// The base model with all of them.
    #[serde(rename = "final")]
    pub last: Scores,
    /// The base model's parameters in the end.
    pub parameters: BTreeMap<String, Estimate>,
    /// How the output's stamps differ from the input's: of the recording, not of the machine. Empty for models without time.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub timing: BTreeMap<String, Estimate>,
    /// What is left.
    pub residual: ResidualReport,
    /// What was looked for and not taken, strongest first.
    pub rejected: Vec<Rejected>,
    /// What reading the files set aside or repaired.
    pub notes: Vec<String>,
    /// One plain sentence.
    pub verdict: String,
    /// How far the model explains the held-out recordings.
    pub explained: Explained,
    /// Faults that the recordings show without a model; then, if it explains nothing, likely mistakes, each with the base model's error once
    /// it is corrected, smallest error first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub suspicions: Vec<String>,
}

impl Report {
    /// What is wrong with the output's stamps, beyond four standard deviations; `None` if nothing is.
    #[must_use]
    pub fn timing_fault(&self) -> Option<String> {
        let sure = |name: &str| self.timing.get(name).filter(|estimate| estimate.is_off(0.0, SURE));
        let late = sure(STAMPS_LATE).map(|estimate| {
            let side = if estimate.value < 0.0 { "early" } else { "late" };
            format!("{:.2} ms {side}", 1e3 * estimate.value.abs())
        });
        let drift = sure(CLOCK_DRIFT).map(|estimate| format!("later by {:.3} ms each second", 1e3 * estimate.value));
        let faults: Vec<String> = late.into_iter().chain(drift).collect();
        (!faults.is_empty()).then(|| format!("the output's stamps are {}", faults.join(", and ")))
    }
}

/// In [`Report::timing`]: by how much the output's stamps are late, s.
pub const STAMPS_LATE: &str = "stamps_late_s";
/// In [`Report::timing`]: by how much later they become each second.
pub const CLOCK_DRIFT: &str = "clock_drift";
/// Standard deviations beyond which stamps are said to be off.
const SURE: f64 = 4.0;

/// How far a model explains recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Explained {
    /// The residual is white noise.
    ToTheNoise,
    /// The model explains most of the signal, but the residual is not white.
    InPart,
    /// The residual is too large; [`Report::suspicions`] lists likely causes.
    Not,
}

/// Largest NRMSE on held-out data of a base model without effects whose residual is not white: above it an effect is missing and was not
/// found. Our choice, a tenth of the NRMSE of a constant; other values have not been compared.
const NAMELESS: f64 = 0.1;
/// Largest NRMSE on held-out data with effects, or with a white residual. Our choice: a quarter of the variance; other values have not
/// been compared.
const NAMED: f64 = 0.5;

impl Explained {
    /// Grades a model by its NRMSE on held-out data, `left`, whether it has an effect with a size (see [`EffectReport::has_size`]), and
    /// whether its residual is white.
    #[must_use]
    pub fn of(left: f64, has_effects: bool, is_white: bool) -> Self {
        // The NRMSE of a constant is 1, and NaN where the recordings are constant.
        let most = if has_effects || is_white { NAMED } else { NAMELESS };
        if left.is_nan() || left > most {
            Self::Not
        } else if is_white {
            Self::ToTheNoise
        } else {
            Self::InPart
        }
    }
}

/// How well a model does on both kinds of data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// On what it was fitted to.
    pub train: Score,
    /// On what it never saw.
    pub holdout: Score,
}

/// Error of a free run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Root mean square, in the unit of the output.
    pub rmse: f64,
    /// Over the standard deviation of what was measured.
    pub nrmse: f64,
    /// Mean absolute error, in the unit of the output.
    pub mae: f64,
}

/// A number and how well it is known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Best value.
    pub value: f64,
    /// Standard deviation by the curvature at the best value; `null` where the data do not fix it.
    pub std: Option<f64>,
    /// `N m`; `1` for a plain number.
    pub unit: String,
    /// 95 % by the profile of the error: how far the number can go with all others fitted again. An end beyond what the
    /// number may be is the end of that. Absent where the error does not rise enough on both sides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval: Option<[f64; 2]>,
    /// The data do not fix the scale: the value holds for this assumption.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assumed: Option<String>,
}

impl Estimate {
    /// Whether it is so many standard deviations from a value.
    #[must_use]
    pub fn is_off(&self, from: f64, deviations: f64) -> bool {
        self.std.is_some_and(|std| (self.value - from).abs() >= deviations * std)
    }
}

/// An effect that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EffectReport {
    /// Name in the catalogue, or `unknown`.
    pub name: String,
    /// Of `input, speed, position, acceleration, direction, time, supply, history`.
    pub depends_on: Vec<String>,
    /// By name.
    pub parameters: BTreeMap<String, Estimate>,
    /// RMSE on the held-out data without it, in the order of adding.
    pub holdout_rmse_before: f64,
    /// And with it.
    pub holdout_rmse_after: f64,
    /// Why it was taken.
    pub evidence: Evidence,
    /// Effects that explain these data as well, and how to tell them apart.
    pub rivals: Vec<Rival>,
    /// The shape of an effect that has no name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub table: Option<Table>,
}

impl EffectReport {
    /// Whether any of its parameters is at least two standard errors from 0, or the effect is a fitted curve.
    #[must_use]
    pub fn has_size(&self) -> bool {
        self.table.is_some() || self.parameters.values().any(|estimate| estimate.is_off(0.0, 2.0))
    }
}

/// Why an effect was taken.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// RMSE on blocks of the training data left out of the fit, without the effect.
    pub blocked_rmse_before: f64,
    /// And with it.
    pub blocked_rmse_after: f64,
    /// Chance that blocks without the effect would show such a gain, times the number of effects tried.
    pub p_value: f64,
    /// Blocks that got better, of all.
    pub blocks_better: [usize; 2],
    /// Least distance of a parameter from having no effect, in standard deviations.
    pub z: f64,
}

/// Another explanation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rival {
    /// Name in the catalogue.
    pub name: String,
    /// Its RMSE on the blocks left out.
    pub blocked_rmse: f64,
    /// What to record so that the two differ.
    pub experiment: String,
}

/// An effect that was tried and not taken.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rejected {
    /// Name in the catalogue.
    pub name: String,
    /// Its RMSE on the blocks left out, beside the final model.
    pub blocked_rmse: f64,
    /// Why not.
    pub reason: String,
}

/// What is left of the data.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResidualReport {
    /// Whether it is white: no correlation over time beyond chance.
    pub white: bool,
    /// What it still depends on, strongest first.
    pub unexplained: Vec<Unexplained>,
}

/// A dependence that remains.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unexplained {
    /// What on.
    pub depends_on: String,
    /// Share of the residual's variance, 0..=1.
    pub share: f64,
    /// After correcting for all that was looked at.
    pub p_value: f64,
}

/// A curve over what it depends on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// What `at` is.
    pub over: String,
    /// Its unit.
    pub at_unit: String,
    /// Unit of `values`.
    pub unit: String,
    /// Where the curve has its corners.
    pub at: Vec<f64>,
    /// Its values there, straight between.
    pub values: Vec<f64>,
    /// Standard deviations of `values`.
    pub std: Vec<f64>,
}

/// What the report's plots are drawn of.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// What each step left on the held-out data: name and RMSE.
    pub ladder: Vec<(String, f64)>,
    /// Some runs, held-out ones first.
    pub runs: Vec<Traces>,
    /// The residual against each thing it may depend on, what explains most first.
    pub causes: Vec<Cause>,
}

/// One run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Traces {
    /// Of the run.
    pub name: String,
    /// Not fitted to.
    pub held_out: bool,
    /// s.
    pub time_s: Vec<f64>,
    /// Name and values; empty where a model has none.
    pub input: (String, Vec<f64>),
    /// Name and unit of the output.
    pub output: (String, String),
    /// What was measured.
    pub measured: Vec<f64>,
    /// The base model's free run.
    pub before: Vec<f64>,
    /// The final model's.
    pub after: Vec<f64>,
}

/// The residual over one thing it may depend on, as means of bins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cause {
    /// Such as `speed`.
    pub depends_on: String,
    /// Of `at`.
    pub at_unit: String,
    /// Of the residual.
    pub unit: String,
    /// Middle of each bin.
    pub at: Vec<f64>,
    /// Mean residual of the base model there.
    pub before: Vec<f64>,
    /// Mean residual of the final model there.
    pub after: Vec<f64>,
    /// Two standard errors of `before`.
    pub error: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_explains_is_told_from_what_does_not() {
        use Explained::{InPart, Not, ToTheNoise};
        for (left, has_effects, is_white, expected) in [
            (0.04, true, false, InPart),
            (0.04, false, false, InPart),
            (0.04, false, true, ToTheNoise),
            (0.3, true, false, InPart),
            (0.3, false, true, ToTheNoise),
            (0.3, false, false, Not),
            (0.6, true, true, Not),
            (1.5, true, false, Not),
            (f64::NAN, true, true, Not),
        ] {
            assert_eq!(Explained::of(left, has_effects, is_white), expected, "{left} {has_effects} {is_white}");
        }
    }

    #[test]
    fn an_effect_that_may_be_anything_has_no_size() {
        let estimate = |value, std| Estimate { value, std, unit: "N".to_owned(), interval: None, assumed: None };
        let effect = |values: &[Estimate]| EffectReport {
            name: "cogging".to_owned(),
            depends_on: Vec::new(),
            parameters: values.iter().enumerate().map(|(at, value)| (at.to_string(), value.clone())).collect(),
            holdout_rmse_before: 1.0,
            holdout_rmse_after: 0.5,
            evidence: Evidence {
                blocked_rmse_before: 1.0,
                blocked_rmse_after: 0.5,
                p_value: 0.0,
                blocks_better: [9, 9],
                z: 10.0,
            },
            rivals: Vec::new(),
            table: None,
        };
        let [open, wide, sure] = [estimate(1.0, None), estimate(176e3, Some(3.4e6)), estimate(-2.0, Some(0.1))];
        assert!(!effect(&[open.clone(), wide.clone()]).has_size());
        assert!(effect(&[open, wide, sure]).has_size());
    }
}
