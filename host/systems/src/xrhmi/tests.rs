use std::pin::pin;

use futures::future::{Either, select};
use r4_protocol::SafetyState;

use super::{cue::Outputs, *};

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:cue-desk".parse().expect("a board") }
}

fn values(arm: &'static str, seed: u64) -> Values {
    Xrhmi.run(&trial(arm, seed)).expect("a trial")
}

#[test]
fn a_session_is_logged_and_its_cues_are_in_time() {
    let outcome = session(&trial(OURS, 3)).expect("a session");
    let ours = evaluate(&outcome);
    assert!(ours["cue_latency_p99_s"] <= 0.020 && ours["cues_shown"] == 1.0, "{ours:?}");
    assert_eq!((ours["cues_measured"], ours["mistakes_missed"], ours["timeouts"]), (42.0, 0.0, 0.0), "{ours:?}");
    // Three echoes of a sensor are at least 480 ms apart, and their readings 720 ms at most, with the hand's ways between.
    assert!(ours["crossing_latency_s"] > 0.48 && ours["crossing_latency_p99_s"] < 0.80, "{ours:?}");
    let rows = log::read_trials(&outcome.log.trials_csv()).expect("our own table");
    assert_eq!(rows.len(), 3);
    assert!(rows.iter().all(|row| row.time_s > 14.0 && row.sus.is_some()), "{rows:?}");
    assert_eq!(session(&trial(OURS, 3)).expect("a session").log, outcome.log, "the same seed, bit for bit");
    let slow = values(SLOW, 3);
    assert!(slow["cue_latency_p99_s"] > 0.020, "{slow:?}");
}

/// A released dead-man ends the session: all outputs are safe, the trial is kept as stopped and does not count.
#[test]
fn a_released_dead_man_ends_the_session() {
    let rig = Rig::new(trial(OURS, 1).board);
    let work = async |session: &Session<'_>| {
        let release = async {
            // During a buzz of the first trial that has one.
            while desk::seen(session)?.0.bands == [false; 2] {
                session.board.sleep_s(5e-3).await;
            }
            session.virtual_board()?.dead_man().set(false);
            std::future::pending::<Result<(), r4_rig::Error>>().await
        };
        let Either::Left((outcome, _)) = select(pin!(protocol::run(session, 1, TELEMETRY_MS)), pin!(release)).await
        else {
            unreachable!("it does not end")
        };
        session.board.sleep_s(0.1).await;
        Ok::<_, r4_rig::Error>((outcome?, session.board.safety().0, desk::seen(session)?.0))
    };
    let ((outcome, state, outputs), _) = rig.run(None, work).expect("a session");
    assert_eq!((state, outputs), (SafetyState::Tripped, Outputs::default()));
    let trials = &outcome.log.trials;
    let last = trials.last().expect("a trial");
    assert!(!last.is_complete && last.time_s().is_none() && outcome.stopped.is_some(), "{last:?}");
    let counted = log::read_trials(&outcome.log.trials_csv()).expect("our own table");
    assert_eq!(counted.len(), trials.len() - 1);
    assert!(outcome.log.trials_csv().contains(",stopped,"));
}

#[test]
fn printed_numbers_are_reproduced() {
    let paper = values(PAPER, 1);
    assert!(paper["power_reproduced_error"] <= 0.005, "{paper:?}");
    assert_eq!([paper["sus_visual"], paper["sus_auditory"], paper["sus_haptic"]], [78.25, 76.5, 54.25]);
}

/// Rates over 4000 studies with a difference and 40 000 without: the paired analysis has the power; the paper's has what it prints where its people are
/// strangers. The same test of the same people hardly ever claims too much: its standard error is too large.
#[test]
fn pairs_have_the_power_that_welchs_test_lacks() {
    let rates = |analysis| {
        let of = |seed| rates::sampled(seed, analysis).expect("studies");
        let all: Vec<Rates> = (1..=20).map(of).collect();
        let mean = |of: &dyn Fn(&Rates) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
        [mean(&|rates| rates.powers[0]), mean(&|rates| rates.powers[1]), mean(&|rates| rates.false_alarms)]
    };
    // Standard errors: 0.008 of a power of 0.5, four of them; 0.001 of the alarms.
    let ours = rates(Analysis::Paired);
    assert!(ours[0] >= 0.8 && ours[1] >= 0.8 && ours[2] <= 0.05, "{ours:?}");
    let paper = rates(Analysis::Independent);
    assert!((paper[0] - 0.58).abs() < 0.032 && (paper[1] - 0.53).abs() < 0.032, "{paper:?}");
    // Three tests at 5 % each, uncorrected.
    assert!(paper[2] > 0.08, "{paper:?}");
    let repeated = rates(Analysis::Welch);
    assert!(repeated[0] < ours[0] && repeated[2] < 0.02, "{repeated:?}");
}

#[test]
fn hidden_effects_are_named_and_clean_studies_are_quiet() {
    for name in missing::NAMES {
        let arm = ABOUT.arms.iter().find(|arm| arm.name.strip_prefix(BLIND) == Some(name)).expect("an arm").name;
        let named = (1..=20).filter(|seed| values(arm, *seed)["effect_named"] == 1.0).count();
        assert!(named >= 18, "{name}: {named} of 20");
    }
    let quiet = (1..=100).filter(|seed| values(CLEAN, *seed)["clean_quiet"] == 1.0).count();
    // One of a hundred is expected to claim something; more than 5 have a probability of 5e-4.
    assert!(quiet >= 95, "{quiet} of 100");
}

#[test]
fn a_robot_without_zones_is_refused() {
    let trial = Trial { board: "sim:openscout".parse().expect("a board"), ..trial(OURS, 1) };
    let error = Xrhmi.run(&trial).expect_err("wheels").to_string();
    assert!(error.contains("cannot run xrhmi: it has no relay1"), "{error}");
}
