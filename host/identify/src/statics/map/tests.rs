use std::collections::BTreeMap;

use r4_maths::statistics::RootMeanSquare;

use super::*;
use crate::data::{Quantity, Signal};

/// Makes a recording of these columns, one row per second.
fn recording(input: &[f64], output: &[f64], supply: Option<&[f64]>) -> Run {
    let signal = |values: &[f64]| Signal { column: "c".into(), quantity: Quantity::Number, values: values.to_vec() };
    let mut signals = BTreeMap::from([("input".to_owned(), signal(input)), ("output".to_owned(), signal(output))]);
    if let Some(supply) = supply {
        signals.insert("supply".to_owned(), signal(supply));
    }
    let time_s = (0..u32::try_from(input.len()).unwrap()).map(f64::from).collect();
    Run { name: "sweep".into(), time_s, origin_s: None, signals }
}

/// Levels up and down over -100..=100 in steps of 5, with a plain output that has a dead zone.
fn sweep() -> (MapRun, StaticMap) {
    let up: Vec<f64> = (-20..=20).map(|level| 5.0 * f64::from(level)).collect();
    let input: Vec<f64> = up.iter().copied().chain(up.iter().rev().copied()).collect();
    let output: Vec<f64> = input.iter().map(|&u| if u.abs() > 22.0 { 3.0 * u } else { 0.0 }).collect();
    let supply: Vec<f64> = (0..input.len()).map(|row| if row < 41 { 8.0 } else { 7.0 }).collect();
    let run = MapRun::new(&recording(&input, &output, Some(&supply))).unwrap();
    let map = StaticMap::new(&[&run], "rad/s").unwrap();
    (run, map)
}

fn with(map: &StaticMap, gain: f64, effects: &[(&str, &[f64])]) -> Structure {
    let place = |name: &str| map.catalogue().iter().position(|candidate| candidate.name == name).unwrap();
    Structure {
        terms: effects.iter().map(|(name, _)| Term::Known(place(name))).collect(),
        base: vec![gain],
        added: effects.iter().map(|(_, values)| values.to_vec()).collect(),
    }
}

fn predicted(map: &StaticMap, structure: &Structure, run: &MapRun) -> Vec<f64> {
    let mut out = vec![f64::NAN; run.measured.len()];
    map.predict(structure, &[], run, &mut out);
    out
}

/// Returns the output of the first row (on the way up) with this input.
fn at(map: &StaticMap, run: &MapRun, effects: &[(&str, &[f64])], input: f64) -> f64 {
    let row = run.input().iter().position(|&u| u == input).unwrap();
    predicted(map, &with(map, 2.0, effects), run)[row]
}

#[track_caller]
fn same(left: f64, right: f64) {
    // Closed forms of a few operations each are exact to a few bits of an `f64`.
    assert!((left - right).abs() < 1e-9 * (1.0 + right.abs()), "{left} {right}");
}

#[test]
fn each_bend_follows_its_closed_form() {
    let (run, map) = sweep();
    let at = |effects: &[(&str, &[f64])], input| at(&map, &run, effects, input);
    same(at(&[], -35.0), -70.0);
    let dead = [("dead-zone", &[20.0, 10.0][..])];
    same(at(&dead, 35.0), 30.0);
    same(at(&dead, -35.0), -50.0);
    same(at(&dead, 15.0), 0.0);
    let soft = [("saturation", &[0.02, 0.01, 1.0, 1.0][..])];
    same(at(&soft, 50.0), 2.0 * 25.0);
    same(at(&soft, -100.0), -2.0 * 50.0);
    let hard = [("saturation", &[0.02, 0.01, 16.0, 16.0][..])];
    same(at(&hard, 50.0), 2.0 * 50.0 / 2.0f64.powf(1.0 / 16.0));
    same(at(&hard, 100.0), 2.0 * 50.0 / (1.0 + 2.0f64.powi(-16)).powf(1.0 / 16.0));
    let curved = [("gain-curve", &[2.0, 3.0][..])];
    same(at(&curved, 25.0), 25.0);
    same(at(&curved, -25.0), -2.0 * 50.0 * 0.125);
    // The drag solves 60 = y + 0.05 y².
    same(at(&[("quadratic-drag", &[0.05])], 30.0), 10.0 * 13f64.sqrt() - 10.0);
    same(at(&[("direction-asymmetry", &[0.1])], -10.0), -18.0);
    same(at(&[("offset", &[3.0])], -10.0), -17.0);
    // The gain holds at the median of 8 V and 7 V; the way up has 8 V.
    same(at(&[("supply", &[2.0])], 30.0), 60.0 * (8.0f64 / 7.5).powi(2));
    same(at(&[("supply-drive", &[1.0]), ("dead-zone", &[20.0, 20.0])], 30.0), 2.0 * (30.0 * 8.0 / 7.5 - 20.0));
    // On the way up the output belongs to a lower level.
    same(at(&[("hysteresis", &[10.0])], 30.0), 40.0);
    same(at(&[("drift", &[0.01])], -90.0), -180.0 * 1.02);
}

#[test]
fn play_and_rest_remember_the_way() {
    let (run, map) = sweep();
    let down = run.input().len() - 1 - run.input().iter().position(|&u| u == 30.0).unwrap();
    let out = |effects: &[(&str, &[f64])]| predicted(&map, &with(&map, 2.0, effects), &run)[down];
    same(out(&[("hysteresis", &[10.0])]), 80.0);
    // A level of 50 starts the motion, 20 keeps it up: at 30 it rests on the way up and moves on the way down.
    let sticks: [(&str, &[f64]); 2] = [("dead-zone", &[20.0, 20.0]), ("static-friction", &[50.0, 50.0])];
    assert!(at(&map, &run, &sticks, 30.0).abs() < 1e-9);
    same(out(&sticks), 20.0);
    // The start is smoothed over an eighth of a row's step: one row away, e⁻⁸ of the output is left.
    assert!(at(&map, &run, &sticks, 45.0) < 60.0 * (-8.0f64).exp());
    assert!((at(&map, &run, &sticks, 55.0) - 70.0).abs() < 80.0 * (-8.0f64).exp());
}

#[test]
fn settling_is_a_lag_over_the_time_between_rows() {
    let (run, map) = sweep();
    let out = predicted(&map, &with(&map, 2.0, &[("slow-settling", &[2.0])]), &run);
    let share = (-0.5f64).exp();
    same(out[0], -200.0);
    same(out[1], -190.0 - 10.0 * share);
    same(out[2], -180.0 - 10.0 * share - 10.0 * share * share);
}

#[test]
fn what_is_absent_changes_nothing() {
    let (run, map) = sweep();
    let plain = predicted(&map, &with(&map, 2.0, &[]), &run);
    assert_eq!(map.catalogue().len(), BENDS.len());
    for (place, candidate) in map.catalogue().iter().enumerate() {
        let added = vec![candidate.parameters.iter().map(|parameter| parameter.absent.unwrap_or(1.0)).collect()];
        let structure = Structure { terms: vec![Term::Known(place)], base: vec![2.0], added };
        for (left, right) in predicted(&map, &structure, &run).into_iter().zip(&plain) {
            same(left, *right);
        }
        for start in &candidate.starts {
            assert_eq!(start.len(), candidate.parameters.len(), "{}", candidate.name);
        }
    }
}

#[test]
fn a_part_is_predicted_as_in_the_whole() {
    let (run, map) = sweep();
    let mut structure = with(&map, 2.0, &[("hysteresis", &[10.0]), ("slow-settling", &[2.0])]);
    let fitted = Fit::at(&map, &[&run], structure.clone(), vec![map.initial(&run).0]);
    structure.terms.push(Term::Curve(map.curves(&fitted, (Dependence::History, None), &[&run]).remove(0)));
    let Some(Term::Curve(curve)) = structure.terms.last() else { unreachable!() };
    structure.added.push(curve.at.iter().map(|at| 0.1 * at).collect());
    let whole = predicted(&map, &structure, &run);
    let part = map.part(&run, 30, 60);
    assert_eq!(map.measured(&part), &map.measured(&run)[30..60]);
    assert_eq!(map.time_s(&part), &map.time_s(&run)[30..60]);
    for (left, right) in predicted(&map, &structure, &part).iter().zip(&whole[30..60]) {
        same(*left, *right);
    }
}

#[test]
fn a_part_begins_where_the_rest_before_it_is_known() {
    let (run, map) = sweep();
    for effects in [vec![], vec![("dead-zone", &[20.0, 10.0][..]), ("static-friction", &[50.0, 30.0][..])]] {
        let structure = with(&map, 2.0, &effects);
        let whole = predicted(&map, &structure, &run);
        for (row, expected) in whole.into_iter().enumerate() {
            same(predicted(&map, &structure, &map.part(&run, row, row + 1))[0], expected);
        }
    }
}

#[test]
fn alternate_rows_keep_every_input() {
    let input: Vec<f64> = (1..=20).map(f64::from).collect();
    let run = recording(&input, &input, None);
    let (fit, held_out) = alternate_rows(&run, 2).unwrap();
    assert_eq!((fit.values("input"), held_out.values("input")), (run.values("input"), run.values("input")));
    for (row, y) in input.iter().enumerate() {
        let (kept, left) = if row % 2 == 0 { (&fit, &held_out) } else { (&held_out, &fit) };
        assert!(kept.values("output").unwrap()[row] == *y && left.values("output").unwrap()[row].is_nan());
    }
    assert!(alternate_rows(&run, 3).is_none(), "six rows are too few to score");
    assert!(alternate_rows(&run, 0).is_none());
}

#[test]
fn guesses_come_from_the_recording() {
    let (run, map) = sweep();
    // Slope Σuy/Σu² of 3u above 22: 3 · (1 - 2·(5²+10²+15²+20²)/(2·25·2870)).
    same(map.starts(&[&run])[0][0], 3.0 * (1.0 - 750.0 / 71750.0));
    let dead = &map.catalogue()[0];
    assert_eq!((dead.name, &dead.starts[0]), ("dead-zone", &vec![20.0, 20.0]));
    let rest = map.catalogue().iter().find(|candidate| candidate.name == "static-friction").unwrap();
    assert_eq!(rest.starts, [[22.5, 22.5]; 3]);
    assert_eq!(map.supply_ref(), 7.5);
}

#[test]
fn what_cannot_be_seen_is_not_looked_for() {
    let input: Vec<f64> = (1..=20).map(f64::from).collect();
    let run = MapRun::new(&recording(&input, &input, Some(&[8.0; 20]))).unwrap();
    let map = StaticMap::new(&[&run], "m/s").unwrap();
    let names: Vec<_> = map.catalogue().iter().map(|candidate| candidate.name).collect();
    for name in ["direction-asymmetry", "drift", "supply", "supply-drive", "hysteresis", "static-friction"] {
        assert!(!names.contains(&name), "{name}");
    }
    // A recording of one direction gives one parameter.
    assert_eq!((map.catalogue()[0].name, map.catalogue()[0].parameters.len()), ("dead-zone", 1));
}

#[test]
fn a_missing_input_is_not_made_up() {
    let mut input: Vec<f64> = (1..=20).map(f64::from).collect();
    input[4] = f64::NAN;
    let run = MapRun::new(&recording(&input, &[1.0; 20], None)).unwrap();
    assert!(run.measured[4].is_nan());
    assert_eq!(run.input()[4], 4.0);
    assert_eq!(&*run.since_turn, &since_turn(run.input())[..]);
}

#[test]
fn the_way_since_the_last_turn() {
    assert_eq!(&*since_turn(&[0.0, 10.0, 10.0, 8.0, 5.0, 6.0]), [0.0, 10.0, 10.0, -2.0, -5.0, 1.0]);
    assert!(since_turn(&[]).is_empty());
}

#[test]
fn useless_recordings_say_what_is_needed() {
    let input: Vec<f64> = (1..=20).map(f64::from).collect();
    let new = |run: &Run| StaticMap::new(&[&MapRun::new(run)?], "m").map(|_| ());
    let constant = new(&recording(&[3.0; 20], &input, None)).unwrap_err();
    assert_eq!(constant, MapError::ConstantInput { level: 3.0 });
    let still = new(&recording(&input, &[0.0; 20], None)).unwrap_err();
    assert_eq!(still, MapError::ConstantOutput { value: 0.0 });
    let short = new(&recording(&input[..3], &input[..3], None)).unwrap_err();
    assert!(matches!(short, MapError::TooFew { rows: 3, .. }));
    let mut without = recording(&input, &input, None);
    without.signals.remove("output");
    assert!(new(&without).unwrap_err().to_string().contains("--output"));
}

/// Returns the names of what a search finds, and the RMSE of the last structure on `held_out`.
fn search(fitted: &[MapRun], held_out: &[&MapRun]) -> (Vec<&'static str>, Vec<f64>) {
    let map = StaticMap::new(&fitted.iter().collect::<Vec<_>>(), "rad/s").unwrap();
    let found = crate::select::search(&map, fitted, &|_| ());
    let name = |step: &crate::select::Step| match &step.term {
        Term::Known(index) => map.catalogue()[*index].name,
        Term::Curve(_) => "unknown",
    };
    let rmse = |run: &&MapRun| {
        let residuals = crate::fit::residuals(&map, &found.last.structure, &[], run);
        let known: RootMeanSquare = residuals.into_iter().filter(|residual| residual.is_finite()).collect();
        known.value().unwrap()
    };
    (found.steps.iter().map(name).collect(), held_out.iter().map(rmse).collect())
}

/// A motor that loses some of its drive and saturates exponentially, unlike the model's form. The drive is
/// proportional to the supply.
fn machine(level: f64, supply: f64, lost: f64) -> f64 {
    let drive = (level.abs() * supply / 8.0 - lost).max(0.0);
    level.signum() * 60.0 * (1.0 - (-drive / 40.0).exp())
}

#[test]
fn finds_what_was_put_in_and_nothing_where_nothing_was() {
    use rand_distr::{Distribution, Normal};
    let mut random = rand_pcg::Pcg64::new(6, 1);
    let noise = Normal::new(0.0, 0.3).unwrap();
    // Levels in no order, so that nothing depends on time.
    let input: Vec<f64> = (0..160).map(|row| f64::from((row * 67) % 161 - 80)).collect();
    let mut record = |output: &dyn Fn(f64) -> f64, supply: f64| {
        let output: Vec<f64> = input.iter().map(|&u| output(u) + noise.sample(&mut random)).collect();
        MapRun::new(&recording(&input, &output, Some(&[supply; 160]))).unwrap()
    };
    let plain = [record(&|u| 0.7 * u, 8.0), record(&|u| 0.7 * u, 7.0)];
    assert_eq!(search(&plain, &[]).0, [""; 0]);

    let bent = [record(&|u| machine(u, 8.0, 15.0), 8.0), record(&|u| machine(u, 7.0, 15.0), 7.0)];
    let other = record(&|u| machine(u, 7.5, 15.0), 7.5);
    let (names, rmse) = search(&bent, &[&other]);
    for name in ["dead-zone", "saturation", "supply-drive"] {
        assert!(names.contains(&name), "{names:?}");
    }
    // The noise is 0.3; the two forms of saturation differ by at most as much.
    assert!(rmse[0] < 0.45, "{rmse:?}");
}

#[test]
fn two_motors_on_a_bridge() {
    use crate::data::{Mapping, Options, read};
    const RPM: f64 = std::f64::consts::TAU / 60.0;
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/micromouse_drv8833");
    // RMSE on the odd rows of static_3: the requirement as the upper bound, and half of what was reached as the lower
    // one.
    for (wheel, most, least) in [("left", 10.0, 4.0), ("right", 7.0, 2.6)] {
        let load = |name: &str| {
            let roles = vec![
                Mapping::driving("input", "command_duty256"),
                Mapping::measured("output", &format!("{wheel}_rpm")),
                Mapping::driving("supply", "battery_mV"),
            ];
            let recorded = read(&[folder.join(name)], &Options { roles, ..Options::default() }).unwrap();
            let (fitted, held_out) = alternate_rows(&recorded.runs[0], 2).unwrap();
            (MapRun::new(&fitted).unwrap(), MapRun::new(&held_out).unwrap())
        };
        let (fitted, held_out) = load("static_3.csv");
        let (names, rmse) = search(std::slice::from_ref(&fitted), &[&held_out]);
        assert!(names.contains(&"dead-zone") && names.contains(&"saturation"), "{names:?}");
        assert!((least..=most).contains(&(rmse[0] / RPM)), "{wheel}: {rmse:?} rad/s");

        // With a proportional map 92.9 and 97.4 rpm remain; with a map of 7.93 V only, 55.3 and 74.7.
        let (at_7v4, held_out_at_7v4) = load("static_4.csv");
        let (names, rmse) = search(&[fitted, at_7v4], &[&held_out, &held_out_at_7v4]);
        assert!(names.iter().any(|name| name.starts_with("supply")), "{names:?}");
        assert!(rmse.iter().all(|rmse| rmse / RPM < 10.0), "{wheel}: {rmse:?} rad/s");
    }
}
