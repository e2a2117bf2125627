//! Tests of predictions against closed forms, of errors, and of effects found in simulated tyres and in a recording.

mod husky;
mod tyres;

use std::collections::BTreeMap;

use r4_plants::Dependence;
use r4_world::{Chassis, SlipLaw, Wheel};

use super::{Declared, Geometry, Output, SkidError, SkidRun, SkidSteer};
use crate::{
    data::{Quantity, Run, Signal},
    family::{Acts, Curve, Family, Model, Structure, Term},
    fit::Fit,
};

/// Sampling period of 50 Hz, s.
const PERIOD_S: f64 = 0.02;
const GEOMETRY: Geometry = Geometry { wheel_radius_m: 0.1, track_m: 0.5 };
const DECLARED: Declared = Declared { geometry: GEOMETRY, average_s: None };

fn quantity(role: &str) -> Quantity {
    match role {
        "yaw" => Quantity::Angle,
        "x" | "y" => Quantity::Length,
        _ => Quantity::AngularSpeed,
    }
}

/// Makes a run of roles at a constant rate.
fn run(name: &str, period_s: f64, roles: &[(&str, Vec<f64>)]) -> Run {
    let len = roles[0].1.len();
    let signal = |(role, values): &(&str, Vec<f64>)| {
        let signal = Signal { column: (*role).to_owned(), quantity: quantity(role), values: values.clone() };
        ((*role).to_owned(), signal)
    };
    Run {
        name: name.to_owned(),
        time_s: (0..len).map(|at| at as f64 * period_s).collect(),
        origin_s: None,
        signals: roles.iter().map(signal).collect(),
    }
}

/// Makes a run whose sides step from rest to `left` and `right` at the third sample; the gyro stays at zero.
fn step(left: f64, right: f64, len: usize) -> Run {
    let side = |speed: f64| (0..len).map(|at| if at < 2 { 0.0 } else { speed }).collect::<Vec<f64>>();
    run("step", PERIOD_S, &[("left", side(left)), ("right", side(right)), ("gyro", vec![0.0; len])])
}

fn model(run: &Run) -> (SkidSteer, SkidRun) {
    model_of(DECLARED, Output::YawRate, run)
}

fn model_of(declared: Declared, output: Output, run: &Run) -> (SkidSteer, SkidRun) {
    let (family, mut runs) = SkidSteer::new(declared, output, std::slice::from_ref(run)).unwrap();
    (family, runs.remove(0))
}

fn index(family: &SkidSteer, name: &str) -> usize {
    family.catalogue().iter().position(|candidate| candidate.name == name).unwrap()
}

/// Returns the free-run simulation with effects at given values.
fn predicted(family: &SkidSteer, run: &SkidRun, effects: &[(&str, &[f64])]) -> Vec<f64> {
    let structure = Structure {
        terms: effects.iter().map(|(name, _)| Term::Known(index(family, name))).collect(),
        base: vec![],
        added: effects.iter().map(|(_, values)| values.to_vec()).collect(),
    };
    free_run(family, &structure, run)
}

fn free_run(family: &SkidSteer, structure: &Structure, run: &SkidRun) -> Vec<f64> {
    let mut predicted = vec![0.0; family.measured(run).len()];
    family.predict(structure, &[], run, &mut predicted);
    predicted
}

/// Checks equality to the rounding of some tens of operations on numbers near one.
#[track_caller]
fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-12 * expected.abs().max(1.0), "{found} instead of {expected}");
}

#[test]
fn without_slip_the_body_follows_the_arc_of_its_wheels() {
    // Yaw rate 0.1 m · (7 - 3) rad/s / 0.5 m.
    let (family, run) = model(&step(3.0, 7.0, 10));
    let rates = predicted(&family, &run, &[]);
    close(rates[0], 0.0);
    close(rates[9], 0.8);
}

#[test]
fn speeds_along_and_across_are_taken_from_the_pose() {
    // Half a turn on a circle of 2 m in 3.14 s, with the pose's point 0.3 m ahead of the turning centre: it moves at
    // 2 m · 1 rad/s along the body, and at 0.3 m · 1 rad/s across it.
    let len = 158;
    let at = |sample: usize| sample as f64 * PERIOD_S;
    let series = |of: &dyn Fn(f64) -> f64| (0..len).map(|sample| of(at(sample))).collect::<Vec<f64>>();
    let arc = run(
        "arc",
        PERIOD_S,
        &[
            ("left", vec![17.5; len]),
            ("right", vec![22.5; len]),
            ("yaw", series(&|t| t)),
            ("x", series(&|t| 2.0 * t.sin() + 0.3 * t.cos())),
            ("y", series(&|t| -2.0 * t.cos() + 0.3 * t.sin())),
        ],
    );
    for (output, effect, value, expected) in
        [(Output::ForwardSpeed, "slip-longitudinal", 1.0, 2.0), (Output::LateralSpeed, "slip-lateral", -0.3, 0.3)]
    {
        let (family, arc) = model_of(DECLARED, output, &arc);
        let free = predicted(&family, &arc, &[(effect, &[value])]);
        for (&measured, &predicted) in family.measured(&arc).iter().zip(&free) {
            close(predicted, expected);
            // Chords of 0.02 rad are shorter than their arcs by 0.02² / 24.
            assert!((measured - expected).abs() < 2e-5 * expected, "{measured} instead of {expected}");
        }
    }
}

#[test]
fn each_slip_has_the_size_that_it_says() {
    // 0.8 rad/s at 0.5 m/s without slip; the slower side has 3/7 of the faster side's speed.
    let (family, run) = model(&step(3.0, 7.0, 10));
    for (effect, values, expected) in [
        ("slip-track", &[1.0][..], 0.4),
        ("slip-turning", &[0.5], 0.8 / 1.4),
        ("slip-driving", &[0.6], 0.8 * (-0.3_f64).exp()),
        // At 0.3 and 0.7 m/s the factor is 1 / (4 · 0.3 · 0.7) without creep; with much creep, all speeds are alike.
        ("slip-standing-side", &[0.5, 1e-9], 0.8 / (1.0 + 0.5 * (1.0 / 0.84 - 1.0))),
        ("slip-standing-side", &[0.5, 1e9], 0.8),
        ("direction-asymmetry", &[0.1], 0.88),
        ("slip-drift", &[-2.0], 0.8 * (-0.36_f64).exp()),
        ("encoder-scale", &[1.21], 0.2 * (7.7 / 1.21 - 3.0 / 1.1) + 0.2 * (7.7 - 7.7 / 1.21)),
        ("dead-zone", &[1.0], 0.8),
        ("rate-limit", &[0.7], 0.7),
        ("slip-limit", &[0.7, 0.2], 0.6),
        // Both sides slow down by the factor that brings the faster one from 0.7 m/s to 0.35 m/s.
        ("saturation", &[3.5, 1.0], 0.4),
        ("sensor-offset", &[0.05], 0.85),
    ] {
        let rates = predicted(&family, &run, &[(effect, values)]);
        let found = rates[9];
        assert!((found - expected).abs() < 1e-12, "{effect}: {found} instead of {expected}");
    }
}

#[test]
fn a_dead_zone_holds_a_side_that_hardly_turns() {
    let (family, run) = model(&step(-0.5, 7.0, 10));
    close(predicted(&family, &run, &[("dead-zone", &[1.0])])[9], 0.1 * 6.0 / 0.5);
}

#[test]
fn a_lag_answers_a_step_by_its_exponential() {
    let (family, run) = model(&step(-5.0, 5.0, 100));
    let rates = predicted(&family, &run, &[("drive-lag", &[0.1])]);
    // The step is a linear rise from the second to the third sample, which averages the exponential over it.
    let rise = |t: f64| {
        let (tau, width) = (0.1_f64, PERIOD_S);
        2.0 * (1.0 - tau / width * ((width / tau).exp() - 1.0) * (-(t + width) / tau).exp())
    };
    for (after, &rate) in rates[2..].iter().enumerate() {
        close(rate, rise(after as f64 * PERIOD_S));
    }
    // The sensor's lag is the same filter at another place, and equal lags of the sides act like one of the body.
    for (effect, values) in [("sensor-lag", &[0.1][..]), ("drive-lag-sides", &[0.1, 0.1])] {
        let other = predicted(&family, &run, &[(effect, values)]);
        rates.iter().zip(&other).for_each(|(&a, &b)| close(a, b));
    }
}

#[test]
fn a_lag_of_no_length_is_none() {
    let (family, run) = model(&step(-5.0, 5.0, 20));
    let without = predicted(&family, &run, &[]);
    for tiny in [0.0, 1e-300, 1e-9] {
        let with = predicted(&family, &run, &[("drive-lag", &[tiny])]);
        // The lag behind a ramp of 100 rad/s² is its slope times 1 ns.
        without.iter().zip(&with).for_each(|(a, b)| assert!((a - b).abs() < 2e-7, "{tiny}: {b} instead of {a}"));
    }
}

#[test]
fn a_slew_limit_makes_a_ramp() {
    let (family, run) = model(&step(-5.0, 5.0, 100));
    let rates = predicted(&family, &run, &[("slew-limit", &[4.0])]);
    // The step is a linear rise from the second sample on.
    for (sample, &rate) in rates.iter().enumerate() {
        close(rate, (4.0 * PERIOD_S * (sample as f64 - 1.0)).clamp(0.0, 2.0));
    }
}

#[test]
fn a_slew_limit_turns_round_where_it_meets_its_input() {
    // The input is 1 rad/s, then falls linearly to -3 rad/s over one sample. The ramp is at 0.96 rad/s then, meets
    // the input 0.04 / (200 + 4) s later, and falls from there.
    let turn = |at: usize| {
        if at == 0 {
            0.0
        } else if at < 13 {
            1.0
        } else {
            -3.0
        }
    };
    let side = |sign: f64| (0..20).map(|at| sign * 2.5 * turn(at)).collect::<Vec<f64>>();
    let roles = [("left", side(-1.0)), ("right", side(1.0)), ("gyro", vec![0.0; 20])];
    let (family, run) = model(&run("turn", PERIOD_S, &roles));
    let rates = predicted(&family, &run, &[("slew-limit", &[4.0])]);
    let (begins, met_s) = (12.0 * 4.0 * PERIOD_S, 0.04 / 204.0);
    close(rates[12], begins);
    close(rates[13], begins + 4.0 * met_s - 4.0 * (PERIOD_S - met_s));
}

#[test]
fn a_delay_of_whole_and_half_samples_shifts_the_input() {
    let (family, run) = model(&step(-5.0, 5.0, 20));
    for (delay_s, expected) in [(3.0 * PERIOD_S, [0.0, 2.0, 2.0]), (2.5 * PERIOD_S, [1.0, 2.0, 2.0])] {
        let rates = predicted(&family, &run, &[("input-delay", &[delay_s])]);
        for (&rate, expected) in rates[4..7].iter().zip(expected) {
            assert!((rate - expected).abs() < 1e-9, "{delay_s}: {rates:?}");
        }
    }
    // The true speeds are ahead of a late recording.
    let rates = predicted(&family, &run, &[("encoder-delay", &[PERIOD_S])]);
    close(rates[0], 0.0);
    close(rates[1], 2.0);
}

#[test]
fn memory_begins_at_the_first_value_measured() {
    let mut coast = step(0.0, 0.0, 60);
    coast.signals.get_mut("gyro").unwrap().values = vec![0.5; 60];
    // The last sample turns, because a run without turning is refused.
    for (role, speed) in [("left", -1.0), ("right", 1.0)] {
        coast.signals.get_mut(role).unwrap().values[59] = speed;
    }
    let (family, whole) = model(&coast);
    let part = family.part(&whole, 20, 59);
    for run in [&whole, &part] {
        let rates = predicted(&family, run, &[("drive-lag", &[0.1])]);
        close(rates[0], 0.5);
        close(rates[10], 0.5 * (-10.0 * PERIOD_S / 0.1_f64).exp());
    }
}

#[test]
fn a_part_knows_the_input_before_it() {
    let (family, whole) = model(&step(-5.0, 5.0, 40));
    let effects = &[("input-delay", &[0.21][..])];
    let (all, part) = (predicted(&family, &whole, effects), family.part(&whole, 8, 40));
    let rates = predicted(&family, &part, effects);
    assert_eq!(family.time_s(&part), &family.time_s(&whole)[8..]);
    rates.iter().zip(&all[8..]).for_each(|(&a, &b)| close(a, b));
}

#[test]
fn means_are_taken_over_the_same_samples() {
    // 0.4 s at 50 Hz in means over 0.1 s; the rate rises by 1 rad/s per second.
    let len = 20;
    let side = |sign: f64| (0..len).map(|at| sign * 2.5 * at as f64 * PERIOD_S).collect::<Vec<f64>>();
    let gyro: Vec<f64> = (0..len).map(|at| at as f64 * PERIOD_S).collect();
    let yaw: Vec<f64> = (0..len).map(|at| 0.5 * (at as f64 * PERIOD_S).powi(2)).collect();
    let declared = Declared { average_s: Some(0.1), ..DECLARED };
    for measured in [("gyro", gyro), ("yaw", yaw)] {
        let ramp = run("ramp", PERIOD_S, &[("left", side(-1.0)), ("right", side(1.0)), measured]);
        let (family, ramp) = model_of(declared, Output::YawRate, &ramp);
        let rates = predicted(&family, &ramp, &[]);
        for (row, (&rate, &measured)) in rates.iter().zip(family.measured(&ramp)).enumerate() {
            close(rate, 0.1 * row as f64 + 0.04);
            close(measured, rate);
        }
        assert_eq!(rates.len(), 4);
    }
}

#[test]
fn a_held_yaw_is_compared_from_fresh_value_to_fresh_value() {
    // 1 rad/s with every second value held, through the jump at half a turn.
    let len = 41;
    let yaw = (0..len).map(|at| {
        let yaw = 3.0 + (at / 2 * 2) as f64 * PERIOD_S;
        if yaw > std::f64::consts::PI { yaw - std::f64::consts::TAU } else { yaw }
    });
    let turn = run("turn", PERIOD_S, &[("left", vec![-2.5; len]), ("right", vec![2.5; len]), ("yaw", yaw.collect())]);
    let (family, turn) = model(&turn);
    let rates = predicted(&family, &turn, &[]);
    for (&measured, &rate) in family.measured(&turn).iter().zip(&rates) {
        close(measured, 1.0);
        close(rate, 1.0);
    }
    assert_eq!(rates.len(), 20);
}

#[test]
fn what_touches_a_gap_is_not_compared() {
    let mut gappy = step(-5.0, 5.0, 20);
    gappy.signals.get_mut("left").unwrap().values[10] = f64::NAN;
    let (family, gappy) = model(&gappy);
    let unknown: Vec<usize> = (0..20).filter(|&at| family.measured(&gappy)[at].is_nan()).collect();
    assert_eq!(unknown, [10]);
    assert!(predicted(&family, &gappy, &[]).iter().all(|rate| rate.is_finite()));
}

#[test]
fn a_curve_adds_over_a_line_and_scales_over_the_directions() {
    let (family, run) = model(&step(-5.0, 5.0, 20));
    let mut tried = 0;
    let fitted = |structure| Fit::at(&family, &[&run], structure, vec![vec![]]);
    let without = fitted(Structure::default());
    for driver in family.drivers(&without.structure, &[], &run) {
        assert_eq!(driver.values.len(), 20);
        let over = (driver.over, driver.period);
        for curve in family.curves(&without, over, &[&run]) {
            // Turning on the spot at 2 rad/s.
            let expected = if curve.acts == Acts::Gain { 2.2 } else { 2.1 };
            assert_eq!(curve.period.is_some(), curve.over == Dependence::Direction);
            let values = vec![0.1; curve.at.len()];
            let structure = Structure { terms: vec![Term::Curve(curve)], base: vec![], added: vec![values] };
            close(free_run(&family, &structure, &run)[19], expected);
            assert!(family.curves(&fitted(structure), over, &[&run]).is_empty());
            tried += 1;
        }
    }
    // Push and gain over turning, speed and time; a gain over the direction.
    assert_eq!(tried, 7);
}

/// Returns a structure of named effects with their values.
fn found(family: &SkidSteer, effects: &[(&str, &[f64])]) -> Structure {
    Structure {
        terms: effects.iter().map(|(name, _)| Term::Known(index(family, name))).collect(),
        base: vec![],
        added: effects.iter().map(|(_, values)| values.to_vec()).collect(),
    }
}

/// With the linear law, wheels that turn on the spot slip by `l²/(r b²)`, `r` being the ratio of the compliances
/// (Trimble, Fox 2023): the effective track is wider by that share, for [`DECLARED`] on a square of wheels by `1/r`.
#[test]
fn a_body_turns_by_the_track_that_was_found() {
    let (family, _) = model(&step(-5.0, 5.0, 20));
    let soft = |_: &mut Chassis, wheels: &mut [Wheel]| {
        wheels.iter_mut().filter_map(|wheel| wheel.tyre.as_mut()).for_each(|tyre| {
            (tyre.law, tyre.friction) = (SlipLaw::Linear, 50.0);
        });
    };
    let known = family.fitted_body(&Structure::default(), "a test").wheeled.changed(soft).unwrap();
    let family = family.with_body(Some(known));
    for wider in [1.25, 2.0, 5.0] {
        let body = family.fitted_body(&found(&family, &[("slip-track", &[wider * 0.5])]), "a test");
        let [long, lat] = body.wheeled.wheels()[0].tyre.unwrap().compliance_per_n;
        // The simulated yaw rate has settled to 1e-6, and the ratio is found to 1e-4 of a power of ten.
        assert!((lat / long * (wider - 1.0) - 1.0).abs() < 1e-3, "{wider}: {}", lat / long);
        assert!(body.provenance.iter().any(|line| line.starts_with("compliance_lat_per_n")), "{:?}", body.provenance);
    }
}

#[test]
fn a_body_holds_radii_and_centre_and_names_what_it_does_not() {
    let (family, _) = model(&step(-5.0, 5.0, 20));
    let curve = Curve {
        at: vec![-1.0, 1.0],
        ..family.curves(&Fit::at(&family, &[], Structure::default(), vec![]), (Dependence::Input, None), &[]).remove(0)
    };
    let mut structure = found(
        &family,
        &[("slip-track", &[0.6]), ("encoder-scale", &[1.21]), ("drive-lag", &[0.1]), ("slip-drift", &[0.1])],
    );
    structure.terms.push(Term::Curve(curve));
    structure.added.push(vec![0.0, 0.0]);
    let body = family.fitted_body(&structure, "a test");
    for wheel in body.wheeled.wheels() {
        let expected = if wheel.place_m[1] > 0.0 { 0.1 / 1.1 } else { 0.1 * 1.1 };
        assert!((wheel.radius_m - expected).abs() < 1e-12, "{wheel:?}");
    }
    let left_out: Vec<_> = body.left_out.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(left_out, ["drive-lag", "slip-drift", "a curve over input"]);
    assert!(body.provenance.iter().any(|line| line.starts_with("Assumed, not fitted")), "{:?}", body.provenance);
}

#[test]
fn each_effect_begins_in_range_and_changes_something() {
    let (left, right) = (step(-5.0, 0.2, 60), step(5.0, 6.0, 60));
    for output in Output::ALL {
        let pose = |run: &Run| {
            let mut run = run.clone();
            for role in ["x", "y", "yaw"] {
                let values = (0..60).map(|at| 0.01 * f64::from(at)).collect();
                let signal = Signal { column: role.to_owned(), quantity: quantity(role), values };
                run.signals.insert(role.to_owned(), signal);
            }
            run
        };
        let (family, runs) = SkidSteer::new(DECLARED, output, &[pose(&left), pose(&right)]).unwrap();
        for candidate in family.catalogue() {
            for start in &candidate.starts {
                assert_eq!(start.len(), candidate.parameters.len(), "{}", candidate.name);
            }
            // Without an offset of the turning centre there is no lateral speed.
            let base: &[(&str, &[f64])] = match output {
                Output::LateralSpeed if candidate.name != "slip-lateral" => &[("slip-lateral", &[0.1])],
                _ => &[],
            };
            let moved = runs.iter().any(|run| {
                let without = predicted(&family, run, base);
                let differs = |start: &Vec<f64>| {
                    predicted(&family, run, &[base, &[(candidate.name, &start[..])]].concat()) != without
                };
                candidate.starts.iter().any(differs)
            });
            assert!(moved, "{output:?}: {}", candidate.name);
        }
    }
}

#[test]
fn what_is_missing_is_said() {
    let good = step(-5.0, 5.0, 20);
    let refused = |run: &Run| SkidSteer::new(DECLARED, Output::YawRate, std::slice::from_ref(run)).unwrap_err();
    let with = |change: &dyn Fn(&mut Run)| {
        let mut run = good.clone();
        change(&mut run);
        refused(&run)
    };
    let values = |run: &mut Run, role: &str, value: f64| run.signals.get_mut(role).unwrap().values = vec![value; 20];

    assert!(matches!(with(&|run| drop(run.signals.remove("left"))), SkidError::NoRole { role: "left", .. }));
    assert!(matches!(with(&|run| drop(run.signals.remove("gyro"))), SkidError::NoRole { role: "gyro", .. }));
    let unit = with(&|run| run.signals.get_mut("right").unwrap().quantity = Quantity::Number);
    assert!(matches!(unit, SkidError::Unit { role: "right", .. }));
    let shorter = with(&|run| run.signals.get_mut("gyro").unwrap().values.truncate(19));
    assert!(matches!(shorter, SkidError::Length { role: "gyro", expected: 20, found: 19, .. }));
    assert!(matches!(with(&|run| values(run, "gyro", f64::NAN)), SkidError::NothingMeasured { .. }));
    assert!(matches!(with(&|run| values(run, "left", f64::NAN)), SkidError::NothingMeasured { .. }));
    let straight = with(&|run| ["left", "right"].iter().for_each(|role| values(run, role, 3.0)));
    assert_eq!(straight, SkidError::NeverTurns);
    let still = with(&|run| ["left", "right"].iter().for_each(|role| values(run, role, 0.0)));
    assert_eq!(still, SkidError::NeverDrives);
    let short = with(&|run| {
        run.time_s.truncate(2);
        run.signals.values_mut().for_each(|signal| signal.values.truncate(2));
    });
    assert!(matches!(short, SkidError::TooShort { found: 2, .. }));
    assert!(matches!(SkidSteer::new(DECLARED, Output::YawRate, &[]).unwrap_err(), SkidError::NoRun));
    let means = Declared { average_s: Some(2.0), ..DECLARED };
    let short = SkidSteer::new(means, Output::YawRate, std::slice::from_ref(&good)).unwrap_err();
    assert!(matches!(short, SkidError::TooShortToAverage { .. }));
}

#[test]
fn geometry_has_to_be_declared() {
    let given = |pairs: &[(&str, f64)]| {
        Declared::from_parameters(
            &pairs.iter().map(|&(name, value)| (name.to_owned(), value)).collect::<BTreeMap<_, _>>(),
        )
    };
    let radius = ("wheel_radius_m", 0.1);
    assert_eq!(given(&[radius, ("track_m", 0.5)]).unwrap(), DECLARED);
    assert!(matches!(given(&[radius]).unwrap_err(), SkidError::NoParameter { name: "track_m", .. }));
    let bad = given(&[radius, ("track_m", -0.5)]).unwrap_err();
    assert_eq!(bad, SkidError::BadParameter { name: "track_m", value: -0.5 });
    assert!(matches!(given(&[radius, ("width_m", 0.5)]).unwrap_err(), SkidError::UnknownParameter { .. }));
}
