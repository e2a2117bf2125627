//! Proposal of terms that may be added to a model, with their initial guesses.

use super::{LEAST_SAMPLES, Search};
use crate::{
    family::{Candidate, Curve, Family, Structure, Term},
    fit::{self, Effort, Fit, fit},
    parallel,
};

/// Largest cost of a candidate's initial guess, as a multiple of the lowest; others are dropped.
const HOPELESS: f64 = 5.0;
/// Number of the best guesses that are fitted by free-run simulation. With half of it and half of `PROMISING`
/// ([`super::judge`]), wrong names came first for one more of 12 plants with an effect in no catalogue (tuning seeds
/// 900000 to 900011), and the time was the same. The other constants here are our choices, made for speed; other
/// values were not compared.
const FOLLOWED: usize = 8;
/// Largest cost of a guess, as a multiple of the lowest, at which it is refined first.
const CLOSE: f64 = 2.5;
/// Largest number of these: half as many again as are followed. With all, the times of 3 tuning pairs (10560003 to
/// 10560005) are a tenth more and their results the same.
const REFINED: usize = 12;
/// Largest ratio of the costs with and without an effect at which candidates that it leads to are tried.
const LEADING: f64 = 0.97;
/// Number of starts above which an effect is first evaluated at each without a fit, and fitted from the best only.
const MOST_STARTS: usize = 24;
const NEAREST: usize = 3;
/// Number of starts from a rough guess, before those of the catalogue: with the rest of the model as guessed and unchanged. With these alone a
/// held command beside a compliance was called a delay (tuning pair 10700095: 4.97 times the noise; 4.30 and the right names with both).
const ROUGH: usize = 2;

/// Term with its fit.
pub(super) struct Trial {
    pub(super) term: Term,
    pub(super) fit: Fit,
    /// Cost of the family's guess; infinite without one.
    pub(super) guess: f64,
}

/// Initial guess of a fit: its structure, and the initial states.
type Start = (Structure, Vec<Vec<f64>>);

/// Term that may be added, with its initial guesses.
pub(super) struct Begun {
    pub(super) term: Term,
    pub(super) starts: Vec<Start>,
    /// Cost of the family's guess; infinite without one.
    pub(super) guess: f64,
    /// True if the guess is too rough to exclude the term.
    is_rough: bool,
}

impl<F: Family> Search<'_, F> {
    /// Returns a model's structure with one more term.
    fn with(&self, current: &Fit, term: Term, values: &[f64]) -> Structure {
        let mut structure = self.family.movable(current.structure.clone());
        structure.terms.push(term);
        structure.added.push(values.to_vec());
        structure
    }

    /// Returns every effect that may be added, with its initial guesses.
    pub(super) fn effects(&self, current: &Fit) -> Vec<Begun> {
        let without = self.guess(vec![current.structure.clone()], current, Effort::GLANCE).map(|(_, left)| left);
        let is_led = |(_, candidate): &(usize, &Candidate)| candidate.led_by.is_some();
        let (led, others): (Vec<_>, Vec<_>) = self.open(current).into_iter().partition(is_led);
        let begun = |all: Vec<(usize, &Candidate)>| -> Vec<Begun> {
            parallel::map(all, |(index, candidate)| self.begin(current, index, candidate))
        };
        let mut all = begun(others);
        let leads = |led: &Candidate| {
            let leader = all.iter().find(|one| led.led_by.is_some_and(|name| self.term_name(&one.term) == name));
            // A family that makes no guesses rules nothing out.
            self.family.is_late(&current.structure)
                || self.family.guesses_roughly(&current.structure)
                || leader.zip(without).is_none_or(|(leader, without)| leader.guess < LEADING * without)
        };
        let led = led.into_iter().filter(|(_, candidate)| leads(candidate)).collect();
        all.extend(begun(led));
        all
    }

    /// Returns the effects that are neither included nor excluded by included ones.
    fn open(&self, current: &Fit) -> Vec<(usize, &Candidate)> {
        let catalogue = self.family.catalogue();
        let names: Vec<&str> = current
            .structure
            .terms
            .iter()
            .filter_map(|term| if let Term::Known(index) = term { Some(catalogue[*index].name) } else { None })
            .collect();
        let open = |candidate: &Candidate| {
            !names.contains(&candidate.name) && !candidate.excludes.iter().any(|name| names.contains(name))
        };
        catalogue.iter().enumerate().filter(|(_, candidate)| open(candidate)).collect()
    }

    /// Refines the best guesses with more effort.
    pub(super) fn refine(&self, all: &mut [Begun], current: &Fit) {
        all.sort_by(|a, b| a.guess.total_cmp(&b.guess));
        let least = all.first().map_or(f64::INFINITY, |one| one.guess);
        let close = all.iter_mut().take(REFINED).filter(|one| one.guess <= CLOSE * least);
        parallel::map(close, |one| {
            let guessed = if one.is_rough { ROUGH } else { one.starts.len() };
            let starts = one.starts.iter().take(guessed).map(|(structure, _)| structure.clone()).collect();
            if let Some((guessed, guess)) = self.guess(starts, current, Effort::SCREEN) {
                (one.starts[0], one.guess) = (guessed, guess);
            }
        });
    }

    /// Returns the initial guesses of an effect: the family's, with the rest of the model as guessed and unchanged;
    /// without a guess or beside a rough one those of the catalogue's starts that have the lowest cost.
    fn begin(&self, current: &Fit, index: usize, candidate: &Candidate) -> Begun {
        let term = Term::Known(index);
        let with = |values: &Vec<f64>| self.with(current, term.clone(), values);
        let as_it_is = |structure| (structure, current.initial.clone());
        let mut starts: Vec<Structure> = candidate.starts.iter().map(with).collect();
        let by_declared = self.by_declared(&starts);
        let is_rough = self.family.guesses_roughly(&current.structure);
        let (mut guesses, mut least) = (vec![], f64::INFINITY);
        if let Some((guessed, guess)) = self.guess(starts.clone(), current, Effort::GLANCE) {
            // A second start keeps the base as fitted and takes only the effect's values from the guess.
            let same_base = with(guessed.0.added.last().unwrap_or(&vec![]));
            (guesses, least) = (vec![guessed, as_it_is(same_base)], guess);
            if !is_rough {
                let starts = guesses.into_iter().chain(by_declared).collect();
                return Begun { term, starts, guess, is_rough };
            }
        }
        if starts.len() > MOST_STARTS {
            let cost = |structure: &Structure| fit::cost(self.family, &self.runs, structure, &current.initial);
            let mut costs: Vec<(f64, Structure)> = starts.into_iter().map(|start| (cost(&start), start)).collect();
            costs.sort_by(|a, b| a.0.total_cmp(&b.0));
            starts = costs.into_iter().take(NEAREST).map(|(_, start)| start).collect();
        }
        let starts = guesses.into_iter().chain(starts.into_iter().map(as_it_is)).chain(by_declared).collect();
        Begun { term, starts, guess: least, is_rough }
    }

    /// Returns the best of an effect's starts on the declared base, with matching initial states.
    fn by_declared(&self, starts: &[Structure]) -> Option<Start> {
        let base = self.family.declared()?;
        let cost = |start: &Structure| {
            let start = Structure { base: base.clone(), ..start.clone() };
            let initial = self.settled_early(&start);
            (fit::cost(self.family, &self.runs, &start, &initial), (start, initial))
        };
        parallel::map(starts, cost).into_iter().min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, start)| start)
    }

    /// Returns the family's guess with initial states from the begin of each run, and its cost.
    fn guess(&self, starts: Vec<Structure>, current: &Fit, effort: Effort) -> Option<(Start, f64)> {
        let (structure, guess) = self.family.guess(starts, current, &self.runs, effort)?;
        let initial = self.settled_early(&structure);
        Some(((structure, initial), guess))
    }

    /// Returns initial states from the begin of each run.
    fn settled_early(&self, structure: &Structure) -> Vec<Vec<f64>> {
        let settled = |run: &&F::Run| {
            let samples = self.family.measured(run).len();
            fit::settle(self.family, structure, run, (samples / 4).max(LEAST_SAMPLES))
        };
        self.runs.iter().map(settled).collect()
    }

    /// Returns every curve that may be added, with its initial guesses; none over an axis that a curve of the model
    /// acts on in the same way.
    pub(super) fn curves(&self, current: &Fit) -> Vec<Begun> {
        let Some(drivers) =
            self.runs.first().map(|run| self.family.drivers(&current.structure, &current.initial[0], run))
        else {
            return vec![];
        };
        let curves =
            parallel::map(drivers, |driver| self.family.curves(current, (driver.over, driver.period), &self.runs));
        let is_new = |curve: &Curve| {
            !current.structure.curves().any(|(other, _)| (other.over, other.acts) == (curve.over, curve.acts))
        };
        parallel::map(curves.into_iter().flatten().filter(is_new), |curve| {
            let none = self.with(current, Term::Curve(curve.clone()), &vec![0.0; curve.at.len()]);
            let (guessed, guess) = self.guess(vec![none.clone()], current, Effort::SCREEN).unzip();
            let starts = guessed.into_iter().chain([(none, current.initial.clone())]).collect();
            Begun { term: Term::Curve(curve), starts, guess: guess.unwrap_or(f64::INFINITY), is_rough: false }
        })
    }

    /// Fits the terms that no guess rules out from each of their starts, and returns the best fit of each.
    pub(super) fn tried(&self, mut begun: Vec<Begun>) -> Vec<Trial> {
        let least = begun.iter().map(|one| one.guess).fold(f64::INFINITY, f64::min);
        let is_open = |one: &Begun| one.is_rough || one.guess.is_infinite();
        begun.retain(|one| is_open(one) || one.guess <= HOPELESS * least);
        begun.sort_by(|a, b| a.guess.total_cmp(&b.guess));
        let mut guessed = 0;
        begun.retain(|one| {
            guessed += usize::from(!is_open(one));
            is_open(one) || guessed <= FOLLOWED
        });
        let fitted = |Begun { term, starts, guess, .. }: Begun| {
            if self.is_over() {
                return None;
            }
            let fits = parallel::map(starts, |(structure, initial)| {
                fit(self.family, &self.runs, structure, initial, Effort::GLANCE)
            });
            let fit = fits.into_iter().min_by(|a, b| a.cost.total_cmp(&b.cost))?;
            Some(Trial { term, fit, guess })
        };
        parallel::filter_map(begun, fitted)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::{
        data::{Quantity, Run, Signal},
        family::Model,
        motion::{Kind, Known, Motion, MotionRun},
    };

    /// Returns a model of a motor's angle, and a recording in which it swings.
    fn swinging() -> (Motion, Vec<MotionRun>) {
        let signal = |column: &str, quantity, value: fn(f64) -> f64| {
            let values = (0..400).map(|sample| value(0.005 * f64::from(sample))).collect();
            (column.to_owned(), Signal { quantity, values, column: column.to_owned() })
        };
        let signals = BTreeMap::from([
            signal("input", Quantity::Number, |time_s| 0.5 * (6.0 * time_s).sin()),
            // Resolved to 1 mrad, as by an encoder.
            signal("output", Quantity::Angle, |time_s| (1e3 * (6.0 * time_s - 0.4).sin()).round() * 1e-3),
        ]);
        let time_s = (0..400).map(|sample| 0.005 * f64::from(sample)).collect();
        let recorded = [Run { name: "swing".to_owned(), time_s, origin_s: None, signals }];
        let known = Known { supply_v: Some(12.0), ..Known::default() };
        let (model, runs, _) = Motion::new(Kind::DcMotor, &known, &recorded, &[]).expect("a model");
        (model, runs)
    }

    #[test]
    fn a_guess_behind_a_lag_excludes_neither_effects_nor_starts() {
        let (model, runs) = swinging();
        let runs: Vec<&MotionRun> = runs.iter().collect();
        let lag = model.catalogue().iter().position(|candidate| candidate.name == "sensor-lag").expect("a lag");
        let halves = [vec![], vec![]];
        let search = Search {
            family: &model,
            whole: runs.clone(),
            runs: runs.clone(),
            halves: &halves,
            progress: &|_| (),
            until: None,
        };
        for (terms, is_rough) in [(vec![], false), (vec![Term::Known(lag)], true)] {
            let added = terms.iter().map(|_| vec![0.05]).collect();
            let structure = Structure { base: model.starts(&runs).remove(0), terms, added };
            let current = Fit::at(&model, &runs, structure, fit::guessed(&model, &runs));
            let mut begun: Vec<Begun> =
                search.effects(&current).into_iter().filter(|one| one.guess.is_finite()).collect();
            assert!(begun.len() > 2, "{} guesses", begun.len());
            for one in &begun {
                let Term::Known(index) = one.term else { panic!("an effect") };
                let offered = model.catalogue()[index].starts.len();
                let others = if offered > MOST_STARTS { NEAREST } else { offered };
                assert_eq!(
                    one.starts.len(),
                    ROUGH + if is_rough { others } else { 0 },
                    "{}",
                    search.term_name(&one.term)
                );
            }
            // One guess is far better than the others.
            begun.truncate(3);
            begun.iter_mut().enumerate().for_each(|(place, one)| one.guess = if place == 0 { 1.0 } else { 100.0 });
            assert_eq!(search.tried(begun).len(), if is_rough { 3 } else { 1 });
        }
    }
}
