//! Selection of effects that the data support: forward selection with removal, by block cross-validation.
//!
//! Each round fits every effect that is not yet included (`propose`), keeps the most promising, and fits these to one
//! half of the blocks to predict the other, and vice versa (`judge`). An effect is accepted if it reduces the blocks'
//! error by more than a noticeable share and by more than chance. Where one is not enough, two are tried at once
//! (`pair`), and accepted terms are revised beside later ones (`trim`). Effects with names come first; curves may
//! explain the remaining residual.

mod judge;
mod pair;
mod propose;
mod trim;

use std::time::Instant;

use r4_maths::statistics;
use r4_plants::Dependence;

use self::{
    judge::{CURVE_WORTH, WORTH, rmse},
    pair::{Firsts, best_guesses},
};
use crate::{
    evidence::{independent, price},
    family::{Acts, Family, Structure, Term},
    fit::{self, Effort, Fit, fit},
    parallel,
    report::Rejected,
    residual::{is_rounding, is_white, largest_correlation, left},
};

/// Largest ratio of the cross-validated RMSE of named effects alone to that with curves at which the names are kept.
/// Our choice.
const AS_GOOD: f64 = 1.15;
/// Largest share of the output's standard deviation that named effects leave on held-out blocks, at which curves are
/// not tried. A curve is undetermined wherever the recordings have no data: on EMPS, of which names leave 0.29 %,
/// curves over speed and input explain the recording that they are fitted to 40 times better and another one 14 times
/// worse. Half of this limit admits them there.
const ENOUGH: f64 = 0.004;
/// Largest autocorrelation of a residual at which the search ends: about the share of its variance that is not noise.
const SMALL: f64 = 0.1;
/// Largest number of terms, and of curves among them.
const MOST_TERMS: usize = 6;
const MOST_CURVES: usize = 2;
/// Approximate number of folds for block cross-validation over all fitted recordings, and the least number of samples of each.
const BLOCKS: usize = 12;
const LEAST_SAMPLES: usize = 40;

/// Result of the search: base model plus accepted terms.
#[derive(Clone, Debug)]
pub struct Found<R> {
    /// Fit of the base model alone.
    pub base: Fit,
    /// Accepted terms, in order.
    pub steps: Vec<Step>,
    /// Fit of the base model with all accepted terms.
    pub last: Fit,
    /// Last model as it was fitted, with the runs it was fitted to: the recordings, or blocks of them.
    pub fitted: (Fit, Vec<R>),
    /// Standard errors of the last model's parameters, for values in their reported units; `None` if undetermined.
    pub deviations: Vec<Option<f64>>,
    /// Their 95 % confidence intervals.
    pub intervals: Vec<Option<[f64; 2]>>,
    /// Terms that were tried and not accepted, or removed later, in order of their error on held-out blocks.
    pub rejected: Vec<Rejected>,
    /// True if time ran out before every effect was tried.
    pub is_cut_short: bool,
}

/// Term that was accepted, with its evidence.
#[derive(Clone, Debug)]
pub struct Step {
    /// Effect of the catalogue, or curve.
    pub term: Term,
    /// Model with this term and the remaining ones before it, over whole runs.
    pub fit: Fit,
    /// The same model, over the runs that it was fitted to.
    pub own: Fit,
    /// Cross-validated RMSE without and with the term.
    pub blocked_rmse: [f64; 2],
    /// P-value of the gain, times the number of effects tried.
    pub p_value: f64,
    /// Number of blocks whose error fell, and number of all blocks.
    pub blocks_better: [usize; 2],
    /// Size of the effect in standard errors; infinite for a term without a size.
    pub z: f64,
    /// Effects that do equally well: their index, and cross-validated RMSE.
    pub rivals: Vec<(usize, f64)>,
}

struct Search<'s, F: Family> {
    family: &'s F,
    /// Whole recordings that are fitted to.
    whole: Vec<&'s F::Run>,
    /// Runs that effects are searched on: whole recordings, or the blocks of both halves.
    runs: Vec<&'s F::Run>,
    halves: &'s [Vec<F::Run>; 2],
    progress: &'s (dyn Fn(&str) + Sync),
    /// Time at which the search ends; `None` for no limit.
    until: Option<Instant>,
}

/// Limits of a search.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Limits {
    /// Time after which no further effect is tried; the result then depends on the speed of the machine.
    pub(crate) until: Option<Instant>,
    /// True to try no curves, which would learn the fault of a faulty recording.
    pub(crate) names_only: bool,
}

impl<R> Found<R> {
    /// Assembles the result of a search: base model plus accepted terms; `runs` are those that the last model was
    /// fitted to.
    fn of<F: Family<Run = R>>(
        family: &F,
        base: Fit,
        mut steps: Vec<Step>,
        rejected: Vec<Rejected>,
        (train, runs): (&[R], Vec<R>),
    ) -> Self
    where
        R: Clone,
    {
        let (own, runs) = match steps.last() {
            Some(step) => (step.own.clone(), runs),
            None => (base.clone(), train.to_vec()),
        };
        let fitted: Vec<&R> = runs.iter().collect();
        let before = own.cost;
        let (own, mut intervals) = own.with_intervals(family, &fitted);
        let mut deviations = own.deviations(family, &fitted);
        // A reported force is a product with the inertia, whose error is often smaller than that of a factor.
        let errors = own.unit_errors(family, &fitted);
        let ranges = fit::parameters(family, &own.structure.terms).into_iter().map(|parameter| parameter.range);
        let values = own.structure.base.iter().chain(own.structure.added.iter().flatten());
        for (((error, range), &value), (deviation, interval)) in
            errors.into_iter().zip(ranges).zip(values).zip(deviations.iter_mut().zip(&mut intervals))
        {
            *deviation = deviation.map(|deviation| deviation * error);
            *interval = interval.map(|ends| range.stretched(value, ends, error));
        }
        let (base, last) = match steps.last_mut() {
            Some(step) => {
                if own.cost < before {
                    step.fit = own.over(family, &train.iter().collect::<Vec<_>>());
                    step.own = own.clone();
                }
                (base, step.fit.clone())
            }
            None => (own.clone(), own.clone()),
        };
        Self { base, steps, last, fitted: (own, runs), deviations, intervals, rejected, is_cut_short: false }
    }
}

/// State of a search.
#[derive(Clone)]
struct Path {
    current: Fit,
    steps: Vec<Step>,
    rejected: Vec<Rejected>,
    /// State with named effects alone, if there are curves.
    named: Option<Box<Path>>,
}

impl Path {
    fn has_curves(&self) -> bool {
        self.current.structure.curves().next().is_some()
    }
}

/// Searches for effects missing from the base model.
///
/// First on whole runs, with named effects, then curves for their residual. If that does not explain everything, the
/// search is repeated on blocks: a missing effect accumulates over a long free-run simulation until nothing else is
/// visible. If that does not help either, or if it accepts both names and curves, on blocks with a curve first: an
/// effect without a name is otherwise partly explained by unrelated named ones.
pub fn search<F: Family>(family: &F, train: &[F::Run], progress: &(dyn Fn(&str) + Sync)) -> Found<F::Run> {
    search_within(family, train, progress, Limits::default())
}

/// Searches as [`search`] does, within limits.
pub(crate) fn search_within<F: Family>(
    family: &F,
    train: &[F::Run],
    progress: &(dyn Fn(&str) + Sync),
    Limits { until, names_only }: Limits,
) -> Found<F::Run> {
    let halves = halves(family, train);
    let (whole, blocks): (Vec<_>, Vec<_>) = (train.iter().collect(), halves.iter().flatten().collect());
    let search = Search { family, whole: whole.clone(), runs: whole, halves: &halves, progress, until };
    let on_blocks = Search { runs: blocks.clone(), whole: search.whole.clone(), ..search };
    progress("base model");
    let base = search.base();
    let orders: &[&[bool]] = if names_only { &[&[false]] } else { &[&[false, true], &[true, false, true]] };
    let mut path = search.path(base.clone(), orders[0]);
    let is_explained = |path: &Path| {
        let left = path.current.residuals(family, &search.whole);
        is_white(&left) || is_rounding(family, &left, &search.whole) || largest_correlation(&left) < SMALL
    };
    let base_on_blocks = std::cell::LazyCell::new(|| on_blocks.on(&blocks, &base, Effort::COMPARE));
    for order in orders {
        // A named effect beside a curve may only correct what the curve absorbed.
        let is_mixed = path.has_curves() && path.current.structure.curves().count() < path.steps.len();
        if search.is_over() || (is_explained(&path) || order[0] && search.is_enough(&path)) && !(order[0] && is_mixed) {
            continue;
        }
        let other = on_blocks.path(base_on_blocks.clone(), order);
        if !other.steps.is_empty() && search.prefers(&path, &other) {
            let before = std::mem::replace(&mut path, other);
            if path.named.is_none() && path.has_curves() {
                path.named = if before.has_curves() { before.named } else { Some(Box::new(before)) };
            }
            path.current = search.on(&search.whole, &path.current, Effort::COMPARE);
            if let Some(named) = &mut path.named {
                named.current = search.on(&search.whole, &named.current, Effort::COMPARE);
            }
        }
    }
    progress("whole runs");
    if let Some(named) = path.named.take().filter(|named| search.is_as_good(named, &path)) {
        let rejected = path.steps.iter().filter(|step| matches!(step.term, Term::Curve(_))).map(|step| Rejected {
            name: search.term_name(&step.term),
            blocked_rmse: step.blocked_rmse[1],
            reason: "left-out blocks are not clearly better off than with named effects alone".to_owned(),
        });
        path = Path { rejected: rejected.chain(named.rejected).collect(), ..*named };
    }
    Found { is_cut_short: search.is_over(), ..search.told(path, &base, train, &blocks) }
}

/// Fits the base model alone to whole recordings.
pub(crate) fn base<F: Family>(family: &F, train: &[F::Run]) -> Fit {
    let whole: Vec<&F::Run> = train.iter().collect();
    let halves = &[Vec::new(), Vec::new()];
    Search { family, whole: whole.clone(), runs: whole, halves, progress: &|_| (), until: None }.base()
}

/// Returns blocks of all runs, alternately in one half and the other; whole runs if there are many.
fn halves<F: Family>(family: &F, runs: &[F::Run]) -> [Vec<F::Run>; 2] {
    let mut halves = [Vec::new(), Vec::new()];
    let each = if runs.len() >= BLOCKS { 1 } else { BLOCKS.div_ceil(runs.len().max(1)) };
    let mut next = 0;
    for run in runs {
        let samples = family.measured(run).len();
        let blocks = family.blocks(run).unwrap_or(each.min(samples / LEAST_SAMPLES)).max(1);
        for block in 0..blocks {
            let part = family.part(run, block * samples / blocks, (block + 1) * samples / blocks);
            halves[next % 2].push(part);
            next += 1;
        }
        // The same part of every run must not always be in the same half.
        next += usize::from(blocks % 2 == 0);
    }
    halves
}

/// Returns the number of all parameters that were added to the base model.
fn numbers(fit: &Fit) -> usize {
    fit.structure.added.iter().map(Vec::len).sum()
}

/// Returns whether the model has an initial state, that is memory.
fn has_memory(fit: &Fit) -> bool {
    fit.initial.iter().any(|initial| !initial.is_empty())
}

/// Returns the quantities that a term depends on, for reports.
#[must_use]
pub fn depends_on<F: Family>(family: &F, term: &Term) -> Vec<Dependence> {
    match term {
        Term::Known(index) => family.catalogue()[*index].depends_on.to_vec(),
        Term::Curve(curve) => match curve.acts {
            Acts::Push => vec![curve.over],
            // A speed has a direction already.
            Acts::Friction if curve.over == Dependence::Speed => vec![curve.over],
            Acts::Friction | Acts::Settling | Acts::Hysteresis => vec![curve.over, Dependence::Direction],
            Acts::Gain => vec![curve.over, Dependence::Input],
        },
    }
}

impl<F: Family> Search<'_, F> {
    /// Returns the result of the search, with the reported parameters fitted with full effort, to blocks if the
    /// residual drifts.
    fn told(&self, mut path: Path, base: &Fit, train: &[F::Run], blocks: &[&F::Run]) -> Found<F::Run> {
        let drifts = self.drifts(&path.current);
        let runs = if drifts { blocks } else { &self.whole };
        if drifts {
            path.current = self.on(runs, &path.current, Effort::COMPARE);
        }
        self.prune(runs, &mut path);
        let Path { current, mut steps, rejected, .. } = path;
        for (place, step) in steps.iter_mut().enumerate() {
            // Earlier terms may have been removed since, so each structure is cut from the last one.
            let mut first = current.structure.clone();
            first.terms.truncate(place + 1);
            first.added.truncate(place + 1);
            let initial = if first == current.structure { current.initial.clone() } else { self.settled(&first, runs) };
            step.own = fit(self.family, runs, first, initial, Effort::FULL);
            step.fit = step.own.over(self.family, &self.whole);
        }
        (self.progress)("intervals");
        let runs = runs.iter().copied().cloned().collect();
        Found::of(self.family, base.clone(), steps, rejected, (train, runs))
    }

    /// Accepts as many named effects (`false`) and curves (`true`) as possible, in turns; of curves in the first
    /// turn, one. Ends if the first turn accepts no curve.
    fn path(&self, base: Fit, order: &[bool]) -> Path {
        let mut path = Path { current: base, steps: vec![], rejected: vec![], named: None };
        for (place, &with_curves) in order.iter().enumerate() {
            if with_curves && place > 0 && self.is_enough(&path) {
                break;
            }
            while !self.is_noise(&path.current) && self.extend(&mut path, with_curves) && !(with_curves && place == 0) {
            }
            if path.steps.is_empty() && order[0] {
                break;
            }
        }
        path
    }

    fn is_over(&self) -> bool {
        self.until.is_some_and(|until| Instant::now() >= until)
    }

    /// Returns whether the residual is noise: at the sensor's resolution, or white and independent of all drivers of
    /// the family.
    fn is_noise(&self, current: &Fit) -> bool {
        // Whiteness is only meaningful for samples that follow each other in time.
        if !has_memory(current) {
            return false;
        }
        let residuals = current.residuals(self.family, &self.runs);
        is_rounding(self.family, &residuals, &self.runs)
            || is_white(&residuals) && left(self.family, current, &self.runs).report(0).unexplained.is_empty()
    }

    /// Accepts the best of all named effects, or of all curves, if one passes the tests and there is time.
    fn extend(&self, path: &mut Path, with_curves: bool) -> bool {
        let curves = path.current.structure.curves().count();
        if self.is_over() || path.steps.len() >= MOST_TERMS || (with_curves && curves >= MOST_CURVES) {
            return false;
        }
        let round = path.steps.len() + 1;
        (self.progress)(&format!("{} {round}", if with_curves { "curve" } else { "effect" }));
        let blocked = self.blocked(&path.current);
        let begun = if with_curves {
            self.curves(&path.current)
        } else {
            let mut begun = self.effects(&path.current);
            self.refine(&mut begun, &path.current);
            begun
        };
        let tried = begun.len();
        let guessed = best_guesses(&begun);
        let trials = self.tried(begun);
        let firsts = Firsts::of(guessed, &trials);
        let judged = self.judge(trials);
        if self.is_over() {
            // Not every effect was tried, so the best of them may not be the best of all.
            return false;
        }
        let (taken, rejected) = self.choose(&path.current, &blocked, judged, tried, with_curves);
        let is_explained = taken.as_ref().is_some_and(|(_, fit)| self.is_noise(fit));
        // Of 19 rounds after the first accepted term, 1 accepted a pair (tuning pairs 10560000 to 10560011, plants
        // 930000 to 930005): two names for an effect that has none.
        if !with_curves && !is_explained && path.steps.is_empty() {
            let alone = taken.as_ref().map_or(&path.current, |(_, fit)| fit);
            let pair = self.pair(&path.current, alone, &blocked, firsts);
            if let Some((steps, fit)) = pair {
                path.steps.extend(steps);
                path.current = fit;
                self.restart(path);
                self.simplify(path);
                self.remove(path);
                return true;
            }
        }
        path.rejected.retain(|one| !rejected.iter().any(|other| other.name == one.name));
        path.rejected.extend(rejected);
        path.rejected.sort_by(|a, b| a.blocked_rmse.total_cmp(&b.blocked_rmse));
        let Some((step, fit)) = taken else { return false };
        if with_curves && curves == 0 && !path.steps.is_empty() {
            path.named = Some(Box::new(path.clone()));
        }
        let name = self.term_name(&step.term);
        path.rejected.retain(|one| one.name != name);
        path.steps.push(step);
        path.current = fit;
        if with_curves {
            self.sharpen(path);
        } else {
            self.restart(path);
        }
        self.simplify(path);
        self.remove(path);
        true
    }

    /// Returns whether a path that began with a curve explains the data better, or equally well with less. Additional
    /// parameters must pay their complexity penalty over whole runs: the blocks of a periodic recording all look
    /// alike.
    fn prefers(&self, named: &Path, other: &Path) -> bool {
        let (first, second) = (self.blocked(&named.current), self.blocked(&other.current));
        let better = rmse(&second) < rmse(&first) * (1.0 - CURVE_WORTH);
        let simpler = other.steps.len() < named.steps.len() && rmse(&second) < rmse(&first) * (1.0 + CURVE_WORTH);
        if !(better || simpler) || second.whole > first.whole * (1.0 + WORTH) {
            return false;
        }
        let more = numbers(&other.current).saturating_sub(numbers(&named.current));
        let whole = self.on(&self.whole, &other.current, Effort::FULL);
        let independent = independent(self.family, &self.whole, &whole);
        more == 0 || price(independent, whole.cost, more) < price(independent, named.current.cost, 0)
    }

    /// Returns whether named effects leave so little error on held-out blocks that a curve is not needed.
    fn is_enough(&self, path: &Path) -> bool {
        let measured = self.whole.iter().flat_map(|run| self.family.measured(run)).copied();
        let measured: Vec<f64> = measured.filter(|value| value.is_finite()).collect();
        let Ok(deviation) = statistics::standard_deviation(&measured) else { return true };
        !path.steps.is_empty() && !path.has_curves() && rmse(&self.blocked(&path.current)) <= ENOUGH * deviation
    }

    /// Returns whether named effects alone explain held-out blocks as well as a model with curves.
    fn is_as_good(&self, named: &Path, with_curves: &Path) -> bool {
        let left = |path: &Path| rmse(&self.blocked(&path.current));
        !named.steps.is_empty() && left(named) <= AS_GOOD * left(with_curves)
    }

    /// Fits the same model to other runs.
    fn on(&self, runs: &[&F::Run], from: &Fit, effort: Effort) -> Fit {
        fit(self.family, runs, from.structure.clone(), self.settled(&from.structure, runs), effort)
    }

    /// Returns whether an unmodelled effect accumulates over a free-run simulation: parameters are then fitted to
    /// blocks, each with an initial state of its own.
    fn drifts(&self, fit: &Fit) -> bool {
        let residuals = fit.residuals(self.family, &self.whole);
        has_memory(fit) && !is_white(&residuals) && !is_rounding(self.family, &residuals, &self.whole)
    }

    fn settled(&self, structure: &Structure, runs: &[&F::Run]) -> Vec<Vec<f64>> {
        runs.iter().map(|run| fit::settle(self.family, structure, run, self.family.measured(run).len())).collect()
    }

    fn base(&self) -> Fit {
        let starts: Vec<_> = self.family.starts(&self.whole).into_iter().chain(self.family.declared()).collect();
        let initial = fit::guessed(self.family, &self.whole);
        let structure = |base: &Vec<f64>| Structure { base: base.clone(), ..Structure::default() };
        let screened = parallel::map(&starts, |start| {
            fit(self.family, &self.whole, structure(start), initial.clone(), Effort::SCREEN)
        });
        let best = screened.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost));
        let (structure, initial) = best.map_or_else(
            || (structure(&vec![1.0; self.family.base().len()]), initial),
            |best| (best.structure, best.initial),
        );
        fit(self.family, &self.whole, structure, initial, Effort::FULL)
    }

    fn term_name(&self, term: &Term) -> String {
        match term {
            Term::Known(index) => self.family.catalogue()[*index].name.to_owned(),
            Term::Curve(curve) => format!("{} over {}", curve.acts.name(), curve.over.name()),
        }
    }
}
