use std::pin::pin;

use futures::future::{Either, select};
use r4_protocol::SafetyState;
use r4_world::{MIDDLE, SuctionState};

use super::*;

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:suction-pad".parse().expect("a board") }
}

fn values(arm: &'static str, seed: u64) -> Values {
    Suction.run(&trial(arm, seed)).expect("a trial")
}

#[test]
fn volume_control_takes_a_cup_off_below_a_fifth_of_a_bar_and_ends_on_the_drop() {
    let ours = values(OURS, 2);
    assert!(ours["detached"] == 1.0 && ours["burst"] == 0.0 && ours["peak_pressure_pa"] <= MOST_PA, "{ours:?}");
    assert!(ours["stopped_by_signature"] == 1.0 && ours["false_signature"] == 0.0, "{ours:?}");
    assert_eq!(values(OURS, 2), ours, "the same seed, bit for bit");
    // Without the end on the pressure drop the membranes stretch farther.
    let blind = values(NO_SIGNATURE, 2);
    assert!(blind["stretch_max"] > ours["stretch_max"] && blind["burst"] == 0.0, "{blind:?} {ours:?}");
}

#[test]
fn pressure_control_bursts_at_the_printed_pressure_and_at_a_fifth_of_a_bar() {
    for arm in [PRINTED, LOW_PRESSURE] {
        let values = values(arm, 2);
        assert!(values["burst"] == 1.0 && values["detached"] == 1.0, "{arm}: {values:?}");
    }
}

/// A kinked tube lets the line's pressure rise beyond 0.2 bar when nothing stops the syringe.
#[test]
fn the_interlock_stops_a_pump_before_a_kinked_tube() {
    let seed = (1..=1000).find(|seed| Case::of(*seed).kink < 1.0).expect("one of ten");
    let (ours, without) = (values(OURS, seed), values(NO_INTERLOCK, seed));
    assert!(ours["interlocked"] == 1.0 && ours["peak_pressure_pa"] <= MOST_PA, "{ours:?}");
    assert!(without["interlocked"] == 0.0 && without["peak_pressure_pa"] > 1.5 * MOST_PA, "{without:?}");
}

/// The dead man is released halfway through the inflation: pumps stop, valves vent, the membranes go slack and both
/// cups stay on the tissue.
#[test]
fn a_released_dead_man_vents_the_membranes_and_leaves_the_cups() {
    let case = Case { kink: 1.0, leak_strain: [0.2; 2], ..Case::of(2) };
    let mut rig = Rig::new("sim:suction-pad".parse().expect("a board"));
    rig.alter = Some(case.altered(Feed::Syringes));
    let setup = Setup::of(&rig.robot().expect("a robot")).expect("a pad");
    let work = async |session: &Session<'_>| {
        let board = session.virtual_board()?;
        let state =
            || -> SuctionState { protocol::with_pad(session, |pad, _| *pad.state()).expect("virtual").expect("a pad") };
        let release = async {
            session.board.sleep_s(4.0).await;
            board.dead_man().set(false);
            std::future::pending::<()>().await;
        };
        let inflate = protocol::inflate(session, &setup, MIDDLE_FIRST, Method::Volume(Settings::default()));
        let Either::Left((ended, _)) = select(pin!(inflate), pin!(release)).await else { unreachable!("it ends") };
        let released = state();
        session.board.sleep_s(1.5).await;
        let later = state();
        Ok::<_, r4_rig::Error>((ended.map(drop), session.board.safety().0, released, later))
    };
    let ((ended, state, released, later), _) = rig.run(None, work).expect("a session");
    assert!(matches!(&ended, Err(r4_rig::Error::Board(_))), "{ended:?}");
    assert_eq!(state, SafetyState::Tripped);
    assert!(released.membrane[MIDDLE].stretch > 1.2, "{released:?}");
    assert!(later.membrane[MIDDLE].stretch < 1.02 && later.line[MIDDLE].gauge_pa().abs() < 200.0, "{later:?}");
    // The strip releases the rims; the cups hold by their unchanged suction.
    assert!(later.is_attached == [true; 2] && later.suction_pa == released.suction_pa, "{later:?}");
    assert!(later.shear_n.iter().all(|shear_n| *shear_n < 0.02), "{later:?}");
    // The lead screw of 2 mm pitch is self-locking: the plunger stays in place.
    let volume = |state: &SuctionState| state.line[MIDDLE].volume_m3;
    assert!((volume(&later) - volume(&released)).abs() < 0.02e-6, "{} {}", volume(&later), volume(&released));
}

#[test]
fn hidden_effects_are_named_and_a_clean_membrane_shows_none() {
    for (arm, hidden) in BLIND {
        let values = values(arm, 3);
        match hidden {
            None => assert_eq!(values["clean_quiet"], 1.0, "{arm}: {values:?}"),
            Some(_) => {
                assert_eq!(values["effect_named"], 1.0, "{arm}: {values:?}");
                assert!(values["effect_rmse_after"] < values["effect_rmse_before"], "{arm}: {values:?}");
            }
        }
    }
}

#[test]
fn a_robot_without_a_pad_is_refused() {
    let trial = Trial { board: "sim:openscout".parse().expect("a board"), ..trial(OURS, 1) };
    let error = Suction.run(&trial).expect_err("wheels").to_string();
    assert!(error.contains("no [body.suction-pad]"), "{error}");
}
