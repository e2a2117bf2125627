//! Tests of robot systems: studies, their shards, and the rows of their reports.

use std::fs;

use tempfile::TempDir;

use crate::program::{all_refused, good, good_json, object, r4};

/// Arms of a study that take a fraction of a second.
const QUICK: [&str; 8] =
    ["system", "study", "skidcal", "--arms", "paper,baseline:repaired", "--board", "sim:openscout", "--json"];

#[test]
fn every_row_has_an_interval_and_says_where_it_is_from() {
    let report = good_json(&[&QUICK[..], &["--seeds", "2"]].concat());
    let rows = report["rows"].as_array().expect("rows");
    assert!(!rows.is_empty());
    for row in rows {
        let number = |field: &str| row[field].as_f64().unwrap_or(f64::NAN);
        assert!(number("lo") <= number("value") && number("value") <= number("hi"), "{row:#}");
        for (field, is) in [("system", "skidcal"), ("source", "simulated"), ("board", "sim")] {
            assert_eq!(row[field], is, "{row:#}");
        }
        let texts = ["arm", "metric", "unit", "method"];
        assert!(texts.iter().all(|field| row[field].as_str().is_some_and(|text| !text.is_empty())), "{row:#}");
        assert_eq!((row["n"].as_u64(), &row["seeds"]), (Some(2), &serde_json::json!([1001, 1002])), "{row:#}");
        assert_eq!(row["paired_p"].is_number(), row["arm"] != "paper", "{row:#}");
    }
}

#[test]
fn shards_merge_into_the_study_byte_for_byte() {
    let folder = TempDir::new().expect("a folder");
    let file = |name: &str| folder.path().join(name).to_str().expect("text").to_owned();
    let rows = good_json(&[&QUICK[..], &["--seeds", "3", "--out", &file("whole")]].concat());
    for part in ["1/2", "2/2"] {
        let out = file(&part.replace('/', "-"));
        good(&[&QUICK[..], &["--seeds", "3", "--shard", part, "--out", &out]].concat());
    }
    let merge = ["system", "merge", &file("1-2"), &file("2-2"), "--out", &file("merged"), "--json"];
    assert_eq!(good_json(&merge), rows);
    assert_eq!(fs::read(file("merged")).expect("records"), fs::read(file("whole")).expect("records"));
}

#[test]
fn what_cannot_be_run_is_said() {
    all_refused([
        (&["system", "run", "skidcall"][..], &["`r4 system list` prints them"][..]),
        (&["system", "run", "skidcal", "--arm", "theirs"], &["it has paper, baseline:repaired"]),
        (&["system", "study", "skidcal", "--shard", "3/2"], &["as in 3/8"]),
        (&["system", "study", "skidcal", "--shard", "1/2"], &["name it with --out"]),
        (&["system", "run", "skidcal", "--arm", "paper", "--board", "sim:osmc-bench"], &["no [drive.skid-steer]"]),
        (
            &["system", "study", "skidcal", "--arms", "paper", "--board", "sim:osmc-bench"],
            &["none of 20 trials could be run", "no [drive.skid-steer]"],
        ),
        (&["system", "merge", "none.jsonl"], &["none.jsonl"]),
    ]);
}

/// Two seeds of the evaluation: a line for each metric, the paper's numbers, and a page with every response.
#[test]
fn the_osmc_evaluation_has_the_paper_beside_ours() {
    let folder = TempDir::new().expect("a folder");
    let page = folder.path().join("report.html");
    let arguments = ["evaluate", "osmc", "--seeds", "2", "--first-seed", "1", "--naming", "0", "--json"];
    let board = ["--board", "sim:osmc-evaluation"];
    let told = r4(&[&arguments[..], &board, &["--report", page.to_str().expect("text")]].concat());
    // The exit code says whether all targets are met, which depends on the board's loops and is not tested here.
    assert!(matches!(told.code, Some(0 | 1)), "{told:?}");
    let told = object(&told.out);
    let rows = told["rows"].as_array().expect("rows");
    let row = |case: &str, metric: &str| {
        rows.iter()
            .find(|row| row["case"] == case && row["metric"] == metric)
            .unwrap_or_else(|| panic!("{case} {metric}"))
    };
    for (case, paper) in [("geared 360 deg", 3.0), ("geared 90 deg", 1.0), ("linear 10 mm", 3.0)] {
        assert_eq!(row(case, "error")["paper"].as_f64(), Some(paper), "{case}");
    }
    for row in rows {
        let number = |field: &str| row[field].as_f64().unwrap_or(f64::NAN);
        assert!(number("ours_median") <= number("ours_worst") && number("plants") == 2.0, "{row:#}");
        assert!(
            row["plain_pid"].is_number() || row["metric"].as_str().is_some_and(|name| name.contains("uncalibrated")),
            "{row:#}"
        );
    }
    assert_eq!(told["ladders"].as_array().map(Vec::len), Some(9));
    let met = rows.iter().all(|row| row["met"] != false);
    assert_eq!(met, told["failing"].as_array().is_some_and(Vec::is_empty), "{told:#}");
    let page = fs::read_to_string(page).expect("a page");
    assert!(
        page.contains("Seed 1</h2>") && page.contains("Seed 2</h2>") && page.matches("<svg").count() == 2,
        "{}",
        page.len()
    );
}

/// Sessions of synthetic participants as a study with people would record them. Too few people are refused, and a
/// second session under the same number.
#[test]
fn sessions_are_recorded_and_compared() {
    let folder = TempDir::new().expect("a folder");
    let out = folder.path().to_str().expect("text");
    let record = |number: &str| {
        ["evaluate", "xrhmi", "--session", number, "--out", out, "--board", "sim:cue-desk"].map(str::to_owned)
    };
    let mut tables = Vec::new();
    for number in 1..=5 {
        let number = number.to_string();
        let arguments = record(&number);
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).chain(["--json"]).collect();
        // On stderr it says which order the person has.
        let recorded = object(&r4(&arguments).out);
        assert_eq!((recorded["complete_trials"].as_u64(), recorded["stopped"].is_null()), (Some(3), true));
        tables.push(recorded["trials"].as_str().expect("a path").to_owned());
    }
    let compare = |tables: &[String]| {
        let mut arguments = vec!["evaluate", "xrhmi"];
        arguments.extend(tables.iter().map(String::as_str));
        arguments.push("--json");
        r4(&arguments)
    };
    let rows = object(&compare(&tables).out)["rows"].as_array().expect("rows").clone();
    let named: Vec<_> = rows.iter().map(|row| row["measure"].as_str().expect("a name").to_owned()).collect();
    assert_eq!(named, ["time_s", "time_s", "time_s", "mistakes", "mistakes", "mistakes", "sus", "sus", "sus"]);
    assert!(rows.iter().all(|row| row["people"] == 5), "{rows:?}");
    let told = compare(&tables[..3]);
    assert!(told.code == Some(1) && told.err.contains("a comparison needs four"), "{told:?}");
    let again = record("1");
    let told = r4(&again.iter().map(String::as_str).collect::<Vec<_>>());
    assert!(told.code == Some(1) && told.err.contains("cannot create"), "{told:?}");
}
