//! Curves over the motion of an axis: missing effects without a name.

use std::f64::consts::TAU;

use r4_plants::Dependence;

use crate::{
    evidence::{TOLD_APART, price},
    family::{Acts, Curve, Family, Structure, Term},
    fit::Fit,
};

use super::{Motion, MotionRun, simulate::Moved};

/// Numbers of knots that are tried; each additional knot has to pay the complexity penalty.
const CORNERS: [usize; 3] = [9, 17, 33];
/// The same for a curve over an angle, or over a position that repeats. Eight knots have a residual of 1.0 times the
/// noise on two tuning plants with a worn track (900000, 900015), twelve of 1.3 times and more: where recordings have
/// no data, fewer knots extrapolate better. With two waves per turn (900006) eight have 1.9 times the noise, twelve
/// 1.1 times.
pub(super) const ROUND: [usize; 5] = [8, 12, 16, 24, 32];
/// Ratio of the last to the second knot over a time since an event. Our choice: each of nine knots is then twice as
/// late as the one before.
const SOONEST: f64 = 128.0;

impl Motion {
    /// Returns curves with values 0 over a driver, one for each way in which it can act.
    pub(super) fn empty_curves(
        &self,
        current: &Fit,
        (over, period): (Dependence, Option<f64>),
        runs: &[&MotionRun],
    ) -> Vec<Curve> {
        let acts: &[Acts] = match over {
            // A force by acceleration is inertia, which the model has; one by direction is friction by direction.
            Dependence::Acceleration | Dependence::Direction => &[],
            Dependence::Input => &[Acts::Push],
            Dependence::Speed => &[Acts::Push, Acts::Friction],
            Dependence::Position | Dependence::Time => &[Acts::Push, Acts::Friction, Acts::Gain],
            Dependence::History => &[Acts::Friction, Acts::Hysteresis, Acts::Settling],
            Dependence::Supply => &[Acts::Gain],
        };
        if acts.is_empty() {
            return vec![];
        }
        let round =
            |acts: Acts, period: f64| self.fitting(current, ROUND.map(|count| self.round(acts, period, count)), runs);
        let open = |acts: Acts| {
            let mut values = self.values_of((over, acts), current, runs);
            values.sort_by(f64::total_cmp);
            let placed = if acts == Acts::Settling { since } else { corners };
            let curves = CORNERS.iter().filter_map(|&count| placed(&values, count));
            self.fitting(current, curves.map(|at| self.curve(over, None, acts, at)), runs)
        };
        if period.is_some() {
            // Offered together with the same position without a period.
            return vec![];
        }
        // A joint repeats its effects each turn, unless the data clearly contradict that.
        let is_angle = over == Dependence::Position && self.is_round();
        let repeats = if over == Dependence::Position { self.repeats(current, acts, runs) } else { vec![] };
        let curve = |(place, &acts): (usize, &Acts)| {
            let repeats = repeats.get(place).copied().flatten();
            let others = repeats.and_then(|period| round(acts, period)).into_iter().chain(open(acts));
            let other = others.min_by(|a, b| a.1.total_cmp(&b.1));
            let turn = if is_angle { round(acts, TAU) } else { None };
            let (curve, _) = match (turn, other) {
                (Some(turn), Some(other)) if other.1 + TOLD_APART < turn.1 => other,
                (turn, other) => turn.or(other)?,
            };
            Some(curve)
        };
        acts.iter().enumerate().filter_map(curve).collect()
    }

    /// Returns a curve over the position with a period.
    pub(super) fn round(&self, acts: Acts, period: f64, count: usize) -> Curve {
        let at = (0..count).map(|corner| corner as f64 * period / count as f64).collect();
        self.curve(Dependence::Position, Some(period), acts, at)
    }

    /// Returns a curve with these knots; its values are per unit of inertia.
    pub(super) fn curve(&self, over: Dependence, period: Option<f64>, acts: Acts, at: Vec<f64>) -> Curve {
        let (units, gain) = (&self.scales.units, acts == Acts::Gain);
        let at_unit = match over {
            Dependence::Input => units.input,
            Dependence::Speed => units.speed,
            Dependence::Time => "s",
            Dependence::History if acts == Acts::Settling => "s",
            Dependence::Supply => "V",
            _ => units.distance,
        };
        Curve {
            over,
            at_unit,
            unit: if gain { "1" } else { units.force },
            at,
            period,
            acts,
            scale: if gain { 0.1 } else { 0.1 * self.scales.acceleration },
        }
    }

    /// Returns the curve with the lowest information criterion in the weak form, and that criterion. It is infinite
    /// if the model cannot be evaluated in windows; then the first curve is returned.
    fn fitting(
        &self,
        current: &Fit,
        curves: impl IntoIterator<Item = Curve>,
        runs: &[&MotionRun],
    ) -> Option<(Curve, f64)> {
        let independent = self.independent_windows(current, runs);
        let priced = |curve: Curve| {
            let left = self.left_over_windows(with(&current.structure, &curve), current, runs);
            let price = independent.zip(left).map(|(independent, left)| price(independent, left, curve.at.len()));
            (curve, price.unwrap_or(f64::INFINITY))
        };
        curves.into_iter().map(priced).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Returns the values of a curve's axis: as measured, or simulated if the motion was not measured directly.
    fn values_of(&self, (over, acts): (Dependence, Acts), current: &Fit, runs: &[&MotionRun]) -> Vec<f64> {
        let moved = self.moved(current, runs);
        let measured = |of: &dyn Fn(&Moved, f64) -> f64| {
            let values = moved.iter().flatten().map(|(moved, time_s)| of(moved, *time_s));
            values.filter(|value| value.is_finite()).collect()
        };
        match (over, acts) {
            // Friction is the same in both directions.
            (Dependence::Speed, Acts::Friction) if moved.is_some() => measured(&|moved, _| moved.speed.abs()),
            (Dependence::Speed, _) if moved.is_some() => measured(&|moved, _| moved.speed),
            (Dependence::Position, _) if moved.is_some() => measured(&|moved, _| moved.position),
            (Dependence::History, Acts::Settling) => measured(&|moved, time_s| time_s - moved.turned_s),
            (Dependence::History, _) if moved.is_some() => {
                measured(&|moved, _| (moved.position - moved.reversal).abs())
            }
            (Dependence::Speed, Acts::Friction) => {
                self.simulated(over, current, runs).into_iter().map(f64::abs).collect()
            }
            _ => self.simulated(over, current, runs),
        }
    }

    fn simulated(&self, over: Dependence, current: &Fit, runs: &[&MotionRun]) -> Vec<f64> {
        runs.iter()
            .zip(&current.initial)
            .flat_map(|(run, initial)| self.drivers(&current.structure, initial, run))
            .filter(|driver| driver.over == over && driver.period.is_none())
            .flat_map(|driver| driver.values)
            .filter(|value| value.is_finite())
            .collect()
    }
}

/// Returns a structure with an additional curve of values 0.
pub(super) fn with(structure: &Structure, curve: &Curve) -> Structure {
    let mut with = structure.clone();
    with.terms.push(Term::Curve(curve.clone()));
    with.added.push(vec![0.0; curve.at.len()]);
    with
}

/// Returns knots over sorted times since an event, s: 0, then a geometric series up to the longest finite time,
/// because a decay of unknown time constant is steepest at its beginning. `None` if no time is finite and above 0.
fn since(values: &[f64], count: usize) -> Option<Vec<f64>> {
    let &longest = values.iter().rev().find(|value| value.is_finite())?;
    let farther = |index: usize| (index as f64 / (count - 2) as f64 - 1.0) * SOONEST.ln();
    let at = (0..count - 1).map(|index| longest * farther(index).exp());
    (longest > 0.0).then(|| std::iter::once(0.0).chain(at).collect())
}

/// Returns knots over sorted values, so that none lacks data and no long interval lacks a knot; `None` for a
/// constant.
fn corners(values: &[f64], count: usize) -> Option<Vec<f64>> {
    let (&low, &high) = (values.first()?, values.last()?);
    if high - low <= f64::EPSILON * high.abs() {
        return None;
    }
    // Mean of equidistant knots and of quantiles of the data.
    let share = |index: usize| index as f64 / (count - 1) as f64;
    let quantile = |share: f64| values[((values.len() - 1) as f64 * share) as usize];
    let mut at: Vec<f64> =
        (0..count).map(|index| 0.5 * (quantile(share(index)) + low + (high - low) * share(index))).collect();
    // Knots that nearly coincide would make the spline's slopes huge.
    at.dedup_by(|a, b| *a - *b < 1e-3 * (high - low));
    (at.len() >= 2).then_some(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_after_an_event_are_each_as_many_times_as_late_as_the_one_before() {
        let at = since(&[-1.0, 0.3, 12.8, f64::INFINITY], 9).expect("corners");
        let expected = [0.0, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8];
        assert!(at.iter().zip(expected).all(|(at, expected)| (at - expected).abs() < 1e-12), "{at:?}");
        assert_eq!(since(&[0.0, f64::INFINITY], 9), None);
    }
}
