//! Play of a held shaft that is pulled from both sides in turn: backlash, elasticity, and the droop of its
//! controller.
//!
//! Each pull and each rest after it is a phase, represented by its last sample, the most settled one. The distance
//! between the ends of pulls from both sides is the gap under load; the distance between the ends of the rests is the
//! gap without load. A spring returns to the middle when it is released, a shaft with backlash stays where it was
//! left: the gap without load distinguishes them. The distance by which the shaft returns when the pull ends is
//! elasticity plus the droop of a proportional controller, which only a known pulling force can separate.

use r4_maths::statistics::RootMeanSquare;
use r4_plants::Dependence;
use serde::Serialize;
use thiserror::Error;

use super::map::{median, unit};
use super::plant::with_play;
use crate::data::Run;
use crate::family::{Acts, Candidate, Curve, Driver, Family, Loadable, Model, Parameter, Range, Structure, Term};
use crate::fit::Fit;
use crate::task::{FileKind, ModelInfo, RoleInfo};

/// Reason why a recording shows no play.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum HysteresisError {
    /// A role has no column.
    #[error("{run}: no column is mapped to `{role}`: name one with --map {role}=COLUMN")]
    NoRole {
        /// Name of the recording.
        run: String,
        /// Name of the role: `output`, `pull_a` or `pull_b`.
        role: &'static str,
    },
    /// One side pulled too seldom or never.
    #[error(
        "{run}: {pulls} pulls by `{role}`, {needed} are needed: pull from both sides in turn, each at least {needed} times, \
         and let go in between"
    )]
    TooFewPulls {
        /// Name of the recording.
        run: String,
        /// Name of the role: `pull_a` or `pull_b`.
        role: &'static str,
        /// Number of pulls found.
        pulls: usize,
        /// Smallest number of pulls.
        needed: usize,
    },
    /// The shaft was never released.
    #[error("{run}: no sample between the pulls: let go for a second after each pull")]
    NoRest {
        /// Name of the recording.
        run: String,
    },
}

/// Side that pulled last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Side {
    /// Side of the role `pull_a`.
    A,
    /// Side of the role `pull_b`.
    B,
}

/// End of a pull, or of the rest after it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseEnd {
    /// Side that pulled in this phase.
    pub side: Side,
    /// True while the side still pulls, false for the rest after it.
    pub loaded: bool,
    /// Number of earlier pulls by this side.
    pub cycle: usize,
    /// Begin of the phase, s.
    pub from_s: f64,
    /// Time of the last sample of the phase, s.
    pub at_s: f64,
    /// Output at the end of the phase, relative to the goal if there is one.
    pub position: f64,
    /// Duty or current that holds the shaft; NaN if it was not recorded.
    pub load: f64,
}

/// Smallest number of pulls of each side: one to see a gap, one to see whether it repeats.
const LEAST_PULLS: usize = 2;

/// Returns the samples at which a puller is more than nine tenths of its largest stroke away from its rest. A
/// position thus counts from its arrival to its departure; a command counts as a whole.
fn pulling(signal: &[f64]) -> Vec<bool> {
    let known: Vec<f64> = signal.iter().copied().filter(|value| value.is_finite()).collect();
    // The median is the rest, because each side rests more than half of the time.
    let rest = median(&known);
    let stroke = known.iter().map(|value| (value - rest).abs()).fold(0.0, f64::max);
    signal.iter().map(|value| stroke > 0.0 && (value - rest).abs() >= 0.9 * stroke).collect()
}

/// Finds the phases of a recording in the order of time. Its roles are `output`, `pull_a` and `pull_b` (commands or
/// positions of the pullers) and optionally `goal` (of the shaft) and `load`.
///
/// Without a goal each rest is as long as the shortest one between two pulls, because the shaft may be moved later.
///
/// # Errors
/// An error for a missing role, fewer than two pulls of a side, or no release.
pub fn phase_ends(run: &Run) -> Result<Vec<PhaseEnd>, HysteresisError> {
    let role = |role| run.values(role).ok_or_else(|| HysteresisError::NoRole { run: run.name.clone(), role });
    let (output, a, b) = (role("output")?, pulling(role("pull_a")?), pulling(role("pull_b")?));
    let (goal, load) = (run.values("goal"), run.values("load"));
    let samples = output.len();
    // Side, first sample and end of each pull.
    let mut pulls: Vec<(Side, usize, usize)> = Vec::new();
    for (side, on) in [(Side::A, &a), (Side::B, &b)] {
        let mut sample = 0;
        while sample < samples {
            let start = sample;
            while sample < samples && on[sample] {
                sample += 1;
            }
            if sample > start {
                pulls.push((side, start, sample));
            }
            sample += 1;
        }
    }
    pulls.sort_by_key(|pull| pull.1);
    for (side, role) in [(Side::A, "pull_a"), (Side::B, "pull_b")] {
        let found = pulls.iter().filter(|pull| pull.0 == side).count();
        if found < LEAST_PULLS {
            return Err(HysteresisError::TooFewPulls {
                run: run.name.clone(),
                role,
                pulls: found,
                needed: LEAST_PULLS,
            });
        }
    }
    // Rests are cut to the shortest one if no goal shows when the shaft was sent elsewhere.
    let shortest = pulls.windows(2).map(|pair| pair[1].1.saturating_sub(pair[0].2)).min().unwrap_or(0);
    let known = |sample: usize| output[sample].is_finite() && goal.is_none_or(|goal| goal[sample].is_finite());
    let end_of = |side, loaded, cycle, from: usize, to: usize| {
        let last = (from..to).rev().find(|&sample| known(sample))?;
        Some(PhaseEnd {
            side,
            loaded,
            cycle,
            from_s: run.time_s[from],
            at_s: run.time_s[last],
            position: output[last] - goal.map_or(0.0, |goal| goal[last]),
            load: load.map_or(f64::NAN, |load| load[last]),
        })
    };
    let mut ends = Vec::new();
    let mut cycles = [0, 0];
    for (place, &(side, start, end)) in pulls.iter().enumerate() {
        let cycle = cycles[side as usize];
        cycles[side as usize] += 1;
        // If the goal changes during the pull, its end is not comparable.
        let stays = |sample: usize| goal.is_none_or(|goal| goal[sample] == goal[start]);
        if !(start..end).all(stays) {
            continue;
        }
        ends.extend(end_of(side, true, cycle, start, end));
        let next = pulls.get(place + 1).map_or(samples, |next| next.1);
        let until = match goal {
            Some(_) => (end..next).find(|&sample| !stays(sample)).unwrap_or(next),
            None => next.min(end + shortest),
        };
        // The first sample of the rest still belongs to the pull.
        if until > end + 1 {
            ends.extend(end_of(side, false, cycle, end + 1, until));
        }
    }
    if !ends.iter().any(|end| !end.loaded) {
        return Err(HysteresisError::NoRest { run: run.name.clone() });
    }
    Ok(ends)
}

/// Gap with its standard error, in the output's unit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Gap {
    /// Difference between the means of both sides; positive if A ends above B.
    pub value: f64,
    /// Standard error, from the scatter of the ends of each side and the output's resolution.
    pub std: f64,
    /// Number of ends of A and of B.
    pub ends: [usize; 2],
}

/// One explanation of the positions at which the shaft ends.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Explanation {
    /// Name of the explanation: `rigid`, `elasticity`, `backlash`, `backlash and elasticity`.
    pub name: &'static str,
    /// RMSE on the pulls that it was fitted to, in the output's unit.
    pub rmse: f64,
    /// RMSE on the later pulls, in the output's unit.
    pub holdout_rmse: f64,
}

/// Stiffness of the controller that holds the shaft: regression of the load's magnitude on the distance to the goal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Droop {
    /// Load per unit of distance.
    pub load_per_distance: f64,
    /// Distance below which the controller does nothing, in the output's unit; it alone makes a gap of twice this
    /// width.
    pub dead_band: f64,
}

/// Analysis of the play of a shaft in one recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Play {
    /// Gap between the ends of the pulls.
    pub loaded: Gap,
    /// Gap between the ends of the rests after them.
    pub unloaded: Gap,
    /// Distance by which the shaft returns when a pull ends, half the difference of the gaps: elasticity and droop
    /// together.
    pub returns_by: f64,
    /// Explanations, fitted to the first two pulls of each side, in the order of their error on the later ones.
    pub explanations: Vec<Explanation>,
    /// Stiffness of the controller; `None` without a goal or a load in the recording.
    pub droop: Option<Droop>,
    /// Resolution of the output: the smallest step in it.
    pub step: f64,
    /// Advice for a recording that separates elasticity from droop, and play from friction.
    pub experiment: &'static str,
}

/// Number of pulls of each side that explanations are fitted to.
const FITTED: usize = 2;

const EXPERIMENT: &str = "the same pulls with a force that is known, at two forces and at two gains: droop goes with one over the gain, \
                          elasticity with the force alone, play with neither";

/// Returns the play of a shaft, in the unit of the output.
///
/// # Errors
/// Errors of [`phase_ends`], and [`HysteresisError::NoRest`] if one side was never released.
pub fn play(run: &Run) -> Result<Play, HysteresisError> {
    let ends = phase_ends(run)?;
    let step = run.values("output").map_or(0.0, smallest_step);
    let gap = |loaded| gap(&ends, loaded, step).ok_or_else(|| HysteresisError::NoRest { run: run.name.clone() });
    let (loaded, unloaded) = (gap(true)?, gap(false)?);
    let mut explanations = explanations(&ends);
    explanations.sort_by(|a, b| a.holdout_rmse.total_cmp(&b.holdout_rmse));
    Ok(Play {
        loaded,
        unloaded,
        returns_by: (loaded.value.abs() - unloaded.value.abs()) / 2.0,
        explanations,
        droop: run.values("goal").and_then(|_| droop(&ends)),
        step,
        experiment: EXPERIMENT,
    })
}

/// Returns the smallest difference between successive values that differ; 0 if none do.
fn smallest_step(output: &[f64]) -> f64 {
    let largest =
        output.iter().filter(|value| value.is_finite()).fold(0.0f64, |largest, value| largest.max(value.abs()));
    let steps = output.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > 1e-9 * largest);
    let least = steps.fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

fn gap(ends: &[PhaseEnd], loaded: bool, step: f64) -> Option<Gap> {
    let of = |side| -> Option<(f64, f64, usize)> {
        let positions: Vec<f64> =
            ends.iter().filter(|end| end.side == side && end.loaded == loaded).map(|end| end.position).collect();
        let count = positions.len();
        if count == 0 {
            return None;
        }
        let mean = positions.iter().sum::<f64>() / count as f64;
        let spread =
            positions.iter().map(|position| (position - mean).powi(2)).sum::<f64>() / (count as f64 - 1.0).max(1.0);
        // Ends with equal readings are still known only to the resolution (variance of rounding: step² / 12).
        Some((mean, spread.max(step * step / 12.0) / count as f64, count))
    };
    let ((a, variance_a, count_a), (b, variance_b, count_b)) = (of(Side::A)?, of(Side::B)?);
    Some(Gap { value: a - b, std: (variance_a + variance_b).sqrt(), ends: [count_a, count_b] })
}

/// Column of a linear model: the contribution to a phase's end per unit of a parameter.
type Column<'c> = &'c dyn Fn(&PhaseEnd) -> f64;

/// Fits each explanation to the first pulls, and predicts the later ones.
fn explanations(ends: &[PhaseEnd]) -> Vec<Explanation> {
    let way = |end: &PhaseEnd| if end.side == Side::A { 1.0 } else { -1.0 };
    let stays = |end: &PhaseEnd| way(end);
    let springs = |end: &PhaseEnd| if end.loaded { way(end) } else { 0.0 };
    let kinds: [(&'static str, &[Column<'_>]); 4] = [
        ("rigid", &[]),
        ("elasticity", &[&springs]),
        ("backlash", &[&stays]),
        ("backlash and elasticity", &[&stays, &springs]),
    ];
    let (fitted, later): (Vec<&PhaseEnd>, Vec<&PhaseEnd>) = ends.iter().partition(|end| end.cycle < FITTED);
    let explain = |(name, columns): (&'static str, &[Column<'_>])| {
        let entry = |end: &PhaseEnd, column: usize| if column == 0 { 1.0 } else { columns[column - 1](end) };
        // Column 0 is the middle, which every explanation has.
        let design =
            nalgebra::DMatrix::from_fn(fitted.len(), columns.len() + 1, |row, column| entry(fitted[row], column));
        let positions = nalgebra::DVector::from_fn(fitted.len(), |row, _| fitted[row].position);
        // An SVD also solves a design in which a column is zero.
        let values = design.svd(true, true).solve(&positions, 1e-9).ok()?;
        let rmse = |ends: &[&PhaseEnd]| {
            let error = |end: &&PhaseEnd| {
                let expected: f64 = values.iter().enumerate().map(|(column, value)| value * entry(end, column)).sum();
                end.position - expected
            };
            ends.iter().map(error).collect::<RootMeanSquare>().value().unwrap_or(f64::NAN)
        };
        Some(Explanation { name, rmse: rmse(&fitted), holdout_rmse: rmse(&later) })
    };
    kinds.into_iter().filter_map(explain).collect()
}

fn droop(ends: &[PhaseEnd]) -> Option<Droop> {
    let points: Vec<(f64, f64)> =
        ends.iter().filter(|end| end.load.is_finite()).map(|end| (end.position.abs(), end.load.abs())).collect();
    let count = points.len() as f64;
    let (mx, my) = points.iter().fold((0.0, 0.0), |(x, y), point| (x + point.0 / count, y + point.1 / count));
    let xx: f64 = points.iter().map(|point| (point.0 - mx).powi(2)).sum();
    let xy: f64 = points.iter().map(|point| (point.0 - mx) * (point.1 - my)).sum();
    (xx > 0.0 && xy > 0.0).then(|| {
        let load_per_distance = xy / xx;
        Droop { load_per_distance, dead_band: (mx - my / load_per_distance).max(0.0) }
    })
}

/// Divides one recording into two: the second has the output of every `every`th pull of each side and of the rest
/// after it, the first has the others. `None` if `every` is below 2, or if one part has too few pulls.
#[must_use]
pub fn alternate_cycles(run: &Run, every: usize) -> Option<(Run, Run)> {
    let ends = phase_ends(run).ok().filter(|_| every > 1)?;
    let only = |second: bool| {
        let mut part = run.clone();
        let output = part.signals.get_mut("output")?;
        for end in ends.iter().filter(|end| (end.cycle % every == every - 1) != second) {
            let samples = output.values.iter_mut().zip(&run.time_s);
            samples
                .filter(|(_, time)| (end.from_s..=end.at_s).contains(*time))
                .for_each(|(value, _)| *value = f64::NAN);
        }
        let both = |side| phase_ends(&part).is_ok_and(|ends| ends.iter().any(|end| end.side == side));
        (both(Side::A) && both(Side::B)).then_some(part)
    };
    only(false).zip(only(true))
}

/// Phases of one recording as rows of a regression.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldRun {
    name: String,
    time_s: Vec<f64>,
    measured: Vec<f64>,
    /// Side that pulled last, +1 or -1, with the sign that makes the gap positive.
    last_pull: Vec<f64>,
    /// The same while the side pulls, 0 during rests.
    pull: Vec<f64>,
}

impl HeldRun {
    /// Finds the phases of a recording and makes them rows.
    ///
    /// # Errors
    /// Errors of [`phase_ends`].
    pub fn new(run: &Run) -> Result<Self, HysteresisError> {
        let ends = phase_ends(run)?;
        // The side that ends higher counts as positive, because the model's gap cannot be negative.
        let sign = gap(&ends, true, 0.0).map_or(1.0, |gap| if gap.value < 0.0 { -1.0 } else { 1.0 });
        let way = |end: &PhaseEnd| if end.side == Side::A { sign } else { -sign };
        Ok(Self {
            name: run.name.clone(),
            time_s: ends.iter().map(|end| end.at_s).collect(),
            measured: ends.iter().map(|end| end.position).collect(),
            last_pull: ends.iter().map(way).collect(),
            pull: ends.iter().map(|end| if end.loaded { way(end) } else { 0.0 }).collect(),
        })
    }

    fn rows(&self, from: usize, to: usize) -> Self {
        let cut = |values: &[f64]| values[from..to].to_vec();
        Self {
            name: self.name.clone(),
            time_s: cut(&self.time_s),
            measured: cut(&self.measured),
            last_pull: cut(&self.last_pull),
            pull: cut(&self.pull),
        }
    }
}

/// The model `held-shaft`: positions at which a held shaft ends after each pull and each rest.
///
/// Without effects the shaft yields to a pull and returns to the middle, like anything that a spring or a
/// proportional controller holds.
#[derive(Clone, Debug)]
pub struct HeldShaft {
    base: [Parameter; 2],
    catalogue: [Candidate; 2],
    unit: &'static str,
}

impl HeldShaft {
    /// Name of the model, for `--model`.
    pub const NAME: &str = "held-shaft";

    /// Returns the description for the list of models.
    #[must_use]
    pub fn info() -> ModelInfo {
        let role = |name, required, driving, what| RoleInfo { name, required, driving, what };
        ModelInfo {
            name: Self::NAME,
            summary: "where a held shaft ends that is pulled from both sides in turn, and let go in between",
            roles: vec![
                role("output", true, false, "position of the shaft"),
                role("pull_a", true, true, "command or position of what pulls from one side"),
                role("pull_b", true, true, "command or position of what pulls from the other"),
                role("goal", false, true, "where the shaft is to be"),
                role("load", false, false, "duty or current that holds it"),
            ],
            parameters: vec![],
            effects: vec!["backlash", "drift"],
            file: FileKind::Plant,
        }
    }

    /// Returns the model for some recordings, and the prepared recordings: those to fit to and those held out.
    ///
    /// # Errors
    /// Errors of [`phase_ends`].
    pub fn prepare(train: &[Run], holdout: &[Run]) -> Result<(Self, Vec<HeldRun>, Vec<HeldRun>), HysteresisError> {
        let make = |runs: &[Run]| runs.iter().map(HeldRun::new).collect::<Result<Vec<_>, _>>();
        let (fitted, held_out) = (make(train)?, make(holdout)?);
        let unit = train.first().map_or("1", unit);
        Ok((Self::new(&fitted.iter().collect::<Vec<_>>(), unit), fitted, held_out))
    }

    /// Creates a model whose parameter scales follow from the range of these runs' positions.
    #[must_use]
    pub fn new(runs: &[&HeldRun], unit: &'static str) -> Self {
        let positions = runs.iter().flat_map(|run| run.measured.iter().copied());
        let (low, high) =
            positions.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        let span = if high > low { high - low } else { 1.0 };
        let length_s = runs.iter().filter_map(|run| run.time_s.last()).fold(1.0, |most: f64, &time| most.max(time));
        let scale = 0.05 * span;
        let effect = |name, depends_on, parameter, start, experiment| Candidate {
            name,
            depends_on,
            parameters: vec![parameter],
            starts: vec![vec![start]],
            experiment,
            excludes: &[],
            led_by: None,
        };
        let size = |name, range| Parameter { name, unit, range, absent: Some(0.0) };
        Self {
            base: [
                Parameter { name: "middle", unit, range: Range::Any { scale }, absent: None },
                Parameter { name: "gives_way", unit, range: Range::NotNegative { scale }, absent: Some(0.0) },
            ],
            catalogue: [
                effect(
                    "backlash",
                    &[Dependence::History],
                    size("gap", Range::NotNegative { scale }),
                    0.5 * span,
                    "pull from both sides in turn, and let go in between",
                ),
                effect(
                    "drift",
                    &[Dependence::Time],
                    Parameter { name: "per_s", unit, range: Range::Any { scale: scale / length_s }, absent: Some(0.0) },
                    0.0,
                    "the same pulls after an hour",
                ),
            ],
            unit,
        }
    }
}

impl Model for HeldShaft {
    type Run = HeldRun;

    fn base(&self) -> &[Parameter] {
        &self.base
    }

    fn catalogue(&self) -> &[Candidate] {
        &self.catalogue
    }

    fn initial(&self, _: &HeldRun) -> (Vec<f64>, Vec<f64>) {
        (Vec::new(), Vec::new())
    }

    fn predict(&self, structure: &Structure, _: &[f64], run: &HeldRun, predicted: &mut [f64]) {
        let base = |place| structure.base.get(place).copied().unwrap_or(0.0);
        let of = |candidate| structure.of(candidate).map_or(0.0, |values| values[0]);
        let (middle, gives_way, gap, drift) = (base(0), base(1), of(0), of(1));
        for (row, out) in predicted.iter_mut().enumerate() {
            *out = middle + 0.5 * gap * run.last_pull[row] + gives_way * run.pull[row] + drift * run.time_s[row];
        }
        for (curve, values) in structure.curves() {
            let spline = curve.spline(values);
            for (row, out) in predicted.iter_mut().enumerate() {
                *out += spline.value(run.time_s[row]);
            }
        }
    }

    fn measured<'r>(&self, run: &'r HeldRun) -> &'r [f64] {
        &run.measured
    }
}

impl Family for HeldShaft {
    fn unit(&self) -> &'static str {
        self.unit
    }

    fn starts(&self, runs: &[&HeldRun]) -> Vec<Vec<f64>> {
        let all: Vec<f64> = runs.iter().flat_map(|run| run.measured.iter().copied()).collect();
        let Range::NotNegative { scale } = self.base[1].range else { return vec![] };
        vec![vec![median(&all), 4.0 * scale]]
    }

    fn time_s<'r>(&self, run: &'r HeldRun) -> &'r [f64] {
        &run.time_s
    }

    fn name<'r>(&self, run: &'r HeldRun) -> &'r str {
        &run.name
    }

    fn part(&self, run: &HeldRun, from: usize, to: usize) -> HeldRun {
        run.rows(from, to)
    }

    /// Cuts blocks of one pull from each side with their rests: a single side shows no gap.
    fn blocks(&self, run: &HeldRun) -> Option<usize> {
        Some(run.measured.len() / 4)
    }

    fn drivers(&self, _: &Structure, _: &[f64], run: &HeldRun) -> Vec<Driver> {
        let driver = |over, unit, values: &[f64]| Driver { over, unit, period: None, values: values.to_vec() };
        vec![
            driver(Dependence::Input, "1", &run.pull),
            driver(Dependence::History, "1", &run.last_pull),
            driver(Dependence::Time, "s", &run.time_s),
        ]
    }

    fn input(&self, run: &HeldRun) -> (String, Vec<f64>) {
        ("pull".to_owned(), run.pull.clone())
    }

    fn loadable(&self, structure: &Structure, source: &str) -> Loadable {
        let base = self.base.iter().zip(&structure.base);
        let found = base.map(|(parameter, value)| format!("{} = {value:?} {}", parameter.name, self.unit));
        let others = structure.terms.iter().filter_map(|term| match term {
            Term::Known(0) => None,
            Term::Known(index) => Some(self.catalogue[*index].name.to_owned()),
            Term::Curve(curve) => Some(format!("a curve over {}", curve.over.name())),
        });
        let left_out: Vec<_> = found.chain(others).collect();
        let gap = structure.of(0).map(|values| values[0]);
        Loadable::Plant(with_play(self.unit, gap, source, &left_out))
    }

    /// Offers curves over time only: pulls and sides have two values each, which the effects use up.
    fn curves(&self, _: &Fit, (over, _): (Dependence, Option<f64>), runs: &[&HeldRun]) -> Vec<Curve> {
        let mut at: Vec<f64> = runs.iter().flat_map(|run| run.time_s.iter().copied()).collect();
        at.sort_unstable_by(f64::total_cmp);
        let Range::Any { scale } = self.base[0].range else { return vec![] };
        if over != Dependence::Time || at.len() < 16 {
            return vec![];
        }
        let at = (0..4).map(|corner| at[corner * (at.len() - 1) / 3]).collect();
        vec![Curve { over, at_unit: "s", unit: self.unit, at, period: None, acts: Acts::Push, scale }]
    }
}

#[cfg(test)]
mod tests;
