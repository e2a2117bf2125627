//! What becomes of a model's terms once others stand beside them: finer, simpler, one for two, or none.

use rayon::prelude::*;

use super::{
    Path, Search,
    judge::{CURVE_WORTH, LEAST_Z, rmse},
    numbers,
};
use crate::{
    evidence::{TOLD_APART, independent, price},
    family::{Family, Term},
    fit::{Effort, Fit, fit},
    report::Rejected,
};

/// A term whose removal costs less than this share was superfluous.
const SUPERFLUOUS: f64 = 0.004;
/// Of a curve.
const MOST_CORNERS: usize = 33;

impl<F: Family> Search<'_, F> {
    /// Halves the distances between the corners of the curve that was added last while that pays: without free runs, fewer were seen to.
    pub(super) fn sharpen(&self, path: &mut Path) {
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
    pub(super) fn simplify(&self, path: &mut Path) {
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
        let other =
            fit(self.family, &self.runs, structure.without(gone), path.current.initial.clone(), Effort::COMPARE);
        let samples = independent(self.family, &self.runs, &path.current);
        let price_of = |fit: &Fit| price(samples, fit.cost, numbers(fit));
        if price_of(&other) < price_of(&path.current) + TOLD_APART {
            path.steps.remove(gone);
            path.steps[place].term = term;
            path.current = other;
        }
    }

    /// Takes out of a model fitted to runs what has no size of its own beside all others, and whose numbers do not pay.
    pub(super) fn prune(&self, runs: &[&F::Run], path: &mut Path) {
        while path.steps.len() > 1 {
            let with = &path.current;
            let deviations = with.deviations(self.family, runs);
            let samples = independent(self.family, runs, with);
            let price_of = |fit: &Fit| price(samples, fit.cost, numbers(fit));
            let without = (0..path.steps.len()).into_par_iter().filter_map(|place| {
                let z = self.own_size(&with.structure, &deviations, place);
                if z.is_some_and(|z| z >= LEAST_Z) {
                    return None;
                }
                let structure = with.structure.without(place);
                let fit = fit(self.family, runs, structure, with.initial.clone(), Effort::COMPARE);
                (price_of(&fit) <= price_of(with)).then_some((place, fit))
            });
            let cheapest = without.min_by(|a, b| price_of(&a.1).total_cmp(&price_of(&b.1)));
            let Some((place, fit)) = cheapest else { return };
            let taken = path.steps.remove(place);
            path.rejected.insert(
                0,
                Rejected {
                    name: self.term_name(&taken.term),
                    blocked_rmse: taken.blocked_rmse[1],
                    reason: "nothing of it is left beside the others".to_owned(),
                },
            );
            path.current = fit;
        }
    }

    /// Takes out again what later terms made superfluous.
    pub(super) fn remove(&self, path: &mut Path) {
        while path.steps.len() > 1 {
            let with = rmse(&self.blocked(&path.current));
            let without: Vec<(usize, Fit, f64)> = (0..path.steps.len() - 1)
                .into_par_iter()
                .map(|place| {
                    let structure = path.current.structure.without(place);
                    let fit = fit(self.family, &self.runs, structure, path.current.initial.clone(), Effort::SCREEN);
                    let error = rmse(&self.blocked(&fit));
                    (place, fit, error)
                })
                .collect();
            let least = without.into_iter().min_by(|a, b| a.2.total_cmp(&b.2));
            match least {
                Some((place, fit, error)) if error <= with * (1.0 + SUPERFLUOUS) => {
                    (self.progress)(&format!("without {}", self.term_name(&path.steps[place].term)));
                    path.steps.remove(place);
                    path.current = fit;
                }
                _ => return,
            }
        }
    }
}
