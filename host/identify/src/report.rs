//! Content of `report.json`, and the data of the report's plots.

use std::collections::BTreeMap;

use serde::Serialize;

/// The report, as written to `report.json`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Name of the base model.
    pub model: String,
    /// Unit of every RMSE, which is that of the output.
    pub unit: String,
    /// Scores of the base model alone.
    pub baseline: Scores,
    /// Accepted effects, in the order in which they were added.
    pub effects: Vec<EffectReport>,
    /// Scores of the base model with all accepted effects.
    #[serde(rename = "final")]
    pub last: Scores,
    /// Parameters of the base model in the final fit.
    pub parameters: BTreeMap<String, Estimate>,
    /// Timing errors of the output's stamps relative to the input's: properties of the recording, not of the machine.
    /// Empty for models without time.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub timing: BTreeMap<String, Estimate>,
    /// Analysis of the residual of the final model.
    pub residual: ResidualReport,
    /// Effects that were tried and not accepted, strongest first.
    pub rejected: Vec<Rejected>,
    /// Notes of reading the files: what was set aside or repaired.
    pub notes: Vec<String>,
    /// Result in one plain sentence.
    pub verdict: String,
    /// Grade of how far the model explains the held-out recordings.
    pub explained: Explained,
    /// Faults of the recordings that show without a model; then, if the model explains nothing, likely mistakes, each
    /// with the base model's error after its correction, smallest error first.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub suspicions: Vec<String>,
}

impl Report {
    /// Describes an error of the output's stamps beyond four standard errors; `None` without one.
    #[must_use]
    pub fn timing_fault(&self) -> Option<String> {
        // Uncertain errors of the stamps are not reported as faults.
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

/// Key in [`Report::timing`] of the delay of the output's stamps, s; positive if they are late.
pub const STAMPS_LATE: &str = "stamps_late_s";
/// Key in [`Report::timing`] of the drift of that delay, s/s.
pub const CLOCK_DRIFT: &str = "clock_drift";
/// Standard errors beyond which an error of the stamps is reported.
const SURE: f64 = 4.0;

/// Grade of how far a model explains recordings.
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

/// Largest NRMSE on held-out data of a base model without effects whose residual is not white: above it an effect is
/// missing and was not found. Our choice, a tenth of the NRMSE of a constant; other values have not been compared.
const NAMELESS: f64 = 0.1;
/// Largest NRMSE on held-out data with effects, or with a white residual. Our choice: a quarter of the variance;
/// other values have not been compared.
const NAMED: f64 = 0.5;

impl Explained {
    /// Grades a model by `left`, its NRMSE on held-out data, and `alone`, that of the base model; by whether it has an
    /// effect with a significant size (see [`EffectReport::has_size`]), and by whether its residual is white.
    #[must_use]
    pub fn of([alone, left]: [f64; 2], has_effects: bool, is_white: bool) -> Self {
        // The NRMSE of a constant prediction is 1, and NaN if the recordings are constant.
        let most = if has_effects || is_white { NAMED } else { NAMELESS };
        if left.is_nan() || left > most {
            Self::Not
        } else if is_white {
            Self::ToTheNoise
        } else if left > alone {
            // Effects of the fitted recordings that make others worse explain nothing.
            Self::Not
        } else {
            Self::InPart
        }
    }
}

/// Scores of a model on the fitted and on the held-out data.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Score on the runs that it was fitted to.
    pub train: Score,
    /// Score on the held-out runs.
    pub holdout: Score,
}

/// Error of a free-run simulation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Score {
    /// Root mean square error, in the output's unit.
    pub rmse: f64,
    /// RMSE divided by the standard deviation of the measured output.
    pub nrmse: f64,
    /// Mean absolute error, in the output's unit.
    pub mae: f64,
}

/// Estimated number with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Value at the best fit.
    pub value: f64,
    /// Standard error by the curvature of the cost at the best fit; `null` if the data do not determine the number.
    pub std: Option<f64>,
    /// Unit such as `N m`; `1` for a dimensionless number.
    pub unit: String,
    /// 95 % confidence interval by profile likelihood: the others are refitted at each value. An end at the limit of
    /// the number's range means that the data do not bound it there. Absent if the cost does not rise enough on both
    /// sides.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval: Option<[f64; 2]>,
    /// Assumption under which the value holds, if the data do not determine its scale.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assumed: Option<String>,
}

impl Estimate {
    /// Returns whether the value is at least `deviations` standard errors from `from`; false if the error is unknown.
    #[must_use]
    pub fn is_off(&self, from: f64, deviations: f64) -> bool {
        self.std.is_some_and(|std| (self.value - from).abs() >= deviations * std)
    }
}

/// Effect that was found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EffectReport {
    /// Name in the catalogue, or `unknown` for an effect without a name.
    pub name: String,
    /// Dependences, of `input, speed, position, acceleration, direction, time, supply, history`.
    pub depends_on: Vec<String>,
    /// Parameters of the effect by name.
    pub parameters: BTreeMap<String, Estimate>,
    /// RMSE on the held-out data before the effect was added.
    pub holdout_rmse_before: f64,
    /// RMSE on the held-out data with the effect added.
    pub holdout_rmse_after: f64,
    /// Evidence on which the effect was accepted.
    pub evidence: Evidence,
    /// Effects that explain these data equally well, and how to distinguish them.
    pub rivals: Vec<Rival>,
    /// Curve of an effect without a name; `None` for a named effect.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub table: Option<Table>,
}

impl EffectReport {
    /// Returns whether any parameter is at least two standard errors from 0, or the effect is a fitted curve.
    #[must_use]
    pub fn has_size(&self) -> bool {
        self.table.is_some() || self.parameters.values().any(|estimate| estimate.is_off(0.0, 2.0))
    }
}

/// Evidence for an effect by block cross-validation on the training data.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// RMSE on held-out folds without the effect.
    pub blocked_rmse_before: f64,
    /// RMSE on held-out folds with the effect.
    pub blocked_rmse_after: f64,
    /// Probability that blocks without the effect would show such a gain, times the number of effects tried
    /// (Bonferroni).
    pub p_value: f64,
    /// Number of blocks whose error fell, and number of all blocks.
    pub blocks_better: [usize; 2],
    /// Smallest distance of a parameter from the effect's absence, in standard errors.
    pub z: f64,
}

/// Other effect that explains the same data.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rival {
    /// Name of the effect in the catalogue.
    pub name: String,
    /// RMSE of the rival on held-out folds.
    pub blocked_rmse: f64,
    /// Advice for a recording that distinguishes the two.
    pub experiment: String,
}

/// Effect that was tried and not accepted.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rejected {
    /// Name of the effect in the catalogue.
    pub name: String,
    /// RMSE on held-out folds with this effect added to the final model.
    pub blocked_rmse: f64,
    /// Reason why it was not accepted.
    pub reason: String,
}

/// Analysis of the residual.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ResidualReport {
    /// True if the residual is white: no autocorrelation beyond chance.
    pub white: bool,
    /// Quantities that it still depends on, strongest first.
    pub unexplained: Vec<Unexplained>,
}

/// Remaining dependence of the residual.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Unexplained {
    /// Name of the quantity it depends on.
    pub depends_on: String,
    /// Share of the residual's variance that the quantity explains, 0..=1.
    pub share: f64,
    /// Probability of such a share by chance, corrected for the number of quantities tried.
    pub p_value: f64,
}

/// Curve of an effect over the quantity it depends on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// Quantity on the axis `at`.
    pub over: String,
    /// Unit of the axis `at`.
    pub at_unit: String,
    /// Unit of the curve's `values`.
    pub unit: String,
    /// Knots of the curve, in `at_unit`.
    pub at: Vec<f64>,
    /// Values at the knots.
    pub values: Vec<f64>,
    /// Standard errors of `values`.
    pub std: Vec<f64>,
}

/// Data of the report's plots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Figures {
    /// RMSE on the held-out data after each step of the search, with the name of the step.
    pub ladder: Vec<(String, f64)>,
    /// Some of the runs, held-out ones first.
    pub runs: Vec<Traces>,
    /// Residual over each quantity that it may depend on, strongest dependence first.
    pub causes: Vec<Cause>,
}

/// Signals of one run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Traces {
    /// Name of the run.
    pub name: String,
    /// True for a held-out run.
    pub held_out: bool,
    /// Times of the samples, s.
    pub time_s: Vec<f64>,
    /// Name and values of the input; empty if the model has none.
    pub input: (String, Vec<f64>),
    /// Name and unit of the output.
    pub output: (String, String),
    /// Measured output, in the output's unit.
    pub measured: Vec<f64>,
    /// Free-run simulation of the base model.
    pub before: Vec<f64>,
    /// Free-run simulation of the final model.
    pub after: Vec<f64>,
}

/// Residual over one quantity that it may depend on, as means of bins.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cause {
    /// Name of the quantity, such as `speed`.
    pub depends_on: String,
    /// Unit of the axis `at`.
    pub at_unit: String,
    /// Unit of the residual.
    pub unit: String,
    /// Mean of the quantity in each bin.
    pub at: Vec<f64>,
    /// Mean residual of the base model in each bin.
    pub before: Vec<f64>,
    /// Mean residual of the final model in each bin.
    pub after: Vec<f64>,
    /// Two standard errors of each value of `before`.
    pub error: Vec<f64>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_explains_is_told_from_what_does_not() {
        use Explained::{InPart, Not, ToTheNoise};
        for (left, has_effects, is_white, expected) in [
            (0.041, true, false, Not),
            (0.041, true, true, ToTheNoise),
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
            let alone = if left == 0.041 { 0.04 } else { left };
            assert_eq!(
                Explained::of([alone, left], has_effects, is_white),
                expected,
                "{left} {has_effects} {is_white}"
            );
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
