//! Benchmark of the models of a motor by their mean absolute error, as publications of recordings report it.

use super::{Kind, Known, Motion};
use crate::{
    data::Run,
    error::IdentifyError,
    family::{Family, Model, Term},
    fit, select,
    task::Protocol,
};

/// Errors of a search's base model and of its last model on held-out runs, in the unit of the output.
#[derive(Clone, Debug, PartialEq)]
pub struct MeanAbsolute {
    /// Error of the base model: mean over the runs of their mean absolute errors.
    pub before: f64,
    /// The same with the effects that were found.
    pub after: f64,
    /// Names of these effects, in the order in which they were added.
    pub effects: Vec<&'static str>,
}

/// Searches `train` for missing effects and measures the errors on `holdout`, each run from an initial state fitted to its first tenth.
///
/// A report has the mean over all samples instead, in which a long run counts more.
///
/// # Errors
/// [`IdentifyError`] for runs that the model cannot read.
pub fn mean_absolute(
    kind: Kind,
    known: &Known,
    (train, holdout): (&[Run], &[Run]),
    progress: &(dyn Fn(&str) + Sync),
) -> Result<MeanAbsolute, IdentifyError> {
    let (model, train, holdout) = Motion::new(kind, known, train, holdout)?;
    let found = select::search(&model, &train, progress);
    let [before, after] = [&found.base, &found.last].map(|fit| mean_over_runs(&model, fit, &holdout));
    let name = |term: &Term| match term {
        Term::Known(index) => model.catalogue()[*index].name,
        Term::Curve(_) => "unknown",
    };
    Ok(MeanAbsolute { before, after, effects: found.last.structure.terms.iter().map(name).collect() })
}

fn mean_over_runs<F: Family>(family: &F, fit: &fit::Fit, runs: &[F::Run]) -> f64 {
    let of_run = |run: &F::Run| {
        let window = Protocol::FirstTenth.window(family.measured(run).len());
        let initial = fit::settle(family, &fit.structure, run, window);
        let residuals = fit::residuals(family, &fit.structure, &initial, run);
        let known: Vec<f64> = residuals.into_iter().filter(|residual| residual.is_finite()).map(f64::abs).collect();
        known.iter().sum::<f64>() / known.len() as f64
    };
    runs.iter().map(of_run).sum::<f64>() / runs.len() as f64
}
