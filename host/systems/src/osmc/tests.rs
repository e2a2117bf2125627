use super::*;

const BOARD: &str = "sim:osmc-evaluation";

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: BOARD.parse().expect("a board") }
}

/// Runs one motor of a seed.
fn one(arm: &'static str, seed: u64, index: usize, hold_s: f64) -> (Motor, Driven) {
    let trial = trial(arm, seed);
    let scene = scene(&trial).expect("a scene");
    let driven = driven(&scene, index, &trial, hold_s).expect("a trial");
    (scene.motors[index].clone(), driven)
}

/// Finds the first seed that hides `effect` in motor number `index`.
fn seed_of(effect: &str, index: usize) -> u64 {
    let hides = |seed: &u64| {
        let scene = scene(&trial(OURS, *seed)).expect("a scene");
        scene.motors[index].truth.as_ref().map_or("nothing", |truth| truth.name) == effect
    };
    (1..200).find(hides).expect("each is as likely as the others")
}

#[test]
fn a_scale_of_the_actuators_sensor_is_corrected_and_the_error_falls_below_the_target() {
    let (motor, driven) = one(OURS, seed_of("encoder-scale", 2), 2, 1.0);
    let measured = driven.measured(&motor.bench);
    let worst = measured.true_errors.iter().map(|error| error.abs()).fold(0.0, f64::max);
    assert!(driven.uncalibrated.is_some_and(|before| before > 0.3) && worst <= 0.2, "{driven:.0?} {measured:?}");
    assert_eq!((measured.true_errors.len(), measured.is_settled), (5, true));
}

/// The plain controller overshoots and misses its set points, as in the paper's tables; the board's loops do neither.
#[test]
fn ours_is_nearer_than_the_papers_controller_on_the_same_motor() {
    let seed = seed_of("nothing", 1);
    let (motor, paper) = one(PAPER, seed, 1, 1.0);
    let (_, ours) = one(OURS, seed, 1, 1.0);
    let (paper, ours) = (paper.measured(&motor.bench), ours.measured(&motor.bench));
    assert!(ours.counts <= 1.0 && ours.overshoot_percent <= 1.0, "{ours:?}");
    assert!(paper.counts > 5.0 && paper.overshoot_percent > 2.0, "{paper:?}");
    // Printed: 2.81 s. The plant's shape follows the tables; its speed is our choice.
    assert!(paper.rise_s.is_some_and(|rise_s| (2.0..3.6).contains(&rise_s)), "{paper:?}");
    assert!(ours.rise_s.is_some_and(|rise_s| rise_s <= 2.75), "{ours:?}");
}

#[test]
fn a_sum_without_bound_overshoots_by_more_than_the_printed_rows() {
    let (motor, driven) = one(UNBOUNDED, seed_of("nothing", 1), 1, 0.0);
    assert!(driven.measured(&motor.bench).overshoot_percent > 19.0);
}

/// Perfect actuators lack the errors of board and motor, but have that of the sensor.
#[test]
fn perfect_actuators_change_the_error() {
    let seed = seed_of("encoder-offset", 1);
    let (motor, ours) = one(OURS, seed, 1, 0.0);
    let perfect = kinematic::driven(&motor, seed);
    let (ours, perfected) = (ours.measured(&motor.bench), perfect.measured(&motor.bench));
    assert!(perfect.uncalibrated.is_some_and(|before| before > 1.9), "{perfect:.0?}");
    assert!(perfected.true_errors.iter().all(|error| error.abs() < 0.3), "{perfected:?}");
    assert!(ours.true_errors != perfected.true_errors && perfected.counts < 0.51, "{ours:?}, {perfected:?}");
}

#[test]
fn the_same_trial_gives_the_same_values() {
    let (_, first) = one(OURS, 3, 0, 0.0);
    let (_, again) = one(OURS, 3, 0, 0.0);
    assert_eq!(first.response, again.response);
}

#[test]
fn the_paper_has_its_numbers_beside_ours() {
    let record = |arm: &str, seed: u64, value: f64| Record {
        system: NAME.into(),
        arm: arm.into(),
        board: "sim".into(),
        seed,
        values: Values::from([("geared_error_360_deg".to_owned(), value), ("geared_settled".to_owned(), 1.0)]),
        failed: None,
    };
    let records = [record(PAPER, 1, 4.0), record(PAPER, 2, 6.0), record(OURS, 1, 0.1), record(OURS, 2, 1.5)];
    let rows = comparison::rows(&records);
    let [error, settled] = &rows[..] else { panic!("{rows:?}") };
    assert_eq!((error.case.as_str(), error.metric, error.unit), ("geared 360 deg", "error", "deg"));
    assert_eq!((error.paper, error.plain_pid, error.plain_pid_worst), (Some(3.0), Some(5.0), Some(6.0)));
    assert!(error.ours_median.is_some_and(|median| (median - 0.8).abs() < 1e-12), "{error:?}");
    assert_eq!((error.ours_worst, error.plants), (Some(1.5), 2));
    assert_eq!((error.met, &error.failing[..]), (Some(false), &[2][..]));
    assert_eq!((settled.met, settled.ours_worst), (Some(true), Some(1.0)));
    assert_eq!(missed(&records[3]), [("geared_error_360_deg".to_owned(), 1.5)]);
}

#[test]
fn printed_rows_and_ours_have_their_laws() {
    let ladders = ladder::all(&trial(OURS, seed_of("encoder-scale", 1))).expect("a trial");
    let chosen: Vec<_> = ladders.iter().map(|ladder| (ladder.data.as_str(), ladder.chosen.as_str())).collect();
    assert!(chosen.contains(&("OSMC Table 1", "scale")), "{chosen:?}");
    assert_eq!(ladders.len(), 9, "{chosen:?}");
}
