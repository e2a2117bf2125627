//! Task of identification, from recordings to a report.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use r4_maths::statistics::RootMeanSquare;
use r4_plants::PlantSpec;
use r4_world::Wheeled;

use crate::{
    data::Run,
    error::IdentifyError,
    evidence::independent,
    family::{Acts, Family, Loadable, Structure, Term},
    fit::{self, Effort, Fit},
    motion::{Kind, Known, Motion},
    report::{EffectReport, Estimate, Evidence, Explained, Figures, Report, Rival, Score, Scores, Table, Traces},
    residual::{Left, left},
    select::{Found, Limits, base, depends_on, search_within},
    skid::{Declared, Output, SkidSteer},
    statics::{hysteresis::HeldShaft, map::StaticMap, table::task as table},
    suspect::{Checked, check_recordings, suspicions},
};

/// Task: the model, known parameters and limits of the search.
#[derive(Clone, Debug, Default)]
pub struct Task {
    /// Name of the base model.
    pub model: String,
    /// Known parameters by name.
    pub parameters: BTreeMap<String, f64>,
    /// Declared plant of the motor or actuator, if there is one.
    pub plant: Option<PlantSpec>,
    /// Declared body of the robot, if there is one.
    pub body: Option<Wheeled>,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Samples of a held-out run that its initial state is fitted to.
    pub protocol: Protocol,
    /// Time after which no further effect is tried; `None` for no limit.
    pub budget: Option<Duration>,
}

/// Samples of a held-out run that its initial state is fitted to. Errors are those of the whole run, these samples
/// included.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Protocol {
    /// The first tenth of its samples, and at least 20.
    #[default]
    FirstTenth,
    /// The first 20 samples, as the benchmark of the EMPS recordings in the Python package `nonlinear_benchmarks` 1.0.1 prescribes.
    First20,
}

impl Protocol {
    /// Returns the number of samples, of a run of `samples`, that its initial state is fitted to.
    pub(crate) fn window(self, samples: usize) -> usize {
        let wished = match self {
            Self::FirstTenth => (samples / SETTLE_SHARE).max(SETTLE_SAMPLES),
            Self::First20 => SETTLE_SAMPLES,
        };
        wished.min(samples)
    }
}

/// Progress of an identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Progress {
    /// Description of the current step.
    pub step: String,
    /// Estimated share of the work that is done, 0..=1.
    pub share: f64,
}

/// Result of an identification.
#[derive(Clone, Debug)]
pub struct Identified {
    /// Content of the file `report.json`.
    pub report: Report,
    /// Data of the plots on the report's page.
    pub figures: Figures,
    /// The model as something that a simulated board loads.
    pub loadable: Loadable,
}

/// Parameter that may be declared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParameterInfo {
    /// Name used with `--param`.
    pub name: &'static str,
    /// Unit of the value.
    pub unit: &'static str,
    /// Meaning of the parameter.
    pub what: &'static str,
}

/// Role of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoleInfo {
    /// Name used with `--map`.
    pub name: &'static str,
    /// True if the model needs the column.
    pub required: bool,
    /// True for an input of the model, false for an output that is compared with it.
    pub driving: bool,
    /// Meaning of the column.
    pub what: &'static str,
}

/// Description of a base model.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelInfo {
    /// Name used with `--model`.
    pub name: &'static str,
    /// Summary of what it is a model of.
    pub summary: &'static str,
    /// Roles of the columns.
    pub roles: Vec<RoleInfo>,
    /// Parameters that may be declared.
    pub parameters: Vec<ParameterInfo>,
    /// Names of the effects that are tried.
    pub effects: Vec<&'static str>,
    /// Kind of file that a simulated board loads.
    pub file: FileKind,
}

/// Kind of file that a simulated board loads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A plant file, by `--plant CHANNEL=FILE`.
    Plant,
    /// A body file, by `--body FILE`.
    Body,
}

impl FileKind {
    /// Returns the name of the file in the folder of the results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Plant => "plant.toml",
            Self::Body => "body.toml",
        }
    }
}

/// Fits the base model, searches for effects that it lacks, and reports errors on the held-out runs.
///
/// # Errors
/// An [`IdentifyError`], whose message says what to do next.
pub fn identify(
    task: &Task,
    train: &[Run],
    holdout: &[Run],
    notes: Vec<String>,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Identified, IdentifyError> {
    if train.is_empty() {
        return Err(IdentifyError::NoRuns);
    }
    // A table of working points may have too few rows to hold any out, so its held-out rows are optional.
    if task.model == table::NAME {
        return Ok(table::identify(train, holdout, notes, task.seed)?);
    }
    if holdout.is_empty() {
        return Err(IdentifyError::NoHoldout);
    }
    let Checked { suspicions: faults, notes: compared } = check_recordings(&task.model, train, holdout);
    let notes = notes.into_iter().chain(compared).collect();
    let mut found =
        with_family(task, train, holdout, Assemble { task, notes, names_only: !faults.is_empty(), progress })??;
    // What no model explains is most often a mistake in the recording, so common mistakes are tried.
    if found.report.explained == Explained::Not {
        let likely = suspicions(task, train, holdout, found.report.last.holdout.nrmse);
        found.report.suspicions.splice(0..0, likely);
        found.report.verdict = not_explained(&found.report);
    }
    if let Some(first) = faults.first() {
        let verdict = found.report.verdict.trim_end_matches('.');
        found.report.verdict = format!("{verdict}; check the recordings: {first}.");
        found.report.suspicions.splice(0..0, faults);
    }
    Ok(found)
}

/// A computation over a model and its runs, generic over the model.
pub(crate) trait Work {
    /// Result of the computation.
    type Done;

    /// Runs the computation on the fitted and the held-out runs of `family`.
    fn with<F: Family>(self, family: &F, train: &[F::Run], holdout: &[F::Run]) -> Self::Done;
}

/// Builds the model that a task names, prepares its runs, and hands both to `work`.
pub(crate) fn with_family<W: Work>(
    task: &Task,
    train: &[Run],
    holdout: &[Run],
    work: W,
) -> Result<W::Done, IdentifyError> {
    if let Some(kind) = Kind::ALL.into_iter().find(|kind| kind.name() == task.model) {
        let known = Known::from_parameters(kind, &task.parameters, task.plant.clone())?;
        let (model, train, holdout) = Motion::new(kind, &known, train, holdout)?;
        return Ok(work.with(&model, &train, &holdout));
    }
    if task.model == StaticMap::NAME {
        let (model, train, holdout) = StaticMap::prepare(train, holdout)?;
        return Ok(work.with(&model, &train, &holdout));
    }
    if task.model == HeldShaft::NAME {
        let (model, train, holdout) = HeldShaft::prepare(train, holdout)?;
        return Ok(work.with(&model, &train, &holdout));
    }
    if let Some(output) = Output::ALL.into_iter().find(|output| output.model() == task.model) {
        let declared = Declared::from_parameters(&task.parameters)?;
        let (model, train) = SkidSteer::new(declared, output, train)?;
        let model = model.with_body(task.body.clone());
        let holdout = holdout.iter().map(|run| model.run(declared, run)).collect::<Result<Vec<_>, _>>()?;
        return Ok(work.with(&model, &train, &holdout));
    }
    let known = models().iter().map(|model| model.name).collect::<Vec<_>>().join(", ");
    Err(IdentifyError::UnknownModel { name: task.model.clone(), known })
}

struct Assemble<'t> {
    task: &'t Task,
    notes: Vec<String>,
    /// True if the recordings have faults, which curves would learn; then only named effects are tried.
    names_only: bool,
    progress: &'t (dyn Fn(Progress) + Sync),
}

impl Work for Assemble<'_> {
    type Done = Result<Identified, IdentifyError>;

    fn with<F: Family>(self, family: &F, train: &[F::Run], holdout: &[F::Run]) -> Self::Done {
        assemble(self, family, train, holdout)
    }
}

/// Returns the descriptions of all base models.
#[must_use]
pub fn models() -> Vec<ModelInfo> {
    Kind::ALL
        .into_iter()
        .map(Motion::info)
        .chain(Output::ALL.into_iter().map(SkidSteer::info))
        .chain([StaticMap::info(), HeldShaft::info(), table::info()])
        .collect()
}

/// Divisor of a held-out run's length that gives the samples its initial state is fitted to, and their smallest
/// number.
const SETTLE_SHARE: usize = 10;
const SETTLE_SAMPLES: usize = 20;

/// Returns the 95 % confidence intervals of the last model's parameters, and descriptions of exchanges of parameters
/// that fit as well: an interval reaches from one of the two solutions to the other.
fn intervals<F: Family>(
    family: &F,
    found: &Found<F::Run>,
) -> (Vec<Option<[f64; 2]>>, impl Iterator<Item = String> + use<F>) {
    let (fitted, runs) = (&found.fitted.0, &found.fitted.1.iter().collect::<Vec<_>>());
    let mut intervals = found.intervals.clone();
    // Costs up to this limit lie within the 95 % confidence region of the fit.
    let unnoticed = fitted.cost * (1.0 + fit::RISE / independent(family, runs, fitted));
    let mut exchanged = Vec::new();
    // An exchanged solution that fits as well belongs to the confidence region too.
    for (what, other) in family.exchanged(&fitted.structure) {
        let other = fit::fit(family, runs, other, fitted.initial.clone(), Effort::FULL);
        if other.cost > unnoticed {
            continue;
        }
        for (interval, other) in intervals.iter_mut().zip(other.with_intervals(family, runs).1) {
            *interval = interval.zip(other).map(|([low, high], [lower, higher])| [low.min(lower), high.max(higher)]);
        }
        exchanged.push(what);
    }
    (intervals, exchanged.into_iter())
}

/// Share of the allowed time after which no further effect is tried; the rest is for intervals. Our choice, not
/// compared.
const SEARCHING: f64 = 0.6;

/// Returns the free-run simulations of a structure over held-out runs.
fn free_runs<F: Family>(family: &F, structure: &Structure, runs: &[F::Run], protocol: Protocol) -> Vec<Vec<f64>> {
    runs.iter()
        .map(|run| {
            let samples = family.measured(run).len();
            let initial = fit::settle(family, structure, run, protocol.window(samples));
            let mut predicted = vec![0.0; samples];
            family.predict(structure, &initial, run, &mut predicted);
            predicted
        })
        .collect()
}

/// Returns the NRMSE of the base model alone on the held-out runs.
pub(crate) fn base_nrmse<F: Family>(family: &F, train: &[F::Run], holdout: &[F::Run]) -> f64 {
    let fit = base(family, train);
    let held_out: Vec<&F::Run> = holdout.iter().collect();
    score(family, &held_out, &free_runs(family, &fit.structure, holdout, Protocol::default())).nrmse
}

fn score<F: Family>(family: &F, runs: &[&F::Run], predicted: &[Vec<f64>]) -> Score {
    let mut errors = RootMeanSquare::default();
    let (mut sum, mut sum_square, mut magnitudes) = (0.0, 0.0, 0.0);
    for (run, predicted) in runs.iter().zip(predicted) {
        for (measured, predicted) in family.measured(run).iter().zip(predicted) {
            if measured.is_finite() {
                errors.push(measured - predicted);
                magnitudes += (measured - predicted).abs();
                sum += measured;
                sum_square += measured * measured;
            }
        }
    }
    let (rmse, count) = (errors.value().unwrap_or(0.0), errors.count().max(1) as f64);
    let deviation = (sum_square / count - (sum / count).powi(2)).max(0.0).sqrt();
    let nrmse = if deviation > 0.0 { rmse / deviation } else { f64::NAN };
    Score { rmse, nrmse, mae: magnitudes / count }
}

fn scores<F: Family>(family: &F, fit: &Fit, (train, holdout): (&[F::Run], &[F::Run]), protocol: Protocol) -> Scores {
    let fitted: Vec<&F::Run> = train.iter().collect();
    let residuals = fit.residuals(family, &fitted);
    let predicted: Vec<Vec<f64>> = fitted
        .iter()
        .zip(residuals)
        .map(|(run, residual)| family.measured(run).iter().zip(residual).map(|(m, r)| m - r).collect())
        .collect();
    let held_out: Vec<&F::Run> = holdout.iter().collect();
    Scores {
        train: score(family, &fitted, &predicted),
        holdout: score(family, &held_out, &free_runs(family, &fit.structure, holdout, protocol)),
    }
}

fn assemble<F: Family>(
    Assemble { task, mut notes, names_only, progress }: Assemble<'_>,
    family: &F,
    train: &[F::Run],
    holdout: &[F::Run],
) -> Result<Identified, IdentifyError> {
    let started = Instant::now();
    let rounds = std::sync::atomic::AtomicUsize::new(0);
    let tell = |step: &str| {
        let round = rounds.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        // The number of rounds is unknown in advance: each takes a fixed share of the remaining progress.
        progress(Progress { step: step.to_owned(), share: 1.0 - 0.85_f64.powi(i32::try_from(round).unwrap_or(99)) });
    };
    let until = task.budget.map(|budget| started + budget.mul_f64(SEARCHING));
    let found = search_within(family, train, &tell, Limits { until, names_only });
    notes.extend(family.known());
    // A curve has enough freedom to reproduce a fault of the recordings.
    if names_only {
        notes.push(
            "effects without a name were not looked for: they would learn what is wrong with the recordings".to_owned(),
        );
    }
    if found.is_cut_short {
        notes
            .push("the time limit was reached before every effect had been tried: allow more with --budget".to_owned());
    }
    if !found.base.cost.is_finite() {
        return Err(IdentifyError::NoFit { why: "no values of its parameters give a finite free run" });
    }
    let fitted: Vec<&F::Run> = train.iter().collect();
    let held_out: Vec<&F::Run> = holdout.iter().collect();
    let protocol = task.protocol;
    let held_out_rmse =
        |fit: &Fit| score(family, &held_out, &free_runs(family, &fit.structure, holdout, protocol)).rmse;
    // Held-out runs are scored only here, after the search has ended.
    let [baseline, last] = [&found.base, &found.last].map(|fit| scores(family, fit, (train, holdout), protocol));
    let (intervals, exchanged) = intervals(family, &found);
    notes.extend(
        exchanged
            .map(|what| format!("either way round says the same of the data, and both are in the intervals: {what}")),
    );
    let (mut parameters, terms) = family.estimates(&found.last.structure, &found.deviations, &intervals);
    let mut ladder = vec![("base model".to_owned(), baseline.holdout.rmse)];
    let mut effects = Vec::new();
    let mut before = baseline.holdout.rmse;
    // Errors of the stamps say nothing about the machine, so they are reported apart.
    let of_stamps = |parameters: &mut BTreeMap<String, Estimate>| -> Vec<(String, Estimate)> {
        let names: Vec<String> = parameters.keys().filter(|name| family.timing(name).is_some()).cloned().collect();
        names.into_iter().filter_map(|name| parameters.remove_entry(&name)).collect()
    };
    let mut timing: BTreeMap<String, Estimate> = of_stamps(&mut parameters).into_iter().collect();
    for (place, step) in found.steps.iter().enumerate() {
        // The last step is the final model, whose error is known already.
        let after = if place + 1 == found.steps.len() { last.holdout.rmse } else { held_out_rmse(&step.fit) };
        let name = name(family, &step.term);
        ladder.push((format!("+ {name}"), after));
        if let Some(stamps) = family.timing(&name) {
            timing.extend(
                terms.get(place).and_then(|values| values.values().next()).map(|one| (stamps.to_owned(), one.clone())),
            );
            before = after;
            continue;
        }
        effects.push(EffectReport {
            depends_on: depends_on(family, &step.term).iter().map(|over| over.name().to_owned()).collect(),
            parameters: terms.get(place).cloned().unwrap_or_default(),
            holdout_rmse_before: before,
            holdout_rmse_after: after,
            evidence: Evidence {
                blocked_rmse_before: step.blocked_rmse[0],
                blocked_rmse_after: step.blocked_rmse[1],
                p_value: step.p_value,
                blocks_better: step.blocks_better,
                // JSON has no infinity, the z of a term without a size.
                z: step.z.min(1e6),
            },
            rivals: step
                .rivals
                .iter()
                .map(|(index, blocked_rmse)| {
                    let rival = &family.catalogue()[*index];
                    let experiment = match &step.term {
                        Term::Known(taken) => family.catalogue()[*taken].experiment,
                        Term::Curve(_) => rival.experiment,
                    };
                    Rival {
                        name: rival.name.to_owned(),
                        blocked_rmse: *blocked_rmse,
                        experiment: experiment.to_owned(),
                    }
                })
                .collect(),
            table: table(family, &found, place),
            name,
        });
        before = after;
    }
    let (left_before, left_after) = (left(family, &found.base, &fitted), left(family, &found.last, &fitted));
    let residual = left_after.report(task.seed);
    let figures = Figures {
        ladder,
        runs: traces(family, &found, (train, holdout), protocol),
        causes: Left::causes(&left_before, &left_after),
    };
    let source = format!("r4 identify --model {}, fitted to {} runs", task.model, train.len());
    let loadable = family.loadable(&found.last.structure, &source);
    let unit = family.unit().to_owned();
    let verdict = verdict(&task.model, &unit, &effects, &baseline, &last, residual.white);
    // An output that precedes its input is not explained by it, however small the error.
    let is_early = family.is_early(&found.last.structure) && !residual.white;
    let explained = if is_early {
        Explained::Not
    } else {
        let errors = [baseline, last].map(|scores| scores.holdout.nrmse);
        Explained::of(errors, effects.iter().any(EffectReport::has_size), residual.white)
    };
    let mut report = Report {
        model: task.model.clone(),
        explained,
        suspicions: is_early.then(|| MOVES_FIRST.to_owned()).into_iter().collect(),
        unit,
        baseline,
        effects,
        last,
        parameters,
        timing,
        residual,
        rejected: found.rejected.clone(),
        notes,
        verdict,
    };
    if let Some(fault) = report.timing_fault() {
        report.verdict = format!("{}; {fault}.", report.verdict.trim_end_matches('.'));
    }
    Ok(Identified { report, figures, loadable })
}

fn name<F: Family>(family: &F, term: &Term) -> String {
    match term {
        Term::Known(index) => family.catalogue()[*index].name.to_owned(),
        Term::Curve(_) => "unknown".to_owned(),
    }
}

fn table<F: Family>(family: &F, found: &Found<F::Run>, place: usize) -> Option<Table> {
    let structure = &found.last.structure;
    let Term::Curve(curve) = structure.terms.get(place)? else { return None };
    // A gain is dimensionless; the other curves are per unit of inertia.
    let scale = if curve.acts == Acts::Gain { 1.0 } else { family.force_per_push(structure) };
    let from: usize = structure.base.len() + structure.added[..place].iter().map(Vec::len).sum::<usize>();
    let std = (0..curve.at.len())
        .map(|corner| found.deviations.get(from + corner).copied().flatten().map_or(f64::NAN, |std| std * scale))
        .collect();
    Some(Table {
        over: curve.over.name().to_owned(),
        at_unit: curve.at_unit.to_owned(),
        unit: curve.unit.to_owned(),
        at: curve.at.clone(),
        values: structure.added[place].iter().map(|value| value * scale).collect(),
        std,
    })
}

/// Suspicion if the delay of the output's stamps is at the early end of its range.
const MOVES_FIRST: &str =
    "the output moves before its input: look whether both are of one recording and stamped by one clock";

/// Largest number of runs that are plotted.
const DRAWN: usize = 6;

fn traces<F: Family>(
    family: &F,
    found: &Found<F::Run>,
    (train, holdout): (&[F::Run], &[F::Run]),
    protocol: Protocol,
) -> Vec<Traces> {
    let some = |runs: &[F::Run]| runs.iter().take(DRAWN / 2).cloned().collect::<Vec<_>>();
    let mut all = Vec::new();
    for (runs, held_out) in [(some(holdout), true), (some(train), false)] {
        let [before, after] = [&found.base, &found.last].map(|fit| free_runs(family, &fit.structure, &runs, protocol));
        for ((run, before), after) in runs.iter().zip(before).zip(after) {
            all.push(Traces {
                name: family.name(run).to_owned(),
                held_out,
                time_s: family.time_s(run).to_vec(),
                input: family.input(run),
                output: ("output".to_owned(), family.unit().to_owned()),
                measured: family.measured(run).to_vec(),
                before,
                after,
            });
        }
    }
    all
}

fn verdict(model: &str, unit: &str, effects: &[EffectReport], baseline: &Scores, last: &Scores, white: bool) -> String {
    let percent = 100.0 * last.holdout.nrmse;
    let end = if white { "the residual is white noise" } else { "the residual is not white" };
    if effects.is_empty() {
        return format!(
            "No effect found: the {model} model alone leaves {:.3e} {unit} of the held-out data ({percent:.1} %); {end}.",
            last.holdout.rmse
        );
    }
    let names: Vec<String> = effects
        .iter()
        .map(|effect| match &effect.table {
            Some(table) => format!("an effect without a name that depends on {}", table.over),
            None => effect.name.clone(),
        })
        .collect();
    let lacks = format!("The {model} model lacks {}", names.join(", then "));
    let (before, after) = (baseline.holdout.rmse, last.holdout.rmse);
    if after < before {
        format!(
            "{lacks}: with it the error on held-out data falls from {before:.3e} to {after:.3e} {unit} ({percent:.1} % of \
             what was measured); {end}."
        )
    } else {
        format!(
            "{lacks} by the data it was fitted to, but the error on held-out data does not fall ({before:.3e} to \
             {after:.3e} {unit}): do not use it; record runs that move through more of what is held out."
        )
    }
}

/// Returns the verdict for recordings that are not explained.
fn not_explained(report: &Report) -> String {
    let left = report.last.holdout.nrmse;
    let compared = if left < 1.0 { "" } else { ", no less than a constant does" };
    let alone = report.baseline.holdout.nrmse;
    let worse = if report.effects.is_empty() || left < alone {
        String::new()
    } else {
        format!(" ({:.1} % without the effects: do not use them)", 100.0 * alone)
    };
    let likely = match report.suspicions.as_slice() {
        [] => "no likely mistake in the recordings was found: look whether model, columns and units are those of the machine".to_owned(),
        [likeliest, ..] => format!("likely {likeliest}"),
    };
    format!(
        "Not explained: the {} model leaves {:.1} % of the held-out data{worse}{compared}; {likely}.",
        report.model,
        100.0 * left
    )
}

#[cfg(test)]
mod tests;
