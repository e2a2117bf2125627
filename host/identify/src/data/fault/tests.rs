use std::path::PathBuf;

use proptest::prelude::*;
use r4_blind::{
    Draw,
    experiment::{Length, Setup, experiment},
};

use super::*;
use crate::data::{
    Mapping, Options, Quantity,
    generated::{PERIOD_S, SAMPLES, counted, dice, motor, noisy, run, uniform},
    read,
};

const COUNT: f64 = 0.5 * std::f64::consts::PI / 180.0;

/// Returns a motor's recording with properties that `seed` selects: angle or speed; noise 30 dB below, counts of half
/// a degree, or neither; end stops or none.
fn clean(seed: u64) -> Run {
    let mut dice = dice(seed ^ 0x5eed);
    let stops = (seed.is_multiple_of(3)).then(|| [-0.5 - uniform(&mut dice), 1.0 + uniform(&mut dice)]);
    let motor = motor(seed, stops);
    let of_speed = seed.is_multiple_of(5);
    let (quantity, values) =
        if of_speed { (Quantity::AngularSpeed, &motor.speed) } else { (Quantity::Angle, &motor.angle) };
    let values = match seed % 4 {
        0 | 1 => noisy(values, 30.0, &mut dice),
        2 => counted(values, if of_speed { 0.5 } else { COUNT }),
        _ => values.clone(),
    };
    run(vec![("input", Quantity::Number, motor.duty), ("output", quantity, values)])
}

fn found(run: &Run) -> Vec<Fault> {
    faults(&[run], &["input"], &["output", "speed"])
}

fn output(run: &mut Run) -> &mut Vec<f64> {
    &mut run.signals.get_mut("output").expect("an output").values
}

/// Applies `spoil` to clean recordings, and returns the seeds of those in which `is_found` finds nothing.
fn missed(seeds: std::ops::Range<u64>, spoil: impl Fn(&mut Run, u64), is_found: fn(&Fault) -> bool) -> Vec<String> {
    seeds
        .filter_map(|seed| {
            let mut run = clean(seed);
            spoil(&mut run, seed);
            let found = found(&run);
            (!found.iter().any(is_found)).then(|| format!("{seed} ({} {}): {found:?}", seed % 4, seed % 5))
        })
        .collect()
}

#[test]
fn good_recordings_have_no_fault() {
    let wrong: Vec<String> = (0..400)
        .map(|seed| (seed, found(&clean(seed))))
        .filter(|(_, found)| !found.is_empty())
        .map(|one| format!("{one:?}"))
        .collect();
    assert!(wrong.is_empty(), "{} of 400: {}", wrong.len(), wrong.join("\n"));
}

#[test]
fn simulated_plants_with_hidden_effects_have_no_fault() {
    let mut wrong = Vec::new();
    for seed in 0..60 {
        let setup = Setup::ALL[seed as usize % 3];
        let drawn = experiment(setup, Draw::of(seed), Length { train: 1, holdout: 1, seconds: 12.0 }, seed);
        for one in drawn.train.iter().chain(&drawn.holdout) {
            let quantity = if setup == Setup::MotorSpeed { Quantity::AngularSpeed } else { Quantity::Angle };
            // Signals as recorded, without noise, and in counts.
            let count = 2e-3 * one.clean.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
            for values in [one.output.clone(), one.clean.clone(), counted(&one.clean, count.max(1e-9))] {
                let run = run(vec![("input", Quantity::Number, one.input.clone()), ("output", quantity, values)]);
                wrong.extend(found(&run).into_iter().map(|fault| {
                    format!(
                        "{seed} {setup} {:?}: {fault}",
                        drawn.hidden.truth().iter().map(|t| t.name).collect::<Vec<_>>()
                    )
                }));
            }
        }
    }
    assert!(wrong.is_empty(), "{}: {}", wrong.len(), wrong.join("\n"));
}

/// Cuts a recording off at both ends of the middle of its range.
fn clip(run: &mut Run, seed: u64) {
    let mut dice = dice(seed ^ 0xc11b);
    let values = output(run);
    let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    let from = low + (0.1 + 0.2 * uniform(&mut dice)) * (high - low);
    let to = high - (0.1 + 0.2 * uniform(&mut dice)) * (high - low);
    values.iter_mut().for_each(|value| *value = value.clamp(from, to));
}

#[test]
fn saturated_sensors_are_found() {
    let missed = missed(0..100, clip, |fault| matches!(fault, Fault::Saturated { .. }));
    // Noise is evidence in each. Without it, some recordings pass the limit slowly, or in step with the duty.
    let noisy: Vec<_> = missed.iter().filter(|told| told.contains("(0 ") || told.contains("(1 ")).collect();
    assert!(noisy.is_empty() && missed.len() <= 15, "{} {}: {}", noisy.len(), missed.len(), missed.join("\n"));
}

/// Removes rows, and gives the rest even time stamps or their true ones.
fn drop_rows(run: &mut Run, seed: u64, blocks: [f64; 2], share: f64, restamp: bool) {
    let mut dice = dice(seed ^ 0xd00b);
    let mut keep = vec![true; run.time_s.len()];
    let mean = 0.5 * (blocks[0] + blocks[1]);
    let mut at = 0;
    while at < keep.len() {
        if uniform(&mut dice) < share / mean {
            let length = (blocks[0] + (blocks[1] - blocks[0]) * uniform(&mut dice)).round() as usize;
            let end = (at + length).min(keep.len());
            keep[at..end].fill(false);
            at = end;
        }
        at += 1;
    }
    let kept = |values: &[f64]| {
        values.iter().zip(&keep).filter(|(_, keep)| **keep).map(|(value, _)| *value).collect::<Vec<_>>()
    };
    run.time_s = kept(&run.time_s);
    run.signals.values_mut().for_each(|signal| signal.values = kept(&signal.values));
    if restamp {
        run.time_s.iter_mut().enumerate().for_each(|(at, time_s)| *time_s = PERIOD_S * at as f64);
    }
}

/// A body on two wheels: its rate steps when the tyres begin to slip, while the speeds of the wheels ramp.
#[test]
fn a_rate_may_step_where_no_input_does() {
    let ramp = |at: usize| (at % 200) as f64 / 200.0;
    let wheel = |sign: f64| (0..SAMPLES).map(|at| sign * ramp(at)).collect::<Vec<f64>>();
    let rate = |at: usize| ramp(at) + if at % 200 > 100 { 0.2 } else { 0.0 };
    let rates: Vec<f64> = (0..SAMPLES).map(rate).collect();
    let columns = |names: &[&str]| {
        let wheels = names.iter().zip([1.0, -1.0]).map(|(name, sign)| (*name, Quantity::AngularSpeed, wheel(sign)));
        run(wheels.chain([("gyro", Quantity::AngularSpeed, rates.clone())]).collect())
    };
    assert!(matches!(&faults(&[&columns(&["left"])], &["left"], &["gyro"])[..], [Fault::Dropped { .. }]));
    assert_eq!(faults(&[&columns(&["left", "right"])], &["left", "right"], &["gyro"]), []);
}

#[test]
fn missing_rows_are_found() {
    let is_gap = |fault: &Fault| matches!(fault, Fault::Gaps { .. });
    let stamped = missed(0..50, |run, seed| drop_rows(run, seed, [1.0, 1.0], 0.1, false), is_gap);
    assert!(stamped.is_empty(), "{}", stamped.join("\n"));
    let is_jump = |fault: &Fault| matches!(fault, Fault::Dropped { .. });
    let even = missed(0..100, |run, seed| drop_rows(run, seed, [1.0, 1.0], 0.1, true), is_jump);
    let blocks = missed(0..100, |run, seed| drop_rows(run, seed, [5.0, 20.0], 0.1, true), is_jump);
    // A run of twelve seconds loses about 17 blocks. They do not show at rest, in noise of several steps, or in
    // coarse counts. A test of two lines against a cubic over 20 samples each found no more, and took a sensor that
    // holds its value for one that jumps.
    assert!(
        even.len() <= 2 && blocks.len() <= 45,
        "{} {}: {}\n{}",
        even.len(),
        blocks.len(),
        even.join("\n"),
        blocks.join("\n")
    );
}

#[test]
fn rows_out_of_order_are_found() {
    let shuffle = |run: &mut Run, seed: u64| {
        let mut dice = dice(seed ^ 0x54ff);
        let rows = run.time_s.len();
        let order: Vec<usize> = (0..rows).map(|_| (uniform(&mut dice) * rows as f64) as usize).collect();
        let only_output = seed.is_multiple_of(2);
        for (role, signal) in &mut run.signals {
            if role == "output" || !only_output {
                for (at, &other) in order.iter().enumerate() {
                    signal.values.swap(at, other);
                }
            }
        }
    };
    let missed = missed(0..100, shuffle, |fault| matches!(fault, Fault::Shuffled { .. }));
    assert!(missed.is_empty(), "{}", missed.join("\n"));
}

#[test]
fn another_machines_output_does_not_react() {
    // As many runs as are usually recorded: in a single one, motions of 12 s resemble each other too often.
    let is_found = |seed: u64| {
        let other = |run: u64| {
            let mut one = clean(seed + 100 * run);
            *output(&mut one) = output(&mut clean(seed + 100 * run + 501)).clone();
            one
        };
        let runs = [other(0), other(1), other(2)];
        let found = faults(&runs.iter().collect::<Vec<_>>(), &["input"], &["output"]);
        found.iter().any(|fault| matches!(fault, Fault::NoReaction { .. }))
    };
    let found = (0..100).filter(|seed| is_found(*seed)).count();
    // Slow motions resemble each other by chance, and an explained share above a quarter always counts as a reaction.
    assert!(found >= 55, "{found}");
}

#[test]
fn real_recordings_have_no_fault() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../data");
    let check = |files: &[&str], roles: &[(&str, &str, bool)], split: &[&str]| {
        let paths: Vec<PathBuf> = files.iter().map(|file| folder.join(file)).collect();
        let roles = roles
            .iter()
            .map(|&(role, column, driving)| Mapping { role: role.into(), column: column.into(), driving })
            .collect();
        let split = split.iter().map(|&column| column.to_owned()).collect();
        let recorded = read(&paths, &Options { roles, split, ..Options::default() }).expect("a data set");
        let told = |found: Vec<Fault>| found.iter().map(|fault| format!("{}: {fault}", files[0])).collect::<Vec<_>>();
        let together: Vec<&Run> = recorded.runs.iter().collect();
        told(faults(&together, &["input", "left", "right"], &["output", "speed", "yaw", "gyro", "x", "y"]))
    };
    let mut wrong = Vec::new();
    for file in ["emps/train_trajectory.csv", "emps/test_trajectory_with_pulses.csv"] {
        wrong.extend(check(&[file], &[("input", "u_V", true), ("output", "q_meas_m", false)], &[]));
    }
    for kp in [100, 200, 400, 800] {
        for what in ["lift_and_drop", "sin_sin", "sin_time_square", "up_and_down"] {
            let file = format!("bam_xl330_pendulum/kp{kp}_{what}.csv");
            let roles = [("input", "goal_rad", true), ("output", "pos_rad", false), ("speed", "vel_rad_s", false)];
            wrong.extend(check(&[&file], &roles, &[]));
        }
    }
    for wheel in ["left", "right"] {
        let [mode, counts, duty, rpm] =
            ["mode", "counts", "command_duty256", "rpm"].map(|column| format!("{wheel}_{column}"));
        for number in 1..=6 {
            let file = format!("micromouse_drv8833/openloop_encoder_{number}.csv");
            wrong.extend(check(&[&file], &[("input", &mode, true), ("output", &counts, false)], &[]));
        }
        for number in 1..=8 {
            let file = format!("micromouse_drv8833/pid_{number}.csv");
            wrong.extend(check(&[&file], &[("input", &duty, true), ("output", &rpm, false)], &[]));
        }
    }
    for wheels in ["wheel", "cmd"] {
        let sides = ["left", "right"].map(|side| format!("{wheels}_{side}_rad_s"));
        let roles = [
            ("left", &sides[0][..], true),
            ("right", &sides[1][..], true),
            ("yaw", "yaw_rad", false),
            ("gyro", "gyro_z_rad_s", false),
            ("x", "x_m", false),
            ("y", "y_m", false),
        ];
        wrong.extend(check(&["husky_skidsteer/husky.csv"], &roles, &["step", "window"]));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

proptest! {
    #[test]
    fn anything_is_looked_at_without_panic(
        values in prop::collection::vec(prop_oneof![Just(f64::NAN), Just(0.0), Just(1.0), Just(f64::INFINITY), -1e9..1e9], 0..300),
        grain in 0.0..2.0,
    ) {
        let duty = values.iter().rev().map(|value| value * grain).collect();
        let run = run(vec![("input", Quantity::Number, duty), ("output", Quantity::Angle, values)]);
        for fault in found(&run) {
            prop_assert!(!fault.to_string().is_empty());
        }
    }
}
