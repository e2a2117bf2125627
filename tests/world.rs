//! Tests of robots with a body: the demo that drives round a room, and worlds named on the command line.

use std::fs;

use tempfile::TempDir;

use crate::program::{good, good_json, r4};

fn path(path: &std::path::Path) -> &str {
    path.to_str().expect("a temporary folder's path is text")
}

#[test]
fn openscout_drives_round_a_room_and_stops_for_people() {
    let folder = TempDir::new().expect("a folder");
    let report = good_json(&["demo", "--robot", "openscout", "--out", path(folder.path()), "--json"]);
    assert_eq!(report["board"], "sim:openscout");
    let rows = report["rows"].as_array().expect("rows");
    assert!(rows.iter().all(|row| row["met"] == true), "{report:#}");
    let value = |what: &str| rows.iter().find(|row| row["what"] == what).and_then(|row| row["value"].as_f64());
    assert_eq!((value("corners reached"), value("trips")), (Some(4.0), Some(1.0)), "{report:#}");
    let events: Vec<_> =
        report["events"].as_array().expect("events").iter().map(|event| event["what"].as_str()).collect();
    let stops = Some("stops for an obstacle");
    let (goes_on, tripped) = (Some("continues"), Some("tripped: proximity"));
    assert_eq!(events, [stops, goes_on, stops, tripped, Some("cleared and armed again"), goes_on]);
    let page = fs::read_to_string(folder.path().join("report.html")).expect("a report");
    for there in ["class=\"map\"", "path by odometry", "tripped: proximity", "Slip:", "by the range sensors"] {
        assert!(page.contains(there), "{there}");
    }
    // The log has the host's set points in whole microseconds; in the same world the wheels repeat within some counts.
    let log = folder.path().join("log.mcap");
    let again =
        ["log", "replay", path(&log), "--board", "sim:openscout", "--world", "square", "--within", "position=1deg"];
    good(&again);
}

#[test]
fn worlds_are_files_with_a_world_and_nothing_else() {
    let folder = TempDir::new().expect("a folder");
    let file = folder.path().join("wall.toml");
    fs::write(&file, "[world]\n[[world.wall]]\npoints_m = [[0.5, -1.0], [0.5, 1.0]]\n").expect("written");
    let near =
        good_json(&["--board", "sim:openscout", "--world", path(&file), "watch", "range0", "--for", "0.2", "--json"]);
    let range_m = near["channels"][0]["value"].as_f64().expect("a range");
    // Distance from the sensor at 0.2 m; the echo is measured in whole microseconds, 0.17 mm.
    assert!((range_m - 0.3).abs() < 1e-3, "{near}");

    for (text, says) in [
        ("[world]\nstart = { x_m = 0.0 }\n", "wall.toml:2: world.start: missing field `y_m`"),
        ("[world]\n[[world.post]]\ncentre_m = [0, 0]\nradius_m = -1.0\n", "wall.toml:2: world.post[0]: `radius_m`"),
        ("name = \"x\"\n[world]\n", "unknown field `name`"),
    ] {
        fs::write(&file, text).expect("written");
        let seen = r4(&["--board", "sim:openscout", "--world", path(&file), "info"]);
        assert!(seen.code != Some(0) && seen.err.contains(says), "{text}: {seen:?}");
    }
    for (args, says) in [
        (["--board", "sim:osmc-bench", "--world", "square", "info"], "no [body]"),
        (["--board", "sim:openscout", "--world", "moon", "info"], "there is no world `moon`: write square, stand"),
    ] {
        let seen = r4(&args);
        assert!(seen.code != Some(0) && seen.err.contains(says), "{seen:?}");
    }
}
