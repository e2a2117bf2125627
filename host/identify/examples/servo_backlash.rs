//! Play of bus servos that are pulled from both sides (`data/sts_servo_backlash`).
//!
//! `cargo run --release -p r4-identify --example servo_backlash [data/sts_servo_backlash]`

use std::{error::Error, path::PathBuf};

use r4_identify::{
    data::{Mapping, Options, read},
    statics::hysteresis::{Gap, play},
};

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "data/sts_servo_backlash".to_owned()));
    let servos = [
        ("sts3215_single", "dut"),
        ("sts3250_single", "dut"),
        ("sts3215_pair_default", "dut1"),
        ("sts3215_pair_default", "dut2"),
        ("sts3215_pair_pretension", "dut1"),
        ("sts3215_pair_pretension", "dut2"),
        ("sts3215_pair_pgain_zero_deadband", "dut1"),
        ("sts3215_pair_pgain_zero_deadband", "dut2"),
    ];
    for (file, servo) in servos {
        let roles = vec![
            Mapping::measured("output", &format!("{servo}_pos_cnt")),
            Mapping::driving("goal", &format!("{servo}_target_cnt")),
            Mapping::measured("load", &format!("{servo}_load_permille")),
            Mapping::driving("pull_a", "pullA_target_cnt"),
            Mapping::driving("pull_b", "pullB_target_cnt"),
        ];
        let options = Options { roles, counts_per_turn: Some(4096.0), ..Options::default() };
        let recorded = read(&[folder.join(format!("{file}.csv"))], &options)?;
        let play = play(recorded.runs.first().ok_or("no run")?)?;
        let show = |gap: &Gap| format!("{:.3} ± {:.3} deg", gap.value.abs().to_degrees(), gap.std.to_degrees());
        println!("{file} {servo}: loaded {}, unloaded {}", show(&play.loaded), show(&play.unloaded));
        println!("  returns by {:.3} deg when let go", play.returns_by.to_degrees());
        for explanation in &play.explanations {
            println!(
                "  {:24} first two cycles {:.3}, later ones {:.3} deg",
                explanation.name,
                explanation.rmse.to_degrees(),
                explanation.holdout_rmse.to_degrees()
            );
        }
        if let Some(droop) = play.droop {
            println!(
                "  holds with {:.1} permille of duty per degree beyond {:.3} deg",
                droop.load_per_distance.to_radians() * 1e3,
                droop.dead_band.to_degrees()
            );
        }
    }
    Ok(())
}
