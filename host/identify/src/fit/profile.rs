//! Confidence intervals by profile likelihood: one parameter is held beside its best value, all others are fitted
//! again.

use crate::{
    family::{Model, Range, Term},
    parallel,
};

use super::{Effort, Fit, Problem, Spread, flat, set_flat};

/// 95 % quantile of chi-square with one degree of freedom (NIST/SEMATECH e-Handbook of Statistical Methods,
/// 1.3.6.7.4).
pub(crate) const RISE: f64 = 3.841;
/// Tolerance of the square root of the cost's rise over its limit at an end; this root is nearly linear in the
/// parameter.
const NEAR: f64 = 0.02;
/// Largest number of fits for each end of an interval.
const FITS: usize = 8;
/// Share of the best value that stands for 0 if 0 itself is out of range.
const NOTHING: f64 = 1e-3;
/// Share of the cost's rise at the end of an interval by which a fit beside the best must be better to replace it. Our
/// choice; other values were not compared.
const BETTER: f64 = 0.01;
/// Largest number of times that the best fit is replaced. With none, four of 24 fits of load-dependent friction (plants
/// of seeds 700000 to 700299, two draws of noise each) ended 1.3 to 6.2 variances of a residual above the lowest cost.
const REPLACED: usize = 4;

impl Range {
    /// Returns the end of the range, and the last value before it that can be simulated; `None` for an unbounded
    /// side.
    fn end(self, value: f64, upwards: bool) -> Option<(f64, f64)> {
        match (self, upwards) {
            (Self::Positive | Self::Coarse { .. }, false) => Some((0.0, NOTHING * value)),
            (Self::NotNegative { .. }, false) => Some((0.0, 0.0)),
            (Self::Between(lower, _) | Self::Reflected(lower, _), false) => Some((lower, lower)),
            (Self::Between(_, upper) | Self::Reflected(_, upper), true) => Some((upper, upper)),
            _ => None,
        }
    }

    /// Returns the ends of an interval about a value, `factor` times as far from it. An end of the range stays.
    pub(crate) fn stretched(self, value: f64, ends: [f64; 2], factor: f64) -> [f64; 2] {
        let [low, high] = ends;
        let stays = |end: f64, upwards: bool| self.end(value, upwards).is_some_and(|(limit, _)| limit == end);
        let place = |end: f64, upwards: bool| if stays(end, upwards) { end } else { value + (end - value) * factor };
        [place(low, false), place(high, true)]
    }

    /// Returns a value changed by `by`, or by less if that would leave the range.
    fn moved(self, value: f64, by: f64) -> f64 {
        match self {
            Self::Positive | Self::Coarse { .. } => value * (by / value).clamp(-3.0, 3.0).exp(),
            Self::NotNegative { .. } => (value + by).max(0.1 * value),
            Self::Between(lower, upper) | Self::Reflected(lower, upper) => {
                (value + by).clamp(0.9 * lower + 0.1 * value.min(upper), 0.9 * upper + 0.1 * value.max(lower))
            }
            Self::Any { .. } => value + by,
        }
    }
}

impl Fit {
    /// Returns the 95 % confidence intervals of the structure's parameters by profile likelihood, in the order of
    /// [`super::parameters()`], and the fit that they belong to. An end is the value at which the cost, with everything
    /// else refitted, has risen by 3.84 times the variance of the parameter's standard error. For a parabolic cost that
    /// is 1.96 standard errors to either side.
    ///
    /// A profile may find a lower cost than the fit that it began from, because a cost with steps, as friction at rest
    /// causes them, stops a descent early. The parameters are then fitted again from there.
    ///
    /// An end beyond the parameter's range is the end of the range. `None` if the data do not determine a parameter,
    /// if the cost does not rise enough on an unbounded side, and for the knots of curves.
    #[must_use]
    pub fn with_intervals<F: Model>(mut self, family: &F, runs: &[&F::Run]) -> (Self, Vec<Option<[f64; 2]>>) {
        for _ in 0..REPLACED {
            let (intervals, lower) = self.profiles(family, runs);
            let Some(lower) = lower else { return (self, intervals) };
            let problem = Problem::new(family, runs, lower.structure, lower.initial, lower.weights);
            self = problem.solved(Effort::FULL).into_fit();
        }
        let (intervals, _) = self.profiles(family, runs);
        (self, intervals)
    }

    /// Returns the intervals of all parameters, and the best fit that the profiles found, if it is better than this one.
    fn profiles<F: Model>(&self, family: &F, runs: &[&F::Run]) -> (Vec<Option<[f64; 2]>>, Option<Self>) {
        let spreads = self.spreads(family, runs);
        let corners = self.structure.terms.iter().zip(&self.structure.added);
        let is_corner: Vec<bool> = std::iter::repeat_n(false, self.structure.base.len())
            .chain(corners.flat_map(|(term, values)| values.iter().map(move |_| matches!(term, Term::Curve(_)))))
            .collect();
        // Both ends of all intervals are independent, so they run in parallel.
        let sides: Vec<(Option<f64>, Option<Self>)> = parallel::map(0..2 * spreads.len(), |side| {
            let parameter = side / 2;
            let Some(spread) = spreads[parameter].as_ref().filter(|_| !is_corner[parameter]) else {
                return (None, None);
            };
            let mut profile = Profile { fit: self, family, runs, parameter, spread, lower: None };
            (profile.end(side % 2 == 1), profile.lower)
        });
        let intervals = sides.chunks(2).map(|ends| Some([ends[0].0?, ends[1].0?])).collect();
        let lower = sides.into_iter().filter_map(|(_, lower)| lower).min_by(|a, b| a.cost.total_cmp(&b.cost));
        (intervals, lower)
    }
}

/// Profile of the cost over one parameter.
struct Profile<'p, F: Model> {
    fit: &'p Fit,
    family: &'p F,
    runs: &'p [&'p F::Run],
    parameter: usize,
    spread: &'p Spread,
    /// Best fit with a noticeably lower cost than the one that the profile began from.
    lower: Option<Fit>,
}

impl<F: Model> Profile<'_, F> {
    /// Returns the end of the interval on one side.
    fn end(&mut self, upwards: bool) -> Option<f64> {
        let best = flat(&self.fit.structure).nth(self.parameter)?;
        let parameters = super::parameters(self.family, &self.fit.structure.terms);
        let range = parameters[self.parameter].range;
        let deviation = self.spread.deviation;
        if !(deviation.is_finite() && deviation > 0.0 && self.spread.variance > 0.0) {
            return None;
        }
        let limit = RISE * self.spread.variance;
        let sign = if upwards { 1.0 } else { -1.0 };
        let end = range.end(best, upwards);
        let farthest = end.map_or(f64::INFINITY, |(_, last)| (last - best) * sign);
        if farthest <= 1e-3 * deviation {
            return end.map(|(end, _)| end);
        }
        // Square roots of the cost's rise over its limit are linear in the distance for a parabolic cost.
        let (mut inside, mut outside) = ((0.0, 0.0), None);
        let mut distance = (RISE.sqrt() * deviation).min(0.5 * farthest);
        let mut from = self.fit.clone();
        for _ in 0..FITS {
            let fit = self.held(&from, best + sign * distance, limit);
            let root = ((fit.cost - self.fit.cost).max(0.0) / limit).sqrt();
            let least = self.lower.as_ref().map_or(self.fit.cost - BETTER * limit, |lower| lower.cost);
            if fit.cost < least {
                self.lower = Some(fit.clone());
            }
            if root <= 1.0 {
                inside = (distance, root);
                from = fit;
                if distance >= farthest {
                    return end.map(|(end, _)| end);
                }
            } else {
                outside = Some((distance, root));
            }
            if (root - 1.0).abs() < NEAR {
                // The remaining distance follows from the slope from the best value.
                return Some(best + sign * (distance / root).min(farthest));
            }
            distance = match outside {
                None => (distance * (1.1 / root).clamp(1.1, 4.0)).min(farthest),
                Some((outer, _)) if outer - inside.0 < NEAR * outer => return Some(best + sign * inside.0),
                Some(outside) => {
                    let share = (1.0 - inside.1) / (outside.1 - inside.1);
                    // The clamp bounds each step, so that a cost with jumps does not keep one end in place.
                    inside.0 + (outside.0 - inside.0) * share.clamp(0.1, 0.9)
                }
            };
        }
        // The cost has a jump at the end, or it never rises enough.
        outside.map(|_| best + sign * distance)
    }

    /// Returns the fit with the parameter held at a value, starting where a parabolic cost would have its minimum.
    fn held(&self, from: &Fit, value: f64, limit: f64) -> Fit {
        let parameters = super::parameters(self.family, &from.structure.terms);
        let mut values: Vec<f64> = flat(&from.structure).collect();
        let by = value - values[self.parameter];
        let mut along = self.spread.along.iter();
        for (index, ((place, parameter), share)) in values.iter_mut().zip(&parameters).zip(&mut along).enumerate() {
            *place = if index == self.parameter { value } else { parameter.range.moved(*place, share * by) };
        }
        let mut structure = from.structure.clone();
        set_flat(&mut structure, &values);
        let mut initial = from.initial.clone();
        for (run, initial) in self.runs.iter().zip(&mut initial) {
            let scales = self.family.initial(run).1;
            for ((place, scale), share) in initial.iter_mut().zip(scales).zip(&mut along) {
                *place += scale * share * by;
            }
        }
        let mut problem = Problem::new(self.family, self.runs, structure, initial, from.weights.clone());
        problem.held = Some(self.parameter);
        // The solver's remaining error must be small compared with the rise.
        let tolerance = (0.01 * limit / self.fit.cost).clamp(1e-9, Effort::SCREEN.tolerance);
        problem.solved(Effort { tolerance, ..Effort::SCREEN }).into_fit()
    }
}
