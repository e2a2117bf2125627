use std::pin::pin;

use futures::future::{Either, select};
use r4_protocol::SafetyState;
use r4_world::{AnyBody, TwoFingers};

use super::*;

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:two-finger-gripper".parse().expect("a board") }
}

fn values(arm: &'static str, seed: u64) -> Values {
    Inhand.run(&trial(arm, seed)).expect("a trial")
}

/// Of five objects the median: the study's limits, on seeds that the constants were set on.
#[test]
fn ours_finds_size_and_contacts_and_constant_links_do_not() {
    let median = |arm: &'static str, metric: &str| {
        let mut found: Vec<f64> = (1..=5).map(|seed| values(arm, seed)[metric]).collect();
        found.sort_by(f64::total_cmp);
        found[2]
    };
    let (size_m, contact_m) = (median(OURS, "size_error_m"), median(OURS, "contact_error_m"));
    assert!(size_m <= 3e-4 && contact_m <= 1e-3, "{size_m} {contact_m}");
    let [both_m, pivot_m, roll_m] = [PAPER, PIVOT, ROLL].map(|arm| median(arm, "contact_error_m"));
    assert!(both_m > 2.0 * contact_m && pivot_m > both_m && roll_m > 2.0 * pivot_m, "{both_m} {pivot_m} {roll_m}");
    assert_eq!(values(OURS, 2), values(OURS, 2), "the same seed, bit for bit");
}

#[test]
fn what_is_hidden_is_named() {
    for (arm, hidden) in BLIND {
        let found = values(arm, 3);
        let metric = if hidden == Hidden::Nothing { "clean_quiet" } else { "effect_named" };
        assert_eq!(found[metric], 1.0, "{arm}: {found:?}");
    }
}

#[test]
fn a_robot_without_fingers_is_refused() {
    let trial = Trial { board: "sim:openscout".parse().expect("a board"), ..trial(OURS, 1) };
    let error = Inhand.run(&trial).expect_err("wheels").to_string();
    assert!(error.contains("no [body.two-fingers]"), "{error}");
}
