//! Interfaces between a model and its identification: parameters, possible effects and free-run simulation.

use std::collections::BTreeMap;

use r4_maths::spline::Spline;
use r4_plants::Dependence;
use r4_world::Wheeled;

use crate::{
    fit::{Effort, Fit, white_noise},
    report::Estimate,
};

/// Range of a parameter. It is built into the optimiser's variables, so no fit can leave it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Range {
    /// Positive, over many decades; optimised as a logarithm.
    Positive,
    /// Positive, but the prediction changes only in steps of a sampling period. `step` is the relative change that
    /// passes some of these steps.
    Coarse {
        /// Relative change of the value.
        step: f64,
    },
    /// Zero or positive; `scale` is a change that is noticeable.
    NotNegative {
        /// Noticeable change, in the parameter's unit.
        scale: f64,
    },
    /// Strictly between two values.
    Between(f64, f64),
    /// Between two values, both included: a step beyond an end is reflected there.
    Reflected(f64, f64),
    /// Any number; `scale` is a change that is noticeable.
    Any {
        /// Noticeable change, in the parameter's unit.
        scale: f64,
    },
}

/// Parameter that is fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// Name in reports; it ends in the unit unless the parameter is dimensionless.
    pub name: &'static str,
    /// Unit such as `N m`; `1` for a dimensionless number.
    pub unit: &'static str,
    /// Range of the value.
    pub range: Range,
    /// Value without the effect, which may be infinite; `None` for a parameter that only shapes the effect.
    pub absent: Option<f64>,
}

impl Parameter {
    /// Returns the distance of a value from the effect's absence in standard errors; `None` for a parameter that only
    /// shapes the effect, 0 if the standard error is unknown.
    #[must_use]
    pub fn deviations_off(&self, value: f64, deviation: Option<f64>) -> Option<f64> {
        let absent = self.absent?;
        // A parameter that the data do not determine is no evidence for the effect.
        let Some(deviation) = deviation else { return Some(0.0) };
        // To first order, the relative standard error of an inverse is that of the value itself.
        let off = if absent.is_infinite() { value } else { value - absent };
        Some(off.abs() / deviation.max(f64::MIN_POSITIVE))
    }
}

/// Effect that the base model lacks and the data may show.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// Name in reports and plant files.
    pub name: &'static str,
    /// Quantities that the effect's contribution is a function of.
    pub depends_on: &'static [Dependence],
    /// Parameters; empty for an effect that is either present or not.
    pub parameters: Vec<Parameter>,
    /// Initial guesses of the parameters, in the units of the family.
    pub starts: Vec<Vec<f64>>,
    /// Advice for a recording that separates this effect from others.
    pub experiment: &'static str,
    /// Effects whose presence makes this one superfluous or impossible.
    pub excludes: &'static [&'static str],
    /// Effect that explains part of what this one does and is much easier to find. If it explains nothing, this one
    /// is not tried.
    pub led_by: Option<&'static str>,
}

/// Way in which the values of a [`Curve`] act on the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acts {
    /// Values are added to the push on the output.
    Push,
    /// Values are a friction: they oppose motion in either direction.
    Friction,
    /// The input is multiplied by one plus the value.
    Gain,
    /// Values are a friction as a function of the time since the last reversal, s.
    Settling,
    /// Values oppose the last direction of motion, also at rest, as a function of the travel since the last reversal:
    /// a spring that is wound anew after each reversal.
    Hysteresis,
}

impl Acts {
    /// Returns the name of the action in messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Push => "a force",
            Self::Friction => "a friction",
            Self::Gain => "a gain",
            Self::Settling => "a friction since the last turn",
            Self::Hysteresis => "a hysteresis",
        }
    }
}

/// Smooth curve (spline) over something the residual depends on; its values at the knots are the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Quantity on its axis.
    pub over: Dependence,
    /// Unit of the axis.
    pub at_unit: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Knots of the spline, increasing, in `at_unit`.
    pub at: Vec<f64>,
    /// Period of a circular axis, on which the first knot follows the last; `None` for a straight axis.
    pub period: Option<f64>,
    /// Way in which the values act.
    pub acts: Acts,
    /// Noticeable change of a value.
    pub scale: f64,
}

impl Curve {
    /// Returns the spline with these values at its knots.
    #[must_use]
    pub fn spline(&self, values: &[f64]) -> Spline {
        Spline::through(&self.at, values, self.period)
    }

    /// Returns the curve with an additional knot midway between neighbours; on a circle also between the last and the
    /// first.
    #[must_use]
    pub fn with_midpoints(&self) -> Self {
        let around = self.period.and_then(|period| Some(self.at.first()? + period));
        let ends = self.at.iter().skip(1).copied().chain(around);
        let mut at: Vec<f64> = self.at.iter().zip(ends).flat_map(|(&from, to)| [from, 0.5 * (from + to)]).collect();
        if self.period.is_none() {
            at.extend(self.at.last());
        }
        Self { at, ..self.clone() }
    }
}

/// Addition to a base model.
#[derive(Clone, Debug, PartialEq)]
pub enum Term {
    /// Effect with this index in the catalogue.
    Known(usize),
    /// Effect without a name: a curve.
    Curve(Curve),
}

/// Base model with the terms that were added to it, and values of all parameters.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Structure {
    /// Terms in the order in which they were added.
    pub terms: Vec<Term>,
    /// Values of the base model's parameters.
    pub base: Vec<f64>,
    /// Values of each term's parameters.
    pub added: Vec<Vec<f64>>,
}

impl Structure {
    /// Returns the structure without the term at index `place`. Panics if there is none.
    #[must_use]
    pub fn without(&self, place: usize) -> Self {
        let mut without = self.clone();
        without.terms.remove(place);
        without.added.remove(place);
        without
    }

    /// Returns the values of an effect of the catalogue; `None` if it was not added.
    #[must_use]
    pub fn of(&self, candidate: usize) -> Option<&[f64]> {
        let place = self.terms.iter().position(|term| *term == Term::Known(candidate))?;
        Some(&self.added[place])
    }

    /// Returns the curves that were added, with their values at the knots.
    pub fn curves(&self) -> impl Iterator<Item = (&Curve, &[f64])> {
        self.terms.iter().zip(&self.added).filter_map(|(term, values)| match term {
            Term::Curve(curve) => Some((curve, &values[..])),
            Term::Known(_) => None,
        })
    }
}

/// Free-run simulation that was computed.
#[derive(Clone, Copy, Debug)]
pub struct Simulated<'s> {
    /// Structure that was simulated.
    pub structure: &'s Structure,
    /// Initial state of the simulation.
    pub initial: &'s [f64],
    /// Predicted output, one value per measured sample.
    pub predicted: &'s [f64],
}

/// Series beside the output that the residual may depend on.
#[derive(Clone, Debug, PartialEq)]
pub struct Driver {
    /// Quantity of the series.
    pub over: Dependence,
    /// Unit of the quantity.
    pub unit: &'static str,
    /// Period of a circular axis, such as a turn; `None` for a straight one.
    pub period: Option<f64>,
    /// Values of the series, one per measured sample.
    pub values: Vec<f64>,
}

/// Model as a fit sees it: parameters and the prediction that follows from them.
///
/// `predict` is called many thousand times: it must allocate as little as possible, and must return finite numbers
/// for all values in range (a run that cannot be simulated is filled with NaN, which counts as infinitely bad).
pub trait Model: Sync {
    /// Run, prepared for the model.
    type Run: Clone + Sync;

    /// Parameters of the base model; empty if all of it is declared.
    fn base(&self) -> &[Parameter];

    /// Catalogue of the effects that these data could show.
    fn catalogue(&self) -> &[Candidate];

    /// Returns initial guesses of the initial state's variables that have to be fitted for a run, and the scale of
    /// the error of each; both of the same length, empty if nothing has to be fitted.
    fn initial(&self, run: &Self::Run) -> (Vec<f64>, Vec<f64>);

    /// Computes the free-run simulation from the initial state: the output at each sample of [`Model::measured`].
    fn predict(&self, structure: &Structure, initial: &[f64], run: &Self::Run, predicted: &mut [f64]);

    /// Computes free-run simulations that differ little from a known one, and passes each to `told` with its index. A
    /// family can override it to compute once what they have in common.
    fn predict_each(
        &self,
        known: &Simulated<'_>,
        others: &[(&Structure, &[f64])],
        run: &Self::Run,
        told: &mut dyn FnMut(usize, &[f64]),
    ) {
        let mut predicted = vec![0.0; known.predicted.len()];
        for (index, (structure, initial)) in others.iter().enumerate() {
            self.predict(structure, initial, run, &mut predicted);
            told(index, &predicted);
        }
    }

    /// Returns the measured output; NaN where there is no sample.
    fn measured<'r>(&self, run: &'r Self::Run) -> &'r [f64];

    /// Returns the standard deviation of the measurement noise, in the output's unit.
    fn noise(&self, run: &Self::Run) -> f64 {
        white_noise(self.measured(run))
    }

    /// Returns the standard deviation of the error that the sensor's resolution causes; 0 if it is unknown.
    fn rounding(&self, _run: &Self::Run) -> f64 {
        0.0
    }
}

/// Fitted model in the form that a simulated board loads.
#[derive(Clone, Debug)]
pub enum Loadable {
    /// Text of a plant file.
    Plant(String),
    /// Body of a wheeled robot.
    Body(Box<FittedBody>),
}

/// Body of a robot with the numbers that were identified.
#[derive(Clone, Debug)]
pub struct FittedBody {
    /// The body, in its state at rest.
    pub wheeled: Wheeled,
    /// Origin of its numbers, one line each.
    pub provenance: Vec<String>,
    /// Identified values that a body has no place for, by name, with the place where they belong.
    pub left_out: Vec<(String, &'static str)>,
}

impl Loadable {
    /// Returns the text of the plant file; `None` for a body.
    #[must_use]
    pub fn plant(&self) -> Option<&str> {
        match self {
            Self::Plant(text) => Some(text),
            Self::Body(_) => None,
        }
    }

    /// Returns the body; `None` for a plant.
    #[must_use]
    pub fn body(&self) -> Option<&FittedBody> {
        match self {
            Self::Plant(_) => None,
            Self::Body(body) => Some(body),
        }
    }
}

/// Kind of model: the effects to search for, and their presentation in reports.
pub trait Family: Model {
    /// Returns the unit of the output.
    fn unit(&self) -> &'static str;

    /// Returns initial guesses of the base parameters, found from the data.
    fn starts(&self, runs: &[&Self::Run]) -> Vec<Vec<f64>>;

    /// Returns base parameters as declared beforehand, if they were. A missing effect may have biased the fit of the
    /// base model so far that no descent leads back to the truth; the declared values are another initial guess.
    fn declared(&self) -> Option<Vec<f64>> {
        None
    }

    /// Returns the times of [`Model::measured`], s.
    fn time_s<'r>(&self, run: &'r Self::Run) -> &'r [f64];

    /// Returns the name of the run.
    fn name<'r>(&self, run: &'r Self::Run) -> &'r str;

    /// Returns name and values of the input of a run, for plots.
    fn input(&self, _run: &Self::Run) -> (String, Vec<f64>) {
        (String::new(), Vec::new())
    }

    /// Returns samples `from..to` as a run of its own; models with memory still know the input before `from`.
    fn part(&self, run: &Self::Run, from: usize, to: usize) -> Self::Run;

    /// Returns the number of blocks into which a run is cut for block cross-validation; `None` for blocks as long as
    /// the run's memory requires.
    fn blocks(&self, _: &Self::Run) -> Option<usize> {
        None
    }

    /// Returns the model with values from which a fit can move: none at an end of its range where the gradient
    /// vanishes.
    fn movable(&self, structure: Structure) -> Structure {
        structure
    }

    /// Returns whether the fitted model needs the output earlier than wrong stamps can explain: then the input does
    /// not drive it.
    fn is_early(&self, _structure: &Structure) -> bool {
        false
    }

    /// Returns structures with other numbers that may predict the same, each with a description of the exchange.
    fn exchanged(&self, _structure: &Structure) -> Vec<(String, Structure)> {
        vec![]
    }

    /// Returns a description of what is taken as known beside the base model's declared numbers; `None` if nothing
    /// is.
    fn known(&self) -> Option<String> {
        None
    }

    /// Returns whether the model's delay is at the end of its range, so that an effect that delays is likely missing.
    fn is_late(&self, _structure: &Structure) -> bool {
        false
    }

    /// Returns simpler terms that may replace one of a model's, with initial guesses of their values.
    fn simpler(&self, _structure: &Structure, _place: usize) -> Vec<(Term, Vec<f64>)> {
        vec![]
    }

    /// Returns one term that may replace two of a structure: the indexes of the two, of which the first is kept for
    /// it, the term, and initial guesses of its values. `None` without such a pair.
    fn merged(&self, _structure: &Structure) -> Option<([usize; 2], Term, Vec<f64>)> {
        None
    }

    /// Returns the initial guesses of a run's initial state under a model; more than one where a single one may fail.
    fn beginnings(&self, _structure: &Structure, run: &Self::Run) -> Vec<Vec<f64>> {
        vec![self.initial(run).0]
    }

    /// Returns the most promising of some structures that extend a model, with values closer to the optimum, and the
    /// sum of squared residuals (comparable only with other guesses for the same runs). It is found without free-run
    /// simulations; `None` if the family has no such method.
    fn guess(
        &self,
        _starts: Vec<Structure>,
        _current: &Fit,
        _runs: &[&Self::Run],
        _effort: Effort,
    ) -> Option<(Structure, f64)> {
        None
    }

    /// Returns whether guesses beside a model are rough, so that they exclude nothing: neither an effect nor another start of its fit.
    fn guesses_roughly(&self, _structure: &Structure) -> bool {
        false
    }

    /// Returns the series that the residual is compared with.
    fn drivers(&self, structure: &Structure, initial: &[f64], run: &Self::Run) -> Vec<Driver>;

    /// Returns the residual of the output as the missing push, with its unit: causes are clearer there. `None` if the
    /// residual of the output itself is best.
    fn push(&self, _structure: &Structure, _run: &Self::Run, _residual: &[f64]) -> Option<(Vec<f64>, &'static str)> {
        None
    }

    /// Returns the factor from each parameter of a structure to its reported value, in the order of
    /// [`crate::fit::parameters()`]. It may depend on other parameters.
    fn units(&self, structure: &Structure) -> Vec<f64> {
        vec![1.0; structure.base.len() + structure.added.iter().map(Vec::len).sum::<usize>()]
    }

    /// Returns values, standard errors and confidence intervals in the units of reports: of the base model, and of
    /// each term. By default they are as fitted.
    fn estimates(
        &self,
        structure: &Structure,
        deviations: &[Option<f64>],
        intervals: &[Option<[f64; 2]>],
    ) -> (BTreeMap<String, Estimate>, Vec<BTreeMap<String, Estimate>>) {
        let mut deviations = deviations.iter().copied().chain(std::iter::repeat(None));
        let mut intervals = intervals.iter().copied().chain(std::iter::repeat(None));
        let mut estimate = |(parameter, &value): (&Parameter, &f64)| {
            let (std, interval) = (deviations.next().flatten(), intervals.next().flatten());
            (
                parameter.name.to_owned(),
                Estimate { value, std, unit: parameter.unit.to_owned(), interval, assumed: None },
            )
        };
        let base = self.base().iter().zip(&structure.base).map(&mut estimate).collect();
        let terms = structure
            .terms
            .iter()
            .zip(&structure.added)
            .map(|(term, values)| match term {
                Term::Known(index) => {
                    self.catalogue()[*index].parameters.iter().zip(values).map(&mut estimate).collect()
                }
                Term::Curve(_) => {
                    // A curve's values are reported as a table, but their errors must be consumed here to stay in
                    // step.
                    let corner = Parameter { name: "", unit: "", range: Range::Any { scale: 1.0 }, absent: None };
                    values.iter().for_each(|value| drop(estimate((&corner, value))));
                    BTreeMap::new()
                }
            })
            .collect();
        (base, terms)
    }

    /// Returns the name in [`Report::timing`](crate::report::Report::timing) of a base parameter or effect that
    /// describes the recording's stamps; `None` for one of the machine.
    fn timing(&self, _name: &str) -> Option<&'static str> {
        None
    }

    /// Returns the factor that converts a curve's values to its unit.
    fn force_per_push(&self, _structure: &Structure) -> f64 {
        1.0
    }

    /// Returns the model in the form that a simulated board loads. `source` names its origin.
    fn loadable(&self, structure: &Structure, source: &str) -> Loadable;

    /// Returns empty curves over a driver, one for each way in which the model can include it.
    fn curves(&self, current: &Fit, driver: (Dependence, Option<f64>), runs: &[&Self::Run]) -> Vec<Curve>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_gets_a_corner_midway_between_neighbours() {
        let curve = |period, at: &[f64]| Curve {
            over: Dependence::Position,
            at_unit: "rad",
            unit: "N m",
            at: at.to_vec(),
            period,
            acts: Acts::Push,
            scale: 1.0,
        };
        assert_eq!(curve(None, &[0.0, 1.0, 4.0]).with_midpoints().at, [0.0, 0.5, 1.0, 2.5, 4.0]);
        assert_eq!(curve(Some(3.0), &[0.0, 1.0]).with_midpoints().at, [0.0, 0.5, 1.0, 2.0]);
    }
}
