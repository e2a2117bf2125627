//! Tests of `r4 identify` as a user runs it: recordings in; a report, a page and a plant file out. The quality of what
//! it finds is tested in `r4-identify`.

use crate::program;
use std::{fmt::Write as _, fs, process::Output};

use serde_json::Value;
use tempfile::TempDir;

fn r4(folder: &TempDir, args: &str) -> Output {
    let args: Vec<&str> = args.split_whitespace().collect();
    program::command(&args).current_dir(folder.path()).output().expect("r4 runs")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn json(bytes: &[u8]) -> Value {
    serde_json::from_slice(bytes).unwrap_or_else(|error| panic!("{error}: {}", String::from_utf8_lossy(bytes)))
}

/// Writes the speed of a motor with friction, every 20 ms for 8 s, driven by steps both ways that differ from one
/// `kind` to the next.
fn recording(folder: &TempDir, name: &str, kind: u32) {
    let mut table = String::from("t_s,duty,speed_rad_s\n");
    let (mut speed, step_s) = (0.0_f64, 0.001);
    for row in 0..8_000_u32 {
        let duty = [0.0, 0.3, 0.6, 0.0, -0.4, -0.7, 0.2, -0.2, 0.5, 0.0][((row / 800 + kind) % 10) as usize];
        if row % 20 == 0 {
            let noise = 0.02 * (f64::from(row * 7_919 % 1_000) / 1_000.0 - 0.5);
            writeln!(table, "{},{duty},{:.4}", f64::from(row) * step_s, speed + noise)
                .expect("strings take everything");
        }
        let push = 120.0 * duty - 8.0 * speed;
        let rub = 10.0_f64;
        let next = speed + step_s * (push - rub * if speed == 0.0 { push.signum() } else { speed.signum() });
        let sticks = speed == 0.0 && push.abs() <= rub || next * speed < 0.0 && push.abs() <= rub;
        speed = if sticks { 0.0 } else { next };
    }
    fs::write(folder.path().join(name), table).expect("a file");
}

#[test]
fn recordings_become_a_report_a_page_and_a_plant() {
    let folder = tempfile::tempdir().expect("a folder");
    for (kind, name) in ["a.csv", "b.csv", "c.csv"].into_iter().enumerate() {
        recording(&folder, name, kind as u32);
    }
    let question = "--model dc-motor --input duty --output speed_rad_s --param supply_v=12 --out out";
    let told = r4(&folder, &format!("--json identify a.csv b.csv --holdout c.csv {question}"));
    assert_eq!(told.status.code(), Some(0), "{}", stderr(&told));
    let file = |name: &str| fs::read_to_string(folder.path().join("out").join(name)).expect("it was written");
    let (told, report) = (json(&told.stdout), json(file("report.json").as_bytes()));
    for field in ["model", "baseline", "effects", "final", "residual", "verdict"] {
        assert_eq!(told[field], report[field], "{field}");
        assert!(!report[field].is_null(), "{field}");
    }
    for model in ["baseline", "final"] {
        for data in ["train", "holdout"] {
            assert!(report[model][data]["rmse"].is_f64() && report[model][data]["nrmse"].is_f64(), "{model} {data}");
        }
    }
    let verdict = report["verdict"].as_str().expect("a sentence");
    assert!(file("report.html").contains("</html>") && file("report.html").contains(&verdict[..20]));
    r4_plants::PlantSpec::from_toml("plant.toml", &file("plant.toml")).expect("a plant");
}

#[test]
fn what_cannot_be_answered_is_told_and_nothing_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    recording(&folder, "a.csv", 0);
    recording(&folder, "b.csv", 1);
    fs::write(folder.path().join("empty.csv"), "").expect("a file");
    let model = "--model dc-motor --input duty --output speed_rad_s";
    for (question, told) in [
        (format!("empty.csv --holdout b.csv {model}"), "empty.csv is empty"),
        (format!("a.csv --holdout a.csv {model}"), "both to fit to and to test on"),
        (format!("a.csv --holdout every:2 {model}"), "1 run cannot be shared"),
        ("a.csv --holdout b.csv --model dc-motor --input dty --output speed_rad_s".to_owned(), "did you mean `duty`?"),
        (format!("a.csv --holdout b.csv {model} --map yaw=duty"), "has no role `yaw`"),
        (format!("a.csv --holdout gone.csv {model}"), "cannot read gone.csv"),
        (format!("a.csv --holdout b.csv {model} --param colour=1"), "colour"),
    ] {
        let output = r4(&folder, &format!("identify {question} --out out"));
        assert_eq!(output.status.code(), Some(1), "{question}: {}", stderr(&output));
        assert!(stderr(&output).contains(told), "{question}: {}", stderr(&output));
        assert!(output.stdout.is_empty() && !folder.path().join("out").exists(), "{question}");
    }
}

/// Reverses the rows of a table, but not their times.
fn turn_round(folder: &TempDir, name: &str) {
    let path = folder.path().join(name);
    let table = fs::read_to_string(&path).expect("it was written");
    let (head, rows) = table.split_once('\n').expect("a header");
    let parts: Vec<(&str, &str)> = rows.lines().filter_map(|row| row.split_once(',')).collect();
    let turned = parts.iter().zip(parts.iter().rev()).map(|((time, _), (_, values))| format!("{time},{values}\n"));
    fs::write(path, format!("{head}\n{}", turned.collect::<String>())).expect("a file");
}

#[test]
fn recordings_that_nothing_explains_end_with_a_code_of_their_own() {
    let folder = tempfile::tempdir().expect("a folder");
    for (kind, name) in ["a.csv", "b.csv"].into_iter().enumerate() {
        recording(&folder, name, kind as u32);
        turn_round(&folder, name);
    }
    let question = "--model dc-motor --input duty --output speed_rad_s --out out";
    let told = r4(&folder, &format!("--json identify a.csv --holdout b.csv {question}"));
    let report = json(&told.stdout);
    assert_eq!((told.status.code(), report["explained"].as_str()), (Some(6), Some("not")), "{report}");
    let verdict = report["verdict"].as_str().expect("a sentence");
    assert!(verdict.starts_with("Not explained: ") && verdict.contains("time runs backwards"), "{verdict}");
    assert!(stderr(&told).contains("the recordings are not explained"), "{}", stderr(&told));
}

/// Writes the motion of a robot that turns by three quarters of what its wheels say, every 20 ms for 8 s.
fn drive(folder: &TempDir, name: &str, kind: u32) {
    let mut table = String::from("t_s,left_rad_s,right_rad_s,yaw_rate_rad_s\n");
    for row in 0..400_u32 {
        let of = |shift: u32| [0.0, 3.0, -2.0, 5.0, 1.0, -4.0, 2.0, 4.0][((row / 25 + kind + shift) % 8) as usize];
        let (left, right): (f64, f64) = (of(0), of(3));
        let noise = 0.004 * (f64::from(row * 7_919 % 1_000) / 1_000.0 - 0.5);
        let yaw_rate = 0.75 * 0.056 * (right - left) / 0.302 + noise;
        writeln!(table, "{},{left},{right},{yaw_rate:.5}", f64::from(row) * 0.02).expect("strings take everything");
    }
    fs::write(folder.path().join(name), table).expect("a file");
}

#[test]
fn a_drive_becomes_a_body_that_a_simulated_board_loads() {
    let folder = tempfile::tempdir().expect("a folder");
    drive(&folder, "a.csv", 0);
    drive(&folder, "b.csv", 1);
    let question = "identify a.csv --holdout b.csv --model skid-steer --map left=left_rad_s right=right_rad_s \
                    gyro=yaw_rate_rad_s --param wheel_radius_m=0.056 track_m=0.302";
    let told = r4(&folder, &format!("--json --board sim:openscout {question} --out out"));
    assert_eq!(told.status.code(), Some(0), "{}", stderr(&told));
    assert!(json(&told.stdout)["files"][2].as_str().is_some_and(|file| file.ends_with("body.toml")));
    let body = fs::read_to_string(folder.path().join("out/body.toml")).expect("it was written");
    // Values that were not fitted are those of the robot.
    assert!(body.contains("mass_kg = 9.0\n") && body.contains("# compliance_lat_per_n: "), "{body}");
    let moved = r4(&folder, "--board sim:openscout --body out/body.toml --json move dhb0 90deg");
    assert_eq!(moved.status.code(), Some(0), "{}", stderr(&moved));
    // A robot without these motors refuses the body.
    let refused = r4(&folder, "--board sim:osmc-bench --body out/body.toml info");
    assert!(refused.status.code() != Some(0) && stderr(&refused).contains("body.wheeled.wheel[0].channel"));
    // Without a robot the body lists its assumptions.
    let told = r4(&folder, &format!("--json {question} --out alone"));
    assert_eq!(told.status.code(), Some(0), "{}", stderr(&told));
    let body = fs::read_to_string(folder.path().join("alone/body.toml")).expect("it was written");
    assert!(body.contains("# Assumed, not fitted: "), "{body}");
    let loaded = r4(&folder, "--board sim:openscout --body alone/body.toml info");
    assert_eq!(loaded.status.code(), Some(0), "{}", stderr(&loaded));
}

#[test]
fn every_model_is_listed_with_what_it_takes() {
    let folder = tempfile::tempdir().expect("a folder");
    let listed = r4(&folder, "--json identify models");
    assert_eq!(listed.status.code(), Some(0));
    let listed = json(&listed.stdout);
    let models = listed["models"].as_array().expect("a list");
    for name in ["dc-motor", "axis", "linear-actuator", "servo"] {
        let model = models.iter().find(|model| model["name"] == name).expect(name);
        for what in ["roles", "parameters", "effects"] {
            assert!(model[what].as_array().is_some_and(|list| !list.is_empty()), "{name} {what}");
        }
    }
    for model in models {
        let files = (model["writes"].as_str().expect("a file"), model["loads"].as_str().expect("an option"));
        assert!([("plant.toml", "--plant CHANNEL=FILE"), ("body.toml", "--body FILE")].contains(&files), "{model}");
    }
}
