//! Classifier of the boxes' load, by the shown bends of both whiskers only.
//!
//! A box that yields holds a whisker at the bend where spring force equals friction; a box that stands bends it as far
//! as the geometry requires. The features are the mean bends of both whiskers in the samples from the first one on in
//! which both are bent. A linear discriminant (Fisher, "The use of multiple measurements in taxonomic problems", Annals
//! of Eugenics 7, 1936) takes the likeliest class.

use super::{law::BENT_RAD, protocol::Run, scene::Load};

/// Number of samples used: the first and those after it, 0.8 s.
pub const FEATURES: usize = 5;

/// Constant and weights of each class, 1 and 1/rad. They come from `the_classes_are_learned` in the tests: seeds 1 to
/// 200 of our arm on perfect actuators.
const WEIGHTS: [[f64; 1 + FEATURES]; 3] = [
    [-36.83, 100.931, -43.577, 57.134, 55.740, 7.535],
    [-54.68, 73.343, -45.108, 101.259, 34.442, 21.840],
    [-111.55, 92.741, -61.493, 125.932, 67.474, 30.734],
];

/// Features of a run, rad; `None` when the whiskers were not bent long enough.
#[must_use]
pub fn features(run: &Run) -> Option<[f64; FEATURES]> {
    let bent = |moment: &&super::Moment| moment.seen.bent_rad.iter().all(|bent_rad| *bent_rad > BENT_RAD);
    let begin_s = run.moments.iter().find(bent)?.time_s;
    let mut features = [0.0; FEATURES];
    for (number, feature) in features.iter_mut().enumerate() {
        // The middle of a sample's period of 0.2 s.
        let at_s = begin_s + 0.2 * number as f64 + 0.1;
        let moment = run.moments.iter().find(|moment| moment.time_s >= at_s)?;
        *feature = 0.5 * (moment.seen.bent_rad[0] + moment.seen.bent_rad[1]);
    }
    Some(features)
}

/// Returns the likeliest load.
#[must_use]
pub fn classify(features: &[f64; FEATURES]) -> Load {
    let score = |weights: &[f64; 1 + FEATURES]| {
        weights[0] + weights[1..].iter().zip(features).map(|(weight, feature)| weight * feature).sum::<f64>()
    };
    let scored = Load::ALL.into_iter().zip(WEIGHTS.iter().map(score));
    scored.max_by(|one, other| one.1.total_cmp(&other.1)).map_or(Load::Heavy, |(load, _)| load)
}
