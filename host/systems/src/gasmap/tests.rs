use super::*;

fn trial(arm: &'static str, seed: u64) -> Trial {
    Trial { arm, seed, board: "sim:gas-scout".parse().expect("a board") }
}
