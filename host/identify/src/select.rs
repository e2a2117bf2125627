//! Which effects the data ask for: forward selection with removal, judged on blocks that were left out of the fit.
//!
//! Each round fits every effect that is not yet in, keeps the most promising, and fits these again on one half of the
//! blocks to predict the other, and the other way round. An effect is taken if it makes the blocks' error smaller by more
//! than a trifle and by more than chance. Effects with names come first; what these leave is offered to curves.

use std::time::Instant;

use r4_maths::statistics;
use r4_plants::Dependence;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, FisherSnedecor, StudentsT};

use crate::{
    family::{Acts, Candidate, Family, Structure, Term},
    fit::{self, Effort, Fit, fit},
    residual::{is_white, largest_correlation, left},
};

/// An effect has to make the error on left-out blocks smaller by this share: less is of no use to anybody, and within
/// what two correct programs differ by.
const WORTH: f64 = 0.015;
/// The same for a curve, which has many more numbers and no name.
const CURVE_WORTH: f64 = 0.03;
/// Named effects may leave so many times what a model with curves leaves of left-out blocks: a choice of what their meaning is
/// worth.
const AS_GOOD: f64 = 1.15;
/// Where named effects leave at most this share of the output's standard deviation on left-out blocks, curves are not looked for. A curve
/// is free wherever the recordings do not go: on EMPS, of which names leave 0.29 %, curves over speed and input explain the recording
/// that they are fitted to 40 times better and another one 14 times worse. Half of it lets them in there.
const ENOUGH: f64 = 0.004;
/// What is left is not looked into further when less than this share of it is anything but noise.
const SMALL: f64 = 0.1;
/// A term whose removal costs less than this share was superfluous.
const SUPERFLUOUS: f64 = 0.004;
/// Chance, after multiplying by the number of effects tried.
const CHANCE: f64 = 0.05;
/// An effect's size in its own standard deviations.
const LEAST_Z: f64 = 3.0;
/// The same by what it explains, beyond which nothing else is asked.
const PLAIN_Z: f64 = 12.0;
/// Effects whose errors differ by less than this share are rivals.
const ALIKE: f64 = 0.01;
/// A difference in price (see [`price`]) from which on a rival is told apart: a ratio of likelihoods of 150, "very strong" in R. E.
/// Kass and A. E. Raftery, *Bayes Factors*, Journal of the American Statistical Association 90 (1995), 773-795.
pub(crate) const TOLD_APART: f64 = 10.0;
/// So many effects of each round are looked at on blocks.
const PROMISING: usize = 6;
/// A guess that leaves so many times what the best one leaves is not followed.
const HOPELESS: f64 = 5.0;
/// Number of the best guesses that are fitted by free runs. This and the next five are our choices, made for speed; other values have not
/// been compared.
const FOLLOWED: usize = 8;
/// Guesses that leave at most this multiple of what the best one leaves are fitted more closely first.
const CLOSE: f64 = 2.5;
/// Number of guesses to which a second effect is added when pairs are sought.
const FIRSTS: usize = 3;
/// Number of pairs that are fitted by free runs.
const PAIRS: usize = 4;
/// An effect leads to another if it leaves at most this share of what is left without it.
const LEADING: f64 = 0.97;
/// Of trials, those are judged on blocks that leave at most so many times what the best one leaves.
const IN_REACH: f64 = 2.0;
/// Beside these, so many that the family guesses to be best.
const GUESSES: usize = 2;
/// An effect with more starts than this is first tried as it is at each, and fitted from the nearest.
const MOST_STARTS: usize = 24;
const NEAREST: usize = 3;
const MOST_TERMS: usize = 6;
const MOST_CURVES: usize = 2;
/// Of a curve.
const MOST_CORNERS: usize = 33;
/// Blocks that the training data are cut into, about; a block has at least so many samples.
const BLOCKS: usize = 12;
const LEAST_SAMPLES: usize = 40;

/// What became of the data.
#[derive(Clone, Debug)]
pub struct Found<R> {
    /// The base model alone.
    pub base: Fit,
    /// What was added, in order; structures after each.
    pub steps: Vec<Step>,
    /// Base model and all terms.
    pub last: Fit,
    /// The last model as it was fitted, and to what: the recordings, or blocks of them.
    pub fitted: (Fit, Vec<R>),
    /// Of the last model's parameters.
    pub deviations: Vec<Option<f64>>,
    /// Tried in the last round and not taken, strongest first: name, error on blocks, why.
    pub rejected: Vec<(String, f64, String)>,
    /// The time was over before every effect had been looked for.
    pub is_cut_short: bool,
}

/// A term that was taken.
#[derive(Clone, Debug)]
pub struct Step {
    /// What.
    pub term: Term,
    /// The model with it and those terms before it that stayed, over whole runs.
    pub fit: Fit,
    /// The same as it was fitted.
    pub own: Fit,
    /// Errors on left-out blocks without and with it.
    pub blocked_rmse: [f64; 2],
    /// Chance of such a gain, times the number of effects tried.
    pub p_value: f64,
    /// Blocks that got better, of all.
    pub blocks_better: [usize; 2],
    /// Size of the effect in its standard deviations; infinite where the effect has no size.
    pub z: f64,
    /// Effects that do as well: their index, and error on blocks.
    pub rivals: Vec<(usize, f64)>,
}

/// Errors of models that were each fitted to one half of the blocks.
#[derive(Clone, Debug)]
struct Blocked {
    /// The mean square error of each block that was left out, and the samples behind it.
    blocks: Vec<(f64, usize)>,
    /// Mean square error of the same models over whole runs: what adds up from block to block shows here only.
    whole: f64,
}

fn rmse(blocked: &Blocked) -> f64 {
    let samples: usize = blocked.blocks.iter().map(|block| block.1).sum();
    (blocked.blocks.iter().map(|block| block.0 * block.1 as f64).sum::<f64>() / samples.max(1) as f64).sqrt()
}

struct Trial {
    term: Term,
    fit: Fit,
    /// What the family's guess leaves; infinite without one.
    guess: f64,
}

/// Where a fit begins: its structure, and the initial states.
type Start = (Structure, Vec<Vec<f64>>);

/// A term that may be added, with where its fit may begin.
struct Begun {
    term: Term,
    starts: Vec<Start>,
    /// What the family's guess leaves; infinite without one.
    guess: f64,
}

struct Judged {
    trial: Trial,
    blocked: Blocked,
    deviations: Vec<Option<f64>>,
}

struct Search<'s, F: Family> {
    family: &'s F,
    /// As recorded.
    whole: Vec<&'s F::Run>,
    /// What effects are looked for on: whole runs, or the blocks of both halves.
    runs: Vec<&'s F::Run>,
    halves: &'s [Vec<F::Run>; 2],
    progress: &'s (dyn Fn(&str) + Sync),
    /// When to stop looking for effects.
    until: Option<Instant>,
}

/// Searches for what the base model lacks.
///
/// On whole runs, names first, then curves for what they leave. Where that does not explain everything, the same on blocks:
/// what is missing adds up over a long free run until nothing else can be seen. Where that does not either, or it takes names
/// and curves, on blocks with a curve first: an effect that has no name makes named ones look good that it has nothing to do
/// with.
pub fn search<F: Family>(family: &F, train: &[F::Run], progress: &(dyn Fn(&str) + Sync)) -> Found<F::Run> {
    search_within(family, train, progress, Limits::default())
}

/// What a search leaves out.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Limits {
    /// A moment after which no further effect is looked for. What is found then depends on how fast the machine is.
    pub(crate) until: Option<Instant>,
    /// No curves: of a faulty recording, they would learn its fault.
    pub(crate) names_only: bool,
}

/// The same within limits.
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
        is_white(&left) || largest_correlation(&left) < SMALL
    };
    let base_on_blocks = std::cell::LazyCell::new(|| on_blocks.on(&blocks, &base, Effort::COMPARE));
    for order in orders {
        // A name beside a curve may only mend what was learned after it.
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
        let rejected = path.steps.iter().filter(|step| matches!(step.term, Term::Curve(_))).map(|step| {
            let reason = "left-out blocks are not clearly better off than with named effects alone";
            (search.term_name(&step.term), step.blocked_rmse[1], reason.to_owned())
        });
        path = Path { rejected: rejected.chain(named.rejected).collect(), ..*named };
    }
    Found { is_cut_short: search.is_over(), ..search.told(path, &base, train, &blocks) }
}

/// The base model alone, fitted to whole recordings.
pub(crate) fn base<F: Family>(family: &F, train: &[F::Run]) -> Fit {
    let whole: Vec<&F::Run> = train.iter().collect();
    let halves = &[Vec::new(), Vec::new()];
    Search { family, whole: whole.clone(), runs: whole, halves, progress: &|_| (), until: None }.base()
}

impl<F: Family> Search<'_, F> {
    /// A path with its numbers as they are told.
    fn told(&self, path: Path, base: &Fit, train: &[F::Run], blocks: &[&F::Run]) -> Found<F::Run> {
        let Path { mut current, mut steps, mut rejected, .. } = path;
        let drifts = self.drifts(&current);
        let runs = if drifts { blocks } else { &self.whole };
        if drifts {
            current = self.on(runs, &current, Effort::COMPARE);
        }
        self.prune(runs, &mut current, &mut steps, &mut rejected);
        for (place, step) in steps.iter_mut().enumerate() {
            // Terms that came before may have been taken out since.
            let mut first = current.structure.clone();
            first.terms.truncate(place + 1);
            first.added.truncate(place + 1);
            step.own = fit(self.family, runs, first, current.initial.clone(), Effort::FULL);
            step.fit = step.own.over(self.family, &self.whole);
        }
        let runs = runs.iter().copied().cloned().collect();
        Found::of(self.family, base.clone(), steps, rejected, (train, runs))
    }
}

impl<R> Found<R> {
    /// What a base model and the terms that were taken come to; `runs` are the recordings, and what terms were fitted to.
    fn of<F: Family<Run = R>>(
        family: &F,
        base: Fit,
        steps: Vec<Step>,
        rejected: Vec<(String, f64, String)>,
        (train, runs): (&[R], Vec<R>),
    ) -> Self
    where
        R: Clone,
    {
        let (last, fitted) = match steps.last() {
            Some(step) => (step.fit.clone(), (step.own.clone(), runs)),
            None => (base.clone(), (base.clone(), train.to_vec())),
        };
        let deviations = fitted.0.deviations(family, &fitted.1.iter().collect::<Vec<_>>());
        Self { base, steps, last, fitted, deviations, rejected, is_cut_short: false }
    }
}

/// How far a search has come.
#[derive(Clone)]
struct Path {
    current: Fit,
    steps: Vec<Step>,
    rejected: Vec<(String, f64, String)>,
    /// What named effects alone came to, if there are curves.
    named: Option<Box<Path>>,
}

impl Path {
    fn has_curves(&self) -> bool {
        self.current.structure.curves().next().is_some()
    }
}

/// Blocks of all runs, alternately in one half and the other. Whole runs where there are many.
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
        // So that the same part of every run is not always in the same half.
        next += usize::from(blocks % 2 == 0);
    }
    halves
}

impl<F: Family> Search<'_, F> {
    /// Takes all it can of named effects (`false`) and of curves, in turn; of curves that come first, one. Where the first
    /// turn gives no curve, it ends.
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

    /// Whether a model leaves nothing to explain: its residual is white, and depends on nothing that the family can name.
    fn is_noise(&self, current: &Fit) -> bool {
        // Only of what goes on from sample to sample does a white residual say anything.
        has_memory(current)
            && is_white(&current.residuals(self.family, &self.runs))
            && left(self.family, current, &self.runs).report(0).unexplained.is_empty()
    }

    /// Takes the best of all named effects, or of all curves, if one passes and there is time.
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
        let firsts = best_guesses(&begun);
        let judged = self.judge(self.tried(begun));
        if self.is_over() {
            // Not every effect was tried: the best of those that were is not the best.
            return false;
        }
        let (taken, rejected) = self.choose(&path.current, &blocked, judged, tried, with_curves);
        let is_explained = taken.as_ref().is_some_and(|(_, fit)| self.is_noise(fit));
        if !with_curves && !is_explained && path.steps.len() + 1 < MOST_TERMS {
            let alone = taken.as_ref().map_or(&path.current, |(_, fit)| fit);
            let pair = self.pair(&path.current, alone, &blocked, firsts);
            if let Some((steps, fit)) = pair {
                path.steps.extend(steps);
                path.current = fit;
                self.simplify(path);
                self.remove(&mut path.current, &mut path.steps);
                return true;
            }
        }
        path.rejected.retain(|(name, ..)| !rejected.iter().any(|(other, ..)| other == name));
        path.rejected.extend(rejected);
        path.rejected.sort_by(|a, b| a.1.total_cmp(&b.1));
        let Some((step, fit)) = taken else { return false };
        if with_curves && curves == 0 && !path.steps.is_empty() {
            path.named = Some(Box::new(path.clone()));
        }
        let name = self.term_name(&step.term);
        path.rejected.retain(|(other, ..)| *other != name);
        path.steps.push(step);
        path.current = fit;
        if with_curves {
            self.sharpen(path);
        }
        self.simplify(path);
        self.remove(&mut path.current, &mut path.steps);
        true
    }

    /// Two effects at once that explain clearly more than the best one alone: what two effects do together can look like
    /// neither of them. They are sought without free runs, where what is missing does not add up.
    fn pair(&self, current: &Fit, alone: &Fit, before: &Blocked, firsts: Vec<Structure>) -> Option<([Step; 2], Fit)> {
        let mut pairs: Vec<(f64, Structure)> = firsts
            .into_iter()
            .flat_map(|first| {
                let with_first = Fit::at(self.family, &self.runs, first, current.initial.clone());
                let seconds = self.effects(&with_first);
                let guessed = seconds.into_iter().filter(|one| one.guess.is_finite());
                guessed.map(|one| (one.guess, one.starts[0].0.clone())).collect::<Vec<_>>()
            })
            .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Each pair once, in the order that is guessed to be better.
        let mut seen: Vec<Vec<Term>> = Vec::new();
        pairs.retain(|(_, structure)| {
            let added = &structure.terms[structure.terms.len() - 2..];
            let reversed: Vec<Term> = added.iter().rev().cloned().collect();
            let new = !seen.iter().any(|terms| terms[..] == *added || *terms == reversed);
            seen.push(added.to_vec());
            new
        });
        pairs.truncate(PAIRS);
        let fitted: Vec<Fit> = pairs
            .into_par_iter()
            .filter_map(|(_, structure)| {
                let (structure, _) = self.family.guess(vec![structure], current, &self.runs, Effort::SCREEN)?;
                let initial = self.settled(&structure, &self.runs);
                Some(fit(self.family, &self.runs, structure, initial, Effort::SCREEN))
            })
            .collect();
        let best = fitted.into_iter().filter(|fit| fit.cost.is_finite()).min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        let best = fit(self.family, &self.runs, best.structure, best.initial, Effort::COMPARE);
        let samples = independent(self.family, &self.runs, &best);
        let [first, second] = [best.structure.terms.len() - 2, best.structure.terms.len() - 1];
        if price(samples, best.cost, numbers(&best)) + TOLD_APART >= price(samples, alone.cost, numbers(alone)) {
            return None;
        }
        let blocked = self.blocked(&best);
        let [left, left_alone] = [rmse(&blocked), rmse(&self.blocked(alone))];
        if left.is_nan() || left > left_alone * (1.0 - WORTH) || blocked.whole > before.whole * (1.0 + WORTH) {
            return None;
        }
        // Each has to be worth it beside the other.
        let deviations = best.deviations(self.family, &self.runs);
        let step = |place: usize| {
            let mut without = best.structure.clone();
            without.terms.remove(place);
            without.added.remove(place);
            let without = fit(self.family, &self.runs, without, best.initial.clone(), Effort::SCREEN);
            let left_without = self.blocked(&without);
            let worth = rmse(&left_without) * (1.0 - WORTH) >= left;
            let z = self.size(&without, &best, &deviations, place);
            let better =
                left_without.blocks.iter().zip(&blocked.blocks).filter(|(before, after)| after.0 < before.0).count();
            let mut with = best.clone();
            with.structure.terms.truncate(place + 1);
            with.structure.added.truncate(place + 1);
            let step = Step {
                term: best.structure.terms[place].clone(),
                fit: with.clone(),
                own: with,
                blocked_rmse: [rmse(&left_without), left],
                p_value: paired(&left_without, &blocked),
                blocks_better: [better, blocked.blocks.len()],
                z,
                rivals: vec![],
            };
            (worth && z >= LEAST_Z).then_some(step)
        };
        Some(([step(first)?, step(second)?], best))
    }

    /// Halves the distances between the corners of the curve that was added last while that pays: without free runs, fewer were seen to.
    fn sharpen(&self, path: &mut Path) {
        while !self.is_noise(&path.current) {
            let mut finer = path.current.structure.clone();
            let (Some(Term::Curve(curve)), Some(values)) = (finer.terms.last_mut(), finer.added.last_mut()) else {
                return;
            };
            let spline = curve.spline(values);
            *curve = curve.halved();
            *values = curve.at.iter().map(|&at| spline.value(at)).collect();
            if values.len() > MOST_CORNERS {
                return;
            }
            let term = finer.terms.last().cloned();
            let other = fit(self.family, &self.runs, finer, path.current.initial.clone(), Effort::COMPARE);
            let samples = independent(self.family, &self.runs, &other);
            let price_of = |fit: &Fit| price(samples, fit.cost, numbers(fit));
            let (before, after) = (self.blocked(&path.current), self.blocked(&other));
            let is_better = rmse(&after) < rmse(&before) * (1.0 - CURVE_WORTH) && after.whole <= before.whole;
            if !is_better || price_of(&other) >= price_of(&path.current) {
                return;
            }
            if let (Some(step), Some(term)) = (path.steps.last_mut(), term) {
                step.term = term;
                step.blocked_rmse[1] = rmse(&after);
                (step.fit, step.own) = (other.clone(), other.clone());
            }
            path.current = other;
        }
    }

    /// Exchanges terms for simpler ones that explain as much.
    fn simplify(&self, path: &mut Path) {
        for place in 0..path.steps.len() {
            for (term, values) in self.family.simpler(&path.current.structure, place) {
                let mut structure = path.current.structure.clone();
                (structure.terms[place], structure.added[place]) = (term.clone(), values);
                let other = fit(self.family, &self.runs, structure, path.current.initial.clone(), Effort::COMPARE);
                let samples = independent(self.family, &self.runs, &path.current);
                let price_of = |fit: &Fit| price(samples, fit.cost, numbers(fit));
                if price_of(&other) < price_of(&path.current) {
                    path.steps[place].term = term;
                    path.current = other;
                }
            }
        }
        self.merge(path);
    }

    /// Exchanges two terms for one from which the data do not tell them apart.
    fn merge(&self, path: &mut Path) {
        let Some(([place, gone], term, values)) = self.family.merged(&path.current.structure) else { return };
        let mut structure = path.current.structure.clone();
        (structure.terms[place], structure.added[place]) = (term.clone(), values);
        structure.terms.remove(gone);
        structure.added.remove(gone);
        let other = fit(self.family, &self.runs, structure, path.current.initial.clone(), Effort::COMPARE);
        let samples = independent(self.family, &self.runs, &path.current);
        let price_of = |fit: &Fit| price(samples, fit.cost, numbers(fit));
        if price_of(&other) < price_of(&path.current) + TOLD_APART {
            path.steps.remove(gone);
            path.steps[place].term = term;
            path.current = other;
        }
    }

    /// Whether a path that began with a curve explains the data better, or as well with less. Numbers that it has more than
    /// the other have to pay over whole runs: a recording that repeats itself looks alike on all blocks.
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

    /// Whether named effects leave so little of left-out blocks that a curve is not worth having.
    fn is_enough(&self, path: &Path) -> bool {
        let measured = self.whole.iter().flat_map(|run| self.family.measured(run)).copied();
        let measured: Vec<f64> = measured.filter(|value| value.is_finite()).collect();
        let Ok(deviation) = statistics::standard_deviation(&measured) else { return true };
        !path.steps.is_empty() && !path.has_curves() && rmse(&self.blocked(&path.current)) <= ENOUGH * deviation
    }

    /// Whether named effects alone explain left-out blocks as well as a model with curves.
    fn is_as_good(&self, named: &Path, with_curves: &Path) -> bool {
        let left = |path: &Path| rmse(&self.blocked(&path.current));
        !named.steps.is_empty() && left(named) <= AS_GOOD * left(with_curves)
    }

    /// The same model fitted to other runs.
    fn on(&self, runs: &[&F::Run], from: &Fit, effort: Effort) -> Fit {
        fit(self.family, runs, from.structure.clone(), self.settled(&from.structure, runs), effort)
    }

    /// Whether what a model lacks adds up over a free run: its numbers are then those of blocks, each of which begins anew.
    fn drifts(&self, fit: &Fit) -> bool {
        has_memory(fit) && !is_white(&fit.residuals(self.family, &self.whole))
    }

    fn settled(&self, structure: &Structure, runs: &[&F::Run]) -> Vec<Vec<f64>> {
        runs.iter().map(|run| fit::settle(self.family, structure, run, self.family.measured(run).len())).collect()
    }

    fn base(&self) -> Fit {
        let starts = self.family.starts(&self.whole);
        let initial = fit::guessed(self.family, &self.whole);
        let structure = |base: &Vec<f64>| Structure { base: base.clone(), ..Structure::default() };
        let screened: Vec<Fit> = starts
            .par_iter()
            .map(|start| fit(self.family, &self.whole, structure(start), initial.clone(), Effort::SCREEN))
            .collect();
        let best = screened.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost));
        let (structure, initial) = best.map_or_else(
            || (structure(&vec![1.0; self.family.base().len()]), initial),
            |best| (best.structure, best.initial),
        );
        fit(self.family, &self.whole, structure, initial, Effort::FULL)
    }

    fn with(&self, current: &Fit, term: Term, values: &[f64]) -> Structure {
        let mut structure = self.family.movable(current.structure.clone());
        structure.terms.push(term);
        structure.added.push(values.to_vec());
        structure
    }

    /// Every effect that may be added, with where its fit begins.
    fn effects(&self, current: &Fit) -> Vec<Begun> {
        let without = self.guess(vec![current.structure.clone()], current, Effort::GLANCE).map(|(_, left)| left);
        let is_led = |(_, candidate): &(usize, &Candidate)| candidate.led_by.is_some();
        let (led, others): (Vec<_>, Vec<_>) = self.open(current).into_iter().partition(is_led);
        let begun = |all: Vec<(usize, &Candidate)>| -> Vec<Begun> {
            all.into_par_iter().map(|(index, candidate)| self.begin(current, index, candidate)).collect()
        };
        let mut all = begun(others);
        let leads = |led: &Candidate| {
            let leader = all.iter().find(|one| led.led_by.is_some_and(|name| self.term_name(&one.term) == name));
            // Where nothing guesses, nothing is ruled out.
            self.family.is_late(&current.structure)
                || leader.zip(without).is_none_or(|(leader, without)| leader.guess < LEADING * without)
        };
        let led = led.into_iter().filter(|(_, candidate)| leads(candidate)).collect();
        all.extend(begun(led));
        all
    }

    /// Every effect that may be added.
    fn open(&self, current: &Fit) -> Vec<(usize, &Candidate)> {
        let catalogue = self.family.catalogue();
        let names: Vec<&str> = current
            .structure
            .terms
            .iter()
            .filter_map(|term| if let Term::Known(index) = term { Some(catalogue[*index].name) } else { None })
            .collect();
        let open = |candidate: &Candidate| {
            !names.contains(&candidate.name) && !candidate.excludes.iter().any(|name| names.contains(name))
        };
        catalogue.iter().enumerate().filter(|(_, candidate)| open(candidate)).collect()
    }

    /// Looks closer at the best guesses.
    fn refine(&self, all: &mut [Begun], current: &Fit) {
        let least = all.iter().map(|one| one.guess).fold(f64::INFINITY, f64::min);
        all.par_iter_mut().filter(|one| one.guess <= CLOSE * least).for_each(|one| {
            let starts = one.starts.iter().map(|(structure, _)| structure.clone()).collect();
            if let Some((guessed, guess)) = self.guess(starts, current, Effort::SCREEN) {
                (one.starts[0], one.guess) = (guessed, guess);
            }
        });
    }

    /// Where an effect's fit begins: where the family guesses, with the rest of the model as it guesses and as it is; else of
    /// many places, those from which it has least to go.
    fn begin(&self, current: &Fit, index: usize, candidate: &Candidate) -> Begun {
        let term = Term::Known(index);
        let with = |values: &Vec<f64>| self.with(current, term.clone(), values);
        let as_it_is = |structure| (structure, current.initial.clone());
        let mut starts: Vec<Structure> = candidate.starts.iter().map(with).collect();
        if let Some((guessed, guess)) = self.guess(starts.clone(), current, Effort::GLANCE) {
            let same_base = with(guessed.0.added.last().unwrap_or(&vec![]));
            return Begun { starts: vec![guessed, as_it_is(same_base)], guess, term };
        }
        if starts.len() > MOST_STARTS {
            let cost = |structure: &Structure| fit::cost(self.family, &self.runs, structure, &current.initial);
            let mut costs: Vec<(f64, Structure)> = starts.into_iter().map(|start| (cost(&start), start)).collect();
            costs.sort_by(|a, b| a.0.total_cmp(&b.0));
            starts = costs.into_iter().take(NEAREST).map(|(_, start)| start).collect();
        }
        Begun { starts: starts.into_iter().map(as_it_is).collect(), guess: f64::INFINITY, term }
    }

    /// What the family guesses, with initial states by how each run begins, and what the guess leaves.
    fn guess(&self, starts: Vec<Structure>, current: &Fit, effort: Effort) -> Option<(Start, f64)> {
        let (structure, guess) = self.family.guess(starts, current, &self.runs, effort)?;
        let settled = |run: &&F::Run| {
            let samples = self.family.measured(run).len();
            fit::settle(self.family, &structure, run, (samples / 4).max(LEAST_SAMPLES))
        };
        let initial = self.runs.iter().map(settled).collect();
        Some(((structure, initial), guess))
    }

    fn curves(&self, current: &Fit) -> Vec<Begun> {
        let Some(drivers) =
            self.runs.first().map(|run| self.family.drivers(&current.structure, &current.initial[0], run))
        else {
            return vec![];
        };
        drivers
            .par_iter()
            .flat_map(|driver| self.family.curves(current, (driver.over, driver.period), &self.runs))
            .filter(|curve| {
                !current.structure.curves().any(|(other, _)| (other.over, other.acts) == (curve.over, curve.acts))
            })
            .map(|curve| {
                let term = Term::Curve(curve.clone());
                let none = self.with(current, term.clone(), &vec![0.0; curve.at.len()]);
                let (guessed, guess) = self.guess(vec![none.clone()], current, Effort::SCREEN).unzip();
                let starts = guessed.into_iter().chain([(none, current.initial.clone())]).collect();
                Begun { term, starts, guess: guess.unwrap_or(f64::INFINITY) }
            })
            .collect()
    }

    /// Those that no guess rules out, fitted from each of their starts; the best fit of each.
    fn tried(&self, mut begun: Vec<Begun>) -> Vec<Trial> {
        let least = begun.iter().map(|one| one.guess).fold(f64::INFINITY, f64::min);
        begun.retain(|one| one.guess.is_infinite() || one.guess <= HOPELESS * least);
        begun.sort_by(|a, b| a.guess.total_cmp(&b.guess));
        let mut guessed = 0;
        begun.retain(|one| {
            guessed += usize::from(one.guess.is_finite());
            one.guess.is_infinite() || guessed <= FOLLOWED
        });
        let fitted = |Begun { term, starts, guess }: Begun| {
            if self.is_over() {
                return None;
            }
            let fits = starts
                .into_par_iter()
                .map(|(structure, initial)| fit(self.family, &self.runs, structure, initial, Effort::GLANCE));
            let fit = fits.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
            Some(Trial { term, fit, guess })
        };
        begun.into_par_iter().filter_map(fitted).collect()
    }

    /// The most promising trials, fitted to the end and judged on blocks; best first.
    fn judge(&self, mut trials: Vec<Trial>) -> Vec<Judged> {
        trials.retain(|trial| trial.fit.cost.is_finite());
        promising(&mut trials, 2 * PROMISING);
        trials = trials
            .into_par_iter()
            .map(|Trial { term, fit: glanced, guess }| {
                let fit = fit(self.family, &self.runs, glanced.structure, glanced.initial, Effort::SCREEN);
                Trial { term, fit, guess }
            })
            .collect();
        promising(&mut trials, PROMISING);
        let least = trials.iter().map(|trial| trial.fit.cost).fold(f64::INFINITY, f64::min);
        trials.retain(|trial| trial.fit.cost <= IN_REACH * least);
        let mut judged: Vec<Judged> = trials
            .into_par_iter()
            .map(|Trial { term, fit: screened, guess }| {
                let fit = fit(self.family, &self.runs, screened.structure, screened.initial, Effort::COMPARE);
                let blocked = self.blocked(&fit);
                let deviations = fit.deviations(self.family, &self.runs);
                Judged { trial: Trial { term, fit, guess }, blocked, deviations }
            })
            .collect();
        judged.sort_by(|a, b| rmse(&a.blocked).total_cmp(&rmse(&b.blocked)));
        judged
    }

    /// Errors of a structure on each block, fitted to the other half of the blocks.
    fn blocked(&self, from: &Fit) -> Blocked {
        let halves: Vec<_> = [(0, 1), (1, 0)]
            .par_iter()
            .map(|&(fitted, left_out)| {
                let runs: Vec<&F::Run> = self.halves[fitted].iter().collect();
                let len = |run: &F::Run| self.family.measured(run).len();
                let initial = self.settled(&from.structure, &runs);
                let refit = fit(self.family, &runs, from.structure.clone(), initial, Effort::SCREEN).structure;
                let error = |run: &F::Run, samples: usize| {
                    let residuals =
                        fit::residuals(self.family, &refit, &fit::settle(self.family, &refit, run, samples), run);
                    let known: Vec<f64> = residuals.into_iter().filter(|residual| !residual.is_nan()).collect();
                    let square: f64 = known.iter().map(|residual| residual * residual).sum();
                    (square / known.len().max(1) as f64, known.len())
                };
                let blocks: Vec<_> = self.halves[left_out].iter().map(|block| error(block, len(block))).collect();
                let whole: Vec<_> = self.whole.iter().map(|run| error(run, len(run) / 4)).collect();
                (blocks, whole)
            })
            .collect();
        let whole: Vec<_> = halves.iter().flat_map(|half| half.1.iter()).collect();
        let samples: usize = whole.iter().map(|run| run.1).sum();
        Blocked {
            whole: whole.iter().map(|run| run.0 * run.1 as f64).sum::<f64>() / samples.max(1) as f64,
            blocks: halves.into_iter().flat_map(|half| half.0).collect(),
        }
    }

    /// The best effect that passes, and what the others lacked.
    #[allow(clippy::type_complexity)]
    fn choose(
        &self,
        current: &Fit,
        before: &Blocked,
        judged: Vec<Judged>,
        tried: usize,
        with_curves: bool,
    ) -> (Option<(Step, Fit)>, Vec<(String, f64, String)>) {
        let rmse_before = rmse(before);
        let mut others = Vec::new();
        let mut passed: Vec<(Judged, Step)> = Vec::new();
        // Of the one that leaves the whitest: the noise is the same for all.
        let independent = if with_curves {
            judged.iter().map(|one| independent(self.family, &self.runs, &one.trial.fit)).fold(0.0, f64::max)
        } else {
            0.0
        };
        for candidate in judged {
            let after = rmse(&candidate.blocked);
            let name = self.term_name(&candidate.trial.term);
            let worth = if with_curves { CURVE_WORTH } else { WORTH };
            let p_value = self.chance(current, before, &candidate) * tried as f64;
            let last = candidate.trial.fit.structure.terms.len() - 1;
            let z = self.size(current, &candidate.trial.fit, &candidate.deviations, last);
            let better = before
                .blocks
                .iter()
                .zip(&candidate.blocked.blocks)
                .filter(|(before, after)| after.0 < before.0)
                .count();
            let reason = if !after.is_finite() || after > rmse_before * (1.0 - worth) {
                Some(format!("changes the error on left-out blocks by {:+.1} %", 100.0 * (after / rmse_before - 1.0)))
            } else if candidate.blocked.whole > before.whole * if with_curves { 1.0 } else { 1.0 + WORTH }
                && !self.pays_over_whole_runs(current, &candidate.trial.fit)
            {
                let worse = 100.0 * ((candidate.blocked.whole / before.whole).sqrt() - 1.0);
                Some(format!("better on blocks, but {worse:.0} % worse over whole runs"))
            } else if with_curves
                && price(independent, candidate.trial.fit.cost, corners(&candidate.trial.fit))
                    >= price(independent, current.cost, 0)
            {
                Some("explains too little for a curve of so many corners".to_owned())
            } else if p_value >= CHANCE {
                Some(format!("not more than chance (p = {p_value:.2})"))
            } else if z < LEAST_Z {
                Some(format!("its size is {z:.1} standard deviations from none"))
            } else {
                None
            };
            if let Some(reason) = reason {
                others.push((name, after, reason));
                continue;
            }
            let step = Step {
                term: candidate.trial.term.clone(),
                fit: candidate.trial.fit.clone(),
                own: candidate.trial.fit.clone(),
                blocked_rmse: [rmse_before, after],
                p_value: p_value.min(1.0),
                blocks_better: [better, before.blocks.len()],
                z,
                rivals: vec![],
            };
            passed.push((candidate, step));
        }
        if passed.is_empty() {
            return (None, others);
        }
        // Among those that do as well as the best, the one whose price is least. So does one with fewer numbers that
        // explains more of what it was fitted to, and left-out blocks do not tell from the best: one block on which a model
        // sticks where the axis did not outweighs all others.
        let (best, its) = &passed[0];
        let corners = |judged: &Judged| corners(&judged.trial.fit);
        let is_alike = |(judged, step): &(Judged, Step)| {
            let explains_more = judged.trial.fit.cost < best.trial.fit.cost && corners(judged) < corners(best);
            step.blocked_rmse[1] <= its.blocked_rmse[1] * (1.0 + ALIKE)
                || (explains_more && paired(&judged.blocked, &best.blocked) >= CHANCE)
        };
        let alike = (0..passed.len()).filter(|&place| is_alike(&passed[place]));
        let samples = passed
            .iter()
            .map(|(one, _)| self::independent(self.family, &self.runs, &one.trial.fit))
            .fold(0.0, f64::max);
        let price_of = |one: &Judged| price(samples, one.trial.fit.cost, corners(one));
        let place = alike.min_by(|&a, &b| price_of(&passed[a].0).total_cmp(&price_of(&passed[b].0))).unwrap_or(0);
        let (winner, mut step) = passed.remove(place);
        let gain = rmse_before - step.blocked_rmse[1];
        for (rival, its) in passed {
            let close = price_of(&rival) <= price_of(&winner) + TOLD_APART;
            let most = rmse_before - its.blocked_rmse[1] > 0.5 * gain;
            let told_apart = paired(&rival.blocked, &winner.blocked) < CHANCE;
            match rival.trial.term {
                Term::Known(index) if close || (most && !told_apart) => {
                    step.rivals.push((index, its.blocked_rmse[1]));
                }
                term => others.push((self.term_name(&term), its.blocked_rmse[1], "explains less".to_owned())),
            }
        }
        others.sort_by(|a, b| a.1.total_cmp(&b.1));
        (Some((step, winner.trial.fit)), others)
    }

    /// Whether a model explains whole runs better than another when both are fitted to them. Half of the blocks may lack places of a
    /// curve at which a free run over all of them goes astray.
    fn pays_over_whole_runs(&self, without: &Fit, with: &Fit) -> bool {
        let [without, with] = [without, with].map(|fit| self.on(&self.whole, fit, Effort::SCREEN));
        let samples = independent(self.family, &self.whole, &with);
        price(samples, with.cost, numbers(&with)) + TOLD_APART < price(samples, without.cost, numbers(&without))
    }

    fn term_name(&self, term: &Term) -> String {
        match term {
            Term::Known(index) => self.family.catalogue()[*index].name.to_owned(),
            Term::Curve(curve) => format!("{} over {}", curve.acts.name(), curve.over.name()),
        }
    }

    /// Chance of such a gain without the effect: by the blocks, paired, or by the variance explained (F), whichever is
    /// clearer. The former takes any noise, the latter an effect that shows in few blocks.
    fn chance(&self, current: &Fit, before: &Blocked, candidate: &Judged) -> f64 {
        let fit = &candidate.trial.fit;
        let independent = independent(self.family, &self.runs, fit);
        let added = corners(fit).max(1) as f64;
        let free = independent - fit.structure.base.len() as f64 - added - 2.0;
        let explained = (current.cost - fit.cost).max(0.0) / added / (fit.cost / free.max(1.0));
        let by_variance = FisherSnedecor::new(added, free.max(1.0)).map_or(1.0, |f| f.sf(explained));
        by_variance.min(paired(before, &candidate.blocked))
    }

    /// Distance from no effect of what tells the effect's size, in standard deviations. A size that stands in for another
    /// number, as one of two lags that are alike does, has a wide deviation on its own; that it is there all the same is told
    /// by what is left without it.
    fn size(&self, without: &Fit, fit: &Fit, deviations: &[Option<f64>], place: usize) -> f64 {
        let Some(z) = self.own_size(&fit.structure, deviations, place) else { return f64::INFINITY };
        if z >= LEAST_Z {
            return z;
        }
        let explained = independent(self.family, &self.runs, fit) * (without.cost / fit.cost).ln().max(0.0);
        if explained.sqrt() >= PLAIN_Z { explained.sqrt() } else { z }
    }

    /// The same by the standard deviations alone; `None` of what has no size. A curve has none: its corners share what the base model
    /// has too, a slope and a mean.
    fn own_size(&self, structure: &Structure, deviations: &[Option<f64>], place: usize) -> Option<f64> {
        if matches!(structure.terms[place], Term::Curve(_)) {
            return None;
        }
        let parameters = fit::parameters(self.family, &structure.terms);
        let values = &structure.added[place];
        let from = structure.base.len() + structure.added[..place].iter().map(Vec::len).sum::<usize>();
        let sizes = parameters[from..].iter().zip(values).zip(&deviations[from..]);
        // Of several sizes (both directions, for one) one must be there.
        let z = sizes.filter_map(|((parameter, &value), &deviation)| parameter.deviations_off(value, deviation));
        z.reduce(f64::max)
    }

    /// Takes out of a model fitted to runs what has no size of its own beside all others, and whose numbers do not pay.
    fn prune(
        &self,
        runs: &[&F::Run],
        current: &mut Fit,
        steps: &mut Vec<Step>,
        rejected: &mut Vec<(String, f64, String)>,
    ) {
        while steps.len() > 1 {
            let with = &*current;
            let deviations = with.deviations(self.family, runs);
            let samples = independent(self.family, runs, with);
            let price_of = |fit: &Fit| price(samples, fit.cost, numbers(fit));
            let without = (0..steps.len()).into_par_iter().filter_map(|place| {
                let z = self.own_size(&with.structure, &deviations, place);
                if z.is_some_and(|z| z >= LEAST_Z) {
                    return None;
                }
                let mut fit = with.clone();
                fit.structure.terms.remove(place);
                fit.structure.added.remove(place);
                let fit = fit::fit(self.family, runs, fit.structure, fit.initial, Effort::COMPARE);
                (price_of(&fit) <= price_of(with)).then_some((place, fit))
            });
            let cheapest = without.min_by(|a, b| price_of(&a.1).total_cmp(&price_of(&b.1)));
            let Some((place, fit)) = cheapest else { return };
            let taken = steps.remove(place);
            let reason = "nothing of it is left beside the others".to_owned();
            rejected.insert(0, (self.term_name(&taken.term), taken.blocked_rmse[1], reason));
            *current = fit;
        }
    }

    /// Takes out again what later terms made superfluous.
    fn remove(&self, current: &mut Fit, steps: &mut Vec<Step>) {
        while steps.len() > 1 {
            let with = rmse(&self.blocked(current));
            let without: Vec<(usize, Fit, f64)> = (0..steps.len() - 1)
                .into_par_iter()
                .map(|place| {
                    let mut structure = current.structure.clone();
                    structure.terms.remove(place);
                    structure.added.remove(place);
                    let fit = fit(self.family, &self.runs, structure, current.initial.clone(), Effort::SCREEN);
                    let error = rmse(&self.blocked(&fit));
                    (place, fit, error)
                })
                .collect();
            let least = without.into_iter().min_by(|a, b| a.2.total_cmp(&b.2));
            match least {
                Some((place, fit, error)) if error <= with * (1.0 + SUPERFLUOUS) => {
                    (self.progress)(&format!("without {}", self.term_name(&steps[place].term)));
                    steps.remove(place);
                    *current = fit;
                }
                _ => return,
            }
        }
    }
}

/// Keeps so many trials that explain most, and the best guesses beside them.
fn promising(trials: &mut Vec<Trial>, count: usize) {
    trials.sort_by(|a, b| a.guess.total_cmp(&b.guess));
    let guessed = trials.iter().take(GUESSES).take_while(|trial| trial.guess.is_finite()).count();
    let mut rest = trials.split_off(guessed);
    rest.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    rest.truncate(count);
    trials.append(&mut rest);
}

/// Numbers of all that was added to the base model.
fn numbers(fit: &Fit) -> usize {
    fit.structure.added.iter().map(Vec::len).sum()
}

/// Numbers of the term that was added last.
fn corners(fit: &Fit) -> usize {
    fit.structure.added.last().map_or(0, Vec::len)
}

/// The structures of the best guesses, best first.
fn best_guesses(begun: &[Begun]) -> Vec<Structure> {
    let mut guessed: Vec<&Begun> = begun.iter().filter(|one| one.guess.is_finite()).collect();
    guessed.sort_by(|a, b| a.guess.total_cmp(&b.guess));
    guessed.into_iter().take(FIRSTS).map(|one| one.starts[0].0.clone()).collect()
}

/// Whether free runs of a model begin with a state.
fn has_memory(fit: &Fit) -> bool {
    fit.initial.iter().any(|initial| !initial.is_empty())
}

/// How many independent samples say as much as those that a model was fitted to.
pub(crate) fn independent<F: Family>(family: &F, runs: &[&F::Run], fit: &Fit) -> f64 {
    let residuals = fit.residuals(family, runs);
    let samples = residuals.iter().flatten().filter(|residual| residual.is_finite()).count() as f64;
    samples / correlated(&residuals)
}

/// What a model costs, of which less is better, but for a constant: twice Schwarz's criterion for its numbers, with only as many
/// samples as are `independent`. What is left of a long free run is so correlated that any few corners would explain some of
/// it.
pub(crate) fn price(independent: f64, cost: f64, numbers: usize) -> f64 {
    independent * cost.ln() + 2.0 * numbers as f64 * independent.max(2.0).ln()
}

/// Chance that the first's blocks are not worse than the second's, by the logarithms of their errors (Student, one side).
fn paired(worse: &Blocked, better: &Blocked) -> f64 {
    let gains: Vec<f64> = worse
        .blocks
        .iter()
        .zip(&better.blocks)
        .filter(|(worse, better)| worse.0 > 0.0 && better.0 > 0.0)
        .map(|(worse, better)| (worse.0 / better.0).ln())
        .collect();
    let count = gains.len() as f64;
    if count < 3.0 {
        return 1.0;
    }
    let mean = gains.iter().sum::<f64>() / count;
    let variance = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let t = mean / (variance / count).sqrt().max(f64::MIN_POSITIVE);
    StudentsT::new(0.0, 1.0, count - 1.0).map_or(1.0, |student| student.sf(t))
}

/// How many samples say as much as one independent one: the integrated autocorrelation, up to where it first vanishes.
pub(crate) fn correlated(residuals: &[Vec<f64>]) -> f64 {
    let mut sum = 1.0;
    let variance = product(residuals, 0);
    if variance <= 0.0 {
        return 1.0;
    }
    let longest = residuals.iter().map(Vec::len).max().unwrap_or(0) / 2;
    let mut lag = 1;
    while lag < longest {
        let correlation = product(residuals, lag) / variance;
        if correlation < 0.05 {
            break;
        }
        // Far lags by strides: the sum stays right where the correlation is smooth.
        let stride = (lag / 10).max(1);
        sum += 2.0 * correlation * stride as f64;
        lag += stride;
    }
    sum
}

/// Mean product of residuals a lag apart.
pub(crate) fn product(residuals: &[Vec<f64>], lag: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for run in residuals {
        for (a, b) in run.iter().zip(run.iter().skip(lag)) {
            if a.is_finite() && b.is_finite() {
                sum += a * b;
                count += 1.0;
            }
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

/// What a term depends on, for reports.
#[must_use]
pub fn depends_on<F: Family>(family: &F, term: &Term) -> Vec<Dependence> {
    match term {
        Term::Known(index) => family.catalogue()[*index].depends_on.to_vec(),
        Term::Curve(curve) => match curve.acts {
            Acts::Push => vec![curve.over],
            // A speed has a direction.
            Acts::Friction if curve.over == Dependence::Speed => vec![curve.over],
            Acts::Friction | Acts::Settling | Acts::Hysteresis => vec![curve.over, Dependence::Direction],
            Acts::Gain => vec![curve.over, Dependence::Input],
        },
    }
}
