//! Joint search for two effects whose combination resembles neither.

use super::{
    Search, Step,
    judge::{Blocked, LEAST_Z, WORTH, paired, rmse},
    numbers,
    propose::{Begun, Trial},
};
use crate::{
    evidence::{TOLD_APART, independent, price},
    family::{Family, Structure, Term},
    fit::{Effort, Fit, fit},
    parallel,
};

/// Number of first effects to which a second one is added. Our choice, made for speed; other values were not
/// compared.
const FIRSTS: usize = 3;
/// Number of pairs that are fitted by free-run simulation. Our choice as well.
const PAIRS: usize = 4;
/// Number of first effects without a guess, which only free-run simulation can evaluate, and number of pairs with each that are fitted by it.
/// Without any, a sensor lag beside friction over position was called a delay, and cogging beside a compliance was lost (tuning pairs 10700005
/// and 10700026: 4.0 and 11.3 times the noise; 1.0 with these). Other values were not compared.
const UNSEEN: usize = 2;
const PAIRS_UNSEEN: usize = 3;

/// First effects, to each of which a second one is added.
pub(super) struct Firsts {
    /// Structures with a guess, best first.
    guessed: Vec<Structure>,
    /// Fits of effects without a guess by free-run simulation, best first.
    unseen: Vec<Fit>,
}

impl Firsts {
    /// Collects the guessed first effects, and the best of the trials that have no guess.
    pub(super) fn of(guessed: Vec<Structure>, trials: &[Trial]) -> Self {
        let unguessed = trials.iter().filter(|trial| trial.guess.is_infinite() && trial.fit.cost.is_finite());
        let mut unseen: Vec<Fit> = unguessed.map(|trial| trial.fit.clone()).collect();
        unseen.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        unseen.truncate(UNSEEN);
        Self { guessed, unseen }
    }
}

impl<F: Family> Search<'_, F> {
    /// Returns two effects that together explain clearly more than the best one alone; their combination can resemble neither of them. The
    /// search is in the weak form, where missing effects do not accumulate. If its pairs leave more than noise, effects without a guess there,
    /// such as a sensor lag, are first effects as well. `None` if no pair passes every test.
    pub(super) fn pair(
        &self,
        current: &Fit,
        alone: &Fit,
        before: &Blocked,
        firsts: Firsts,
    ) -> Option<([Step; 2], Fit)> {
        if firsts.guessed.is_empty() {
            return None;
        }
        let at = |first: Structure| Fit::at(self.family, &self.runs, first, current.initial.clone());
        let guessed: Vec<Fit> = firsts.guessed.into_iter().map(at).collect();
        let least = |fits: Vec<Fit>| {
            fits.into_iter().filter(|fit| fit.cost.is_finite()).min_by(|a, b| a.cost.total_cmp(&b.cost))
        };
        let mut best = least(self.joined(&guessed, Some(current), PAIRS));
        if best.as_ref().is_none_or(|best| !self.is_noise(best)) {
            let joined = |first| self.joined(std::slice::from_ref(first), None, PAIRS_UNSEEN);
            best = least(firsts.unseen.iter().flat_map(joined).chain(best).collect());
        }
        // Where the pair of lowest cost fails a test, none of higher cost is taken: with that one, the wrong pair of a guess came back (tuning
        // pair 10700005).
        self.passing(best?, alone, before)
    }

    /// Returns the two last terms of a model with the evidence for each, and the model fitted further, if it passes every test beside `alone`,
    /// the best model with one of its terms or another one.
    fn passing(&self, model: Fit, alone: &Fit, before: &Blocked) -> Option<([Step; 2], Fit)> {
        let best = fit(self.family, &self.runs, model.structure, model.initial, Effort::COMPARE);
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
        let step = |place| self.worth_it(&best, &blocked, &deviations, place);
        Some(([step(first)?, step(second)?], best))
    }

    /// Returns a term of a model with the evidence for it beside the others, `None` if that is too little; `blocked` is the model's
    /// cross-validation.
    fn worth_it(&self, model: &Fit, blocked: &Blocked, deviations: &[Option<f64>], place: usize) -> Option<Step> {
        let without = model.structure.without(place);
        let without = fit(self.family, &self.runs, without, model.initial.clone(), Effort::SCREEN);
        let left_without = self.blocked(&without);
        let [before, after] = [rmse(&left_without), rmse(blocked)];
        let worth = before * (1.0 - WORTH) >= after && self.is_resolved(before, after);
        let z = self.size(&without, model, deviations, place);
        let better =
            left_without.blocks.iter().zip(&blocked.blocks).filter(|(before, after)| after.0 < before.0).count();
        let mut with = model.clone();
        with.structure.terms.truncate(place + 1);
        with.structure.added.truncate(place + 1);
        (worth && z >= LEAST_Z).then(|| Step {
            term: model.structure.terms[place].clone(),
            fit: with.clone(),
            own: with,
            blocked_rmse: [before, after],
            p_value: paired(&left_without, blocked),
            blocks_better: [better, blocked.blocks.len()],
            z,
            rivals: vec![],
        })
    }

    /// Returns the `count` most promising pairs of one of `firsts` and a second effect, fitted. With `current`, which has neither, both are
    /// guessed; otherwise the first keeps its fit.
    fn joined(&self, firsts: &[Fit], current: Option<&Fit>, count: usize) -> Vec<Fit> {
        let mut pairs: Vec<(f64, Structure, usize)> = (0..firsts.len())
            .flat_map(|place| {
                let seconds = self.effects(&firsts[place]);
                let guessed = seconds.into_iter().filter(|one| one.guess.is_finite());
                guessed.map(|one| (one.guess, one.starts[0].0.clone(), place)).collect::<Vec<_>>()
            })
            .collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Each pair once, in the order that is guessed to be better.
        let mut seen: Vec<Vec<Term>> = Vec::new();
        pairs.retain(|(_, structure, _)| {
            let added = &structure.terms[structure.terms.len() - 2..];
            let reversed: Vec<Term> = added.iter().rev().cloned().collect();
            let new = !seen.iter().any(|terms| terms[..] == *added || *terms == reversed);
            seen.push(added.to_vec());
            new
        });
        pairs.truncate(count);
        let fitted = |(_, structure, place): (f64, Structure, usize)| {
            let added_to = current.unwrap_or(&firsts[place]);
            let (structure, _) = self.family.guess(vec![structure], added_to, &self.runs, Effort::SCREEN)?;
            let initial = self.settled(&structure, &self.runs);
            Some(fit(self.family, &self.runs, structure, initial, Effort::SCREEN))
        };
        parallel::filter_map(pairs, fitted)
    }
}

/// Returns the structures of the best guesses, best first.
pub(super) fn best_guesses(begun: &[Begun]) -> Vec<Structure> {
    let mut guessed: Vec<&Begun> = begun.iter().filter(|one| one.guess.is_finite()).collect();
    guessed.sort_by(|a, b| a.guess.total_cmp(&b.guess));
    guessed.into_iter().take(FIRSTS).map(|one| one.starts[0].0.clone()).collect()
}
