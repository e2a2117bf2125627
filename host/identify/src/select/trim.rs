//! Revision of accepted terms beside later ones: fits from elsewhere, more knots, simpler terms, one term for two,
//! removal.

use super::{
    Path, Search,
    judge::{CURVE_WORTH, LEAST_Z, rmse},
    numbers,
};
use crate::{
    evidence::{TOLD_APART, independent, price},
    family::{Family, Structure, Term},
    fit::{Effort, Fit, fit},
    parallel,
    report::Rejected,
};

/// Largest relative increase of the cross-validated RMSE at which a term is removed.
const SUPERFLUOUS: f64 = 0.004;
/// Number of starts above which an effect keeps its values when others start again.
const MOST_STARTS: usize = 8;
/// Number of the best restarts that are fitted. A tuning pair of two lags and a sag (10550000) is found from one of
/// 24. Other values, of these three, were not compared.
const NEAREST: usize = 24;
/// Number of these that are fitted further.
const FOLLOWED: usize = 4;
/// Largest number of knots that a curve is given after it was accepted; the largest that the weak form offers.
const MOST_CORNERS: usize = 33;

impl<F: Family> Search<'_, F> {
    /// Adds knots midway between those of the curve that was added last, as long as that pays: the weak form resolves
    /// less than free-run simulation does.
    pub(super) fn sharpen(&self, path: &mut Path) {
        while !self.is_noise(&path.current) {
            let mut finer = path.current.structure.clone();
            let (Some(Term::Curve(curve)), Some(values)) = (finer.terms.last_mut(), finer.added.last_mut()) else {
                return;
            };
            let spline = curve.spline(values);
            *curve = curve.with_midpoints();
            *values = curve.at.iter().map(|&at| spline.value(at)).collect();
            if values.len() > MOST_CORNERS {
                return;
            }
            let term = Term::Curve(curve.clone());
            let Some(other) = self.preferred(path, finer, 0.0) else { return };
            let (before, after) = (self.blocked(&path.current), self.blocked(&other));
            if rmse(&after) >= rmse(&before) * (1.0 - CURVE_WORTH) || after.whole > before.whole {
                return;
            }
            let place = path.steps.len() - 1;
            path.steps[place].blocked_rmse[1] = rmse(&after);
            self.exchange(path, place, term, other);
        }
    }

    /// Fits the accepted effects again, from the catalogue's starts of the last one and of each of the others, and
    /// those of the base model: earlier values are biased by what came later, and no descent may lead back.
    pub(super) fn restart(&self, path: &mut Path) {
        if path.steps.len() < 2 || self.is_noise(&path.current) {
            return;
        }
        if let Some(other) = self.restarted(&path.current) {
            path.current = other;
        }
    }

    /// Returns the model fitted from elsewhere, if the data clearly prefer it.
    fn restarted(&self, current: &Fit) -> Option<Fit> {
        let begun = |start| Fit::at(self.family, &self.runs, start, current.initial.clone());
        let begun = parallel::map(self.elsewhere(&current.structure), begun);
        let best_fitted = |starts: Vec<Fit>, effort: Effort, count: usize| {
            let fits = parallel::map(starts, |Fit { structure, initial, .. }| {
                fit(self.family, &self.runs, structure, initial, effort)
            });
            lowest(fits, count)
        };
        let glanced = best_fitted(lowest(begun, NEAREST), Effort::GLANCE, FOLLOWED);
        let screened = best_fitted(glanced, Effort::SCREEN, 1);
        let best = best_fitted(screened, Effort::COMPARE, 1).pop()?;
        let samples = independent(self.family, &self.runs, &best);
        (price(samples, best.cost, 0) + TOLD_APART < price(samples, current.cost, 0)).then_some(best)
    }

    /// Returns structures with the last effect, each of the others beside it, and the base model at their starts.
    fn elsewhere(&self, structure: &Structure) -> Vec<Structure> {
        let starts = |place: usize| -> Vec<Vec<f64>> {
            let here = std::iter::once(structure.added[place].clone());
            let Term::Known(index) = structure.terms[place] else { return here.collect() };
            let starts = &self.family.catalogue()[index].starts;
            if starts.len() > MOST_STARTS { here.collect() } else { here.chain(starts.iter().cloned()).collect() }
        };
        let here = self.family.movable(structure.clone());
        let bases: Vec<_> = std::iter::once(here.base.clone()).chain(self.family.starts(&self.whole)).collect();
        let last = structure.terms.len() - 1;
        let mut all = Vec::new();
        for place in 0..last {
            for (own, other) in
                starts(last).iter().flat_map(|own| starts(place).into_iter().map(move |other| (own, other)))
            {
                for base in &bases {
                    let mut start = Structure { base: base.clone(), ..here.clone() };
                    (start.added[last], start.added[place]) = (own.clone(), other.clone());
                    all.push(start);
                }
            }
        }
        all
    }

    /// Exchanges terms for simpler ones that explain as much, and two for one from which the data do not tell them apart.
    pub(super) fn simplify(&self, path: &mut Path) {
        for place in 0..path.steps.len() {
            for (term, values) in self.family.simpler(&path.current.structure, place) {
                let mut structure = path.current.structure.clone();
                (structure.terms[place], structure.added[place]) = (term.clone(), values);
                if let Some(other) = self.preferred(path, structure, 0.0) {
                    self.exchange(path, place, term, other);
                }
            }
        }
        let Some(([place, gone], term, values)) = self.family.merged(&path.current.structure) else { return };
        let mut structure = path.current.structure.clone();
        (structure.terms[place], structure.added[place]) = (term.clone(), values);
        if let Some(other) = self.preferred(path, structure.without(gone), TOLD_APART) {
            path.steps.remove(gone);
            self.exchange(path, place, term, other);
        }
    }

    /// Fits a structure to the same runs, and returns it if its information criterion is below that of the path's
    /// model plus `tolerated`.
    fn preferred(&self, path: &Path, structure: Structure, tolerated: f64) -> Option<Fit> {
        let other = fit(self.family, &self.runs, structure, path.current.initial.clone(), Effort::COMPARE);
        // The whiter residual gives the number of independent samples: the noise is the same for both.
        let samples = [&path.current, &other].map(|fit| independent(self.family, &self.runs, fit));
        let price_of = |fit: &Fit| price(samples[0].max(samples[1]), fit.cost, numbers(fit));
        (price_of(&other) < price_of(&path.current) + tolerated).then_some(other)
    }

    /// Replaces a term by a fitted one, which stays neither its own rival nor among the rejected ones.
    fn exchange(&self, path: &mut Path, place: usize, term: Term, fit: Fit) {
        let name = self.term_name(&term);
        path.rejected.retain(|one| one.name != name);
        let step = &mut path.steps[place];
        step.rivals.retain(|&(rival, _)| term != Term::Known(rival));
        step.term = term;
        path.current = fit;
    }

    /// Removes from a path's model, which is fitted to `runs`, each term whose z is too small beside the others and
    /// whose parameters do not lower the information criterion.
    pub(super) fn prune(&self, runs: &[&F::Run], path: &mut Path) {
        while path.steps.len() > 1 {
            let with = &path.current;
            let deviations = with.deviations(self.family, runs);
            let samples = independent(self.family, runs, with);
            let price_of = |fit: &Fit| price(samples, fit.cost, numbers(fit));
            let without = parallel::filter_map(0..path.steps.len(), |place| {
                let z = self.own_size(&with.structure, &deviations, place);
                if z.is_some_and(|z| z >= LEAST_Z) {
                    return None;
                }
                let structure = with.structure.without(place);
                let fit = fit(self.family, runs, structure, with.initial.clone(), Effort::COMPARE);
                (price_of(&fit) <= price_of(with)).then_some((place, fit))
            });
            let cheapest = without.into_iter().min_by(|a, b| price_of(&a.1).total_cmp(&price_of(&b.1)));
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

    /// Removes terms that later ones made superfluous.
    pub(super) fn remove(&self, path: &mut Path) {
        while path.steps.len() > 1 {
            let with = rmse(&self.blocked(&path.current));
            let without = parallel::map(0..path.steps.len() - 1, |place| {
                let structure = path.current.structure.without(place);
                let fit = fit(self.family, &self.runs, structure, path.current.initial.clone(), Effort::SCREEN);
                let error = rmse(&self.blocked(&fit));
                (place, fit, error)
            });
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

/// Returns the `count` fits of lowest cost, lowest first, without those whose cost is not finite.
fn lowest(mut fits: Vec<Fit>, count: usize) -> Vec<Fit> {
    fits.retain(|fit| fit.cost.is_finite());
    fits.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    fits.truncate(count);
    fits
}
