//! Which of three loads boxes have, by what both whiskers show and nothing else.
//!
//! A box that gives way holds a whisker at the bend whose spring is as strong as its friction, and one that stands bends it as far as the
//! geometry has it. The features are the mean bends of both whiskers in the samples from the first one on in which both are bent; a linear discriminant
//! (Fisher, "The use of multiple measurements in taxonomic problems", Annals of Eugenics 7, 1936) takes the likeliest class.

use super::{law::BENT_RAD, protocol::Run, scene::Load};

/// Samples that are used: the first and those after it, 0.8 s.
pub const FEATURES: usize = 5;

/// Constant and weights of each class, 1 and 1/rad: by `the_classes_are_learned` in the tests, from seeds 1 to 200 of ours on perfect actuators.
const WEIGHTS: [[f64; 1 + FEATURES]; 3] = [
    [-36.83, 100.931, -43.577, 57.134, 55.740, 7.535],
    [-54.68, 73.343, -45.108, 101.259, 34.442, 21.840],
    [-111.55, 92.741, -61.493, 125.932, 67.474, 30.734],
];

/// The features of a run; `None` where whiskers were not bent for so long.
#[must_use]
pub fn features(run: &Run) -> Option<[f64; FEATURES]> {
    let bent = |moment: &&super::Moment| moment.seen.bent_rad.iter().all(|bent_rad| *bent_rad > BENT_RAD);
    let begin_s = run.moments.iter().find(bent)?.time_s;
    let mut features = [0.0; FEATURES];
    for (number, feature) in features.iter_mut().enumerate() {
        // In the middle of a sample's period.
        let at_s = begin_s + 0.2 * number as f64 + 0.1;
        let moment = run.moments.iter().find(|moment| moment.time_s >= at_s)?;
        *feature = 0.5 * (moment.seen.bent_rad[0] + moment.seen.bent_rad[1]);
    }
    Some(features)
}

/// The likeliest load.
#[must_use]
pub fn classify(features: &[f64; FEATURES]) -> Load {
    let score = |weights: &[f64; 1 + FEATURES]| {
        weights[0] + weights[1..].iter().zip(features).map(|(weight, feature)| weight * feature).sum::<f64>()
    };
    let scored = Load::ALL.into_iter().zip(WEIGHTS.iter().map(score));
    scored.max_by(|one, other| one.1.total_cmp(&other.1)).map_or(Load::Heavy, |(load, _)| load)
}
