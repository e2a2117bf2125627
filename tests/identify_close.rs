//! Tests of `r4 identify close` and `check`: from a board to a plant file that makes the simulated board more like it.

use std::fs;

use crate::program::*;
use tempfile::TempDir;

const ROTARY: &str = include_str!("../boards/plants/osmc-bench-rotary.toml");

/// Seed that hides effects of the catalogue from the motor which show in a short run.
const SEED: &str = "2";

fn folder() -> TempDir {
    TempDir::new().expect("a temporary folder")
}

#[test]
fn a_simulated_board_is_as_far_from_a_recording_as_its_plant_is() {
    let folder = folder();
    let file = |name: &str| folder.path().join(name);
    fs::write(file("rubs.toml"), format!("{ROTARY}\n[[effects]]\neffect = \"coulomb-friction\"\ntorque_nm = 0.5\n"))
        .expect("the folder can be written to");
    let [rubs, log] = [file("rubs.toml"), file("rubs.mcap")];
    let has = format!("osmc0={}", path(&rubs));
    good(&["duty", "osmc0", "80%", "--for", "1", "--plant", &has, "--record", path(&log)]);
    let check =
        |more: &[&str]| good_json(&[&["identify", "check", path(&log), "--channel", "osmc0", "--json"], more].concat());
    let told = check(&["--plant-after", path(&rubs)]);
    // The same plant, controller and noise give the same run to the last bit.
    let errors = |told: &serde_json::Value, when: &str| {
        let of = |difference: &serde_json::Value| number(difference, when);
        array(told, "differences").iter().map(of).collect::<Vec<_>>()
    };
    assert_eq!(errors(&told, "rmse_after"), [0.0, 0.0]);
    // Position in rad, speed in rad/s.
    let before = errors(&told, "rmse_before");
    assert!(before[0] > 0.01 && before[1] > 0.05, "{told}");
    let turned = file("own.toml");
    fs::write(&turned, ROTARY).expect("the folder can be written to");
    let args = ["identify", "check", path(&log), "--channel", "osmc0", "--json"];
    let worse = r4(&[&args[..], &["--plant-before", path(&rubs), "--plant-after", path(&turned)]].concat());
    assert!(worse.code == Some(1) && worse.err.contains("farther from the recording"), "{worse:?}");
    let worse = object(&worse.out);
    assert_eq!((errors(&worse, "rmse_before"), errors(&worse, "rmse_after")), (errors(&told, "rmse_after"), before));
}

#[test]
fn what_cannot_be_excited_or_compared_is_refused() {
    let folder = folder();
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    let (log, own, rod) = (file("run.mcap"), file("own.toml"), file("rod.toml"));
    fs::write(&own, ROTARY).expect("the folder can be written to");
    fs::write(&rod, include_str!("../boards/plants/osmc-bench-actuator.toml")).expect("the folder can be written to");
    good(&["duty", "osmc0", "50%", "--for", "0.1", "--record", &log]);
    let out = file("out");
    all_refused([
        (
            &["identify", "check", &log, "--channel", "osmc7", "--plant-after", &own][..],
            &["no samples", "it has osmc0"][..],
        ),
        (&["identify", "check", &log, "--channel", "osmc0", "--plant-after", &rod], &["linear"]),
        (&["identify", "check", &own, "--channel", "osmc0", "--plant-after", &own], &["not an MCAP file"]),
        (&["identify", "check", &log, "--channel", "osmc0", "--plant-after", &own, "--blind", "1"], &["--blind"]),
        (
            &["identify", "check", &log, "--channel", "osmc0", "--plant-after", &own, "--board", "tcp:127.0.0.1:1"],
            &["simulated"],
        ),
        (&["identify", "close", "--out", &out, "--channel", "osmc7"], &["no simulated motor osmc7"]),
        (&["identify", "close", "--out", &out, "--channel", "osmc0", "--duty", "0.95"], &["up to 0.902"]),
        (&["identify", "close", "--out", &out, "--channel", "osmc0", "--duty", "0.3"], &["friction"]),
        (&["identify", "close", "--out", &out, "--channel", "osmc0", "--for", "1"], &["--for"]),
        (&["identify", "close", "--out", &out, "--channel", "osmc0", "--plant-before", &log], &["run.mcap"]),
    ]);
}

#[test]
fn a_body_found_from_a_gyroscope_makes_the_simulated_board_turn_like_a_blind_one() {
    let folder = folder();
    let file = |name: &str| path(&folder.path().join(name)).to_owned();
    let legs = |run| format!("{}/../../docs/identify/legs-{run}.toml", env!("CARGO_MANIFEST_DIR"));
    let logs = [1, 2].map(|run| {
        let log = file(&format!("legs-{run}.mcap"));
        // Seed 21 hides tyres that are 0.316 times as compliant across, which is 1.264 times that along.
        good(&["scenario", &legs(run), "--blind", "21", "--record", &log]);
        log
    });
    let out = file("legs");
    let board = ["--board", "sim:openscout", "--json"];
    let columns = ["--map", "left=dhb0.speed_rad_s", "right=dhb1.speed_rad_s", "gyro=imu0.rate_z_rad_s"];
    let known = ["--param", "wheel_radius_m=0.056", "track_m=0.302", "--model", "skid-steer", "--out", &out];
    let found = r4(&[&["identify", &logs[0], "--holdout", &logs[1]], &columns[..], &known, &board].concat());
    // Effects of drives and sensors belong in no body file.
    assert!(found.code == Some(0) && found.err.contains("sensor-offset was found and is not in the body"), "{found:?}");
    let body = file("legs/body.toml");
    let check = ["identify", "check", &logs[1], "--body-after", &body];
    let told = good_json(&[&check[..], &["--signal", "imu0.rate_z_rad_s"], &board].concat());
    let turning = &array(&told, "differences")[0];
    // Measured: 0.200 and 0.0005 rad/s. The seed is the same, and with it the noise of the chip.
    let errors = ["rmse_before", "rmse_after"].map(|when| number(turning, when));
    assert!(errors[0] > 0.1 && errors[1] < 0.002, "{told}");
    all_refused([
        (
            &[&check[..], &["--signal", "imu0.rate_w", "--board", "sim:openscout"]].concat()[..],
            &["imu0.rate_z_rad_s"][..],
        ),
        (&[&check[..], &["--channel", "dhb0"]].concat()[..], &["--plant-after"]),
        (&["identify", "check", &logs[1], "--signal", "imu0.rate_z_rad_s"], &["--body-after"]),
    ]);
}

#[test]
fn the_simulated_board_becomes_like_a_blind_one() {
    let folder = folder();
    let out = folder.path().join("out");
    let close =
        ["identify", "close", "--channel", "osmc0", "--blind", SEED, "--for", "6", "--out", path(&out), "--json"];
    let closed = r4(&close);
    assert_eq!(closed.code, Some(0), "{closed:?}");
    let closed = object(&closed.out);
    for name in ["train-1.mcap", "train-2.mcap", "fresh.mcap", "report.json", "report.html", "plant.toml"] {
        assert!(out.join(name).is_file(), "{name}");
    }
    let position = &array(&closed["twin"], "differences")[0];
    assert!(number(position, "rmse_after") < 0.5 * number(position, "rmse_before"), "{}", closed["twin"]);
    let revealed = good_json(&["sim", "reveal", SEED, "--json"]);
    let hidden = text(&array(&array(&revealed, "channels")[0], "effects")[0], "name");
    let found = array(&closed, "effects");
    let names = |effect: &serde_json::Value| {
        let rivals = array(effect, "rivals").iter().map(|rival| text(rival, "name").to_owned());
        rivals.chain([text(effect, "name").to_owned()]).collect::<Vec<_>>()
    };
    assert!(found.iter().any(|effect| names(effect).iter().any(|name| name == hidden)), "{hidden}: {found:?}");
    // A board can load the plant file.
    let plant = format!("osmc0={}", path(&out.join("plant.toml")));
    good(&["info", "--plant", &plant]);
}
