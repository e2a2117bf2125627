//! What fitting and choosing need to know of a model: its parameters, its possible effects, its free run.

use std::collections::BTreeMap;

use r4_maths::spline::Spline;
use r4_plants::Dependence;
use r4_world::Wheeled;

use crate::{
    fit::{Effort, Fit, white_noise},
    report::Estimate,
};

/// What values a parameter may take. There is no way to leave its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Range {
    /// Above zero, over many decades.
    Positive,
    /// Above zero, and what is predicted changes in steps only: a period of sampling. `step` is the share of it by which some
    /// of these are seen.
    Coarse {
        /// A share.
        step: f64,
    },
    /// Zero and above; `scale` is a size that would be noticed.
    NotNegative {
        /// In the parameter's unit.
        scale: f64,
    },
    /// Strictly between.
    Between(f64, f64),
    /// Between these, both included: a step that would leave the range comes back from its end as far.
    Reflected(f64, f64),
    /// Any number; `scale` is a size that would be noticed.
    Any {
        /// In the parameter's unit.
        scale: f64,
    },
}

/// A number that is fitted.
#[derive(Clone, Debug, PartialEq)]
pub struct Parameter {
    /// In reports, ending in its unit unless it is a plain number.
    pub name: &'static str,
    /// `N m`; `1` for a plain number.
    pub unit: &'static str,
    /// What it may be.
    pub range: Range,
    /// The value at which the effect is not there, which may be infinite; `None` where it only shapes the effect.
    pub absent: Option<f64>,
}

impl Parameter {
    /// By how many standard deviations a value is off from the effect's absence; `None` where it only shapes the effect.
    #[must_use]
    pub fn deviations_off(&self, value: f64, deviation: Option<f64>) -> Option<f64> {
        let absent = self.absent?;
        let Some(deviation) = deviation else { return Some(0.0) };
        // To first order, the inverse of a value is as many of its own deviations from 0.
        let off = if absent.is_infinite() { value } else { value - absent };
        Some(off.abs() / deviation.max(f64::MIN_POSITIVE))
    }
}

/// An effect the base model lacks and the data may show.
#[derive(Clone, Debug, PartialEq)]
pub struct Candidate {
    /// In reports and plant files.
    pub name: &'static str,
    /// What its contribution is a function of.
    pub depends_on: &'static [Dependence],
    /// Empty for an effect that is there or not.
    pub parameters: Vec<Parameter>,
    /// Sets of values to begin a fit from, in units the family's own.
    pub starts: Vec<Vec<f64>>,
    /// The recording that shows this effect apart from others.
    pub experiment: &'static str,
    /// Effects that would make this one superfluous or impossible when they are in already.
    pub excludes: &'static [&'static str],
    /// An effect that explains a part of what this one does, and is much easier to find: where it explains nothing, this one is not
    /// looked for.
    pub led_by: Option<&'static str>,
}

/// What the values of a [`Curve`] do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Acts {
    /// They are added to what pushes the output.
    Push,
    /// They are a friction, against motion whichever way it goes.
    Friction,
    /// What drives the output is multiplied by one more than they are.
    Gain,
    /// They are a friction, over the seconds since it last turned round.
    Settling,
    /// They are a force against the way in which it moved last, also at rest: over the way since it turned, a spring that is
    /// wound anew each time, from where it was.
    Hysteresis,
}

impl Acts {
    /// In messages.
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

/// A smooth curve over something the residual depends on; its values at the corners are the parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// What is on its axis.
    pub over: Dependence,
    /// Unit of the axis.
    pub at_unit: &'static str,
    /// Unit of the values.
    pub unit: &'static str,
    /// Corners, increasing.
    pub at: Vec<f64>,
    /// The axis is a circle of this length, the first corner follows the last.
    pub period: Option<f64>,
    /// What its values do.
    pub acts: Acts,
    /// A value that would be noticed.
    pub scale: f64,
}

impl Curve {
    /// With these values at its corners.
    #[must_use]
    pub fn spline(&self, values: &[f64]) -> Spline {
        Spline::through(&self.at, values, self.period)
    }

    /// The same curve with one more corner midway between neighbours; on a circle, between the last and the first too.
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

/// What is added to a base model.
#[derive(Clone, Debug, PartialEq)]
pub enum Term {
    /// An effect, by its index in the catalogue.
    Known(usize),
    /// An effect without a name.
    Curve(Curve),
}

/// A base model and what was added to it, with values for all of it.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Structure {
    /// What was added, in the order of adding.
    pub terms: Vec<Term>,
    /// The base model's values.
    pub base: Vec<f64>,
    /// The values of each term.
    pub added: Vec<Vec<f64>>,
}

impl Structure {
    /// The same structure without the term at a place, which must be one of [`Self::terms`].
    #[must_use]
    pub fn without(&self, place: usize) -> Self {
        let mut without = self.clone();
        without.terms.remove(place);
        without.added.remove(place);
        without
    }

    /// The values of an effect of the catalogue; `None` if it was not added.
    #[must_use]
    pub fn of(&self, candidate: usize) -> Option<&[f64]> {
        let place = self.terms.iter().position(|term| *term == Term::Known(candidate))?;
        Some(&self.added[place])
    }

    /// The curves that were added, with their values.
    pub fn curves(&self) -> impl Iterator<Item = (&Curve, &[f64])> {
        self.terms.iter().zip(&self.added).filter_map(|(term, values)| match term {
            Term::Curve(curve) => Some((curve, &values[..])),
            Term::Known(_) => None,
        })
    }
}

/// A free run that was simulated.
#[derive(Clone, Copy, Debug)]
pub struct Simulated<'s> {
    /// Of what.
    pub structure: &'s Structure,
    /// From where.
    pub initial: &'s [f64],
    /// What came of it.
    pub predicted: &'s [f64],
}

/// A series beside the output that the residual may depend on, one value per sample.
#[derive(Clone, Debug, PartialEq)]
pub struct Driver {
    /// What it is.
    pub over: Dependence,
    /// Its unit.
    pub unit: &'static str,
    /// The axis is a circle of this length, such as a turn.
    pub period: Option<f64>,
    /// One per measured sample.
    pub values: Vec<f64>,
}

/// Numbers and what follows from them: what a fit needs to know.
///
/// `predict` is called many thousand times: it must not allocate more than it has to, and must return finite numbers for
/// all values in range (a run that cannot be simulated is filled with NaN, which counts as infinitely bad).
pub trait Model: Sync {
    /// A run as the model wants it.
    type Run: Clone + Sync;

    /// The base model's parameters; none where all of it is declared.
    fn base(&self) -> &[Parameter];

    /// Every effect these data could show.
    fn catalogue(&self) -> &[Candidate];

    /// A guess of what of the initial state has to be fitted for each run, and how far off each may be; both of the same
    /// length, empty where nothing has to.
    fn initial(&self, run: &Self::Run) -> (Vec<f64>, Vec<f64>);

    /// Free run: what the output would have been, one value for each of [`Model::measured`], from the initial state.
    fn predict(&self, structure: &Structure, initial: &[f64], run: &Self::Run, predicted: &mut [f64]);

    /// Free runs that differ little from one that is known, given to `told` with their index: a family may do once what
    /// they have in common.
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

    /// What was measured; NaN where nothing was.
    fn measured<'r>(&self, run: &'r Self::Run) -> &'r [f64];

    /// Deviation of the noise on it.
    fn noise(&self, run: &Self::Run) -> f64 {
        white_noise(self.measured(run))
    }

    /// Deviation of what the resolution of the sensor leaves of it; 0 where nothing tells.
    fn rounding(&self, _run: &Self::Run) -> f64 {
        0.0
    }
}

/// A model as something that a simulated board loads.
#[derive(Clone, Debug)]
pub enum Loadable {
    /// The text of a plant file.
    Plant(String),
    /// A robot's body.
    Body(Box<FittedBody>),
}

/// A body with what was found of it.
#[derive(Clone, Debug)]
pub struct FittedBody {
    /// The body, at rest.
    pub wheeled: Wheeled,
    /// Where its numbers are from, a line for each.
    pub provenance: Vec<String>,
    /// What was found and no body has, by name, and where it belongs.
    pub left_out: Vec<(String, &'static str)>,
}

impl Loadable {
    /// The text of the plant file; `None` for a body.
    #[must_use]
    pub fn plant(&self) -> Option<&str> {
        match self {
            Self::Plant(text) => Some(text),
            Self::Body(_) => None,
        }
    }

    /// The body; `None` for a plant.
    #[must_use]
    pub fn body(&self) -> Option<&FittedBody> {
        match self {
            Self::Plant(_) => None,
            Self::Body(body) => Some(body),
        }
    }
}

/// A kind of model: what is looked for beside what is fitted, and how it is told.
pub trait Family: Model {
    /// Unit of the output.
    fn unit(&self) -> &'static str;

    /// Sets of base values to begin a fit from, found from the data.
    fn starts(&self, runs: &[&Self::Run]) -> Vec<Vec<f64>>;

    /// Base values by what was declared of the plant beforehand, if anything was. What is missing may have bent a fit of the base
    /// model so far that no slope leads from there to the truth; what was believed before is another place to begin.
    fn declared(&self) -> Option<Vec<f64>> {
        None
    }

    /// The moments of [`Model::measured`], s.
    fn time_s<'r>(&self, run: &'r Self::Run) -> &'r [f64];

    /// Name of the run.
    fn name<'r>(&self, run: &'r Self::Run) -> &'r str;

    /// Name and values of what drives a run, for plots.
    fn input(&self, _run: &Self::Run) -> (String, Vec<f64>) {
        (String::new(), Vec::new())
    }

    /// Samples `from..to` as a run of its own; the input before `from` stays known to models with memory.
    fn part(&self, run: &Self::Run, from: usize, to: usize) -> Self::Run;

    /// Into how many blocks a run is cut to leave some out; `None` for blocks as long as the run's memory asks for.
    fn blocks(&self, _: &Self::Run) -> Option<usize> {
        None
    }

    /// The same model where a fit can begin: no value at an end of its range from which no slope leads back.
    fn movable(&self, structure: Structure) -> Structure {
        structure
    }

    /// Whether a model needs the output earlier than any stamps explain: an output that moves before its input is not driven by it.
    fn is_early(&self, _structure: &Structure) -> bool {
        false
    }

    /// Structures that may predict the same with other numbers, each with what that is, in words.
    fn exchanged(&self, _structure: &Structure) -> Vec<(String, Structure)> {
        vec![]
    }

    /// What is taken as known beside the base model's declared numbers, in words; `None` if nothing is.
    fn known(&self) -> Option<String> {
        None
    }

    /// Whether a model is as late as its base may be: an effect that delays is likely missing.
    fn is_late(&self, _structure: &Structure) -> bool {
        false
    }

    /// Simpler terms that may stand for one of a model's, with values that come near it.
    fn simpler(&self, _structure: &Structure, _place: usize) -> Vec<(Term, Vec<f64>)> {
        vec![]
    }

    /// One term that may replace two of a structure: the places of the two, of which the first is kept for it, the term, and initial
    /// guesses of its values. `None` where there are no two such terms.
    fn merged(&self, _structure: &Structure) -> Option<([usize; 2], Term, Vec<f64>)> {
        None
    }

    /// Initial states from which that of a run is to be sought under a model, if one is not enough.
    fn beginnings(&self, _structure: &Structure, run: &Self::Run) -> Vec<Vec<f64>> {
        vec![self.initial(run).0]
    }

    /// The most promising of some structures that add to a model as it is, with values from which a fit has less far to go,
    /// and what they leave (a sum of squares, to be compared with other guesses for the same runs): found without free runs.
    /// `None` where there is no such way.
    fn guess(
        &self,
        _starts: Vec<Structure>,
        _current: &Fit,
        _runs: &[&Self::Run],
        _effort: Effort,
    ) -> Option<(Structure, f64)> {
        None
    }

    /// The series that the residual is compared with.
    fn drivers(&self, structure: &Structure, initial: &[f64], run: &Self::Run) -> Vec<Driver>;

    /// The residual of the output as the push that is missing, and its unit: what causes show in. `None` where the
    /// residual of the output itself is best looked at.
    fn push(&self, _structure: &Structure, _run: &Self::Run, _residual: &[f64]) -> Option<(Vec<f64>, &'static str)> {
        None
    }

    /// Values, deviations and intervals in the units of reports: of the base model, and of each term. By default as they
    /// are fitted.
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
                    // They are told as a table.
                    let corner = Parameter { name: "", unit: "", range: Range::Any { scale: 1.0 }, absent: None };
                    values.iter().for_each(|value| drop(estimate((&corner, value))));
                    BTreeMap::new()
                }
            })
            .collect();
        (base, terms)
    }

    /// Whether a parameter of the base model, or an effect, is of the recording's stamps and not of the machine; its name in
    /// [`Report::timing`](crate::report::Report::timing).
    fn timing(&self, _name: &str) -> Option<&'static str> {
        None
    }

    /// By how much a curve's values are multiplied to be in its unit.
    fn force_per_push(&self, _structure: &Structure) -> f64 {
        1.0
    }

    /// The model as something that a simulated board loads.
    fn loadable(&self, structure: &Structure, source: &str) -> Loadable;

    /// Empty curves over a driver, one for each way in which a model as it is can take one up.
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
