use std::pin::pin;

use futures::future::{Either, select};
use r4_protocol::SafetyState;
use rayon::prelude::*;

use super::*;

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:deformobot".parse().expect("a board") }
}

/// Runs a trial on perfect actuators.
fn perfect(arm: &'static str, seed: u64, load: Load, law: impl Fn(&Setup) -> Law) -> Run {
    let robot = r4_boards::load(ABOUT.robot).expect("built in");
    let setup = Setup { settles_s: 0.0, ..Setup::of(&robot).expect("a shell") };
    let case = case(&trial(arm, seed), load);
    kinematic::drive(&robot, &setup, &case, &mut law(&setup)).expect("a case")
}

fn values(arm: &'static str, seed: u64) -> Values {
    Whisker.run(&trial(arm, seed)).expect("a trial")
}

/// Mean travel of an arm between heavy boxes over some seeds, m, on perfect actuators.
fn heavy_m(arm: &'static str, seeds: std::ops::RangeInclusive<u64>) -> f64 {
    let seeds: Vec<u64> = seeds.collect();
    let way_m = |seed: &u64| {
        let mut values = Values::new();
        evaluate(Load::Heavy, &perfect(arm, *seed, Load::Heavy, |setup| law(arm, setup)), &mut values);
        values["way_heavy_m"]
    };
    seeds.par_iter().map(way_m).sum::<f64>() / seeds.len() as f64
}

#[test]
fn on_a_simulated_board_the_robot_passes_boxes_of_every_load() {
    let ours = values(OURS, 1);
    for load in Load::ALL {
        assert_eq!(ours[&format!("passed_{}", load.name())], 1.0, "{ours:?}");
        assert!(ours[&format!("way_{}_m", load.name())] > 0.8, "{ours:?}");
    }
    // Narrower than the gap of 24 cm between boxes that stand.
    assert!(ours["width_heavy_m"] < 0.24 && ours["class"] == 1.0, "{ours:?}");
    assert_eq!(values(OURS, 1), ours, "the same seed, bit for bit");
}

/// Travel with one part of the law disabled, against all parts, on the same bodies.
#[test]
fn without_holding_or_waiting_ours_comes_less_far() {
    let ours_m = heavy_m(OURS, 1..=6);
    assert!(ours_m > 0.88, "{ours_m}");
    let arms =
        [(NO_HOLD, 0.0), (NO_WAIT, 0.2), (PRINTED, 0.02)].map(|(arm, least_m)| (arm, least_m, heavy_m(arm, 1..=6)));
    println!("ours {ours_m}, {arms:?}, {} {}", heavy_m(NO_PREDICTION, 1..=6), heavy_m(NO_SHAPE, 1..=6));
    for (arm, least_m, way_m) in arms {
        assert!(way_m < ours_m - least_m, "{arm}: {way_m} m, ours {ours_m} m");
    }
}

/// The dead man is released between heavy boxes: the board trips, the robot stops within the travel of a stop, and the
/// boxes stay. The servo has no pulses any more.
#[test]
fn a_released_dead_man_stops_the_robot_in_the_gap() {
    let trial = trial(OURS, 3);
    let case = case(&trial, Load::Heavy);
    let (rig, setup) = prepared(&trial, &case).expect("a robot");
    let mut law = law(OURS, &setup);
    let work = async |session: &Session<'_>| {
        let board = session.virtual_board()?;
        let release = async {
            loop {
                session.board.sleep_s(0.02).await;
                let body = protocol::truth(session).expect("virtual").expect("a shell");
                if r4_world::Body::pose(&body).x_m > 0.45 {
                    board.dead_man().set(false);
                    return body;
                }
            }
        };
        let drive = pin!(protocol::drive(session, &setup, &mut law, case.waits_s));
        let (released, ended) = match select(drive, pin!(release)).await {
            Either::Right((released, drive)) => (released, drive.await),
            Either::Left(_) => unreachable!("it was never in the gap"),
        };
        session.board.sleep_s(2.0).await;
        let still = protocol::truth(session)?.expect("a shell");
        let boxes = board.world().scene().boxes().to_vec();
        Ok::<_, r4_rig::Error>((ended.map(drop), session.board.safety().0, released, still, boxes))
    };
    let ((ended, state, released, still, boxes), _) = rig.run(None, work).expect("a session");
    assert!(matches!(&ended, Err(r4_rig::Error::Board(_))), "{ended:?}");
    assert_eq!(state, SafetyState::Tripped);
    let [before, after] = [&released, &still].map(|body| r4_world::Body::pose(body).x_m);
    // 0.187 m/s at a friction of 0.6 stop within 3 mm; the rest of the limit is the stop's time.
    assert!((0.0..0.03).contains(&(after - before)), "{before} {after}");
    let twist = r4_world::Body::twist(&still);
    assert!(twist.forward_m_s.abs() < 1e-3 && twist.yaw_rad_s.abs() < 1e-2, "{twist:?}");
    let width_m = still.shell().width_m(still.angle_rad());
    assert!(width_m < 0.245, "it does not open: {width_m}");
    let centre_m = 0.21 + scene::AHEAD_M + 0.5 * scene::BOX_M[0];
    assert!(boxes.iter().all(|one| (one.pose().x_m - centre_m).abs() < 1e-3), "{boxes:?}");
}

/// A leg stands before the nose until 2.2 s, then leaves along the boxes. The robot leans on it and stands; no sample
/// is lost, nothing trips, and the robot continues between the boxes, behind by the travel that the wait cost.
#[test]
fn a_person_in_the_way_costs_time_and_no_sample() {
    let trial = trial(OURS, 3);
    let case = case(&trial, Load::Heavy);
    let run = |people: Vec<r4_world::Person>| {
        let (mut rig, setup) = prepared(&trial, &case).expect("a robot");
        let altered = rig.alter.take();
        rig.alter = Some(std::rc::Rc::new(move |robot| {
            altered.iter().for_each(|altered| altered(robot));
            for person in &people {
                robot.simulation.scene.add_person(person.clone()).expect("a person");
            }
        }));
        let mut law = law(OURS, &setup);
        let work = async |session: &Session<'_>| {
            let run = protocol::drive(session, &setup, &mut law, case.waits_s).await?;
            Ok::<_, r4_rig::Error>((run, session.board.safety().0))
        };
        rig.run(None, work).expect("a session").0
    };
    let way_m = |run: &Run| run.moments.last().expect("moments").pose.x_m - run.moments[0].pose.x_m;
    let path = vec![(0.0, [0.36, 0.0]), (2.2, [0.36, 0.0]), (2.7, [0.36, 1.0])];
    let person = r4_world::Person { radius_m: 0.06, path };
    let ((free, _), (met, state)) = (run(Vec::new()), run(vec![person.clone()]));
    assert_ne!(state, SafetyState::Tripped);
    // The robot stands while the leg does: 0.187 m/s for at least half a second.
    let cost_m = way_m(&free) - way_m(&met);
    assert!((0.09..0.25).contains(&cost_m), "{cost_m} m of {} m", way_m(&free));
    assert!(way_m(&met) >= scene::PASSED_M, "{} m", way_m(&met));
    // A frame every 10 ms, of which the link may delay one.
    let gap_s = met.moments.windows(2).map(|pair| pair[1].seen.time_s - pair[0].seen.time_s).fold(0.0, f64::max);
    assert!(gap_s < 0.025 && met.moments.len() + 2 >= free.moments.len(), "{gap_s} s, {}", met.moments.len());
    assert_eq!(met, run(vec![person]).0, "the same seed, bit for bit");
}

#[test]
fn a_robot_without_a_shell_is_refused() {
    let trial = Trial { board: "sim:openscout".parse().expect("a board"), ..trial(OURS, 1) };
    let error = Whisker.run(&trial).expect_err("wheels").to_string();
    assert!(error.contains("no [body.deformable]"), "{error}");
}

#[test]
fn hidden_effects_are_named_and_clean_whiskers_show_none() {
    for (arm, metric) in
        [(BLIND_DEAD_TIME, "effect_named"), (BLIND_HYSTERESIS, "effect_named"), (BLIND_CLEAN, "clean_quiet")]
    {
        let found = values(arm, 2);
        assert_eq!(found[metric], 1.0, "{arm}: {found:?}");
        if metric == "effect_named" {
            assert!(found["effect_rmse_after"] < 0.8 * found["effect_rmse_before"], "{arm}: {found:?}");
        }
    }
}

/// The base model of late samples has a minimum with the corner at any distance. On the first seed a corner that counted within
/// the whisker's reach only left the fit without a minimum; on the second one fold converges from another guess only.
#[test]
fn late_samples_leave_the_base_model_a_minimum() {
    for seed in [220_039, 230_028] {
        let found = values(BLIND_DEAD_TIME, seed);
        assert_eq!(found["effect_named"], 1.0, "{seed}: {found:?}");
    }
}

/// Search for the coefficients of the paper's form: 200 sampled sets on seeds 1 to 20, heavy boxes, perfect actuators.
#[test]
#[ignore = "a search of minutes"]
fn the_papers_coefficients_are_searched() {
    let mut sampler = crate::Sampler::new(1, 9);
    let mut tried: Vec<(f64, f64, Coefficients)> = Vec::new();
    for _ in 0..200 {
        let mut at = |low: f64, high: f64| sampler.uniform(low, high);
        let coefficients = Coefficients { a: at(0.0, 0.6), b: at(0.0, 0.8), c: at(-0.15, 0.1), returns: at(0.0, 0.2) };
        let way_m = |seed: u64| {
            let run = perfect(PRINTED, seed, Load::Heavy, |setup| Law::Printed(Printed::new(coefficients, setup)));
            let mut values = Values::new();
            evaluate(Load::Heavy, &run, &mut values);
            (values["way_heavy_m"], values["passed_heavy"])
        };
        let ways: Vec<(f64, f64)> = (1..=20).into_par_iter().map(way_m).collect();
        let mean = |of: fn(&(f64, f64)) -> f64| ways.iter().map(of).sum::<f64>() / ways.len() as f64;
        tried.push((mean(|way| way.0), mean(|way| way.1), coefficients));
    }
    tried.sort_by(|one, other| other.0.total_cmp(&one.0));
    for (way_m, passed, coefficients) in tried.iter().take(12) {
        println!("{way_m:.4} m, passed {passed:.2}, {coefficients:?}");
    }
}

/// Training of the classifier: prints the weights for `class.rs`.
#[test]
#[ignore = "prints what is in class.rs"]
fn the_classes_are_learned() {
    use nalgebra::{DMatrix, DVector};
    let of = |load: Load, seeds: std::ops::RangeInclusive<u64>| -> Vec<[f64; class::FEATURES]> {
        let seeds: Vec<u64> = seeds.collect();
        let one = |seed: &u64| class::features(&perfect(OURS, *seed, load, |setup| law(OURS, setup)));
        seeds.par_iter().filter_map(one).collect()
    };
    let learned: Vec<_> = Load::ALL.iter().map(|load| of(*load, 1..=200)).collect();
    let size = class::FEATURES;
    let means: Vec<DVector<f64>> = learned
        .iter()
        .map(|all| DVector::from_fn(size, |row, _| all.iter().map(|one| one[row]).sum::<f64>() / all.len() as f64))
        .collect();
    let mut pooled = DMatrix::zeros(size, size);
    let count: usize = learned.iter().map(Vec::len).sum();
    for (all, mean) in learned.iter().zip(&means) {
        for one in all {
            let off = DVector::from_column_slice(one) - mean;
            pooled += &off * off.transpose() / (count - 3) as f64;
        }
    }
    let inverse = pooled.try_inverse().expect("features that vary");
    for mean in &means {
        let weights = &inverse * mean;
        println!(
            "[{:.2}, {}],",
            -0.5 * mean.dot(&weights),
            weights.iter().map(|w| format!("{w:.3}")).collect::<Vec<_>>().join(", ")
        );
    }
}
