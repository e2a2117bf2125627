//! Search for the unknown period of a held command (zero-order hold), by the residual of the weak form.

use nalgebra::{DMatrix, DVector};

use crate::{
    family::{Structure, Term},
    fit::{Effort, fit_but_last, parameters},
};

use super::{
    Motion,
    period::Search,
    weak::{Rest, Seen},
};

/// Number of periods from which a fit of all parameters starts.
const OFFERED: usize = 4;
/// Smallest noticeable change, in periods: a hold delays the command's steps by 0.3 periods, more or less.
const NOTICED: f64 = 0.2;

/// Model without a term whose last parameter is a period.
struct Lacking<'r, 'm> {
    motion: &'m Motion,
    rest: &'r Rest<'m>,
    term: Term,
    /// Parameters of the term before the period.
    others: &'r [f64],
    /// Sensitivities of the windows of each recording to the model's parameters.
    slopes: Vec<DMatrix<f64>>,
    /// Accelerations of each recording without the term.
    without: Vec<Vec<f64>>,
}

impl Lacking<'_, '_> {
    fn with(&self, period_s: f64) -> Structure {
        let mut structure = self.rest.fit.structure.clone();
        structure.terms.push(self.term.clone());
        structure.added.push(self.others.iter().copied().chain([period_s]).collect());
        structure
    }

    /// Returns how much of the residual the term explains beyond the rest of the model, over the first `stretch_s` of
    /// the recordings: the share times the number of windows.
    fn stands_out(&self, period_s: f64, stretch_s: f64) -> f64 {
        let Rest { weak, fit, seen, left } = self.rest;
        let numbers = parameters(weak, &fit.structure.terms).len();
        let with = self.with(period_s);
        let mut products = DMatrix::zeros(numbers + 2, numbers + 2);
        let mut count = 0.0;
        for (place, (seen, initial)) in seen.iter().zip(&fit.initial).enumerate() {
            let with = seen.accelerations_until(stretch_s, self.motion, &with, initial);
            let differs: Vec<f64> =
                with.iter().zip(&self.without[place]).map(|(with, without)| with - without).collect();
            let windows = seen.windows.windows.iter().zip(&left[place]).zip(self.slopes[place].row_iter());
            for ((window, left), slopes) in windows.filter(|((window, _), _)| window.ends_within(&differs)) {
                let slopes = slopes.iter().take(numbers).copied();
                let row = DVector::from_iterator(numbers + 2, slopes.chain([window.sum(&differs), *left]));
                products.syger(1.0, &row, &row, 1.0);
                count += 1.0;
            }
        }
        explained(products) * count
    }
}

/// Returns the share of the last series that the one before it explains beyond the others (partial correlation,
/// squared), from the lower triangle of their products; 0 if its coefficient would be negative.
fn explained(products: DMatrix<f64>) -> f64 {
    let others = products.nrows() - 2;
    // A small multiple of the largest product regularises collinear series.
    let smallest = 1e-9 * products.diagonal().rows(0, others).max();
    let mut gram = products.view((0, 0), (others, others)).into_owned();
    gram.fill_upper_triangle_with_lower_triangle();
    gram.set_diagonal(&gram.diagonal().add_scalar(smallest));
    let across = products.view((others, 0), (2, others)).transpose();
    let Some(gram) = gram.cholesky() else { return 0.0 };
    let beyond = products.view((others, others), (2, 2)) - across.transpose() * gram.solve(&across);
    let (one, product, left) = (beyond[(0, 0)], beyond[(1, 0)], beyond[(1, 1)]);
    if one > 0.0 && product > 0.0 && left > 0.0 { product * product / one / left } else { 0.0 }
}

impl Motion {
    /// Returns the best of some structures that add a term with a period, between the periods of the first and the
    /// last: those whose term is most like the residual are fitted with all other parameters. The second value is the
    /// cost of the best.
    pub(super) fn by_periods(&self, starts: &[Structure], rest: &Rest<'_>) -> Option<(Structure, f64)> {
        let (first, last) = (starts.first()?, starts.last()?);
        let [shortest_s, longest_s] = [first, last].map(|start| start.added.last()?.last().copied());
        let (_, others) = first.added.last()?.split_last()?;
        let Rest { weak, fit, seen, .. } = rest;
        let all: Vec<&Seen> = seen.iter().collect();
        let without =
            seen.iter().zip(&fit.initial).map(|(seen, initial)| seen.accelerations(self, &fit.structure, initial));
        let lacking = Lacking {
            motion: self,
            rest,
            term: first.terms.last()?.clone(),
            others,
            slopes: fit.slopes(weak, &all),
            without: without.collect(),
        };
        // Slots begin at the board's power-up, before the first sample.
        let from_s = seen.iter().map(|seen| seen.run.all.slots_s).fold(0.0, f64::max);
        let until_s = seen.iter().filter_map(|seen| Some(seen.run.all.slots_s + seen.run.all.time_s.last()?));
        let search = Search {
            between_s: [shortest_s?, longest_s?],
            from_s,
            until_s: until_s.fold(0.0, f64::max),
            noticed_s: |period_s| NOTICED * period_s,
            offered: OFFERED,
        };
        let fits =
            search.best(|period_s, stretch_s| lacking.stands_out(period_s, stretch_s)).into_iter().map(|period_s| {
                let structure = self.movable(lacking.with(period_s));
                fit_but_last(weak, &all, structure, fit.initial.clone(), Effort::SCREEN)
            });
        let best = fits.min_by(|a, b| a.cost.total_cmp(&b.cost))?;
        Some((best.structure, best.cost))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn products(series: &[Vec<f64>]) -> DMatrix<f64> {
        DMatrix::from_fn(series.len(), series.len(), |a, b| series[a].iter().zip(&series[b]).map(|(a, b)| a * b).sum())
    }

    proptest! {
        #[test]
        fn what_others_explain_is_no_merit(
            one in prop::collection::vec(-1.0..1.0, 8),
            other in prop::collection::vec(-1.0..1.0, 8),
            [left, share] in [0.1..1.0_f64, -3.0..3.0_f64],
        ) {
            // Of eight places the first two differ in the searched term alone, the next two are noise, the rest is
            // the other's.
            let part = |of: &[f64], range: std::ops::Range<usize>| -> Vec<f64> {
                (0..8).map(|place| if range.contains(&place) { of[place] } else { 0.0 }).collect()
            };
            let (own, others) = (part(&[1.0; 8], 0..2), part(&other, 4..8));
            prop_assume!(others.iter().map(|value| value * value).sum::<f64>() > 0.1);
            let mixed: Vec<f64> = own.iter().zip(&others).map(|(own, other)| own + share * other).collect();
            let nobody: Vec<f64> = part(&one, 2..4);
            let noise: f64 = nobody.iter().map(|value| value * value).sum();
            let sum = |sign: f64| -> Vec<f64> {
                (0..8).map(|place| sign * left * own[place] + nobody[place] + 7.0 * others[place]).collect()
            };
            let found = |sign| explained(products(&[others.clone(), mixed.clone(), sum(sign)]));
            // Beyond the others, 2 left² of the residual is explained.
            let expected = 2.0 * left * left / (2.0 * left * left + noise);
            // The regularisation of 1e-9 times the others' product (at most 4) counts 7² times, beside 2 left² (at
            // least 0.02).
            prop_assert!((found(1.0) - expected).abs() < 3e-5, "{} {expected}", found(1.0));
            prop_assert_eq!(found(-1.0), 0.0);
        }
    }
}
