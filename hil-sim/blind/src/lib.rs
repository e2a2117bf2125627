//! Plants with a hidden effect, and recordings of such plants.
//!
//! For the evaluation of an identifier: the hidden effect is sampled from a seed, large enough to be detectable, and
//! the truth is kept separate from the plant. This crate contains no code of an identifier.
//!
//! | module | subject |
//! | --- | --- |
//! | [`hide`], [`Hidden`], [`Truth`] | an effect in a given plant |
//! | [`hide_one_of`], [`Among`] | one of a caller's effects, or nothing |
//! | [`hide_in_body`] | a parameter of a robot's body |
//! | [`experiment`] | recordings of a sampled plant, with noise, in the form that an identifier reads |
//! | [`fault`] | faults of such recordings: wrong stamps, wrong columns, lost rows |
//!
//! An experiment hides an effect of `r4-plants`' catalogue, two of them, one that is in no catalogue, or nothing.

mod among;
mod body;
mod dice;
mod excitation;
pub mod experiment;
pub mod fault;
mod listed;
mod scale;
#[cfg(test)]
mod tests;
mod unlisted;
mod watch;

use r4_plants::{Dependence, Effect, Fitted, InsertionPoint, Plant, PlantKind, PlantSpec};

pub use among::{Among, CALIBRATIONS, NotHidden, hide_one_of};
pub use body::{hide_in_body, is_in_body};
use dice::Dice;
use listed::CANDIDATES;
use scale::Scale;
use watch::{Output, Parts, Plan, shows};

/// Kind of hidden effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Draw {
    /// No hidden effect at all.
    Nothing,
    /// One effect of the catalogue.
    Listed,
    /// Two effects of the catalogue.
    Pair,
    /// An effect that is in no catalogue.
    Unlisted,
}

impl Draw {
    /// Samples the kind: one of eight nothing, one a pair, one unlisted, the others an effect of the catalogue.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        match Dice::new(seed, 1).below(8) {
            0 => Self::Nothing,
            1 => Self::Pair,
            2 => Self::Unlisted,
            _ => Self::Listed,
        }
    }
}

/// Parameter of a hidden effect.
#[derive(Clone, Debug, PartialEq)]
pub struct Value {
    /// Name of the parameter; for an effect of the catalogue as in plant files.
    pub name: &'static str,
    /// Value in the unit `unit`.
    pub value: f64,
    /// Unit, such as `N m`; `1` for a plain number.
    pub unit: &'static str,
}

/// One effect that was hidden.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Name in the catalogue, or of an unlisted effect.
    pub name: &'static str,
    /// Parameters of the effect.
    pub parameters: Vec<Value>,
    /// Quantities on which its contribution depends.
    pub depends_on: &'static [Dependence],
    /// True if the effect is in the catalogue.
    pub listed: bool,
    /// Other effects of the catalogue that no recording of input and output can distinguish from it.
    pub rivals: &'static [&'static str],
}

/// Plant with a hidden effect, and the truth about it.
#[derive(Clone, Debug)]
pub struct Hidden {
    parts: Parts,
    truth: Vec<Truth>,
}

impl Hidden {
    /// Creates the plant, at rest at position 0, with its noise sources started from `seed`.
    #[must_use]
    pub fn plant(&self, seed: u64) -> Plant {
        self.parts.plant(seed)
    }

    /// Description of the plant, with the hidden effects of the catalogue; an unlisted effect is not in it.
    #[must_use]
    pub fn spec(&self) -> &PlantSpec {
        &self.parts.spec
    }

    /// Effects that were hidden; empty if none.
    #[must_use]
    pub fn truth(&self) -> &[Truth] {
        &self.truth
    }
}

/// Hides an effect in a plant that has a supply of `supply_v`. Effect and size are sampled from the seed.
///
/// The effect changes a free-run simulation of 12 s by at least 3 times the noise, which is 30 dB below the signal, and
/// by at least that noise after gain, mass and viscous friction of the plant are fitted again; on a plant where no
/// effect does, nothing is hidden.
#[must_use]
pub fn hide(spec: &PlantSpec, supply_v: f64, seed: u64) -> Hidden {
    hide_as(Draw::of(seed), spec, supply_v, seed)
}

/// Hides an effect like [`hide`], of the given kind.
#[must_use]
pub fn hide_as(draw: Draw, spec: &PlantSpec, supply_v: f64, seed: u64) -> Hidden {
    let scale = Scale::of(spec, supply_v);
    let mut dice = Dice::new(seed, 2);
    let plans = [Plan { start: scale.centre, duty: excitation::run(&mut dice, &scale, 0, 12.0) }];
    // The plant is a board's, which would trip on the effects of the second list.
    let excluded: Vec<_> = NEVER.iter().chain(NOT_ON_BOARDS).map(|(name, _)| *name).collect();
    search(
        &Search { spec, scale: &scale, plans: &plans, output: Output::Position, excluded: &excluded },
        draw,
        &mut dice,
    )
}

/// Effects of the catalogue that are never hidden, with the reason.
pub const NEVER: &[(&str, &str)] = &[
    ("encoder-scale", "a board that counts wrong shows nothing but another gain"),
    ("encoder-offset", "an encoder's zero is wherever power came on"),
    ("encoder-sign", "a board trips on it at once, which gives it away"),
    ("input-sign", "a board trips on it at once, which gives it away"),
    ("missed-edges", "what is lost is lost for good, and looks like another gain by speed"),
    ("potentiometer-dead-spot", "a board trips on a jumping wiper, which gives it away"),
    ("random-load", "it is a function of nothing that is recorded"),
    ("sensor-noise", "it is a function of nothing that is recorded"),
];

/// Further effects that [`hide`] does not hide, with the reason.
pub const NOT_ON_BOARDS: &[(&str, &str)] =
    &[("sensor-hold", "a board takes the jumps for a broken sensor and trips, which gives it away")];

/// Plant in which an effect is hidden, and the criteria for its detectability.
pub(crate) struct Search<'a> {
    pub(crate) spec: &'a PlantSpec,
    pub(crate) scale: &'a Scale,
    pub(crate) plans: &'a [Plan],
    pub(crate) output: Output,
    pub(crate) excluded: &'a [&'a str],
}

/// Number of effects that are tried before nothing is hidden.
const EFFECTS: usize = 40;
/// Number of sizes that are tried for one effect.
const SIZES: usize = 6;

pub(crate) fn search(search: &Search<'_>, draw: Draw, dice: &mut Dice) -> Hidden {
    let bare = Parts { spec: search.spec.clone(), unlisted: Vec::new() };
    let outputs = |parts: &Parts| -> Vec<Vec<f64>> {
        search.plans.iter().map(|plan| parts.outputs(plan, search.scale.supply_v, search.output)).collect()
    };
    // Each effect must be detectable beside the others.
    let all_show = |parts: &Parts, lacking: &[&Parts]| {
        let outputs = outputs(parts);
        outputs.iter().flatten().all(|value| value.is_finite())
            && lacking.iter().all(|without| shows(&outputs, without, search.scale, search.plans, search.output))
    };
    for _ in 0..if draw == Draw::Nothing { 0 } else { EFFECTS } {
        if draw == Draw::Unlisted {
            let (_, make) = unlisted::KINDS[dice.below(unlisted::KINDS.len())];
            for _ in 0..SIZES {
                let (effect, page) = make(dice, search.scale);
                let parts = Parts { spec: bare.spec.clone(), unlisted: vec![effect] };
                if all_show(&parts, &[&bare]) {
                    return Hidden { parts, truth: vec![told(page)] };
                }
            }
            continue;
        }
        let (one, other) = (dice.below(CANDIDATES.len()), dice.below(CANDIDATES.len()));
        if draw == Draw::Pair && is_alike(one, other, search.scale) {
            continue;
        }
        for _ in 0..SIZES {
            let first = (CANDIDATES[one].draw)(dice, search.scale);
            // An effect that is excluded, or that this plant cannot have: another one is tried.
            let Some(alone) = with(search, &bare, first) else { break };
            if draw == Draw::Listed {
                if all_show(&alone, &[&bare]) {
                    return Hidden { parts: alone, truth: vec![truth_of(one, first, search.scale.kind)] };
                }
                continue;
            }
            let second = (CANDIDATES[other].draw)(dice, search.scale);
            let (Some(without_first), Some(both)) = (with(search, &bare, second), with(search, &alone, second)) else {
                break;
            };
            // Each of the two must be detectable when the other one is known.
            if all_show(&both, &[&without_first, &alone]) {
                let truth = [(one, first), (other, second)];
                let truth = truth.into_iter().map(|(index, effect)| truth_of(index, effect, search.scale.kind));
                return Hidden { parts: both, truth: truth.collect() };
            }
        }
    }
    Hidden { parts: bare, truth: Vec::new() }
}

/// Effects whose combination equals one of the catalogue in any recording: a constant load makes friction
/// direction-dependent.
const TOGETHER_ONE: [&str; 2] = ["constant-load", "coulomb-friction"];

/// Returns true if two effects are too similar to be hidden together.
fn is_alike(one: usize, other: usize, scale: &Scale) -> bool {
    let insertion = |index: usize| (CANDIDATES[index].draw)(&mut Dice::new(0, 0), scale).info().insertion;
    let names = [one, other].map(|index| CANDIDATES[index].name);
    one == other
        // At the same insertion point, one effect can take over a part of the other.
        || insertion(one) == insertion(other)
        || CANDIDATES[one].rivals.contains(&names[1])
        || TOGETHER_ONE.iter().all(|name| names.contains(name))
}

/// Returns the plant with one more effect; `None` if it cannot have it. An effect on the input acts before the plant's
/// own.
fn with(search: &Search<'_>, parts: &Parts, effect: Effect) -> Option<Parts> {
    if search.excluded.contains(&effect.name()) {
        return None;
    }
    with_effect(parts, effect)
}

/// Like [`with`], for any effect.
pub(crate) fn with_effect(parts: &Parts, effect: Effect) -> Option<Parts> {
    let mut effects = parts.spec.effects().to_vec();
    let place = if effect.info().insertion == InsertionPoint::Input { 0 } else { effects.len() };
    effects.insert(place, effect);
    let mut spec = PlantSpec::new(*parts.spec.model(), parts.spec.source(), effects).ok()?;
    parts.spec.tables().iter().for_each(|table| spec.push_table(table.clone()));
    Some(Parts { spec, unlisted: parts.unlisted.clone() })
}

fn truth_of(index: usize, effect: Effect, kind: PlantKind) -> Truth {
    told_of(effect, CANDIDATES[index].rivals, kind)
}

pub(crate) fn told_of(effect: Effect, rivals: &'static [&'static str], kind: PlantKind) -> Truth {
    let parameters = effect.parameters().iter().enumerate().map(|(at, parameter)| Value {
        name: parameter.name(kind),
        value: effect.value(at).unwrap_or(f64::NAN),
        unit: parameter.unit(kind),
    });
    let info = effect.info();
    Truth { name: info.name, parameters: parameters.collect(), depends_on: info.depends_on, listed: true, rivals }
}

fn told(page: unlisted::Page) -> Truth {
    let parameters = page.parameters.into_iter().map(|(name, value, unit)| Value { name, value, unit }).collect();
    Truth { name: page.name, parameters, depends_on: page.depends_on, listed: false, rivals: &[] }
}
