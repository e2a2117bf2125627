use std::path::PathBuf;

use proptest::prelude::*;

use super::*;
use crate::data::{
    Mapping, Options, Quantity,
    generated::{PERIOD_S, counted, dice, motor, noisy, run, uniform},
    read,
};

/// True relation of a rate sensor to the rate of an angle.
struct Truth {
    scale: f64,
    offset: f64,
    lag_s: f64,
}

/// Returns a recording of a motor's angle, and of a gyro with a lag, a scale error and an offset.
fn recording(seed: u64, truth: &Truth, decibels: f64) -> Run {
    let motor = motor(seed, None);
    let mut dice = dice(seed ^ 0xabc);
    let late = |at: usize| {
        let place = (at as f64 - truth.lag_s / PERIOD_S).clamp(0.0, motor.speed.len() as f64 - 1.001);
        let (floor, part) = (place.floor() as usize, place.fract());
        motor.speed[floor] * (1.0 - part) + motor.speed[floor + 1] * part
    };
    let rate: Vec<f64> = (0..motor.speed.len()).map(|at| truth.scale * late(at)).collect();
    let rate = noisy(&rate, decibels, &mut dice).iter().map(|rate| rate + truth.offset).collect();
    let angle = noisy(&motor.angle, decibels, &mut dice);
    run(vec![("yaw", Quantity::Angle, angle), ("gyro", Quantity::AngularSpeed, rate)])
}

#[test]
fn sign_scale_offset_and_lag_are_estimated() {
    let (mut far, mut all, mut missed) = (0, 0, Vec::new());
    for seed in 0..60 {
        let mut dice = dice(seed);
        let sign = if uniform(&mut dice) < 0.5 { -1.0 } else { 1.0 };
        let truth = Truth {
            scale: sign * (0.5 + uniform(&mut dice)),
            offset: uniform(&mut dice) - 0.5,
            lag_s: 0.08 * uniform(&mut dice) - 0.02,
        };
        let run = recording(seed, &truth, 30.0);
        let Some(found) = compare(&[&run], "yaw", "gyro", Relation::Derivative) else {
            missed.push(format!("{seed}: nothing"));
            continue;
        };
        for (found, truth) in [(found.scale, truth.scale), (found.offset, truth.offset), (found.lag_s, truth.lag_s)] {
            all += 1;
            far += usize::from((found.value - truth).abs() > 3.0 * found.std);
        }
        let near =
            (found.scale.value / truth.scale - 1.0).abs() < 0.1 && (found.lag_s.value - truth.lag_s).abs() < 0.012;
        if !near {
            missed.push(format!("{seed}: {found}, not {} {}", truth.scale, truth.lag_s));
        }
    }
    assert!(missed.is_empty(), "{far} of {all}; {}", missed.join("\n"));
    // Three standard errors would be exceeded by 0.3 % of normal errors; these standard errors are estimates
    // themselves, with longer tails.
    assert!(far * 20 <= all, "{far} of {all}");
}

#[test]
fn wrong_units_and_signs_are_found_and_good_pairs_are_not() {
    let good = Truth { scale: 1.0, offset: 0.1, lag_s: 0.003 };
    let flagged = |seed: u64, truth: &Truth, decibels: f64| {
        let run = recording(seed, truth, decibels);
        compare(&[&run], "yaw", "gyro", Relation::Derivative).and_then(|found| found.finding())
    };
    let wrong: Vec<String> =
        (0..200).filter_map(|seed| Some(format!("{seed}: {}", flagged(seed, &good, 30.0)?))).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let mut missed = Vec::new();
    for seed in 0..50 {
        for (scale, said) in [
            (PI / 180.0, "degrees for radians"),
            (180.0 / PI, "degrees for radians"),
            (-1.0, "wrong sign"),
            (30.0 / PI, "revolutions per minute"),
            (1.3, "gear ratio"),
        ] {
            let found = flagged(seed, &Truth { scale, ..good }, 30.0).unwrap_or_default();
            if !found.contains(said) {
                missed.push(format!("{seed}, {scale}: {found}"));
            }
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn a_filtered_speed_of_coarse_counts_is_late_but_not_smaller() {
    let mut missed = Vec::new();
    for seed in 0..50 {
        let motor = motor(seed, None);
        // First-order filter of 25 ms: a lag of five samples.
        let mut slow = 0.0;
        let filter = |speed: &f64| {
            slow += PERIOD_S / 0.025 * (speed - slow);
            slow
        };
        let speed: Vec<f64> = motor.speed.iter().map(filter).collect();
        let angle = counted(&motor.angle, 0.5_f64.to_radians());
        let run = run(vec![("output", Quantity::Angle, angle), ("speed", Quantity::AngularSpeed, speed)]);
        let found = compare(&[&run], "output", "speed", Relation::Derivative);
        let good = found.as_ref().is_some_and(|found| {
            found.finding().is_none() && found.has_lag() && (found.lag_s.value - 0.025).abs() < 0.008
        });
        if !good {
            missed.push(format!("{seed}: {}", found.map_or_else(String::new, |found| found.to_string())));
        }
    }
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn an_angle_within_a_turn_in_degrees_is_compared_across_its_jumps() {
    let motor = motor(3, None);
    let degrees = motor.angle.iter().map(|angle| (angle.to_degrees() + 180.0).rem_euclid(360.0) - 180.0).collect();
    let run = run(vec![("yaw", Quantity::Angle, degrees), ("gyro", Quantity::AngularSpeed, motor.speed)]);
    let found = compare(&[&run], "yaw", "gyro", Relation::Derivative).expect("both move");
    assert!(found.finding().is_some_and(|told| told.contains("degrees")), "{found}");
    assert!(found.to_string().contains("scale 0.0175"), "{found}");
}

#[test]
fn another_motors_speed_is_unrelated() {
    let mut missed = Vec::new();
    for seed in 0..50 {
        let (one, other) = (motor(seed, None), motor(seed + 1000, None));
        let run = run(vec![("yaw", Quantity::Angle, one.angle), ("gyro", Quantity::AngularSpeed, other.speed)]);
        let found = compare(&[&run], "yaw", "gyro", Relation::Derivative);
        let told = found.as_ref().and_then(Comparison::finding).unwrap_or_default();
        if !told.contains("does not follow") {
            missed.push(format!("{seed}: {found:?}"));
        }
    }
    // Speeds of two motors may correlate by chance.
    assert!(missed.len() <= 2, "{}", missed.join("\n"));
}

#[test]
fn real_pairs_of_sensors_agree() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../data");
    let compared = |files: &[String], first: (&str, &str), second: (&str, &str), split: &[&str]| {
        let paths: Vec<PathBuf> = files.iter().map(|file| folder.join(file)).collect();
        let roles = [first, second].iter().map(|(role, column)| Mapping::measured(role, column)).collect();
        let split = split.iter().map(|&column| column.to_owned()).collect();
        let recorded = read(&paths, &Options { roles, split, ..Options::default() }).expect("a data set");
        compare(&recorded.runs.iter().collect::<Vec<_>>(), first.0, second.0, Relation::Derivative)
    };
    let husky =
        compared(&["husky_skidsteer/husky.csv".into()], ("yaw", "yaw_rad"), ("gyro", "gyro_z_rad_s"), &["step"]);
    let servo: Vec<String> =
        ["lift_and_drop", "sin_sin", "up_and_down"].map(|what| format!("bam_xl330_pendulum/kp400_{what}.csv")).into();
    let servo = compared(&servo, ("output", "pos_rad"), ("speed", "vel_rad_s"), &[]);
    println!("{husky:?}\n{servo:?}");
    for (found, told) in [(husky, ""), (servo, "")] {
        let found = found.expect("both move");
        assert_eq!(found.finding().unwrap_or_default(), told, "{found}");
    }
}

proptest! {
    #[test]
    fn anything_is_compared_without_panic(
        values in prop::collection::vec(prop_oneof![Just(f64::NAN), Just(0.0), Just(f64::INFINITY), -1e9..1e9], 0..120),
        same in any::<bool>(),
    ) {
        let other = values.iter().rev().copied().collect();
        let run = run(vec![("a", Quantity::Angle, values), ("b", Quantity::AngularSpeed, other)]);
        let relation = if same { Relation::Same } else { Relation::Derivative };
        let told = compare(&[&run], "a", "b", relation).map(|found| format!("{found} {:?}", found.finding()));
        prop_assert!(told.is_none_or(|told| !told.is_empty()));
    }
}
