//! Tests of `r4` as a user runs it, on the program itself.

use std::{
    fmt::Write as _,
    fs,
    path::PathBuf,
    process::{Command, Stdio},
    time::Instant,
};

use crate::program::*;
use r4_log::Log;
use serde_json::Value;
use sha2::{Digest, Sha256};
use tempfile::TempDir;

/// Largest error that the demo promises, and that a move may have here.
const WITHIN_DEG: f64 = 1.0;
const WITHIN_MM: f64 = 0.2;

// The files of osmc-bench are copied to a folder, where a test changes them: a robot of the user's own.

const ROBOT: &str = include_str!("../boards/osmc-bench.toml");
const ACTUATOR: &str = include_str!("../boards/plants/osmc-bench-actuator.toml");

struct Own {
    folder: TempDir,
    robot: String,
}

impl Own {
    fn new(robot: &str, actuator: &str) -> Self {
        let folder = TempDir::new().expect("a temporary folder");
        fs::create_dir(folder.path().join("plants")).unwrap_or_else(|why| panic!("{why}"));
        for (name, text) in [("robot.toml", robot), ("plants/osmc-bench-actuator.toml", actuator)] {
            fs::write(folder.path().join(name), text).unwrap_or_else(|why| panic!("{name}: {why}"));
        }
        let robot = format!("sim:{}", path(&folder.path().join("robot.toml")));
        Self { folder, robot }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

/// Replaces the first line after `section` that sets `key` in `file`, and returns the number of that line, too.
///
/// The line is found by name and not by value, so that no test depends on the tuning of the bench.
fn edited(file: &str, section: &str, key: &str, line: &str) -> (String, usize) {
    let section = file.lines().position(|line| line.starts_with(section)).expect("the section is there");
    let sets = |line: &&str| line.split_once('=').is_some_and(|(name, _)| name.trim() == key);
    let index = section + file.lines().skip(section).position(|line| sets(&line)).expect("the key is there");
    let lines = file.lines().enumerate().map(|(at, old)| if at == index { line } else { old });
    (lines.fold(String::new(), |all, line| all + line + "\n"), index + 1)
}

/// Makes an actuator whose screw nothing on this bench can move.
fn stuck() -> String {
    edited(ACTUATOR, "[[effects]]", "force_n", "force_n = 1e6").0
}

// r4 demo

/// Channel, set point, the paper's result and unit: Alabi, Camara, Fox, TAROS 2023, Tables 1 and 2.
const PAPER: [(&str, f64, f64, &str); 9] = [
    ("osmc0", 90.0, 91.0, "deg"),
    ("osmc0", 180.0, 182.0, "deg"),
    ("osmc0", 270.0, 272.0, "deg"),
    ("osmc0", 360.0, 363.0, "deg"),
    ("actuator1", 10.0, 7.0, "mm"),
    ("actuator1", 25.0, 23.0, "mm"),
    ("actuator1", 40.0, 39.0, "mm"),
    ("actuator1", 70.0, 68.0, "mm"),
    ("actuator1", 85.0, 83.0, "mm"),
];

#[test]
fn demo_json_reports_every_set_point_within_its_promise() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("new/folder");
    let report = good_json(&["demo", "--out", path(&out), "--json"]);
    assert_eq!(text(&report, "board"), "sim:osmc-bench");
    let rows = array(&report, "rows");
    assert_eq!(rows.len(), PAPER.len());
    let mut settling_s = 0.0;
    for (row, (channel, set, paper, unit)) in rows.iter().zip(PAPER) {
        assert_eq!((text(row, "channel"), text(row, "unit")), (channel, unit));
        assert_eq!((number(row, "set"), number(row, "paper"), number(row, "error_paper")), (set, paper, paper - set));
        let within = if unit == "deg" { WITHIN_DEG } else { WITHIN_MM };
        let (ours, error) = (number(row, "ours"), number(row, "error_ours"));
        assert!((ours - set - error).abs() < 1e-9 && error.abs() <= within, "{row}");
        assert!(number(row, "settling_s") > 0.0, "{row}");
        settling_s += number(row, "settling_s");
    }
    assert!(number(&report, "simulated_s") > settling_s, "{report}");
    assert!(number(&report, "real_time_factor") > 1.0, "{report}");

    let table = good(&["log", "export", path(&out.join("log.mcap")), "--csv", "-"]);
    let sha256 = Sha256::digest(&table).iter().fold(String::new(), |mut hex, byte| {
        let _ = write!(hex, "{byte:02x}");
        hex
    });
    assert_eq!(text(&report, "table_sha256"), sha256);
    assert!(out.join("report.html").is_file());
}

#[test]
fn demo_logs_what_it_reports() {
    let folder = TempDir::new().unwrap();
    let report = good_json(&["demo", "--out", path(folder.path()), "--json"]);
    let log = Log::read(folder.path().join("log.mcap")).unwrap();
    assert!(log.warnings.is_empty(), "{:?}", log.warnings);
    assert_eq!((log.header.robot.as_str(), log.header.board.as_str()), ("osmc-bench", "sim:osmc-bench"));
    let per_si = |unit: &str| if unit == "deg" { 1f64.to_degrees() } else { 1e3 };
    assert_eq!(log.commands.len(), PAPER.len());
    for (command, (channel, set, _, unit)) in log.commands.iter().zip(PAPER) {
        assert_eq!(command.channel.to_string(), channel);
        // Set points travel as 32-bit floats, with 24 bits for 360.
        assert!((command.setpoint.value * per_si(unit) - set).abs() < 360.0 / f64::from(1 << 23), "{command:?}");
    }
    for index in [3, 8] {
        let row = &array(&report, "rows")[index];
        let motor = log.motor(text(row, "channel").parse().unwrap()).unwrap();
        let last = motor.samples.last().unwrap().position * per_si(text(row, "unit"));
        // The last reading of the sensor is where the output rests, but for an encoder count (0.15 deg) or the
        // converter's noise (5 codes of 1.6 um).
        assert!((last - number(row, "ours")).abs() < 0.2, "{last}: {row}");
    }
}

#[test]
fn demo_report_is_self_contained() {
    let folder = TempDir::new().unwrap();
    good(&["demo", "--out", path(folder.path())]);
    let page = fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(
        page.to_lowercase().starts_with("<!doctype html>")
            && page.contains("<svg")
            && page.trim_end().ends_with("</html>")
    );
    // The namespace of SVG only looks like an address; nothing loads it.
    let page = page.replace("http://www.w3.org/2000/svg", "");
    for outside in ["http:", "https:", "<link", "<img", "<iframe", "src=", "@import", "url(h", "url(/", "fetch("] {
        assert!(!page.contains(outside), "{outside}");
    }
    for (channel, ..) in PAPER {
        assert!(page.contains(channel), "{channel}");
    }
}

#[test]
fn demo_is_the_same_for_a_seed_and_another_for_another() {
    let folder = TempDir::new().unwrap();
    let run = |name: &str, seed: &str| {
        let out = folder.path().join(name);
        let mut report = good_json(&["demo", "--seed", seed, "--out", path(&out), "--json"]);
        // The speed of the machine and the paths of the files may differ.
        for field in ["real_time_factor", "log", "report"] {
            report.as_object_mut().unwrap().remove(field);
        }
        // The rest of the log has the date and the command line of the recording.
        let table = good(&["log", "export", path(&out.join("log.mcap")), "--csv", "-"]);
        let page = fs::read_to_string(out.join("report.html")).unwrap();
        let is_about_the_run =
            |line: &&str| !["<title>", "<dt>Recorded", "<dt>Command"].iter().any(|of| line.contains(of));
        (report, table, page.lines().filter(is_about_the_run).collect::<Vec<_>>().join("\n"))
    };
    let (first, again, other) = (run("first", "7"), run("again", "7"), run("other", "8"));
    assert!(first == again, "{}\n{}", first.0, again.0);
    assert!(first.1 != other.1, "the noise does not depend on the seed");
}

#[test]
fn demo_prints_a_table_for_people() {
    let folder = TempDir::new().unwrap();
    let printed = good(&["demo", "--out", path(folder.path())]);
    for (channel, set, paper, unit) in PAPER {
        let words = [channel, &set.to_string(), unit, &paper.to_string(), "ok"];
        let has_all = |line: &str| words.iter().all(|word| line.split_whitespace().any(|of_line| of_line == *word));
        assert!(printed.lines().any(has_all), "no line with {words:?} in\n{printed}");
    }
    for word in ["x real time", "sha256", path(&folder.path().join("log.mcap")), "report.html"] {
        assert!(printed.contains(word), "no {word} in\n{printed}");
    }
}

#[test]
fn demo_measures_the_output_and_not_the_sensor() {
    // The rod is at 99 mm where the calibration has 100: sensor and controller agree, and both are wrong by 1 %.
    let high = "high = { code_10bit = 989.0, position_m = 0.099 }";
    let own = Own::new(&edited(ROBOT, "[simulation.linear.potentiometer]", "high", high).0, ACTUATOR);
    let seen = r4(&["--board", &own.robot, "demo", "--out", path(&own.path("out")), "--json"]);
    assert_eq!(seen.code, Some(1), "{seen:?}");
    assert!(seen.err.contains("not every set point"), "{seen:?}");
    for (row, (channel, set, ..)) in array(&object(&seen.out), "rows").iter().zip(PAPER).skip(4) {
        assert_eq!(text(row, "channel"), channel);
        assert!((number(row, "error_ours") + 0.01 * set).abs() <= WITHIN_MM, "{row}");
    }
}

#[test]
fn demo_tells_which_set_points_never_settled_and_keeps_the_log() {
    // A nanometre is below the converter's noise: the actuator arrives and is never at rest.
    let own = Own::new(&edited(ROBOT, "[actuator.settle]", "error_m", "error_m = 1e-9").0, ACTUATOR);
    let out = own.path("out");
    let seen = r4(&["--board", &own.robot, "demo", "--out", path(&out), "--json"]);
    assert_eq!(seen.code, Some(1), "{seen:?}");
    assert!(seen.err.contains("not every set point"), "{seen:?}");
    let report = object(&seen.out);
    for (row, (channel, ..)) in array(&report, "rows").iter().zip(PAPER) {
        assert_eq!(row["settling_s"].is_null(), channel == "actuator1", "{row}");
    }
    assert!(out.join("log.mcap").is_file() && out.join("report.html").is_file());
}

// r4 info

#[test]
fn info_describes_every_channel() {
    let report = good_json(&["info", "--json"]);
    assert_eq!(text(&report, "board"), "sim:osmc-bench");
    assert!(!text(&report, "firmware").is_empty());
    assert_eq!(report["protocol"], r4_protocol::VERSION);
    let channels: Vec<_> = array(&report, "channels")
        .iter()
        .map(|channel| {
            assert!(number(channel, "min") < number(channel, "max") && number(channel, "rate_hz") > 0.0, "{channel}");
            (text(channel, "id"), text(channel, "kind"), text(channel, "unit"))
        })
        .collect();
    let expected = [
        ("osmc0", "osmc", "rad"),
        ("actuator1", "actuator", "m"),
        ("relay0", "relay", "bool"),
        ("relay1", "relay", "bool"),
        ("supply0", "supply", "V"),
        ("supply1", "supply", "V"),
        ("dead-man0", "dead-man", "bool"),
    ];
    assert_eq!(channels, expected);

    let printed = good(&["info"]);
    for (id, ..) in expected {
        assert!(printed.contains(id), "{id} in\n{printed}");
    }
}

// r4 follow

#[test]
fn motors_follow_a_table_together() {
    let table = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../docs/paths/bench.csv");
    let followed = good_json(&["follow", path(&table), "--json"]);
    assert_eq!((followed["held"].as_bool(), followed["duration_s"].as_f64()), (Some(true), Some(4.0)));
    let rows = followed["rows"].as_array().expect("rows");
    // End of the table, and the tolerance of the bench for it. The gains of osmc0 leave it up to 5 degrees behind while
    // it moves.
    for (row, (channel, end, settle, worst)) in
        rows.iter().zip([("osmc0", 0.0, 0.004, 0.09), ("actuator1", 0.012, 0.000_1, 0.000_5)])
    {
        assert_eq!((row["channel"].as_str(), row["points"].as_u64()), (Some(channel), Some(81)));
        assert!((row["end"].as_f64().expect("a place") - end).abs() < 2.0 * settle, "{row}");
        assert!(row["worst"].as_f64().expect("a distance") < worst, "{row}");
    }
    assert!(good(&["follow", path(&table)]).contains("over 4.00 s, on sim:osmc-bench (simulated)"));
}

#[test]
fn a_table_that_cannot_be_followed_moves_nothing() {
    let folder = TempDir::new().expect("a temporary folder");
    let file = folder.path().join("path.csv");
    for (text, exit, said) in [
        ("time_s,osmc0.position_deg\n0,0\n1,1\n", 1, "unknown column `osmc0.position_deg`"),
        ("time_s,osmc0.position_rad\n0,0\n1,x\n", 1, "line 3: `x` is not a number"),
        ("time_s,servo0.position_rad\n0,0\n1,1\n", 3, "the board has no channel servo0"),
        ("time_s,relay1.position_rad\n0,0\n1,1\n", 3, "relay1 cannot follow a path"),
        ("time_s,osmc0.position_rad\n0,0\n0.1,1\n", 3, "give it more time"),
        ("time_s,osmc0.position_rad\n0,0\n20,70\n", 3, "osmc0 takes"),
    ] {
        fs::write(&file, text).unwrap_or_else(|why| panic!("{why}"));
        let refused = r4(&["follow", path(&file)]);
        assert!(refused.code == Some(exit) && refused.err.contains(said), "{text}: {refused:?}");
    }
    let missing = r4(&["follow", "nowhere.csv"]);
    assert!(missing.code == Some(1) && missing.err.contains("nowhere.csv"), "{missing:?}");
}

// r4 move, speed, duty

#[test]
fn a_motor_goes_where_it_is_sent() {
    for (channel, typed, set, within) in [
        ("osmc0", "90deg", 90f64.to_radians(), WITHIN_DEG.to_radians()),
        ("osmc0", "0.25turn", 90f64.to_radians(), WITHIN_DEG.to_radians()),
        ("actuator1", "25mm", 0.025, WITHIN_MM * 1e-3),
        ("actuator1", "0.04m", 0.04, WITHIN_MM * 1e-3),
    ] {
        let end = good_json(&["move", channel, typed, "--json"]);
        assert_eq!((text(&end, "channel"), text(&end, "mode"), &end["settled"]), (channel, "position", &true.into()));
        assert!((number(&end, "set") - set).abs() < 1e-9, "{typed}: {end}");
        assert!((number(&end, "position") - set).abs() <= within, "{typed}: {end}");
    }
    let printed = good(&["move", "actuator1", "25mm"]);
    assert!(printed.starts_with("actuator1 rests at ") && printed.contains("25.00 mm"), "{printed}");
}

#[test]
fn speed_and_duty_are_held_for_a_time() {
    let end = good_json(&["speed", "osmc0", "1rad/s", "--for", "3", "--json"]);
    assert_eq!((text(&end, "mode"), text(&end, "unit")), ("speed", "rad/s"));
    // The accuracy of a speed is tested with the firmware. Here it must be this speed for this time.
    assert!((number(&end, "speed") - 1.0).abs() < 0.2, "{end}");
    assert!((number(&end, "seconds") - 3.0).abs() < 0.1, "{end}");

    let end = good_json(&["duty", "osmc0", "80%", "--json"]);
    assert_eq!((text(&end, "mode"), text(&end, "unit")), ("duty", "duty"));
    assert!((number(&end, "duty") - 0.8).abs() < 1e-6 && number(&end, "position") > 0.0, "{end}");
    assert!((number(&end, "seconds") - 2.0).abs() < 0.1, "the default: {end}");

    for args in [["speed", "actuator1", "5mm/s"], ["duty", "actuator1", "0.5"]] {
        let printed = good(&args);
        assert!(printed.starts_with("actuator1 at ") && printed.contains("now stopped"), "{printed}");
    }
}

#[test]
fn a_negative_value_is_typed_like_any_other() {
    for args in [["move", "osmc0", "-90deg", "--json"], ["move", "osmc0", "--json", "-90deg"]] {
        let end = good_json(&args);
        assert!((number(&end, "position").to_degrees() + 90.0).abs() <= WITHIN_DEG, "{end}");
    }
    let end = good_json(&["speed", "osmc0", "-1rad/s", "--json"]);
    assert!(number(&end, "speed") < 0.0, "{end}");
    for typed in ["-60%", "-0.6"] {
        let end = good_json(&["duty", "osmc0", typed, "--json"]);
        assert!((number(&end, "duty") + 0.6).abs() < 1e-6, "{end}");
    }
    all_refused([
        (&["move", "actuator1", "-5mm"][..], &["actuator1", " to "][..]),
        (&["arm", "--for", "-1", "--pace", "max"], &["--for", "above 0"]),
        (&["watch", "--for", "-1", "--pace", "max"], &["--for", "above 0"]),
        (&["arm", "--pace", "-1", "--for", "1"], &["--pace", "0.01"]),
    ]);
}

#[test]
fn a_motor_that_cannot_move_is_an_error_in_bounded_time() {
    let own = Own::new(ROBOT, &stuck());
    all_refused([
        (&["--board", &own.robot, "move", "actuator1", "25mm"][..], &["stalled", "free the mechanism"][..]),
        (&["--board", &own.robot, "move", "actuator1", "25mm", "--json"], &["stalled"]),
    ]);
    let seen = r4(&["--board", &own.robot, "demo", "--out", path(&own.path("out")), "--json"]);
    assert!(seen.code == Some(1) && seen.err.contains("stalled"), "{seen:?}");
}

#[test]
fn a_motor_that_does_not_arrive_is_an_error_after_the_time_allowed() {
    // Stuck: the limits are raised so that neither a stall nor an overload is detected within the 30 s of a move.
    let robot = edited(ROBOT, "[actuator.stall]", "time_ms", "time_ms = 60000").0;
    let robot = edited(&robot, "[actuator.winding]", "rated_a", "rated_a = 1000.0").0;
    let own = Own::new(&edited(&robot, "[actuator.follow]", "error_m", "error_m = 1.0").0, &stuck());
    all_refused([
        (&["--board", &own.robot, "move", "actuator1", "25mm"][..], &["actuator1", "not settled", "30.0 s"][..]),
        (&["move", "actuator1", "25mm", "--for", "0.5"], &["actuator1", "not settled", "0.5 s"]),
    ]);
}

/// Holds a motor at 1.5 A with a rated current of 1.2 A: its winding is hot after 8.4 s, and would trip after 18.
#[test]
fn a_hot_winding_is_told_once() {
    let robot = edited(ROBOT, "[actuator.stall]", "time_ms", "time_ms = 60000").0;
    let robot = edited(&robot, "[actuator.winding]", "rated_a", "rated_a = 1.2").0;
    let own = Own::new(&robot, &stuck());
    let seen = r4(&["--board", &own.robot, "duty", "actuator1", "40%", "--for", "10"]);
    assert_eq!((seen.code, seen.err.matches("warning: actuator1 winding 90 %").count()), (Some(0), 1), "{seen:?}");
    assert_eq!(seen.err.matches("winding").count(), 1, "{seen:?}");
    let cool = r4(&["duty", "actuator1", "40%", "--for", "1"]);
    assert!(!cool.err.contains("winding"), "{cool:?}");
}

#[test]
fn what_was_not_held_is_not_success() {
    for (args, says) in [
        // Faster than the motor at its highest duty; at the end of the stroke, where the drive is cut and stays so.
        (&["speed", "osmc0", "200deg/s"][..], "did not hold speed 200.0 deg/s"),
        (&["duty", "actuator1", "60%", "--for", "20"], "it was at 100.0"),
        (&["duty", "actuator1", "60%", "--for", "20.3"], "it was at 100.0"),
        (&["speed", "actuator1", "10mm/s", "--for", "20"], "did not hold speed"),
        // So slow that friction holds the motor.
        (&["speed", "osmc0", "0.5deg/s", "--for", "1"], "did not hold speed"),
    ] {
        let seen = r4(args);
        assert!(seen.code == Some(1) && seen.err.contains(says), "{args:?} should say {says}: {seen:?}");
        let json = r4(&[args, &["--json"][..]].concat());
        assert_eq!(object(&json.out)["held"], false, "{json:?}");
    }
}

#[test]
fn a_relay_is_switched_and_told_of() {
    for (state, closed) in [("on", true), ("off", false)] {
        let outcome = good_json(&["relay", "relay1", state, "--json"]);
        assert_eq!((text(&outcome, "channel"), &outcome["closed"]), ("relay1", &closed.into()));
    }
    assert_eq!(
        good(&["relay", "relay1", "on", "--for", "1"]),
        "relay1 was closed for 1 s, on sim:osmc-bench (simulated); now open\n"
    );
    all_refused([
        // The board itself switches the motors' supply.
        (&["relay", "relay0", "on"][..], &["relay0", "cannot be switched"][..]),
        (&["relay", "relay7", "on"], &["relay7", "`r4 info`"]),
        (&["relay", "osmc0", "on"], &["osmc0", "cannot be switched"]),
        (&["relay", "relay1", "half"], &["half", "on", "off"]),
    ]);
}

// r4 arm, disarm, clear, watch

#[test]
fn arm_for_a_time_then_disarm_and_clear() {
    let seen = r4(&["arm", "--for", "2", "--pace", "max", "--json"]);
    assert_eq!(seen.code, Some(0), "{seen:?}");
    let state = object(&seen.out);
    assert_eq!((text(&state, "board"), text(&state, "state")), ("sim:osmc-bench", "armed"));
    assert!(array(&state, "causes").is_empty());
    assert!(seen.err.contains("Ctrl-C disarms"), "{seen:?}");
    for verb in ["disarm", "clear"] {
        assert_eq!(text(&good_json(&[verb, "--json"]), "state"), "disarmed");
        assert_eq!(good(&[verb]), "sim:osmc-bench (simulated) is disarmed\n");
    }
}

#[test]
fn a_flat_battery_is_named_and_nothing_moves() {
    // The board trips below 20 V.
    let own = Own::new(&edited(ROBOT, "[[simulation.rail]]", "emf_v", "emf_v = 19.0").0, ACTUATOR);
    let board = ["--board", &own.robot];
    let with = |args: &[&'static str]| -> Vec<&str> { board.into_iter().chain(args.iter().copied()).collect() };
    let says = ["supply out of range", "battery"];
    for args in [&["arm", "--for", "1", "--pace", "max"][..], &["move", "osmc0", "90deg"], &["clear"]] {
        all_refused([(&with(args)[..], &says[..])]);
    }
    let state = good_json(&with(&["disarm", "--json"]));
    assert_eq!(text(&state, "state"), "tripped");
    assert_eq!(array(&state, "causes"), ["supply out of range"]);
}

#[test]
fn watch_prints_channels_as_they_change() {
    let printed = good(&["watch", "--for", "1", "--pace", "max", "--json"]);
    let lines: Vec<Value> = printed.lines().map(object).collect();
    let times: Vec<f64> = lines.iter().map(|line| number(line, "time_s")).collect();
    // Five a second, plus or minus one at the ends.
    assert!((4..=6).contains(&times.len()) && times.is_sorted_by(|a, b| a < b), "{times:?}");
    assert!(times.iter().all(|time_s| (0.0..=1.1).contains(time_s)), "{times:?}");
    for line in &lines {
        assert_eq!(text(line, "state"), "disarmed");
        let channels: Vec<_> = array(line, "channels").iter().map(|value| text(value, "channel")).collect();
        assert_eq!(channels, ["osmc0", "actuator1", "relay0", "relay1", "supply0", "supply1", "dead-man0"]);
    }
    let volts = number(&array(&lines[0], "channels")[4], "value");
    assert!((volts - 24.0).abs() < 0.5, "{volts}");

    let printed = good(&["watch", "supply0", "--rate", "50", "--for", "1", "--pace", "max"]);
    let (headers, values): (Vec<_>, Vec<_>) = printed.lines().partition(|line| line.contains("supply0 V"));
    // A header at the top and after every twenty lines, and only the channels that were asked for.
    assert!((49..=51).contains(&values.len()) && headers.len() == 3 && !printed.contains("osmc0"), "{printed}");
    assert!(values.iter().all(|line| line.contains("disarmed") && line.contains("24.0")), "{printed}");
}

#[cfg(unix)]
#[test]
fn ctrl_c_and_a_polite_kill_disarm() {
    for signal in ["-INT", "-TERM"] {
        let running = start(command(&["arm"]));
        let armed = std::iter::from_fn(|| next(&running.err, running.begin)).any(|line| line.contains("armed"));
        assert!(armed, "{:?}", running.finish());
        let pid = running.child.id().to_string();
        assert!(Command::new("kill").args([signal, &pid]).status().unwrap().success());
        let seen = running.finish();
        assert!(seen.code.is_some_and(|code| code != 0), "{signal}: {seen:?}");
        assert!(seen.err.contains("the board is disarmed"), "{signal}: {seen:?}");
    }
}

// Every kind of channel

const EVERY: [&str; 2] = ["--board", "sim:every-interface"];

fn every(args: &[&str]) -> Seen {
    r4(&[&EVERY, args].concat())
}

fn every_json(args: &[&str]) -> Value {
    good_json(&[&EVERY, args, &["--json"]].concat())
}

/// Expects refusals as [`all_refused`], on the board with every channel.
fn every_refused<'a>(cases: impl IntoIterator<Item = (&'a [&'a str], &'a [&'a str])>) {
    let complaints = cases.into_iter().filter_map(|(args, says)| complaint(&[&EVERY, args].concat(), says));
    let complaints: String = complaints.collect();
    assert!(complaints.is_empty(), "{complaints}");
}

#[test]
fn info_and_watch_know_every_kind_of_channel() {
    let info = every_json(&["info"]);
    let channels = array(&info, "channels");
    let of_kind = |kind: &str| channels.iter().filter(|channel| text(channel, "kind") == kind).collect::<Vec<_>>();
    for (kind, unit) in [
        ("osmc", "rad"),
        ("dhb", "duty"),
        ("bldc", "duty"),
        ("servo", "rad"),
        ("stepper", "rad"),
        ("relay", "bool"),
        ("encoder", "rad"),
        ("switch", "bool"),
        ("range", "m"),
        ("analog", "V"),
        ("supply", "V"),
        ("dac", "V"),
        ("dead-man", "bool"),
    ] {
        let channels = of_kind(kind);
        assert!(!channels.is_empty() && channels.iter().all(|channel| text(channel, "unit") == unit), "{kind}");
    }
    for channel in channels {
        let (min, max) = (number(channel, "min"), number(channel, "max"));
        assert!(min < max && min.is_finite() && max.is_finite() && number(channel, "rate_hz") > 0.0, "{channel}");
    }
    let printed = every(&["info"]).out;
    let unlimited: Vec<_> = printed.lines().filter(|line| line.contains("unlimited")).collect();
    assert!(unlimited.len() == of_kind("encoder").len() && unlimited[0].contains("encoder0"), "{printed}");

    // More channels than a telemetry frame holds come as one line.
    let printed = every(&["watch", "--for", "1", "--pace", "max", "--json"]).out;
    let lines: Vec<Value> = printed.lines().map(object).collect();
    assert!((4..=6).contains(&lines.len()), "{}", lines.len());
    for line in &lines {
        let ids = array(line, "channels").iter().map(|value| text(value, "channel"));
        assert!(ids.eq(channels.iter().map(|channel| text(channel, "id"))), "{line}");
    }
    let last = lines.last().unwrap();
    let value = |id: &str| {
        let mut values = array(last, "channels").iter();
        values.find(|value| text(value, "channel") == id).unwrap_or_else(|| panic!("{id}")).clone()
    };
    assert!(value("servo0")["value"].is_null(), "nothing was asked of it yet");
    let range = value("range0");
    assert!((0.02..=4.0).contains(&number(&range, "value")) && text(&range, "quality") == "good", "{range}");
    // Four sensors take turns of 60 ms each.
    assert!(number(&range, "age_ms") <= 250.0, "{range}");
    assert_eq!((number(&value("encoder0"), "value"), number(&value("encoder0"), "illegal")), (0.0, 0.0));
    assert_eq!(number(&value("dead-man0"), "value"), 1.0);
    assert!(value("stepper0")["duty"].is_null() && value("stepper0")["homed"] == false);
    let printed = every(&["watch", "--for", "0.3", "--pace", "max"]).out;
    assert!(printed.lines().any(|line| line.contains("range0") && line.ends_with(" mm")), "{printed}");
}

#[test]
fn a_servo_is_held_at_an_angle() {
    let end = every_json(&["servo", "servo3", "-30deg", "--for", "1"]);
    assert_eq!((text(&end, "channel"), text(&end, "mode"), &end["held"]), ("servo3", "position", &true.into()));
    // Angles travel as 32-bit floats.
    assert!((number(&end, "value") + 30f64.to_radians()).abs() < 1e-6 && number(&end, "seconds") == 1.0, "{end}");
    let seen = every(&["servo", "servo3", "30deg"]);
    assert_eq!(
        (seen.code, seen.out.as_str()),
        (Some(0), "servo3 had the set point 30.00 deg for 2 s, on sim:every-interface (simulated); now disarmed\n")
    );
    every_refused([
        (&["servo", "servo3", "60deg"][..], &["servo3", "position from -44.98 deg to 44.98 deg"][..]),
        (&["servo", "servo3", "10mm"], &["servo3", "angle"]),
        (&["servo", "servo16", "10deg"], &["servo16", "`r4 info`"]),
        (&["servo", "stepper0", "10deg"], &["stepper0", "no servo"]),
        (&["move", "servo3", "30deg"], &["servo3", "`r4 servo`"]),
    ]);
}

#[test]
fn a_brushless_drive_runs_and_brakes() {
    let end = every_json(&["bldc", "bldc0", "40%"]);
    assert_eq!((text(&end, "mode"), &end["held"]), ("duty", &true.into()));
    assert!((number(&end, "value") - 0.4).abs() < 1e-6, "{end}");
    let end = every_json(&["bldc", "bldc0", "--brake", "--for", "0.5"]);
    assert_eq!((text(&end, "mode"), number(&end, "set"), number(&end, "value")), ("brake", 1.0, 0.0));
    // Full speed takes at least a second.
    let seen = every(&["bldc", "bldc0", "-0.9", "--for", "0.5", "--json"]);
    assert!(seen.code == Some(1) && seen.err.contains("--for"), "{seen:?}");
    assert_eq!(object(&seen.out)["held"], false);
    every_refused([
        (&["bldc", "bldc0", "1.5"][..], &["bldc0", "-1.000 to 1.000"][..]),
        (&["bldc", "bldc0", "2rad/s"], &["bldc0", "share"]),
        (&["duty", "bldc0", "0.4"], &["bldc0", "`r4 bldc`"]),
    ]);
}

#[test]
fn a_voltage_is_given() {
    for typed in ["1.2V", "1200mV"] {
        let end = every_json(&["dac", "dac0", typed]);
        assert!((number(&end, "value") - 1.2).abs() < 1e-6 && end["held"] == true, "{end}");
    }
    let seen = every(&["dac", "dac1", "0.5V", "--for", "1"]);
    assert_eq!(
        (seen.code, seen.out.as_str()),
        (
            Some(0),
            "dac1 had the set point 0.50 V for 1 s, on sim:every-interface (simulated); now at its safe voltage\n"
        )
    );
    every_refused([
        (&["dac", "dac1", "0.1V"][..], &["dac1", "0.50 V to 2.80 V"][..]),
        (&["dac", "dac0", "1.2"], &["dac0", "1.2V"]),
    ]);
}

#[test]
fn a_stepper_moves_steps_turns_and_finds_its_home() {
    let end = every_json(&["move", "stepper1", "90deg"]);
    // 1600 steps a turn: a quarter of one.
    assert!((number(&end, "position") - 90f64.to_radians()).abs() < 1e-6 && end["settled"] == true, "{end}");
    for (steps, position_deg) in [("200", 45.0), ("-1", -0.225)] {
        let end = every_json(&["step", "stepper0", steps]);
        assert!((number(&end, "position").to_degrees() - position_deg).abs() < 1e-4, "{end}");
    }
    let end = every_json(&["speed", "stepper2", "-2rad/s"]);
    assert!((number(&end, "speed") + 2.0).abs() < 1e-3 && end["held"] == true, "{end}");
    assert!(every(&["speed", "stepper2", "2rad/s"]).out.contains("moving at 2.000 rad/s, after 2.0"));

    // Each comes to rest at the configured place of its switch, the osmc within its tolerance for settling.
    for (channel, home_rad, within) in [("stepper0", -0.5, 0.01), ("stepper1", -0.5, 0.01), ("osmc0", -1.0, 0.02)] {
        let end = every_json(&["home", channel, "--speed", "-1rad/s"]);
        assert_eq!((text(&end, "mode"), &end["homed"]), ("home", &true.into()), "{end}");
        assert!((number(&end, "position") - home_rad).abs() < within, "{end}");
    }
    let seen = every(&["home", "stepper0", "--speed", "-60deg/s"]);
    assert!(seen.code == Some(0) && seen.out.starts_with("stepper0 has found its home and rests at -28"), "{seen:?}");
    every_refused([
        (&["home", "stepper2", "--speed", "-1rad/s"][..], &["stepper2", "home", "`r4 info`"][..]),
        (&["home", "stepper0", "--speed", "5rad/s"], &["stepper0", "2.000 rad/s"]),
        (&["home", "osmc0", "--speed", "-1rad/s", "--for", "0.2"], &["osmc0", "home switch after 0.2 s", "direction"]),
        (&["step", "stepper0", "1000000"], &["stepper0", " to "]),
    ]);
}

#[test]
fn a_motor_without_a_sensor_tells_only_its_duty() {
    let end = every_json(&["duty", "dhb1", "50%"]);
    assert!(end["position"].is_null() && (number(&end, "duty") - 0.5).abs() < 1e-6, "{end}");
    let printed = every(&["duty", "dhb1", "-0.5"]).out;
    assert!(printed.starts_with("dhb1 duty -0.500, after 2.0") && !printed.contains("NaN"), "{printed}");
}

// r4 config

/// File for the flash of a simulated board, and `r4` with it.
struct Kept {
    folder: TempDir,
    robot: String,
}

impl Kept {
    fn new(robot: &str) -> Self {
        Self { folder: TempDir::new().expect("a temporary folder"), robot: robot.to_owned() }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn r4(&self, args: &[&str]) -> Seen {
        let flash = self.file("flash");
        r4(&[&["--board", &self.robot, "--flash", path(&flash)], args].concat())
    }

    /// Returns the one JSON object of a run that must succeed and print nothing on stderr.
    fn json(&self, args: &[&str]) -> Value {
        let seen = self.r4(&[args, &["--json"]].concat());
        assert!(seen.code == Some(0) && seen.err.is_empty(), "{args:?}: {seen:?}");
        object(&seen.out)
    }

    /// Returns a parameter as `r4 config show` prints it.
    fn parameter(&self, key: &str) -> Value {
        let shown = self.json(&["config", "show"]);
        array(&shown, "parameters").iter().find(|info| text(info, "key") == key).expect("it is listed").clone()
    }

    /// Expects a run to fail with these words.
    fn refused(&self, args: &[&str], says: &[&str]) {
        let seen = self.r4(args);
        let told = says.iter().all(|says| seen.err.contains(says)) && !seen.err.contains("panicked");
        let refused = matches!(seen.code, Some(1 | 3 | 5)) && seen.out.is_empty();
        assert!(told && refused, "{args:?} should say {says:?}: {seen:?}");
    }
}

const KP: &str = "osmc0.position_kp";

#[test]
fn config_shows_every_parameter_or_those_of_a_channel() {
    let shown = good_json(&["config", "show", "--json"]);
    assert_eq!(text(&shown, "board"), "sim:osmc-bench");
    let keys: Vec<&str> = array(&shown, "parameters").iter().map(|info| text(info, "key")).collect();
    for key in ["board.link_timeout_ms", KP, "actuator1.pot_low_code", "supply0.volts_min"] {
        assert_eq!(keys.iter().filter(|known| **known == key).count(), 1, "{key}");
    }
    let unit = |key| text(&array(&shown, "parameters")[keys.iter().position(|known| *known == key).unwrap()], "unit");
    assert_eq!((unit(KP), unit("actuator1.speed_max")), ("duty/rad", "m/s"));
    for info in array(&shown, "parameters") {
        assert_eq!((&info["active"], &info["set"]), (&info["built_in"], &info["built_in"]), "{info}");
    }
    let printed = good(&["config", "show", "osmc0"]);
    assert!(printed.contains(KP) && printed.contains("after restart"), "{printed}");
    assert!(!printed.contains("actuator1") && !printed.contains("board."), "{printed}");
    assert!(good(&["config", "show", "board"]).contains("board.link_timeout_ms"));
    assert_eq!(good(&["config", "show", "dead-man0"]), "no parameters\n");
    all_refused([
        (&["config", "show", "osmc3"][..], &["osmc3", "`r4 info`"][..]),
        (&["config", "show", "motor"], &["motor", "board"]),
    ]);
}

#[test]
fn config_keeps_what_is_saved_and_nothing_else() {
    let kept = Kept::new("sim:osmc-bench");
    let built_in = number(&kept.parameter(KP), "active");
    let set = kept.json(&["config", "set", KP, "5.5", "--save"]);
    assert_eq!((text(&set, "key"), number(&set, "set"), &set["saved"]), (KP, 5.5, &true.into()));
    assert_eq!(number(&set, "active"), built_in, "until the restart");
    let shown = kept.parameter(KP);
    assert_eq!((number(&shown, "active"), number(&shown, "built_in")), (5.5, built_in));

    let seen = kept.r4(&["config", "set", KP, "7"]);
    assert!(seen.code == Some(0) && seen.err.contains("loses unsaved") && seen.out.contains("5.5 -> 7"), "{seen:?}");
    assert_eq!(number(&kept.parameter(KP), "active"), 5.5);

    kept.json(&["config", "name", "rover 2", "--save"]);
    assert_eq!(text(&kept.json(&["info"]), "robot"), "rover 2");
    kept.json(&["config", "save"]);
    kept.json(&["config", "reset", "--save"]);
    assert_eq!(number(&kept.parameter(KP), "active"), built_in);
    assert_eq!(text(&kept.json(&["info"]), "robot"), "osmc-bench");
}

#[test]
fn what_is_saved_is_what_the_board_works_with() {
    let kept = Kept::new("sim:osmc-bench");
    let seen = kept.r4(&["config", "set", "osmc0.position_max", "1.0", "--save"]);
    assert_eq!(seen.code, Some(0), "{seen:?}");
    kept.refused(&["move", "osmc0", "90deg"], &["osmc0", "to 57.30 deg"]);
    assert_eq!(good_json(&["move", "osmc0", "90deg", "--json"])["settled"], true, "another board has another flash");
}

#[test]
fn saving_without_a_flash_is_refused() {
    let says = &["sim:osmc-bench", "loses its parameters", "--flash"][..];
    all_refused([
        (&["config", "save"][..], says),
        (&["config", "set", KP, "5", "--save"], says),
        (&["config", "name", "rover", "--save"], says),
        (&["config", "reset", "--save"], says),
        (&["config", "import", "any.toml"], says),
    ]);
    let seen = r4(&["config", "set", KP, "5"]);
    assert!(seen.code == Some(0) && seen.err.contains("--flash") && seen.out.contains("not saved"), "{seen:?}");
    let folder = TempDir::new().unwrap();
    let mut with = command(&["config", "set", KP, "5", "--save"]);
    with.env("R4_FLASH", folder.path().join("flash"));
    let seen = start(with).finish();
    assert!(seen.code == Some(0) && folder.path().join("flash").is_file(), "{seen:?}");
}

#[test]
fn config_refuses_what_the_board_does_not_take() {
    all_refused([
        (
            &["config", "set", "osmc0.position_kpp", "5"][..],
            &["osmc0.position_kpp", "nearest is osmc0.position_kp:"][..],
        ),
        (&["config", "set", "relay0.speed_max", "5"], &["relay0.speed_max", "`r4 config show`"]),
        (&["config", "set", "osmc0.duty_max", "1.5"], &["osmc0.duty_max", "1.5", "not be valid"]),
        (&["config", "set", KP, "nan"], &[KP, "NaN"]),
        (&["config", "set", KP, "fast"], &["fast"]),
        (&["config", "name", "a robot with a name that is longer than any board keeps"], &["bytes"]),
    ]);
}

#[test]
fn a_file_of_parameters_comes_back() {
    let kept = Kept::new("sim:osmc-bench");
    let (all, some) = (kept.file("all.toml"), kept.file("some.toml"));
    let seen = kept.r4(&["config", "export", path(&all)]);
    assert!(seen.code == Some(0) && seen.out.contains("all.toml"), "{seen:?}");
    let before = fs::read_to_string(&all).unwrap();
    assert!(before.contains("\n[board]\n") && before.contains("\n[osmc0]\n"), "{before}");
    assert_eq!(kept.json(&["config", "import", path(&all)])["changed"], Value::Array(vec![]), "nothing differs");

    // The new lower end is beyond the present upper end, which must be moved first.
    fs::write(&some, "[osmc0]\nposition_min = 70\nposition_max = 80.5\nposition_kp = 3.25\n").unwrap();
    let imported = kept.json(&["config", "import", path(&some)]);
    assert_eq!((array(&imported, "changed").len(), &imported["saved"]), (3, &true.into()), "{imported}");
    for (key, value) in [("osmc0.position_min", 70.0), ("osmc0.position_max", 80.5), (KP, 3.25)] {
        assert_eq!(number(&kept.parameter(key), "active"), value, "{key}");
    }
    let printed = kept.r4(&["config", "export", "-"]).out;
    assert!(printed.contains("position_kp = 3.25 # duty/rad; built in: 4.0\n"), "{printed}");
    let printed = kept.r4(&["config", "import", path(&all)]).out;
    assert!(printed.contains("osmc0.position_kp 3.25 -> 4\n") && printed.contains("3 of "), "{printed}");
    assert_eq!(kept.r4(&["config", "export", "-"]).out, before);
}

#[test]
fn a_file_of_parameters_is_taken_as_a_whole_or_not() {
    let kept = Kept::new("sim:osmc-bench");
    let file = kept.file("new.toml");
    let import = ["config", "import", path(&file)];
    for (toml, line, says) in [
        ("[osmc0]\nposition_kp = 9.0\nduty_max = 1.5\n", 3, "osmc0.duty_max cannot be 1.5"),
        ("[osmc0]\nposition_kp = 9.0\n[actuator1]\nposition_kq = 9.0\n", 4, "nearest is actuator1.position_kp"),
        ("[osmc0]\nposition_kp = 9.0\n[osmc2]\nposition_kp = 9.0\n", 4, "nearest is osmc0.position_kp"),
        ("[osmc0]\nposition_kp = 9.0\nspeed_max = \"fast\"\n", 3, "osmc0.speed_max must be a number"),
        ("[osmc0]\nposition_kp = 9.0\nspeed_max =\n", 3, "numbers like"),
    ] {
        fs::write(&file, toml).unwrap();
        kept.refused(&import, &[&format!("new.toml:{line}: "), says]);
        assert_eq!(number(&kept.parameter(KP), "active"), 4.0, "{toml}");
    }
    kept.refused(&["config", "import", path(&kept.file("none.toml"))], &["none.toml", "cannot read"]);
    kept.refused(&["config", "export", path(&kept.file("no/folder.toml"))], &["folder.toml", "cannot write"]);
}

#[test]
fn a_file_that_is_no_flash_is_left_alone() {
    let kept = Kept::new("sim:osmc-bench");
    fs::write(kept.file("flash"), "my thesis").unwrap();
    kept.refused(&["info"], &["flash", "not the flash of a simulated board"]);
    assert_eq!(fs::read_to_string(kept.file("flash")).unwrap(), "my thesis");
    all_refused([
        (&["--flash", path(&kept.file("no/flash")), "info"][..], &["no/flash", "cannot write"][..]),
        (&["--flash", path(kept.folder.path()), "info"], &["cannot read"]),
    ]);
}

/// Content of a flash that the board does not use is reported before anything starts.
#[test]
fn a_flash_that_is_damaged_or_of_another_robot_is_noticed() {
    let kept = Kept::new("sim:osmc-bench");
    kept.json(&["config", "set", KP, "5.0", "--save"]);
    let whole = fs::read(kept.file("flash")).unwrap();
    let other = Kept::new("sim:openscout");
    fs::write(other.file("flash"), &whole).unwrap();
    let seen = other.r4(&["info"]);
    assert!(seen.code == Some(0) && seen.err.contains("of the robot osmc-bench, not openscout"), "{seen:?}");

    fs::write(kept.file("flash"), vec![0; whole.len()]).unwrap();
    let seen = kept.r4(&["info"]);
    assert!(seen.code == Some(0) && seen.err.contains("its parameters are damaged"), "{seen:?}");
    let sector = whole.len() / 4;
    let noise = (0..whole.len()).map(|at| ((at * 7919) >> 3) as u8).collect();
    for bad in [whole[..sector].to_vec(), whole[..whole.len() - 1].to_vec(), whole[..33].to_vec(), noise] {
        fs::write(kept.file("flash"), &bad).unwrap();
        kept.refused(&["info"], &["flash", "not the flash of a simulated board", "another file"]);
        assert_eq!(fs::read(kept.file("flash")).unwrap(), bad, "it is left alone");
    }
    fs::write(kept.file("flash"), &whole).unwrap();
    let seen = kept.r4(&["info"]);
    assert!(seen.code == Some(0) && seen.err.is_empty(), "{seen:?}");
}

// r4 faults

#[test]
fn trips_are_remembered_with_what_came_before() {
    let own = Own::new(ROBOT, &stuck());
    let kept = Kept::new(&own.robot);
    assert!(array(&kept.json(&["faults"]), "faults").is_empty());
    kept.refused(&["faults", "0"], &["no trip 0", "`r4 faults`"]);
    for _ in 0..2 {
        kept.refused(&["move", "actuator1", "25mm"], &["stalled"]);
    }
    let faults = kept.json(&["faults"]);
    let faults = array(&faults, "faults");
    assert_eq!(faults.len(), 2);
    let (newest, oldest) = (&faults[0], &faults[1]);
    assert_eq!((number(newest, "index"), number(newest, "number")), (0.0, number(oldest, "number") + 1.0));
    assert!(number(newest, "start") > number(oldest, "start"), "{newest} {oldest}");
    assert!(array(newest, "causes").contains(&"stalled".into()) && number(newest, "time_s") > 0.3, "{newest}");

    let before = kept.json(&["faults", "0"]);
    assert_eq!(number(&before, "number"), number(newest, "number"));
    let moments = array(&before, "before");
    let times: Vec<f64> = moments.iter().map(|moment| number(moment, "before_ms")).collect();
    // Every 10 ms for 200 ms.
    assert!(times.len() == 20 && times.is_sorted_by(|a, b| a > b) && times[0] <= 200.0, "{times:?}");
    let last = moments.last().unwrap();
    let [osmc, actuator] = array(last, "motors") else { panic!("{last}") };
    assert_eq!((text(osmc, "channel"), text(actuator, "channel")), ("osmc0", "actuator1"));
    // A stall is a high duty without motion.
    assert!(number(actuator, "duty") > 0.3 && number(actuator, "position").abs() < 1e-3, "{actuator}");
    assert_eq!(number(osmc, "duty"), 0.0);
    let volts = number(&array(last, "supplies")[0], "voltage_v");
    assert!((volts - 24.0).abs() < 1.0, "{volts}");

    let printed = kept.r4(&["faults"]).out;
    assert_eq!(printed.matches("stalled").count(), 2, "{printed}");
    let printed = kept.r4(&["faults", "1"]).out;
    for says in ["trip 1", "stalled", "free the mechanism", "ms before", "actuator1", "mm/s", "duty", "supply1"] {
        assert!(printed.contains(says), "{says} in\n{printed}");
    }
    kept.refused(&["faults", "2"], &["no trip 2", "has 2 stored"]);
    let seen = r4(&["faults"]);
    assert!(seen.code == Some(0) && seen.out.contains("no stored trip") && seen.err.contains("--flash"), "{seen:?}");
}

// r4 i2c, uart

#[test]
fn external_connectors_are_reached() {
    // Each I2C connector of a simulated board has an erased memory of 256 bytes; each UART receives what it sends.
    for bus in ["0", "1"] {
        let read = good_json(&["i2c", bus, "0x50", "--write", "10", "--read", "3", "--json"]);
        assert_eq!((text(&read, "written"), text(&read, "read")), ("10", "ffffff"));
        assert_eq!((number(&read, "bus").to_string(), number(&read, "address")), (bus.to_owned(), 80.0));
    }
    assert_eq!(good(&["i2c", "0", "80", "--write", "00", "--read", "2"]), "ff ff\n");
    assert_eq!(good(&["i2c", "0", "0x50", "--write", "00 12 34"]), "wrote 3 bytes to 0x50 on I2C connector 0\n");
    assert_eq!(good(&["uart", "1", "--write", r"R4 \\\r\n\x00", "--read"]), "R4 \\\\\\r\\n\\x00\n");
    let long = "0123456789".repeat(20);
    let echo = good_json(&["uart", "0", "--write", &long, "--read", "--json"]);
    assert_eq!((text(&echo, "read"), text(&echo, "read").len()), (text(&echo, "written"), 400));
    assert_eq!(good(&["uart", "0", "--write", "x"]), "sent 1 byte out of UART connector 0\n");
    assert_eq!(good(&["uart", "0", "--read", "--for", "0.1"]), "\n");
    all_refused([
        (&["i2c", "0", "0x51", "--read", "1"][..], &["0x51", "pull-ups"][..]),
        (&["i2c", "2", "0x50", "--read", "1"], &["connector 2"]),
        (&["i2c", "0", "0x03", "--read", "1"], &["0x08 to 0x77"]),
        (&["i2c", "0", "0x50"], &["--write", "--read"]),
        (&["i2c", "0", "0x50", "--read", "65"], &["65", "64"]),
        (&["i2c", "0", "0x50", "--write", "0"], &["hex", "00ff"]),
        (&["uart", "2", "--read"], &["connector 2"]),
        (&["uart", "0"], &["--write", "--read"]),
        (&["uart", "0", "--write", r"\q"], &["two hex digits"]),
    ]);
}

// Bad input

#[test]
fn a_bad_argument_is_refused_with_what_to_type_instead() {
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    let (below_file, no_file) = (file.join("out"), format!("sim:{}", path(&folder.path().join("none.toml"))));
    all_refused([
        // Unknown boards.
        (&["--board", "sim:nothing", "info"][..], &["nothing", "osmc-bench", ".toml"][..]),
        (&["--board", "sim:nothing", "demo", "--json"], &["nothing", "osmc-bench", ".toml"]),
        (&["--board", "osmc-bench", "info"], &["osmc-bench", "sim:osmc-bench"]),
        (&["--board", "", "info"], &["sim:osmc-bench"]),
        (&["--board", "sim:", "info"], &["sim:osmc-bench"]),
        (&["--board", "usb:1", "info"], &["usb:1", "serial:", "sim:osmc-bench"]),
        (&["--board", "can:slcan", "info"], &["can:slcan", "can:can0", "can:slcan:"]),
        (&["--board", &no_file, "info"], &["none.toml", "cannot be read"]),
        // Unknown channels.
        (&["move", "osmc9", "90deg"], &["osmc9", "`r4 info`"]),
        (&["move", "motor", "90deg"], &["motor", "osmc0"]),
        (&["move", "supply0", "12deg"], &["supply0", "`r4 info`"]),
        (&["watch", "osmc3", "--for", "1", "--pace", "max"], &["osmc3", "`r4 info`"]),
        // Text that is no quantity.
        (&["move", "osmc0"], &["<VALUE>"]),
        (&["move", "osmc0", "90"], &["osmc0", "deg"]),
        (&["move", "osmc0", "fast"], &["fast", "90deg"]),
        (&["move", "osmc0", "nan deg"], &["nan deg", "90deg"]),
        (&["move", "osmc0", "1e999rad"], &["1e999"]),
        (&["move", "osmc0", "1e300rad"], &["osmc0"]),
        (&["duty", "osmc0", "NaN"], &["NaN", "90deg"]),
        (&["speed", "osmc0", "infrad/s"], &["infrad/s", "90deg"]),
        // Modes and units that the channel does not take.
        (&["move", "osmc0", "25mm"], &["osmc0", "position", "deg"]),
        (&["move", "actuator1", "90deg"], &["actuator1", "position", "mm"]),
        (&["speed", "osmc0", "90deg"], &["osmc0", "speed", "deg/s"]),
        (&["duty", "osmc0", "90deg"], &["osmc0", "duty"]),
        (&["move", "osmc0", "11turn"], &["osmc0", " to "]),
        (&["move", "actuator1", "150mm"], &["actuator1", " to "]),
        (&["speed", "osmc0", "100rad/s"], &["osmc0", " to "]),
        (&["duty", "osmc0", "1.5"], &["osmc0", "-0.902 to 0.902"]),
        // Modes that the channel does not have.
        (&["home", "osmc0", "--speed", "-1rad/s"], &["osmc0", "home", "`r4 info`"]),
        (&["home", "osmc0", "--speed", "0rad/s"], &["other than 0"]),
        (&["home", "osmc0"], &["--speed"]),
        (&["step", "osmc0", "200"], &["osmc0", "no stepper", "`r4 move`"]),
        (&["step", "stepper0", "1.5"], &["1.5"]),
        (&["servo", "osmc0", "30deg"], &["osmc0", "no servo"]),
        (&["bldc", "osmc0", "40%"], &["osmc0", "no bldc"]),
        (&["bldc", "bldc0"], &["<VALUE>"]),
        (&["bldc", "bldc0", "40%", "--brake"], &["--brake"]),
        (&["dac", "dac0", "1.2V"], &["dac0", "`r4 info`"]),
        // Options out of range.
        (&["arm", "--for=-1", "--pace", "max"], &["--for", "above 0"]),
        (&["arm", "--for", "nan", "--pace", "max"], &["--for", "above 0"]),
        (&["arm", "--pace", "0", "--for", "1"], &["--pace", "0.01", "max"]),
        (&["arm", "--pace", "nan", "--for", "1"], &["--pace", "0.01", "max"]),
        (&["watch", "--rate", "0", "--for", "1"], &["--rate", "0.1 to 500"]),
        (&["info", "--seed", "lucky"], &["--seed", "lucky"]),
        (&["demo", "--out", path(&below_file)], &["file/out"]),
        // No verb, and an unknown one.
        (&[], &["Usage", "demo", "info"]),
        (&["fly"], &["fly", "Usage"]),
    ]);
}

#[test]
fn a_mistake_in_a_file_is_reported_with_file_line_and_field() {
    let robot = |section, key, line| {
        let (text, at) = edited(ROBOT, section, key, line);
        (Own::new(&text, ACTUATOR), format!("robot.toml:{at}: "))
    };
    let plant = |section, key, line| {
        let (text, at) = edited(ACTUATOR, section, key, line);
        (Own::new(ROBOT, &text), format!("osmc-bench-actuator.toml:{at}: "))
    };
    for ((own, place), field, says) in [
        (robot("[[osmc]]", "speed_max_rad_s", "speed_max_rad_s ="), "osmc[0].speed_max_rad_s", ""),
        (robot("[[osmc]]", "speed_filter_s", "speed_filter_ms = 10"), "osmc[0].speed_filter_ms", "`speed_filter_s`"),
        (robot("[[osmc]]", "duty_max", "duty_max = 1.5"), "osmc[0].duty_max", "at most"),
        (robot("[[actuator]]", "channel", "channel = \"actuator9\""), "actuator[0].channel", "0 to 3"),
        (robot("[[simulation.rotary]]", "plant", "plant = \"no.toml\""), "simulation.rotary[0].plant", "no.toml"),
        (plant("[parameters]", "resistance_ohm", "resistance_ohm = 0.0"), "parameters.resistance_ohm", "outside"),
        (plant("[[effects]]", "force_n", "force = 100.0"), "effects[1].force", "force_n"),
        (plant("[[effects]]", "effect", "effect = \"magic\""), "effects[0].effect", "coulomb-friction"),
    ] {
        all_refused([(&["--board", &own.robot, "info"][..], &[&place[..], field, says][..])]);
    }
}

#[test]
fn a_robot_without_a_simulation_exists_as_hardware_only() {
    let (hardware, _) = ROBOT.split_once("\n[[simulation").unwrap();
    let own = Own::new(hardware, ACTUATOR);
    all_refused([(&["--board", &own.robot, "info"][..], &["robot.toml", "[simulation]"][..])]);
}

#[test]
fn a_failure_says_what_kind_it_is() {
    for (args, code, kind, channel) in [
        (&["move", "osmc0", "90"][..], 3, "refused", Some("osmc0")),
        (&["move", "osmc0", "400turns"], 3, "refused", Some("osmc0")),
        (&["relay", "relay7", "on"], 3, "refused", Some("relay7")),
        (&["move", "osmc0", "90deg", "--for", "0.1"], 1, "not-reached", Some("osmc0")),
        (&["--board", "serial:/dev/nothing-here", "info"], 4, "no-board", None),
        (&["--board", "tcp:127.0.0.1:9", "move", "osmc0", "1deg"], 4, "no-board", None),
        (&["log", "info", "nothing.mcap"], 1, "failed", None),
        (&["move", "osmc0", "90parsec"], 2, "usage", None),
        (&["fly"], 2, "usage", None),
    ] {
        let seen = r4(&[args, &["--json"]].concat());
        assert_eq!(seen.code, Some(code), "{args:?}: {seen:?}");
        let error = &object(&seen.out)["error"];
        assert_eq!(text(error, "kind"), kind, "{args:?}: {seen:?}");
        assert_eq!(error["channel"].as_str(), channel, "{args:?}: {seen:?}");
        assert_eq!(error["board"].is_string(), !matches!(kind, "failed" | "usage"), "{args:?}: {seen:?}");
        assert!(seen.err.contains(text(error, "message")), "{args:?}: {seen:?}");
        let seen = r4(args);
        assert!(seen.code == Some(code) && seen.out.is_empty(), "{args:?}: {seen:?}");
    }
    let own = Own::new(ROBOT, &stuck());
    let seen = r4(&["--board", &own.robot, "move", "actuator1", "25mm", "--json"]);
    assert_eq!((seen.code, text(&object(&seen.out)["error"], "kind")), (Some(5), "stopped"), "{seen:?}");
}

#[test]
fn what_moves_says_where() {
    let without = |args: &[&str]| {
        let mut command = command(args);
        command.env_remove("R4_BOARD");
        start(command).finish()
    };
    for args in [
        &["move", "osmc0", "5deg"][..],
        &["speed", "osmc0", "60deg/s"],
        &["duty", "osmc0", "60%", "--for", "0.2"],
        &["relay", "relay1", "on", "--for", "0.1"],
        &["disarm"],
    ] {
        let named = good(args);
        assert!(named.contains("sim:osmc-bench (simulated)"), "{args:?}: {named}");
        // No real board is connected to a machine that runs tests, so the simulated one is the default.
        let seen = without(args);
        assert!(seen.code == Some(0) && seen.out == named, "{args:?}: {seen:?}");
        let said = "r4: no board was named: this is sim:osmc-bench (simulated); --board or R4_BOARD names another";
        assert_eq!(seen.err.lines().next(), Some(said), "{args:?}");
    }
    for args in [&["log", "info", "nothing.mcap"][..], &["ports"]] {
        assert!(!without(args).err.contains("no board was named"), "{args:?}");
    }
}

#[test]
fn a_speed_is_printed_in_the_unit_it_was_typed_in() {
    let told = good(&["--board", "sim:openscout", "speed", "dhb0", "60rpm", "--for", "1"]);
    assert!(told.contains(" of speed 60.00 rpm") && told.contains(" rpm, duty "), "{told}");
    let told = good(&["move", "osmc0", "0.25turns"]);
    assert!(told.contains("asked for 0.2500 turns") && told.contains("rests at 0.2"), "{told}");
}

#[test]
fn the_board_may_come_from_the_environment() {
    let with = |args: &[&str]| {
        let mut command = command(args);
        command.env("R4_BOARD", "sim:nothing");
        start(command).finish()
    };
    let seen = with(&["info"]);
    assert!(seen.code == Some(1) && seen.err.contains("`nothing`"), "{seen:?}");
    assert_eq!(with(&["--board", "sim:osmc-bench", "info"]).code, Some(0), "what is typed comes first");
}

#[test]
fn a_message_says_it_once() {
    let own = Own::new(&edited(ROBOT, "[[simulation.rotary]]", "plant", "plant = \"no.toml\"").0, ACTUATOR);
    let flat = Own::new(&edited(ROBOT, "[[simulation.rail]]", "emf_v", "emf_v = 19.0").0, ACTUATOR);
    for args in [
        &["--board", "sim:none.toml", "info"][..],
        &["--board", &own.robot, "info"],
        &["--board", &flat.robot, "clear"],
        &["move", "osmc9", "90deg"],
        &["duty", "osmc0", "1.5"],
    ] {
        let seen = r4(args);
        let message = seen.err.trim_end();
        let twice = message.match_indices(": ").any(|(at, colon)| {
            let (before, after) = (&message[..at], &message[at + colon.len()..]);
            before.ends_with(after)
        });
        assert!(!message.is_empty() && !twice, "{args:?}: {message}");
    }
}

#[test]
fn a_pace_that_no_clock_can_keep_is_refused() {
    all_refused([(&["arm", "--for", "1", "--pace", "1e-300"][..], &["--pace"][..])]);
}

#[test]
fn a_reader_that_has_seen_enough_ends_the_program_quietly() {
    let mut running = start(command(&["watch", "--pace", "max"]));
    let out = running.out.take().unwrap();
    assert!(next(&out, running.begin).is_some());
    drop(out);
    let seen = running.finish();
    assert!(seen.code != Some(101) && !seen.err.contains("panicked"), "{seen:?}");
}

#[cfg(target_os = "linux")]
#[test]
fn output_that_cannot_be_written_is_an_error() {
    let folder = TempDir::new().unwrap();
    for args in [&["info"][..], &["info", "--json"], &["demo", "--out", path(folder.path()), "--json"]] {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let mut child = command(args).stdout(full).stderr(Stdio::piped()).spawn().unwrap();
        let err = child.stderr.take().map(lines).unwrap();
        let seen = Running { child, begin: Instant::now(), out: None, err }.finish();
        assert!(seen.code == Some(1) && !seen.err.contains("panicked") && !seen.err.is_empty(), "{args:?}: {seen:?}");
    }
}

#[test]
fn bench_bus_tells_what_the_bus_carries() {
    let told = good_json(&["bench", "bus", "--seconds", "0.5", "--json"]);
    let rows = told["rows"].as_array().expect("rows");
    assert!(rows.len() >= 4, "{told}");
    for row in rows {
        let occupancy = row["occupancy"].as_f64().expect("a share");
        assert!(row["load"].is_string() && (0.0..1.0).contains(&occupancy), "{row}");
        assert_eq!(row["late_ticks"], 0, "{row}");
        assert!(row["worst_tick_us"].as_f64().expect("a time") <= 1000.0, "{row}");
    }
}

#[test]
fn bench_safety_holds_every_limit() {
    let seen = r4(&["bench", "safety", "--injections", "120", "--json"]);
    assert_eq!(seen.code, Some(0), "{seen:?}");
    let told = object(&seen.out);
    assert_eq!(told["board"], "sim:every-interface");
    for row in told["rows"].as_array().expect("rows") {
        assert!(row["cause"].is_string() && row["outputs"].is_string(), "{row}");
        assert!(row["max_ms"].as_f64() <= row["limit_ms"].as_f64() && row["injections"].as_u64() > Some(0), "{row}");
    }
}

#[test]
fn bench_identify_tells_what_was_promised_and_what_came_of_it() {
    let data = concat!(env!("CARGO_MANIFEST_DIR"), "/../../data");
    let told = good_json(&["bench", "identify", "--data", data, "--only", "backlash", "--json"]);
    let rows = told["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 2, "{told}");
    for row in rows {
        assert!(row["data"].is_string() && row["metric"].is_string() && row["unit"] == "deg", "{row}");
        assert!(row["after"].as_f64() <= row["at_least"].as_f64() && row["met"] == true, "{row}");
    }
    assert!(told["seconds"].as_f64() > Some(0.0), "{told}");
}

#[test]
fn bench_identify_without_its_recordings_says_what_to_do() {
    let seen = r4(&["bench", "identify", "--data", "nowhere", "--only", "emps"]);
    assert_eq!((seen.code, seen.out.as_str()), (Some(1), ""), "{seen:?}");
    assert!(seen.err.contains("nowhere/emps") && seen.err.contains("--data"), "{seen:?}");
    let seen = r4(&["bench", "identify", "--only", "nothing"]);
    assert!(seen.code == Some(2) && seen.err.contains("pendulum"), "{seen:?}");
}
