//! Joint search for two effects whose combination resembles neither.

use rayon::prelude::*;

use super::{
    Search, Step,
    judge::{Blocked, LEAST_Z, WORTH, paired, rmse},
    numbers,
    propose::Begun,
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

impl<F: Family> Search<'_, F> {
    /// Two effects at once that explain clearly more than the best one alone: what two effects do together can look like
    /// neither of them. They are sought without free runs, where what is missing does not add up.
    pub(super) fn pair(
        &self,
        current: &Fit,
        alone: &Fit,
        before: &Blocked,
        firsts: Vec<Structure>,
    ) -> Option<([Step; 2], Fit)> {
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
            let without = best.structure.without(place);
            let without = fit(self.family, &self.runs, without, best.initial.clone(), Effort::SCREEN);
            let left_without = self.blocked(&without);
            let worth = rmse(&left_without) * (1.0 - WORTH) >= left && self.is_resolved(rmse(&left_without), left);
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
}

/// The structures of the best guesses, best first.
pub(super) fn best_guesses(begun: &[Begun]) -> Vec<Structure> {
    let mut guessed: Vec<&Begun> = begun.iter().filter(|one| one.guess.is_finite()).collect();
    guessed.sort_by(|a, b| a.guess.total_cmp(&b.guess));
    guessed.into_iter().take(FIRSTS).map(|one| one.starts[0].0.clone()).collect()
}
