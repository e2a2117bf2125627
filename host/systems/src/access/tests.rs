//! Tests of the system: its script has what it says, and its metrics tell arms apart.

use r4_rig::Target as Board;

use super::*;

fn values(arm: &'static str, seed: u64) -> Values {
    let board = Board::Sim("osmc-bench".into());
    Access.run(&Trial { arm, seed, board }).expect("it runs")
}

#[test]
fn the_guard_makes_no_mistake_and_the_others_do() {
    for seed in 1..4 {
        let ours = values(OURS, seed);
        for metric in ABOUT.metrics.iter().filter(|metric| metric.target(OURS).is_some()) {
            assert_eq!(ours.get(metric.name), Some(&0.0), "{} of seed {seed}", metric.name);
        }
        assert_eq!(ours["emergency_s"], 600.0);
        assert!(ours["attacks"] >= 300.0 && ours["tamperings"] >= 20.0, "{ours:?}");
        let paper = values(PAPER, seed);
        assert!(paper["replayed_missed"] >= 100.0 && paper["expired_missed"] >= 50.0, "{paper:?}");
        assert_eq!((paper["altered_missed"], paper["forged_missed"], paper["wrong_denials"]), (0.0, 0.0, 0.0));
        let strict = values(NO_ALLOWANCE, seed);
        assert!(strict["wrong_denials"] > 10.0 && strict["wrong_grants"] == 0.0, "{strict:?}");
        let flagged = values(LEFT_ON, seed);
        assert!(flagged["emergency_s"] >= 3600.0 && flagged["wrong_grants"] > 0.0, "{flagged:?}");
    }
}

#[test]
fn the_space_has_grants_and_denials_of_every_kind() {
    let outcome = space::walked(1).expect("valid policies");
    // 16 sets of rules, 8 pairs of purposes and consents, 2304 requests.
    assert_eq!(outcome.decisions, 16 * 8 * 2304);
    assert!(outcome.grants > 1000 && outcome.grants < outcome.decisions / 10, "{outcome:?}");
    assert_eq!((outcome.wrong_grants, outcome.wrong_denials), (0, 0));
}

#[test]
fn a_verification_that_finds_nothing_is_seen() {
    let steps = day::steps(1).expect("a script");
    let (_, log) = by_guard(&steps, &day::policy(5, 600, 3600).expect("text")).expect("valid");
    let (tried, missed) = tamper::attempts(1, &log.expect("a log"), |_, _| true);
    assert!(tried > 20 && missed == tried);
}
