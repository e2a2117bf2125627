//! Comparison of the whole analysis, from the table of trials on, with SciPy 1.17.1 and statsmodels 0.15.0:
//! `tests/oracle/xrhmi_statsmodels.py` sampled ten people and analysed the same table.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::{analysis, log::read_trials};

#[derive(Deserialize)]
struct Oracle {
    table: String,
    measures: BTreeMap<String, Vec<Compared>>,
    mixed_visual: f64,
    mixed_visual_error: f64,
}

#[derive(Deserialize)]
struct Compared {
    difference: f64,
    interval: [f64; 2],
    p: f64,
    per_place: f64,
    per_place_p: f64,
    wilcoxon_p: f64,
    welch_t: f64,
    welch_df: f64,
    welch_p: f64,
    holm_p: f64,
}

#[test]
fn a_table_is_analysed_as_by_statsmodels() {
    let oracle: Oracle =
        serde_json::from_str(include_str!("../../tests/oracle/xrhmi_statsmodels.json")).expect("the oracle's file");
    let measures = analysis::measures(&read_trials(&oracle.table).expect("its table")).expect("ten people");
    assert_eq!(measures.len(), 3);
    for measure in &measures {
        for (ours, theirs) in measure.comparisons.iter().zip(&oracle.measures[measure.name]) {
            let welch = ours.welch.expect("a spread");
            let pairs = [
                (ours.paired.difference, theirs.difference),
                (ours.paired.interval.low, theirs.interval[0]),
                (ours.paired.interval.high, theirs.interval[1]),
                (ours.paired.p_value, theirs.p),
                (ours.paired.per_place, theirs.per_place),
                (ours.paired.per_place_p, theirs.per_place_p),
                (ours.holm_p, theirs.holm_p),
                (ours.wilcoxon_p, theirs.wilcoxon_p),
                (welch.t, theirs.welch_t),
                (welch.degrees_of_freedom, theirs.welch_df),
                (welch.p_value, theirs.welch_p),
            ];
            for (ours, theirs) in pairs {
                // Rounding of differences of times, and statrs' distributions: 1e-12 was seen.
                assert!((ours - theirs).abs() <= 1e-9 * theirs.abs().max(1e-3), "{}: {ours} {theirs}", measure.name);
            }
        }
    }
    // A mixed model with a random person pools the residuals of all modalities: the estimate is another, of the same size.
    let haptic_visual = measures[0].comparisons[0].paired.difference;
    assert!((haptic_visual - oracle.mixed_visual).abs() < 2.0 * oracle.mixed_visual_error, "{haptic_visual}");
}
