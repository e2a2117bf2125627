use std::pin::pin;

use futures::future::{Either, select};
use r4_protocol::SafetyState;
use r4_world::{AnyBody, BerryPicker, Place};

use super::*;

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:berry-picker".parse().expect("a board") }
}

fn values(arm: &'static str, seed: u64) -> Values {
    BerryPicking.run(&trial(arm, seed)).expect("a trial")
}

#[test]
fn a_bush_is_picked_within_a_second_a_berry() {
    let outcome = picked(&trial(OURS, 2)).expect("a trial");
    let ours = evaluate(OURS, &outcome);
    assert!(
        ours["cycle_s"] <= 1.0 && ours["dropped"] == 0.0 && ours["missed"] <= 0.03,
        "{ours:?} {:?}",
        outcome.fills_s
    );
    assert!(ours["crushed"] == 0.0 && ours["attempts"] > 1.0, "{ours:?}");
    assert_eq!(values(OURS, 2), ours, "the same seed, bit for bit");
    let in_turn = values(IN_TURN, 2);
    assert!(in_turn["cycle_s"] > ours["cycle_s"] + 0.1, "{in_turn:?}");
    let unseen = values(UNSEEN, 2);
    assert!(unseen["missed"] > ours["missed"], "{unseen:?}");
}

/// 5 bar give twice the printed force, and so the squeeze of a gripper whose regulator was set by the printed force.
#[test]
fn the_printed_force_crushes() {
    let paper = values(PAPER, 2);
    assert!(paper["rod_force_n"] > 1.6 * paper["rod_force_printed_n"], "{paper:?}");
    let belief = values(BELIEF, 2);
    assert!(belief["crushed"] > 0.05 && paper["crushed"] > 0.05, "{belief:?}, {paper:?}");
}

#[test]
fn what_has_changed_is_named_and_nothing_is_quiet() {
    for name in missing::NAMES {
        let arm = ABOUT.arms.iter().find(|arm| arm.name.strip_prefix(BLIND) == Some(name)).expect("an arm").name;
        let found = values(arm, 3);
        assert_eq!(found["effect_named"], 1.0, "{arm}: {found:?}");
        // The board's low-pass on its analog input distorts a rise of a few milliseconds.
        assert!(found["effect_size_error"] < 0.3, "{arm}: {found:?}");
        assert!(found["effect_rmse_after"] < 0.6 * found["effect_rmse_before"], "{arm}: {found:?}");
    }
    assert_eq!(values(CLEAN, 3), Values::from([("clean_quiet".to_owned(), 1.0)]));
}

#[test]
fn a_robot_without_a_gripper_is_refused() {
    let trial = Trial { board: "sim:openscout".parse().expect("a board"), ..trial(OURS, 1) };
    let error = BerryPicking.run(&trial).expect_err("wheels").to_string();
    assert!(error.contains("no [body.berry-picker]"), "{error}");
}

/// The relay drops out, the valve's spring opens the fingers, and the axes stop. A berry under squeeze stays on its
/// stalk; a carried one falls straight down.
#[test]
fn a_released_dead_man_neither_crushes_nor_throws() {
    let case = Case::of(2);
    for is_carried in [false, true] {
        let mut rig = Rig::new("sim:berry-picker".parse().expect("a board"));
        let nominal = rig.robot().expect("a robot");
        let picker = scene::picker(&nominal).expect("a gripper");
        let regulated_pa = scene::stall_pa(picker, picker.cylinder().areas_m2()[0]);
        rig.alter = Some(case.altered(Gripper::Soft, regulated_pa));
        let setup = Setup::of(&nominal, regulated_pa).expect("a gripper");
        let (method, _) = method(OURS);
        let work = async |session: &Session<'_>| {
            let board = session.virtual_board()?;
            let look = || -> BerryPicker {
                let mut world = board.world();
                world.catch_up();
                let Some(AnyBody::BerryPicker(picker)) = world.body() else { panic!("a gripper") };
                (**picker).clone()
            };
            let release = async {
                loop {
                    let picker = look();
                    let held = picker.fates().iter().any(|fate| fate.place == Place::Held);
                    let is_there =
                        if is_carried { held && picker.tool_m()[0] < 0.09 } else { !held && picker.squeeze_n() > 2.0 };
                    if is_there {
                        break;
                    }
                    session.board.sleep_s(1e-3).await;
                }
                board.dead_man().set(false);
                std::future::pending::<()>().await;
            };
            let pick = protocol::pick(session, &setup, &case, method);
            let Either::Left((ended, _)) = select(pin!(pick), pin!(release)).await else {
                unreachable!("it does not end")
            };
            session.board.sleep_s(1.0).await;
            Ok::<_, r4_rig::Error>((ended.map(drop), session.board.safety().0, look()))
        };
        let ((ended, state, picker), _) = rig.run(None, work).expect("a session");
        assert!(matches!(&ended, Err(r4_rig::Error::Board(_))), "{ended:?}");
        assert_eq!(state, SafetyState::Tripped);
        assert_eq!((picker.travel_m(), picker.squeeze_n()), (0.0, 0.0), "open");
        let touched: Vec<_> = picker.fates().iter().filter(|fate| fate.squeeze_max_n > 0.0).collect();
        let [fate] = touched[..] else { panic!("{touched:?}") };
        assert!(!fate.is_crushed, "{fate:?}");
        let place = if is_carried { Place::Ground } else { Place::Hanging };
        assert_eq!(fate.place, place, "{fate:?}");
        // The step pulses end at once, 60 ms before the fingers release: the berry has no horizontal speed.
        assert!(fate.released_m_s < 0.01, "{fate:?}");
    }
}
