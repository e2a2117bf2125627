//! Hides one of a caller's effects in a plant: for evaluations that define beforehand what may be hidden.

use r4_plants::{
    Effect, PlantKind, PlantSpec,
    effect::sensor::{EncoderOffset, EncoderScale},
};

use crate::{
    Hidden, Truth,
    dice::Dice,
    listed::{CANDIDATES, Candidate},
    scale::Scale,
    told_of,
    watch::Parts,
    with_effect,
};

/// Effect that may be hidden, with its relative size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Among {
    /// Name of the effect in the catalogue.
    pub effect: &'static str,
    /// Factor on the size that [`hide`](crate::hide) samples; the sizes of [`CALIBRATIONS`] are fixed by that table.
    pub size: f64,
}

/// Error: an effect cannot be hidden.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{name}` cannot be hidden: effects that can be are those of `r4_plants::catalogue()` without `r4_blind::NEVER`, and `r4_blind::CALIBRATIONS`"
)]
pub struct NotHidden {
    /// Name of the requested effect.
    pub name: &'static str,
}

/// Effects that show only in a measurement beside a board, not in its recordings, and their sizes.
pub const CALIBRATIONS: &[(&str, &str)] = &[
    ("encoder-scale", "1 plus or minus 0.5 to 3 %"),
    ("encoder-offset", "plus or minus 2 to 10 degrees, or 0.3 to 1.5 mm"),
];

const OF_CALIBRATION: &[Candidate] = &[
    Candidate {
        name: "encoder-scale",
        rivals: &[],
        draw: |dice, _| Effect::EncoderScale(EncoderScale { scale: 1.0 + dice.sign() * dice.between(0.005, 0.03) }),
    },
    Candidate {
        name: "encoder-offset",
        rivals: &[],
        draw: |dice, scale| {
            let [low, high] = match scale.kind {
                PlantKind::Rotary => [2.0_f64.to_radians(), 10.0_f64.to_radians()],
                PlantKind::Linear => [0.3e-3, 1.5e-3],
            };
            Effect::EncoderOffset(EncoderOffset { offset: dice.sign() * dice.between(low, high) })
        },
    },
];

/// Maximum number of sizes that are tried until the plant suits, each smaller than the one before.
const SIZES: usize = 12;
/// Ratio of each tried size to the previous one.
const SMALLER: f64 = 0.75;

/// Hides one of `effects`, or nothing, all equally likely, in a plant that has a supply of `supply_v`. Effect and size
/// are sampled from the seed; on a plant that does not `suit`, a smaller size is tried, and finally nothing is hidden.
///
/// # Errors
/// [`NotHidden`] for a name that is neither a candidate of [`hide`](crate::hide) nor one of [`CALIBRATIONS`].
pub fn hide_one_of(
    effects: &[Among],
    spec: &PlantSpec,
    supply_v: f64,
    seed: u64,
    suits: &dyn Fn(&PlantSpec) -> bool,
) -> Result<Hidden, NotHidden> {
    let candidates = effects
        .iter()
        .map(|among| {
            let known = |candidates: &'static [Candidate]| candidates.iter().find(|known| known.name == among.effect);
            let found =
                known(CANDIDATES).map(|known| (known, among.size)).or(known(OF_CALIBRATION).map(|known| (known, 1.0)));
            found.ok_or(NotHidden { name: among.effect })
        })
        .collect::<Result<Vec<_>, _>>()?;
    let bare = Parts { spec: spec.clone(), unlisted: Vec::new() };
    let mut dice = Dice::new(seed, 7);
    // One index more than there are candidates: it stands for nothing.
    let Some((candidate, mut size)) = candidates.get(dice.below(candidates.len() + 1)).copied() else {
        return Ok(Hidden { parts: bare, truth: Vec::new() });
    };
    let scale = Scale::of(spec, supply_v);
    let drawn = (candidate.draw)(&mut dice, &scale);
    for _ in 0..SIZES {
        let Some(parts) = sized(drawn, size, spec.kind()).and_then(|effect| with_effect(&bare, effect)) else { break };
        if suits(&parts.spec) {
            let effect = sized(drawn, size, spec.kind()).unwrap_or(drawn);
            return Ok(Hidden { parts, truth: vec![told(candidate, effect, spec.kind())] });
        }
        size *= SMALLER;
    }
    Ok(Hidden { parts: bare, truth: Vec::new() })
}

fn told(candidate: &Candidate, effect: Effect, kind: PlantKind) -> Truth {
    told_of(effect, candidate.rivals, kind)
}

/// Returns the effect with its first parameter (level, gap or resistance) multiplied by `size`; `None` if out of range.
fn sized(effect: Effect, size: f64, kind: PlantKind) -> Option<Effect> {
    use r4_plants::Fitted as _;
    let mut effect = effect;
    if size != 1.0 {
        *effect.value_mut(0)? *= size;
    }
    effect.check(kind).is_ok().then_some(effect)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::tests::motor;

    const AMONG: [Among; 3] = [
        Among { effect: "coulomb-friction", size: 0.5 },
        Among { effect: "backlash", size: 0.1 },
        Among { effect: "encoder-scale", size: 1.0 },
    ];

    #[test]
    fn each_of_the_list_and_nothing_are_about_as_likely_and_of_the_size_that_was_asked_for() {
        let mut found: BTreeMap<&str, usize> = BTreeMap::new();
        let scale = Scale::of(&motor(), 24.0);
        for seed in 0..400 {
            let hidden = hide_one_of(&AMONG, &motor(), 24.0, seed, &|_| true).unwrap();
            assert!(hidden.spec().effects().len() == hidden.truth().len() && hidden.truth().len() <= 1);
            let name = hidden.truth().first().map_or("nothing", |truth| truth.name);
            if let Some(truth) = hidden.truth().first() {
                let value = truth.parameters[0].value;
                let [low, high] = match name {
                    "coulomb-friction" => [0.5 * 0.05 * scale.force, 0.5 * 0.25 * scale.force],
                    "backlash" => [0.1 * 0.03 * scale.way, 0.1 * 0.2 * scale.way],
                    _ => [0.97, 1.03],
                };
                assert!((low..=high).contains(&value), "{name} {value}");
            }
            *found.entry(name).or_default() += 1;
        }
        // Expected 100 of each, standard deviation 8.7: the limits are five of them away.
        assert!(found.len() == 4 && found.values().all(|count| (57..=143).contains(count)), "{found:?}");
    }

    #[test]
    fn what_does_not_suit_is_smaller_or_not_there() {
        let friction = [Among { effect: "coulomb-friction", size: 1.0 }];
        let level = |spec: &PlantSpec| spec.effects().first().and_then(|effect| r4_plants::Fitted::value(effect, 0));
        let scale = Scale::of(&motor(), 24.0);
        let most = 0.03 * scale.force;
        for seed in 0..50 {
            let suits = |spec: &PlantSpec| level(spec).is_none_or(|level| level <= most);
            let hidden = hide_one_of(&friction, &motor(), 24.0, seed, &suits).unwrap();
            assert!(level(hidden.spec()).is_none_or(|level| level <= most && level > 0.7 * most), "{seed}");
            assert!(hide_one_of(&friction, &motor(), 24.0, seed, &|_| false).unwrap().truth().is_empty());
        }
        let unknown = [Among { effect: "encoder-sign", size: 1.0 }];
        assert_eq!(
            hide_one_of(&unknown, &motor(), 24.0, 1, &|_| true).map(|_| ()),
            Err(NotHidden { name: "encoder-sign" })
        );
    }
}
