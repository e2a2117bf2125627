use std::collections::BTreeMap;

use super::*;
use crate::data::{Mapping, Options, Quantity, Signal, read};
use crate::family::Term;

/// Pulls of A and B in turn, 5 samples each with 8 of rest after it, on a shaft with backlash and a spring. `settles`
/// is the share of the remaining distance that it covers per sample.
fn pulled(gap: f64, spring: f64, settles: f64, cycles: usize) -> Run {
    let (mut a, mut b, mut output) = (Vec::new(), Vec::new(), Vec::new());
    let mut position = 0.0;
    let mut go = |samples: usize, force: f64, goal: f64, a_on: bool, b_on: bool| {
        for _ in 0..samples {
            position += settles * (goal + force - position);
            output.push(100.0 + position);
            a.push(if a_on { 7.0 } else { 3.0 });
            b.push(if b_on { -1.0 } else { 0.0 });
        }
    };
    go(8, 0.0, 0.0, false, false);
    for _ in 0..cycles {
        for side in [1.0, -1.0] {
            go(5, side * spring, side * gap / 2.0, side > 0.0, side < 0.0);
            go(8, 0.0, side * gap / 2.0, false, false);
        }
    }
    let time_s = (0..output.len()).map(|sample| 0.1 * sample as f64).collect();
    let signal = |values| Signal { column: "c".into(), quantity: Quantity::Number, values };
    let signals =
        [("pull_a", a), ("pull_b", b), ("output", output)].map(|(role, values)| (role.to_owned(), signal(values)));
    Run { name: "pulls".into(), time_s, origin_s: None, signals: BTreeMap::from(signals) }
}

#[test]
fn play_is_what_stays_and_a_spring_what_returns() {
    for (gap, spring) in [(6.0, 0.0), (0.0, 4.0), (6.0, 4.0)] {
        let play = play(&pulled(gap, spring, 1.0, 4)).unwrap();
        assert!((play.unloaded.value - gap).abs() < 1e-12);
        assert!((play.loaded.value - gap - 2.0 * spring).abs() < 1e-12);
        assert!((play.returns_by - spring).abs() < 1e-12);
        let best = &play.explanations[0];
        assert!(best.holdout_rmse < 1e-12, "{play:?}");
        let wrong = if gap == 0.0 { "backlash" } else { "elasticity" };
        let wrong = play.explanations.iter().find(|explanation| explanation.name == wrong).unwrap();
        // Error of either explanation: half the gap at rest, or the spring's deflection under load, on half of the
        // rows.
        assert!(wrong.holdout_rmse > 0.5, "{play:?}");
    }
}

#[test]
fn the_end_of_a_phase_is_its_most_settled_sample() {
    // 5 samples, each of which covers 70 % of the remaining distance, leave 0.3^5 of it.
    let play = play(&pulled(6.0, 4.0, 0.7, 4)).unwrap();
    assert!((play.loaded.value - 14.0).abs() < 14.0 * 2.0 * 0.3f64.powi(5));
    assert!((play.unloaded.value - 6.0).abs() < 14.0 * 0.3f64.powi(8));
}

#[test]
fn pulls_that_are_missing_are_asked_for() {
    let run = pulled(6.0, 4.0, 1.0, 1);
    assert!(matches!(play(&run), Err(HysteresisError::TooFewPulls { role: "pull_a", pulls: 1, .. })));
    let mut run = pulled(6.0, 4.0, 1.0, 3);
    run.signals.remove("pull_b");
    assert!(play(&run).unwrap_err().to_string().contains("--map pull_b=COLUMN"));
    let empty = Run { time_s: vec![], ..pulled(6.0, 4.0, 1.0, 0) };
    assert!(play(&empty).is_err());
}

#[test]
fn the_search_names_play_and_does_not_without() {
    let names = |run: &Run| {
        let held = HeldRun::new(run).unwrap();
        let shaft = HeldShaft::new(&[&held], "rad");
        let found = crate::select::search(&shaft, &[held], &|_| ());
        let name = |step: &crate::select::Step| match step.term {
            Term::Known(candidate) => shaft.catalogue[candidate].name,
            Term::Curve(_) => "unknown",
        };
        let mut names: Vec<_> = found.steps.iter().map(name).collect();
        names.sort_unstable();
        names
    };
    // Encoder readings with a scatter of a tenth, the same each time.
    let shaken = |gap, spring| {
        use rand_distr::{Distribution, Normal};
        let mut random = rand_pcg::Pcg64::new(3, 1);
        let noise = Normal::new(0.0, 0.1).unwrap();
        let mut run = pulled(gap, spring, 1.0, 8);
        let output = &mut run.signals.get_mut("output").unwrap().values;
        output.iter_mut().for_each(|value| *value += noise.sample(&mut random));
        run
    };
    assert_eq!(names(&shaken(3.0, 2.0)), ["backlash"]);
    assert_eq!(names(&shaken(3.0, 0.0)), ["backlash"]);
    assert_eq!(names(&shaken(0.0, 2.0)), [""; 0]);
    assert_eq!(names(&shaken(0.0, 0.0)), [""; 0]);
}

#[test]
fn servos_play_as_published() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/sts_servo_backlash");
    // Kotov, "A Low-Cost Platform for Measuring Backlash in Popular UART Servos", 2025: degrees with and without
    // load.
    for (file, loaded, unloaded) in [("sts3215_single.csv", 1.30, 0.62), ("sts3250_single.csv", 0.33, 0.13)] {
        let roles = vec![
            Mapping::measured("output", "dut_pos_cnt"),
            Mapping::driving("goal", "dut_target_cnt"),
            Mapping::driving("pull_a", "pullA_target_cnt"),
            Mapping::driving("pull_b", "pullB_target_cnt"),
        ];
        let options = Options { roles, counts_per_turn: Some(4096.0), ..Options::default() };
        let recorded = read(&[folder.join(file)], &options).unwrap();
        let play = play(&recorded.runs[0]).unwrap();
        let off = |gap: &Gap, published: f64| gap.value.abs().to_degrees() - published;
        // Tolerance of 0.05 degrees; half an encoder step is 0.044 degrees.
        assert!(off(&play.loaded, loaded).abs() < 0.05, "{file}: {play:?}");
        assert!(off(&play.unloaded, unloaded).abs() < 0.05, "{file}: {play:?}");
        // Both backlash and elasticity are needed to predict the later pulls.
        assert_eq!(play.explanations[0].name, "backlash and elasticity", "{file}: {play:?}");
    }
}
