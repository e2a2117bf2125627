use super::*;

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:cable-loop".parse().expect("a board") }
}

fn values(arm: &'static str, seed: u64) -> Values {
    Cloop.run(&trial(arm, seed)).expect("a trial")
}

#[test]
fn on_a_simulated_board_a_vial_is_gripped_carried_and_put_down() {
    for seed in 1..=3 {
        let ours = values(OURS, seed);
        assert!(ours["failed"] == 0.0 && ours["reported"] == 1.0, "seed {seed}: {ours:?}");
        assert!(ours["diameter_error_m"] <= 5e-4, "seed {seed}: {ours:?}");
    }
    assert_eq!(values(OURS, 2), values(OURS, 2), "the same seed, bit for bit");
}
