//! Intervals by the profile of the cost: one parameter is held beside its best value, all others are fitted again.

use rayon::prelude::*;

use crate::family::{Model, Range, Term};

use super::{Effort, Fit, Problem, Spread, flat, set_flat};

/// 95 % of chi-square with one degree of freedom (NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7.4).
pub(crate) const RISE: f64 = 3.841;
/// An end is found when the root of the cost's rise, which is nearly straight, is so near to what it has to be.
const NEAR: f64 = 0.02;
/// Fits for each end of an interval, at most.
const FITS: usize = 8;
/// A share of the best value that counts as nothing where nothing itself is out of range.
const NOTHING: f64 = 1e-3;

impl Range {
    /// Where the range ends, and the last value before that can be simulated; `None` where it goes on without end.
    fn end(self, value: f64, upwards: bool) -> Option<(f64, f64)> {
        match (self, upwards) {
            (Self::Positive | Self::Coarse { .. }, false) => Some((0.0, NOTHING * value)),
            (Self::NotNegative { .. }, false) => Some((0.0, 0.0)),
            (Self::Between(lower, _) | Self::Reflected(lower, _), false) => Some((lower, lower)),
            (Self::Between(_, upper) | Self::Reflected(_, upper), true) => Some((upper, upper)),
            _ => None,
        }
    }

    /// A value changed by `by`, or by less where that would leave the range.
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
    /// 95 % intervals of the structure's parameters, in the order of [`super::parameters()`]: how far each can go until the
    /// cost, with all else and the initial states fitted again, has risen by 3.84 times the variance that belongs to
    /// its deviation. Where the cost is a parabola this is 1.96 deviations either way.
    ///
    /// An end beyond the parameter's range is the end of the range. `None` where the data do not fix a parameter, where
    /// nothing within reach is bad enough on a side without end, and for the corners of curves.
    #[must_use]
    pub fn intervals<F: Model>(&self, family: &F, runs: &[&F::Run]) -> Vec<Option<[f64; 2]>> {
        let spreads = self.spreads(family, runs);
        let corners = self.structure.terms.iter().zip(&self.structure.added);
        let is_corner: Vec<bool> = std::iter::repeat_n(false, self.structure.base.len())
            .chain(corners.flat_map(|(term, values)| values.iter().map(move |_| matches!(term, Term::Curve(_)))))
            .collect();
        let sides: Vec<Option<f64>> = (0..2 * spreads.len())
            .into_par_iter()
            .map(|side| {
                let parameter = side / 2;
                let spread = spreads[parameter].as_ref().filter(|_| !is_corner[parameter])?;
                Profile { fit: self, family, runs, parameter, spread }.end(side % 2 == 1)
            })
            .collect();
        sides.chunks(2).map(|ends| Some([ends[0]?, ends[1]?])).collect()
    }
}

/// Of one parameter.
struct Profile<'p, F: Model> {
    fit: &'p Fit,
    family: &'p F,
    runs: &'p [&'p F::Run],
    parameter: usize,
    spread: &'p Spread,
}

impl<F: Model> Profile<'_, F> {
    /// The end of the interval on one side.
    fn end(&self, upwards: bool) -> Option<f64> {
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
        // Rise of the cost over what it may be, as roots: a straight line where the cost is a parabola.
        let (mut inside, mut outside) = ((0.0, 0.0), None);
        let mut distance = (RISE.sqrt() * deviation).min(0.5 * farthest);
        let mut from = self.fit.clone();
        for _ in 0..FITS {
            let fit = self.held(&from, best + sign * distance, limit);
            let root = ((fit.cost - self.fit.cost).max(0.0) / limit).sqrt();
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
                // What is left by the slope from the best value.
                return Some(best + sign * (distance / root).min(farthest));
            }
            distance = match outside {
                None => (distance * (1.1 / root).clamp(1.1, 4.0)).min(farthest),
                Some((outer, _)) if outer - inside.0 < NEAR * outer => return Some(best + sign * inside.0),
                Some(outside) => {
                    let share = (1.0 - inside.1) / (outside.1 - inside.1);
                    // A cost that jumps must not keep one end where it is.
                    inside.0 + (outside.0 - inside.0) * share.clamp(0.1, 0.9)
                }
            };
        }
        // A cost that jumps, or one that never rises.
        outside.map(|_| best + sign * distance)
    }

    /// The fit with the parameter held at a value, beginning where a parabola would have it.
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
        // What the solver leaves must be small beside the rise that is looked for.
        let tolerance = (0.01 * limit / self.fit.cost).clamp(1e-9, Effort::SCREEN.tolerance);
        problem.solved(Effort { tolerance, ..Effort::SCREEN }).into_fit()
    }
}
