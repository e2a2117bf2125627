//! Tests of the program on emulated boards: the firmware's own image as a user sees it.

use std::{fs, path::Path, process::Command};

use crate::program::{self, next, object, start, text};
use r4_image::{Image, Place};
use serde_json::Value;

/// Runs `r4` and returns its output as JSON; it must succeed.
fn r4(arguments: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_r4")).args(arguments).arg("--json").output().expect("r4 starts");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "r4 {}: {errors}", arguments.join(" "));
    // The file that was run is recorded in the log.
    assert!(errors.contains("SHA-256"), "{errors}");
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// Every scenario: positions agree within a count and a period of motion, trips and refusals exactly.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn simulated_and_emulated_boards_agree_in_every_scenario() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/scenarios");
    let files: Vec<_> = fs::read_dir(folder)
        .expect("the folder of scenarios")
        .map(|entry| entry.expect("an entry").path().to_str().expect("a name in Unicode").to_owned())
        .collect();
    assert!(files.len() >= 5, "{files:?}");
    let mut arguments = vec!["scenario", "--compare"];
    arguments.extend(files.iter().map(String::as_str));
    let compared = r4(&arguments);
    let rows = compared["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), files.len());
    for row in rows {
        assert_eq!(row["differences"], Value::Array(Vec::new()), "{row}");
        assert!(row["looks"].as_u64() >= Some(3), "{row}");
    }
}

/// The demo's table from the real image: each set point is reached within the tolerance of the evaluation.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn the_demo_reaches_every_set_point() {
    let out = tempfile::tempdir().expect("a folder");
    let demo = r4(&["demo", "--board", "emu:osmc-bench", "--out", out.path().to_str().expect("a name in Unicode")]);
    let rows = demo["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 9);
    for row in rows {
        // In degrees and millimetres: the loops settle within 0.15 of either.
        assert!(row["error_ours"].as_f64().is_some_and(|error| error.abs() < 0.15), "{row}");
    }
}

/// The regulator of the balance tail on the real image reaches the targets of its study, and the simulated board's
/// lean.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn the_balance_tail_halves_the_lean() {
    let trial = |board| program::good_json(&["system", "run", "tail", "--seed", "2", "--board", board, "--json"]);
    let [emulated, simulated] = ["emu:balance-tail", "sim:balance-tail"].map(|board| trial(board)["values"].clone());
    let of = |values: &Value, name: &str| values[name].as_f64().expect("a metric");
    assert!(of(&emulated, "excursion_relative") <= 0.5 && of(&emulated, "at_limit_s") == 0.0, "{emulated}");
    // The regulator starts at another phase of its 10 ms, while the person leans by up to 65 mm/s: 0.65 mm. Readings of
    // the inertial sensor come at other moments, so that their noise differs: 3.6 mrad/s in each of 100 readings at
    // rest are 0.5 mrad/s between the offsets that the two boards' programs find, and 1.8 mm in the 4 s up to the lift.
    let differ_m = of(&emulated, "excursion_m") - of(&simulated, "excursion_m");
    assert!(differ_m.abs() < 0.65e-3 + 1.8e-3, "{emulated}, {simulated}");
}

/// SKIDCAL on the real image, its gyroscope read over the emulated bus, names the effect that the seed hides.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn a_wheel_radius_is_found_on_an_emulated_board() {
    let arguments = ["system", "run", "skidcal", "--arm", "blind:one-effect", "--seed", "10", "--json"];
    let found = program::good_json(&[&arguments[..], &["--board", "emu:openscout"]].concat());
    let of = |name: &str| found["values"][name].as_f64().expect("a metric");
    // The true radius is 3.4 % off; a run found it within 0.4 % of that.
    assert!(of("hidden_effect_named") == 1.0 && of("effect_size_error") < 0.05, "{found}");
}

/// The OSMC evaluation on the real image reaches set points as on the simulated board, without a limit cycle.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn the_osmc_evaluation_runs_on_an_emulated_board() {
    let arguments = ["system", "run", "osmc", "--arm", "ablation:uncalibrated", "--seed", "4", "--json"];
    let run = program::good_json(&[&arguments[..], &["--board", "emu:osmc-evaluation"]].concat());
    let of = |name: &str| run["values"][name].as_f64().expect("a metric");
    // Seed 4 hides a sagging supply and two dead bands, and no effect in the sensors.
    assert!(
        of("geared_error_360_deg") <= 1.0 && of("small_error_360_deg") <= 1.0 && of("linear_error_85_mm") <= 0.2,
        "{run}"
    );
    assert!(["small", "geared", "linear"].iter().all(|motor| of(&format!("{motor}_limit_cycles")) == 0.0), "{run}");
}

/// Returns the metrics of a trial with seed 2, on the real image and on the simulated board.
fn trials(system: &str, robot: &str) -> [impl Fn(&str) -> f64; 2] {
    ["emu", "sim"].map(|kind| {
        let board = format!("{kind}:{robot}");
        let trial = program::good_json(&["system", "run", system, "--seed", "2", "--board", &board, "--json"]);
        move |metric: &str| trial["values"][metric].as_f64().unwrap_or_else(|| panic!("{metric} in {trial}"))
    })
}

/// CLOOP on the real image, with the board's force loop, its load cell and its distance sensor on the emulated bus.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn a_vial_is_carried_on_an_emulated_board() {
    let [emulated, _] = trials("cloop", "cable-loop");
    assert_eq!([emulated("failed"), emulated("reported")], [0.0, 1.0]);
    // Target of its study.
    assert!(emulated("diameter_error_m") <= 5e-4, "{} m", emulated("diameter_error_m"));
    // Band in which the board's loop rests, 0.05 N, a step of the zero that the host sends, 0.02 N, and three times the
    // noise of 20 mN.
    assert!(emulated("squeeze_error_n") <= 0.13, "{} N", emulated("squeeze_error_n"));
}

/// INHAND on the real image reaches the targets of its study for one object.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn an_object_is_measured_between_fingers_on_an_emulated_board() {
    let [emulated, _] = trials("inhand", "two-finger-gripper");
    assert_eq!(emulated("held"), 1.0);
    assert!(emulated("size_error_m") <= 0.3e-3, "{} m", emulated("size_error_m"));
    assert!(emulated("contact_error_m") <= 1e-3, "{} m", emulated("contact_error_m"));
}

/// BERRY on the real image makes as many attempts as on the simulated board, drops none, and takes the same time.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn berries_are_picked_on_an_emulated_board() {
    let [emulated, simulated] = trials("berry", "berry-picker");
    assert_eq!([emulated("dropped"), emulated("missed"), emulated("crushed")], [0.0; 3]);
    assert_eq!(emulated("attempts"), simulated("attempts"));
    // Samples of the pressure and of the axes have another phase in their 2 and 5 ms, in each of a berry's two moves.
    let [emulated, simulated] = [emulated("cycle_s"), simulated("cycle_s")];
    assert!(emulated <= 1.0 && (emulated - simulated).abs() <= 0.02, "{emulated} s, {simulated} s");
}

/// XRHMI on the real image shows every cue, within 20 ms of the echo that ended a dwell.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn cues_are_in_time_on_an_emulated_board() {
    let [emulated, simulated] = trials("xrhmi", "cue-desk");
    assert_eq!([emulated("cues_shown"), emulated("cues_measured"), emulated("mistakes_missed")], [1.0, 42.0, 0.0]);
    assert!(emulated("cue_latency_p99_s") <= 0.020, "{} s", emulated("cue_latency_p99_s"));
    // The board polls an echo every millisecond and sends every second one: phases differ, and so does the link's speed.
    let apart_s = emulated("cue_latency_s") - simulated("cue_latency_s");
    assert!(apart_s.abs() < 0.005, "{apart_s} s");
}

/// SUCTION on the real image detaches without a burst, at the simulated board's pressure.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn a_cup_is_detached_on_an_emulated_board() {
    let [emulated, simulated] = trials("suction", "suction-pad");
    assert_eq!([emulated("detached"), emulated("burst")], [1.0, 0.0]);
    // The pressure rises by 3 kPa/s while a syringe moves, and samples have another phase in their 5 ms, at the start
    // and at the stop.
    let [emulated, simulated] = [emulated("peak_pressure_pa"), simulated("peak_pressure_pa")];
    assert!(emulated <= 20e3 && (emulated - simulated).abs() <= 60.0, "{emulated} Pa, {simulated} Pa");
}

/// WHISKER on the real image passes boxes of every load; the emulated converter reads its whiskers.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn boxes_are_passed_on_an_emulated_board() {
    let [emulated, simulated] = trials("whisker", "deformobot");
    for load in ["light", "moderate", "heavy"] {
        assert_eq!(emulated(&format!("passed_{load}")), 1.0, "{load}");
        // Readings of the whiskers have another phase in the program's 10 ms: a sample may be known one period of 200
        // ms later, in which the robot goes 37 mm.
        let way = format!("way_{load}_m");
        let [emulated, simulated] = [emulated(&way), simulated(&way)];
        assert!((emulated - simulated).abs() < 0.037, "{load}: {emulated} m, {simulated} m");
    }
}

/// Reads the log over a link: served on a pseudo-terminal, decoded by the ELF that is found by the robot's name.
#[test]
#[cfg_attr(not(feature = "emu"), ignore = "emulated boards are in programs built with --features emu")]
fn the_log_is_read_over_a_link() {
    let mut server = start(program::command(&["sim", "serve", "emu:osmc-bench", "--pty"]));
    let first = next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line");
    let board = format!("serial:{}", text(&object(&first), "pty"));
    server.out = None;
    let r4 = |arguments: &[&str], elf: Option<&str>| {
        let mut command = program::command(&[&["--board", &board, "--log"], arguments].concat());
        command.env_remove("R4_ELF").envs(elf.map(|elf| ("R4_ELF", elf)));
        start(command)
    };
    // Reading the file takes longer than the board waits for its host, and must not hold up heartbeats.
    let seen = r4(&["arm", "--for", "0.3"], None).finish();
    assert!(seen.code == Some(0) && seen.err.contains("tasks run") && !seen.err.contains("trip"), "{seen:?}");
    let mut watching = r4(&["watch", "osmc0"], None);
    watching.out = None;
    let mut told = Vec::new();
    while !told.last().is_some_and(|line: &String| line.contains("tasks run")) {
        told.push(next(&watching.err, watching.begin).unwrap_or_else(|| panic!("it goes on: {told:?}")));
    }
    // The source is printed first, then all records from the first on.
    assert!(told[0].contains("osmc-bench-bare.elf, SHA-256"), "{told:?}");
    assert!(told[1].contains("INFO") && told[1].contains("R4 ") && told[1].ends_with("image bare"), "{told:?}");
    // A chip as delivered has no brown-out reset, of which the image warns.
    let expected = |line: &String| line.contains(" s  INFO ") || line.contains("no brown-out reset");
    assert!(told[1..].iter().all(expected), "{told:?}");
    drop(watching);

    // The ELF of one image must not decode the log of another.
    let hosted = Image::built("osmc-bench", Place::Hosted).expect("built beside the other");
    let seen = r4(&["arm"], Some(hosted.path().to_str().expect("a name in Unicode"))).finish();
    assert!(seen.code == Some(1) && seen.out.is_empty(), "{seen:?}");
    assert!(seen.err.contains("another image than") && seen.err.contains("R4_ELF"), "{}", seen.err);
}
