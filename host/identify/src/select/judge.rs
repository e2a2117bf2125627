//! Acceptance of added terms: block cross-validation, significance and size.

use statrs::distribution::{ContinuousCDF, FisherSnedecor, StudentsT};

use super::{Search, Step, numbers, propose::Trial};
use crate::{
    evidence::{TOLD_APART, independent, price},
    family::{Family, Structure, Term},
    fit::{self, Effort, Fit, fit},
    parallel,
    report::Rejected,
    residual::is_resolved,
};

/// Smallest relative reduction of the cross-validated RMSE by an effect: less is of no use, and within the difference
/// of two correct programs.
pub(super) const WORTH: f64 = 0.015;
/// The same for a curve, which has many more parameters and no name.
pub(super) const CURVE_WORTH: f64 = 0.03;
/// Largest p-value, after multiplying by the number of effects tried.
const CHANCE: f64 = 0.05;
/// Smallest size of an effect in its own standard errors.
pub(super) const LEAST_Z: f64 = 3.0;
/// Smallest equivalent z from the gain in fit, at which a term needs no z of its own.
const PLAIN_Z: f64 = 12.0;
/// Relative difference of errors below which effects are rivals.
const ALIKE: f64 = 0.01;
/// Number of effects per round that are compared by block cross-validation. For half of it see `FOLLOWED` in
/// [`super::propose`].
const PROMISING: usize = 6;
/// Largest cost of these, as a multiple of the lowest one. Our choice; other values were not compared.
const IN_REACH: f64 = 2.0;
/// Number of trials that are kept because the family ranks them best. Our choice; other values were not compared.
const GUESSES: usize = 2;

/// Cross-validation errors of models that were each fitted to one half of the blocks.
#[derive(Clone, Debug)]
pub(super) struct Blocked {
    /// Mean square error of each held-out block, and its number of samples.
    pub(super) blocks: Vec<(f64, usize)>,
    /// Mean square error of the same models over whole runs, where errors that accumulate from block to block show.
    pub(super) whole: f64,
}

/// Trial with its cross-validation and standard errors.
pub(super) struct Judged {
    pub(super) trial: Trial,
    pub(super) blocked: Blocked,
    pub(super) deviations: Vec<Option<f64>>,
}

impl<F: Family> Search<'_, F> {
    /// The most promising trials, fitted to the end and judged on blocks; best first.
    pub(super) fn judge(&self, mut trials: Vec<Trial>) -> Vec<Judged> {
        trials.retain(|trial| trial.fit.cost.is_finite());
        promising(&mut trials, 2 * PROMISING);
        trials = parallel::map(trials, |Trial { term, fit: glanced, guess }| {
            let fit = fit(self.family, &self.runs, glanced.structure, glanced.initial, Effort::SCREEN);
            Trial { term, fit, guess }
        });
        promising(&mut trials, PROMISING);
        let least = trials.iter().map(|trial| trial.fit.cost).fold(f64::INFINITY, f64::min);
        trials.retain(|trial| trial.fit.cost <= IN_REACH * least);
        let mut judged = parallel::map(trials, |Trial { term, fit: screened, guess }| {
            let fit = fit(self.family, &self.runs, screened.structure, screened.initial, Effort::COMPARE);
            let blocked = self.blocked(&fit);
            let deviations = fit.deviations(self.family, &self.runs);
            Judged { trial: Trial { term, fit, guess }, blocked, deviations }
        });
        judged.sort_by(|a, b| rmse(&a.blocked).total_cmp(&rmse(&b.blocked)));
        judged
    }

    /// Computes the error of a structure on each block, fitted to the other half of the blocks.
    pub(super) fn blocked(&self, from: &Fit) -> Blocked {
        let halves = parallel::map([(0, 1), (1, 0)], |(fitted, left_out): (usize, usize)| {
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
        });
        let whole: Vec<_> = halves.iter().flat_map(|half| half.1.iter()).collect();
        let samples: usize = whole.iter().map(|run| run.1).sum();
        Blocked {
            whole: whole.iter().map(|run| run.0 * run.1 as f64).sum::<f64>() / samples.max(1) as f64,
            blocks: halves.into_iter().flat_map(|half| half.0).collect(),
        }
    }

    /// Returns the best effect that passes every test, and for each of the others the test that it failed.
    pub(super) fn choose(
        &self,
        current: &Fit,
        before: &Blocked,
        judged: Vec<Judged>,
        tried: usize,
        with_curves: bool,
    ) -> (Option<(Step, Fit)>, Vec<Rejected>) {
        let rmse_before = rmse(before);
        let mut others = Vec::new();
        let mut passed: Vec<(Judged, Step)> = Vec::new();
        // The whitest residual has the largest number of independent samples; the noise is the same for all.
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
            } else if !self.is_resolved(rmse_before, after) {
                Some("changes the output by less than the sensor resolves".to_owned())
            } else if candidate.blocked.whole > before.whole * if with_curves { 1.0 } else { 1.0 + WORTH }
                && !self.pays_over_whole_runs(current, &candidate.trial.fit)
            {
                let worse = 100.0 * ((candidate.blocked.whole / before.whole).sqrt() - 1.0);
                Some(format!("better on blocks, but {worse:.0} % worse over whole runs"))
            } else if with_curves
                && price(independent, candidate.trial.fit.cost, corners(&candidate.trial.fit))
                    >= price(independent, current.cost, 0)
            {
                Some(format!("explains too little for a curve of {} corners", corners(&candidate.trial.fit)))
            } else if p_value >= CHANCE {
                Some(format!("not more than chance (p = {p_value:.2})"))
            } else if z < LEAST_Z {
                Some(format!("its size is {z:.1} standard deviations from none"))
            } else {
                None
            };
            if let Some(reason) = reason {
                others.push(Rejected { name, blocked_rmse: after, reason });
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
        // Of those as good as the best, the one with the lowest information criterion wins. A term with fewer
        // parameters counts as as good if it explains more of the fitted data and the held-out blocks do not
        // distinguish it from the best: a single block in which a model sticks and the axis did not would outweigh
        // all others.
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
                term => others.push(Rejected {
                    name: self.term_name(&term),
                    blocked_rmse: its.blocked_rmse[1],
                    reason: "explains less".to_owned(),
                }),
            }
        }
        others.sort_by(|a, b| a.blocked_rmse.total_cmp(&b.blocked_rmse));
        (Some((step, winner.trial.fit)), others)
    }

    /// Returns whether a gain in RMSE is noticeable beside the sensor's resolution.
    pub(super) fn is_resolved(&self, before: f64, after: f64) -> bool {
        is_resolved(self.family, &self.whole, [before, after].map(|rmse| rmse * rmse))
    }

    /// Whether a model explains whole runs better than another when both are fitted to them. Half of the blocks may lack places of a
    /// curve at which a free run over all of them goes astray.
    fn pays_over_whole_runs(&self, without: &Fit, with: &Fit) -> bool {
        let [without, with] = [without, with].map(|fit| self.on(&self.whole, fit, Effort::SCREEN));
        let samples = independent(self.family, &self.whole, &with);
        price(samples, with.cost, numbers(&with)) + TOLD_APART < price(samples, without.cost, numbers(&without))
    }

    /// Returns the p-value of a gain without the effect: by paired blocks (t-test), or by the explained variance
    /// (F-test), whichever is smaller. The former allows any noise, the latter detects an effect that shows in few
    /// blocks.
    fn chance(&self, current: &Fit, before: &Blocked, candidate: &Judged) -> f64 {
        let fit = &candidate.trial.fit;
        let independent = independent(self.family, &self.runs, fit);
        let added = corners(fit).max(1) as f64;
        let free = independent - fit.structure.base.len() as f64 - added - 2.0;
        let explained = (current.cost - fit.cost).max(0.0) / added / (fit.cost / free.max(1.0));
        let by_variance = FisherSnedecor::new(added, free.max(1.0)).map_or(1.0, |f| f.sf(explained));
        by_variance.min(paired(before, &candidate.blocked))
    }

    /// Returns the distance of the effect from its absence, in standard errors (z). An effect collinear with another
    /// number, such as one of two similar lags, has a large standard error of its own: it is then accepted by its
    /// gain in fit instead, as the equivalent z.
    pub(super) fn size(&self, without: &Fit, fit: &Fit, deviations: &[Option<f64>], place: usize) -> f64 {
        let Some(z) = self.own_size(&fit.structure, deviations, place) else { return f64::INFINITY };
        if z >= LEAST_Z {
            return z;
        }
        let explained = independent(self.family, &self.runs, fit) * (without.cost / fit.cost).ln().max(0.0);
        if explained.sqrt() >= PLAIN_Z { explained.sqrt() } else { z }
    }

    /// Returns z by the standard errors alone; `None` for a term without a size, such as a curve, whose knots are
    /// collinear with the slope and mean of the base model.
    pub(super) fn own_size(&self, structure: &Structure, deviations: &[Option<f64>], place: usize) -> Option<f64> {
        if matches!(structure.terms[place], Term::Curve(_)) {
            return None;
        }
        let parameters = fit::parameters(self.family, &structure.terms);
        let values = &structure.added[place];
        let from = structure.base.len() + structure.added[..place].iter().map(Vec::len).sum::<usize>();
        let sizes = parameters[from..].iter().zip(values).zip(&deviations[from..]);
        // Of several sizes (such as both directions) one must be significant.
        let z = sizes.filter_map(|((parameter, &value), &deviation)| parameter.deviations_off(value, deviation));
        z.reduce(f64::max)
    }
}

/// Returns the cross-validated RMSE over all held-out blocks, in the output's unit.
pub(super) fn rmse(blocked: &Blocked) -> f64 {
    let samples: usize = blocked.blocks.iter().map(|block| block.1).sum();
    (blocked.blocks.iter().map(|block| block.0 * block.1 as f64).sum::<f64>() / samples.max(1) as f64).sqrt()
}

/// Keeps the `count` trials of lowest cost, and the [`GUESSES`] that the family ranks best.
fn promising(trials: &mut Vec<Trial>, count: usize) {
    trials.sort_by(|a, b| a.guess.total_cmp(&b.guess));
    let guessed = trials.iter().take(GUESSES).take_while(|trial| trial.guess.is_finite()).count();
    let mut rest = trials.split_off(guessed);
    rest.sort_by(|a, b| a.fit.cost.total_cmp(&b.fit.cost));
    rest.truncate(count);
    trials.append(&mut rest);
}

/// Returns the number of parameters of the term that was added last.
pub(super) fn corners(fit: &Fit) -> usize {
    fit.structure.added.last().map_or(0, Vec::len)
}

/// Returns the p-value that the first's blocks are not worse than the second's, by a one-sided t-test of the
/// logarithms of their errors.
pub(super) fn paired(worse: &Blocked, better: &Blocked) -> f64 {
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
