//! Joint search for two effects whose combination resembles neither.

use rayon::prelude::*;

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
};

/// Number of first effects to which a second one is added. Our choice, made for speed; other values were not
/// compared.
const FIRSTS: usize = 3;
/// Number of pairs that are fitted by free-run simulation. Our choice as well.
const PAIRS: usize = 4;
/// Number of first effects among those that only free-run simulation can tell, and number of pairs with each that are fitted by it. Before there
/// were any, a lag of the sensor beside friction over position was called a delay, and cogging beside a spring was lost (tuning pairs 10700005
/// and 10700026: 4.0 and 11.3 times the noise; 1.0 with these). Other values were not compared.
const UNSEEN: usize = 2;
const PAIRS_UNSEEN: usize = 3;

/// Effects to which a second one is added.
pub(super) struct Firsts {
    /// Those with a guess, with its values; best first.
    guessed: Vec<Structure>,
    /// Those without a guess, each fitted by free-run simulation; best first.
    unseen: Vec<Fit>,
}

impl Firsts {
    /// First effects by their guesses, and the best of the trials that have none.
    pub(super) fn of(guessed: Vec<Structure>, trials: &[Trial]) -> Self {
        let unguessed = trials.iter().filter(|trial| trial.guess.is_infinite() && trial.fit.cost.is_finite());
        let mut unseen: Vec<Fit> = unguessed.map(|trial| trial.fit.clone()).collect();
        unseen.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        unseen.truncate(UNSEEN);
        Self { guessed, unseen }
    }
}

impl<F: Family> Search<'_, F> {
    /// Two effects at once that explain clearly more than the best one alone: what two effects do together can look like
    /// neither of them. They are sought without free runs, where what is missing does not add up. Where such pairs leave more than noise, the
    /// first effect may also be one that only free runs can tell, such as a lag of the sensor.
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
        let best = best?;
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
        let step = |place| self.worth_it(&best, &blocked, &deviations, place);
        Some(([step(first)?, step(second)?], best))
    }

    /// A term of a model with the evidence for it beside the others; `None` where that is too little. `blocked` has the errors of the model.
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

    /// The most promising of second effects beside each of some first ones, fitted with it; `current` has neither, where they are guessed.
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
        pairs.into_par_iter().filter_map(fitted).collect()
    }
}

/// The structures of the best guesses, best first.
pub(super) fn best_guesses(begun: &[Begun]) -> Vec<Structure> {
    let mut guessed: Vec<&Begun> = begun.iter().filter(|one| one.guess.is_finite()).collect();
    guessed.sort_by(|a, b| a.guess.total_cmp(&b.guess));
    guessed.into_iter().take(FIRSTS).map(|one| one.starts[0].0.clone()).collect()
}
