//! Tests of boards with other physics than their files say: chosen by `--plant`, hidden by `--blind`.

use std::fs;

use crate::program::*;
use tempfile::TempDir;

const ROTARY: &str = include_str!("../boards/plants/osmc-bench-rotary.toml");
const ACTUATOR: &str = include_str!("../boards/plants/osmc-bench-actuator.toml");

/// Seed that hides an effect of friction from the motor, which reaches its position all the same.
const SEED: &str = "7";

fn folder() -> TempDir {
    TempDir::new().expect("a temporary folder")
}

/// Records a move with these additional arguments. Returns its table, and the log's information without the time of
/// recording.
fn log_of_a_move(folder: &TempDir, name: &str, more: &[&str]) -> (String, String) {
    let file = folder.path().join(name);
    let moved = good_json(&[&["move", "osmc0", "90deg", "--json", "--record", path(&file)], more].concat());
    assert!(moved.is_object());
    let table = good(&["log", "export", path(&file), "--csv", "-"]);
    let info = good(&["log", "info", path(&file)]);
    (table, info.lines().filter(|line| !line.contains("recorded")).map(|line| line.replace(name, "")).collect())
}

#[test]
fn a_blind_board_moves_by_its_seed_and_nothing_it_says_tells_what_it_has() {
    let folder = folder();
    let revealed = good_json(&["sim", "reveal", SEED, "--json"]);
    let channels = array(&revealed, "channels");
    assert_eq!((text(&revealed, "robot"), text(&channels[0], "channel")), ("osmc-bench", "osmc0"));
    let hidden = &array(&channels[0], "effects")[0];
    let (name, depends_on) = (text(hidden, "name"), array(hidden, "depends_on"));
    assert!(!depends_on.is_empty() && hidden["parameters"].as_object().is_some_and(|numbers| !numbers.is_empty()));
    assert!(good(&["sim", "reveal", SEED, "--robot", "osmc-bench"]).contains(name));

    let plain = log_of_a_move(&folder, "plain.mcap", &[]);
    let blind = log_of_a_move(&folder, "blind.mcap", &["--blind", SEED]);
    assert!(blind == log_of_a_move(&folder, "again.mcap", &["--blind", SEED]), "the same seed is not the same board");
    assert!(blind != plain, "{name} does nothing");
    assert!(![&blind.0, &blind.1].iter().any(|told| told.contains(name) || told.contains("blind")), "{}", blind.1);
    for question in [&["info", "--json"][..], &["config", "show", "--json"], &["config", "export", "-"]] {
        let [told, usual] = [r4(&[question, &["--blind", SEED]].concat()), r4(question)];
        assert_eq!((told.code, told.out, told.err), (usual.code, usual.out, usual.err), "{question:?}");
    }
    // The log of the blind board is replayed to the last bit on that board, and not on the board of the file.
    let log = folder.path().join("blind.mcap");
    let replayed = good_json(&["log", "replay", path(&log), "--json", "--exact", "--blind", SEED]);
    assert_eq!(replayed["identical"], true);
    let replayed = good_json(&["log", "replay", path(&log), "--json"]);
    assert_eq!(replayed["identical"], false);
}

#[test]
fn a_robot_with_a_body_has_something_hidden_in_that_or_in_its_motors() {
    let reveal = |seed: &str| good_json(&["sim", "reveal", seed, "--robot", "openscout", "--json"]);
    let seeds: Vec<String> = (0..12).map(|seed| seed.to_string()).collect();
    let seed = seeds.iter().find(|seed| !reveal(seed)["body"].is_null()).expect("a seed that hides in the body");
    let revealed = reveal(seed);
    assert_eq!(array(&revealed, "channels").len(), 0, "{revealed:#}");
    let hidden = &array(&revealed, "body")[0];
    assert!(hidden["parameters"].as_object().is_some_and(|numbers| !numbers.is_empty()), "{revealed:#}");
    let rows = good(&["sim", "reveal", seed, "--robot", "openscout"]);
    assert!(rows.contains("body") && rows.contains(text(hidden, "name")), "{rows}");
    let of_motors = seeds.iter().map(|seed| reveal(seed)).find(|revealed| revealed["body"].is_null());
    assert_eq!(of_motors.map(|revealed| array(&revealed, "channels").len()), Some(4));

    // The robot moves differently, and prints nothing of it.
    let folder = folder();
    let moved = |name: &str, more: &[&str]| {
        let file = folder.path().join(name);
        let drive = ["--board", "sim:openscout", "--record", path(&file), "move", "dhb0", "90deg", "--json"];
        good_json(&[&drive[..], more].concat());
        good(&["log", "export", path(&file), "--csv", "-"])
    };
    let (plain, blind) = (moved("plain.mcap", &[]), moved("blind.mcap", &["--blind", seed]));
    assert!(plain != blind && blind == moved("again.mcap", &["--blind", seed]));
    // On a stand the body is gone, and the effect hidden in it as well: the motors have none.
    let stand = ["--world", "stand"];
    let lifted = moved("stand.mcap", &stand);
    assert_eq!(lifted, moved("lifted.mcap", &[&stand[..], &["--blind", seed]].concat()));
}

#[test]
fn a_run_is_replayed_on_the_plant_that_is_named() {
    let folder = folder();
    let plant = folder.path().join("plant.toml");
    // A shape that no effect has: 0.3 N m of the motor's 4.9.
    let curve =
        "[[effects]]\neffect = \"table\"\nover = \"position\"\nat = [0.0, 0.5, 1.0]\nvalues = [0.0, -0.3, 0.3]\n";
    fs::write(&plant, format!("{ROTARY}\n{curve}")).expect("the folder can be written to");
    let other = format!("osmc0={}", path(&plant));
    log_of_a_move(&folder, "other.mcap", &["--plant", &other]);
    let log = folder.path().join("other.mcap");
    let replayed = good_json(&["log", "replay", path(&log), "--json", "--exact", "--plant", &other]);
    assert_eq!(replayed["identical"], true);
    let far = good_json(&["log", "replay", path(&log), "--json"]);
    assert_eq!(far["identical"], false);
    let rms = |report: &serde_json::Value| {
        let rows = array(report, "signals");
        let row = rows.iter().find(|row| row["signal"] == "osmc0.position_rad").expect("the motor was recorded");
        number(row, "rms")
    };
    assert!(rms(&far) > 1e-3 && rms(&replayed) == 0.0, "{far}");
}

#[test]
fn what_cannot_be_had_is_refused() {
    let folder = folder();
    let write = |name: &str, text: &str| {
        let file = folder.path().join(name);
        fs::write(&file, text).expect("the folder can be written to");
        path(&file).to_owned()
    };
    let rod = format!("osmc0={}", write("rod.toml", ACTUATOR));
    let bad = format!("osmc0={}", write("bad.toml", &ROTARY.replace("gear_ratio = 25.0", "gear_ratio = 0.0")));
    let nowhere = format!("osmc0={}", path(&folder.path().join("none.toml")));
    let wheel = write("wheel.toml", ROTARY);
    let [other, good] = ["dhb7", "osmc0"].map(|channel| format!("{channel}={wheel}"));
    let link = "tcp:127.0.0.1:1";
    all_refused([
        (&["info", "--board", link, "--blind", "1"][..], &["--blind", "simulated", link][..]),
        (&["info", "--board", link, "--plant", &good], &["--plant", "simulated", link]),
        (&["sim", "reveal", "1", "--board", link], &[link, "simulated"]),
        (&["sim", "reveal", "first"], &["first"]),
        (&["info", "--blind=-1"], &["--blind"]),
        (&["info", "--plant", "osmc0"], &["osmc0=plant.toml"]),
        (&["info", "--plant", &rod], &["osmc0 is a rotary plant", "linear"]),
        (&["info", "--plant", &bad], &["bad.toml", "gear_ratio: 0 is outside"]),
        (&["info", "--plant", &nowhere], &["cannot read the plant", "none.toml"]),
        (&["info", "--plant", &other], &["no simulated motor dhb7", "osmc0, actuator1"]),
        (&["info", "--plant", &good, "--plant", &good], &["osmc0 two plants"]),
    ]);
    let ports = r4(&["ports", "--blind", "1"]);
    assert!(ports.code == Some(1) && ports.err.contains("had no effect"), "{ports:?}");
}
