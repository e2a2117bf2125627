use std::collections::BTreeMap;

use super::*;
use crate::data::{Quantity, Signal};

/// A recording of these columns, one row a second.
fn recording(input: &[f64], output: &[f64], supply: Option<&[f64]>) -> Run {
    let signal = |values: &[f64]| Signal { column: "c".into(), quantity: Quantity::Number, values: values.to_vec() };
    let mut signals = BTreeMap::from([("input".to_owned(), signal(input)), ("output".to_owned(), signal(output))]);
    if let Some(supply) = supply {
        signals.insert("supply".to_owned(), signal(supply));
    }
    let time_s = (0..u32::try_from(input.len()).unwrap()).map(f64::from).collect();
    Run { name: "sweep".into(), time_s, signals }
}

/// Up and down over -100..=100 in steps of 5, with an output that only shows what was moved.
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

/// Output of the first row (on the way up) with this input.
fn at(map: &StaticMap, run: &MapRun, effects: &[(&str, &[f64])], input: f64) -> f64 {
    let row = run.input().iter().position(|&u| u == input).unwrap();
    predicted(map, &with(map, 2.0, effects), run)[row]
}

#[track_caller]
fn same(left: f64, right: f64) {
    // Closed forms of a few operations each: a few bits of f64.
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
    let saturated = [("saturation", &[0.02, 0.01][..])];
    same(at(&saturated, 50.0), 2.0 * (1.0 - (-1.0f64).exp()) / 0.02);
    same(at(&saturated, -50.0), -2.0 * (1.0 - (-0.5f64).exp()) / 0.01);
    same(at(&[("clip", &[60.0])], -90.0), -120.0);
    let curved = [("gain-curve", &[2.0, 3.0][..])];
    same(at(&curved, 25.0), 25.0);
    same(at(&curved, -25.0), -2.0 * 50.0 * 0.125);
    // 60 = y + 0.05 y²
    same(at(&[("quadratic-drag", &[0.05])], 30.0), 10.0 * 13f64.sqrt() - 10.0);
    same(at(&[("direction-asymmetry", &[0.1])], -10.0), -18.0);
    same(at(&[("offset", &[3.0])], -10.0), -17.0);
    // The middle of 8 V and 7 V is where the gain holds; the way up has 8 V.
    same(at(&[("supply", &[2.0])], 30.0), 60.0 * (8.0f64 / 7.5).powi(2));
    same(at(&[("supply-drive", &[1.0]), ("dead-zone", &[20.0, 20.0])], 30.0), 2.0 * (30.0 * 8.0 / 7.5 - 20.0));
    // Upwards the output belongs to the level below.
    same(at(&[("hysteresis", &[10.0])], 30.0), 40.0);
    same(at(&[("drift", &[0.01])], -90.0), -180.0 * 1.02);
}

#[test]
fn play_and_rest_remember_the_way() {
    let (run, map) = sweep();
    let down = run.input().len() - 1 - run.input().iter().position(|&u| u == 30.0).unwrap();
    let out = |effects: &[(&str, &[f64])]| predicted(&map, &with(&map, 2.0, effects), &run)[down];
    same(out(&[("hysteresis", &[10.0])]), 80.0);
    // 50 is needed to start, 20 to go on: at 30 it rests on the way up and moves on the way down.
    let sticks: [(&str, &[f64]); 2] = [("dead-zone", &[20.0, 20.0]), ("static-friction", &[50.0, 50.0])];
    assert!(at(&map, &run, &sticks, 30.0).abs() < 1e-9);
    same(out(&sticks), 20.0);
    // Smeared over an eighth of a row: e⁻⁸ of the output is left one row away.
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
        let added = vec![candidate.parameters.iter().map(|parameter| parameter.absent.unwrap()).collect()];
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
    let effects: [(&str, &[f64]); 3] =
        [("hysteresis", &[10.0]), ("static-friction", &[50.0, 50.0]), ("slow-settling", &[2.0])];
    let mut structure = with(&map, 2.0, &effects);
    structure.terms.push(Term::Curve(map.curve(&structure, Dependence::History, None, &[&run]).unwrap()));
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
fn alternate_rows_keep_every_input() {
    let (run, _) = sweep();
    let (fit, held_out) = run.alternate(2);
    assert_eq!(fit.input(), run.input());
    for (row, y) in run.measured.iter().enumerate() {
        let (kept, left) = if row % 2 == 0 { (&fit, &held_out) } else { (&held_out, &fit) };
        assert!(kept.measured[row] == *y && left.measured[row].is_nan());
    }
}

#[test]
fn guesses_come_from_the_recording() {
    let (run, map) = sweep();
    // Σuy/Σu² of 3u above 22: 3 · (1 - 2·(5²+10²+15²+20²)/(2·25·2870))
    same(map.starts(&[&run])[0][0], 3.0 * (1.0 - 750.0 / 71750.0));
    let dead = &map.catalogue()[0];
    assert_eq!((dead.name, &dead.starts[0]), ("dead-zone", &vec![20.0, 20.0]));
    let rest = map.catalogue().iter().find(|candidate| candidate.name == "static-friction").unwrap();
    assert_eq!(rest.starts, [[22.5, 22.5]]);
    assert_eq!(map.supply_ref(), 7.5);
}

#[test]
fn what_cannot_be_seen_is_not_looked_for() {
    let input: Vec<f64> = (1..=20).map(f64::from).collect();
    let run = MapRun::new(&recording(&input, &input, Some(&[8.0; 20]))).unwrap();
    let map = StaticMap::new(&[&run], "m/s").unwrap();
    let names: Vec<_> = map.catalogue().iter().map(|candidate| candidate.name).collect();
    for name in ["direction-asymmetry", "supply", "supply-drive", "hysteresis", "static-friction"] {
        assert!(!names.contains(&name), "{name}");
    }
    // Of one direction, one number.
    assert!(map.catalogue().iter().all(|candidate| candidate.parameters.len() == 1));
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
