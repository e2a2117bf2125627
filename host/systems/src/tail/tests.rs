use std::pin::pin;

use futures::future::{Either, select};
use r4_protocol::SafetyState;
use r4_world::{AnyBody, BalanceTail};

use super::*;

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:balance-tail".parse().expect("a board") }
}

fn values(arm: &'static str, seed: u64) -> Values {
    Tail.run(&trial(arm, seed)).expect("a trial")
}

/// Compares the static lean: the load's moment over the ankle's stiffness beyond gravity on person and load.
#[test]
fn without_a_tail_the_lean_is_that_of_statics() {
    for seed in 1..=4 {
        let Case { mass_kg, ankle, lift, .. } = Case::of(seed);
        let moment_nm = |mass_kg: f64, arm_m: f64| mass_kg * r4_world::GRAVITY_M_S2 * arm_m;
        let [forward_m, up_m] = lift.place_m;
        let stiffness = (ankle - 1.0) * moment_nm(mass_kg, 0.90) - moment_nm(lift.mass_kg, up_m);
        let expected_m = 0.90 * (moment_nm(lift.mass_kg, forward_m) / stiffness);
        let end_m = values(NO_TAIL, seed)["end_m"];
        // Sines of a lean of 0.1 rad contribute 0.2 %, and the load moves closer to the ankle.
        assert!((end_m / expected_m - 1.0).abs() < 0.02, "seed {seed}: {end_m} m, {expected_m} m");
    }
}

#[test]
fn on_a_simulated_board_the_tail_halves_the_lean_inside_all_limits() {
    let ours = values(OURS, 2);
    assert!(ours["excursion_relative"] <= 0.5 && ours["at_limit_s"] == 0.0 && ours["end_m"] < 2e-3, "{ours:?}");
    assert_eq!(values(OURS, 2), ours, "the same seed, bit for bit");
    // Perfect actuators lack the errors of board, encoders and inertial sensor.
    let perfect = values(PERFECT, 2);
    assert!(perfect["excursion_m"] < ours["excursion_m"], "{perfect:?}, {ours:?}");
    // Neither motor comes near its power limit, so that exchanging the limits changes nothing.
    assert_eq!(values(CROSSED, 2), ours);
}

/// 15.6 N m cannot lift the tail's 50 N m: it hangs, and the lean stays.
#[test]
fn the_motors_as_printed_do_not_halve_the_lean() {
    let printed = values(PRINTED, 2);
    assert!(printed["excursion_relative"] > 0.6 && printed["end_m"] > 0.03, "{printed:?}");
    assert!(printed["back_torque_max_nm"] > 0.9 * 0.625, "{printed:?}");
}

/// The dead man is released while the tail moves up: the brakes hold it, the person sways to a new rest, and no command
/// is sent any more.
#[test]
fn a_released_dead_man_leaves_the_tail_on_its_brakes() {
    let case = Case::of(2);
    let mut rig = Rig::new("sim:balance-tail".parse().expect("a board"));
    rig.alter = Some(case.altered(Reading::OuterFirst));
    let setup = Setup::of(&rig.robot().expect("a robot"), Reading::OuterFirst, case.mass_kg).expect("a tail");
    let regulator = Regulator::of(&setup).expect("a gain");
    let work = async |session: &Session<'_>| {
        let board = session.virtual_board()?;
        let tail = || -> BalanceTail {
            let mut world = board.world();
            world.catch_up();
            let Some(AnyBody::BalanceTail(tail)) = world.body() else { panic!("a tail") };
            (**tail).clone()
        };
        let release = async {
            session.board.sleep_s(case.lift.at_s + 0.6 - session.board.now_s()).await;
            board.dead_man().set(false);
            std::future::pending::<()>().await;
        };
        let lift = protocol::lift(session, &setup, case.lift.at_s, Some(&regulator));
        let Either::Left((ended, _)) = select(pin!(lift), pin!(release)).await else { unreachable!("it does not end") };
        let released = tail();
        // The brakes, 1 and 6 N m, stop motors of 0.1 and 1.5 g m² at once; the person sways for a few seconds.
        session.board.sleep_s(6.0).await;
        let held = tail();
        session.board.sleep_s(1.0).await;
        Ok::<_, r4_rig::Error>((ended.map(drop), session.board.safety().0, [released, held, tail()]))
    };
    let ((ended, state, [released, held, later]), _) = rig.run(None, work).expect("a session");
    assert!(matches!(&ended, Err(r4_rig::Error::Board(_))), "{ended:?}");
    assert_eq!(state, SafetyState::Tripped);
    for joint in [1, 2] {
        let angle = |tail: &BalanceTail| tail.state().angle_rad[joint];
        // A cable of 3000 N m/rad yields by 10 mrad under the weight that it carries.
        assert!((angle(&held) - angle(&released)).abs() < 0.15, "joint {joint}: {} {}", angle(&released), angle(&held));
        assert!((angle(&later) - angle(&held)).abs() < 1e-3, "joint {joint} moves");
    }
    assert!(released.state().angle_rad[1] > 0.2, "it was on its way up: {:?}", released.state());
    // The lean is not larger than without a tail.
    assert!(later.wearer_x_m().abs() < 0.08, "{} m", later.wearer_x_m());
}

#[test]
fn a_robot_without_a_tail_is_refused() {
    let trial = Trial { board: "sim:openscout".parse().expect("a board"), ..trial(OURS, 1) };
    let error = Tail.run(&trial).expect_err("wheels").to_string();
    assert!(error.contains("no [body.balance-tail]"), "{error}");
}

/// A missing sensor must not count as a lean of 0: nothing is armed.
#[test]
fn a_tail_without_readings_of_the_lean_is_not_armed() {
    let case = Case::of(2);
    let mut rig = Rig::new("sim:balance-tail".parse().expect("a board"));
    rig.alter = Some(case.altered(Reading::OuterFirst));
    let setup = Setup::of(&rig.robot().expect("a robot"), Reading::OuterFirst, case.mass_kg).expect("a tail");
    let regulator = Regulator::of(&setup).expect("a gain");
    let work = async |session: &Session<'_>| {
        let board = session.virtual_board()?;
        board.world().imu(setup.trunk).expect("it has one").borrow_mut().set_identity(0);
        // Time for the board to detect the other chip.
        session.board.sleep_s(1.0).await;
        let ended = protocol::lift(session, &setup, case.lift.at_s, Some(&regulator)).await;
        Ok::<_, r4_rig::Error>((ended.map(drop), session.board.safety().0))
    };
    let ((ended, state), _) = rig.run(None, work).expect("a session");
    assert!(matches!(ended, Err(r4_rig::Error::NoReadings { channel }) if channel == setup.trunk), "{ended:?}");
    assert_eq!(state, SafetyState::Disarmed);
}

/// The sensor fails during the lift: the board stops the tail when commands expire, and the program reports the sensor.
#[test]
fn a_sensor_that_fails_in_the_lift_ends_it() {
    let case = Case::of(2);
    let mut rig = Rig::new("sim:balance-tail".parse().expect("a board"));
    rig.alter = Some(case.altered(Reading::OuterFirst));
    let setup = Setup::of(&rig.robot().expect("a robot"), Reading::OuterFirst, case.mass_kg).expect("a tail");
    let regulator = Regulator::of(&setup).expect("a gain");
    let work = async |session: &Session<'_>| {
        let board = session.virtual_board()?;
        let fail = async {
            session.board.sleep_s(case.lift.at_s + 0.6 - session.board.now_s()).await;
            board.world().imu(setup.trunk).expect("it has one").borrow_mut().set_hung(true);
            std::future::pending::<()>().await;
        };
        let lift = protocol::lift(session, &setup, case.lift.at_s, Some(&regulator));
        let Either::Left((ended, _)) = select(pin!(lift), pin!(fail)).await else { unreachable!("it does not end") };
        Ok::<_, r4_rig::Error>(ended.map(drop))
    };
    let (ended, _) = rig.run(None, work).expect("a session");
    assert!(matches!(ended, Err(r4_rig::Error::NoReadings { channel }) if channel == setup.trunk), "{ended:?}");
}
