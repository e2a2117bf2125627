//! Tests of recordings as a user makes and uses them.

use crate::program;
use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Output, Stdio},
};

use serde_json::Value;
use tempfile::TempDir;

/// Log of an earlier version of the program.
const PROTOCOL_3: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/protocol-3.mcap");

fn command(folder: &TempDir, args: &[&str]) -> Command {
    let mut command = program::command(args);
    command.current_dir(folder.path());
    command
}

fn r4(folder: &TempDir, args: &[&str]) -> Output {
    command(folder, args).output().expect("r4 runs")
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

fn json(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}{}", stderr(output)))
}

fn stdout(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn code(output: &Output) -> Option<i32> {
    output.status.code()
}

/// Records a move on a simulated board and returns the log's name.
fn recorded(folder: &TempDir) -> &'static str {
    let moved = r4(folder, &["move", "osmc0", "90deg", "--seed", "5", "--record", "move.mcap"]);
    assert_eq!(code(&moved), Some(0), "{}", stderr(&moved));
    "move.mcap"
}

fn bytes(folder: &TempDir, name: impl AsRef<Path>) -> Vec<u8> {
    fs::read(folder.path().join(name)).expect("the file is there")
}

#[test]
fn every_verb_is_recorded_and_played_again_to_the_last_bit() {
    let folder = folder();
    let interfaces = "sim:every-interface";
    for (board, verb) in [
        ("sim:osmc-bench", &["move", "actuator1", "10mm"][..]),
        ("sim:osmc-bench", &["speed", "osmc0", "60deg/s", "--for", "1"]),
        ("sim:osmc-bench", &["duty", "osmc0", "95%", "--for", "1"]),
        ("sim:osmc-bench", &["demo"]),
        ("sim:osmc-bench", &["watch", "--for", "1", "--pace", "max"]),
        (interfaces, &["step", "stepper0", "100"]),
        (interfaces, &["home", "stepper0", "--speed", "1rad/s"]),
        (interfaces, &["servo", "servo3", "30deg"]),
        (interfaces, &["uart", "0", "--write", "hi", "--read"]),
        (interfaces, &["i2c", "0", "0x50", "--read", "4"]),
        (interfaces, &["log", "record", "--for", "1", "--pace", "max", "--rate", "20", "--out", "a.mcap"]),
    ] {
        // Verbs that this board refuses are recorded as well.
        let run = r4(&folder, &[verb, &["--board", board, "--seed", "5", "--record", "a.mcap"]].concat());
        let told = stderr(&run);
        // The demo writes the same recording to its own folder.
        let log = if verb == ["demo"] { "r4-demo/log.mcap" } else { "a.mcap" };
        let replay = ["log", "replay", log, "--board", board, "--exact", "--json", "--record", "b.mcap"];
        let replay = r4(&folder, &replay);
        assert_eq!(code(&replay), Some(0), "{verb:?}: {told}{}{}", stdout(&replay), stderr(&replay));
        let replay = json(&replay);
        assert_eq!((&replay["identical"], &replay["seed"]), (&true.into(), &5.into()), "{verb:?}");
        let table = |log: &str| r4(&folder, &["log", "export", log, "--csv", "-"]).stdout;
        assert!(table(log) == table("b.mcap"), "{verb:?}: the tables differ");
    }
}

#[test]
fn a_bag_of_ros_2_is_made_once_beside_a_table() {
    let folder = folder();
    let log = recorded(&folder);
    let export = |args: &[&str]| r4(&folder, &[&["log", "export", log], args].concat());
    let made = export(&["--ros2", "bag", "--csv", "table.csv", "--json"]);
    assert_eq!(code(&made), Some(0), "{}", stderr(&made));
    assert!(stderr(&made).contains("the bag has no odom"), "a bench does not drive: {}", stderr(&made));
    let told = json(&made);
    let topics: Vec<_> = told["ros2"]["topics"].as_array().expect("topics").iter().map(|each| &each["topic"]).collect();
    assert_eq!(topics, ["/diagnostics", "/joint_states", "/r4/state"]);
    assert!(bytes(&folder, "bag/bag_0.mcap").len() > 1000 && bytes(&folder, "table.csv").starts_with(b"time_s,"));
    assert!(bytes(&folder, "bag/metadata.yaml").starts_with(b"rosbag2_bagfile_information:\n"));
    let again = export(&["--ros2", "bag"]);
    assert!(code(&again) == Some(1) && stderr(&again).contains("exists already"), "{}", stderr(&again));
    // Where to is needed, and the table cannot share stdout.
    assert_eq!(code(&export(&[])), Some(2));
    let mixed = export(&["--ros2", "other", "--csv", "-"]);
    assert!(code(&mixed) == Some(1) && stderr(&mixed).contains("stdout"), "{}", stderr(&mixed));
}

#[test]
fn another_run_is_told_apart_and_held_to_limits() {
    let folder = folder();
    let log = recorded(&folder);
    let replay = |args: &[&str]| r4(&folder, &[&["log", "replay", log], args].concat());
    // The replay must notice a motor that is not the recorded one.
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../boards");
    let bench = fs::read_to_string(robots.join("osmc-bench.toml")).expect("a robot");
    let slower = bench.replacen("speed_rad_s = 2.5", "speed_rad_s = 2.0", 1);
    assert_ne!(slower, bench);
    fs::write(folder.path().join("slower.toml"), slower).expect("written");
    fs::copy(robots.join("r4-carrier.toml"), folder.path().join("r4-carrier.toml")).expect("copied");
    fs::create_dir(folder.path().join("plants")).expect("made");
    for plant in ["osmc-bench-rotary.toml", "osmc-bench-actuator.toml"] {
        let to = folder.path().join("plants").join(plant);
        fs::copy(robots.join("plants").join(plant), to).expect("copied");
    }
    let other = ["--board", "sim:./slower.toml", "--json"];
    let free = replay(&other);
    assert_eq!(code(&free), Some(0), "without limits it only tells: {}", stderr(&free));
    let free = json(&free);
    assert_eq!(free["identical"], false);
    let signals = free["signals"].as_array().expect("signals");
    let position = signals.iter().find(|signal| signal["signal"] == "osmc0.position_rad").expect("a signal");
    let off = position["max"].as_f64().expect("a number");
    assert!((0.1..1.0).contains(&off), "a fifth slower over 1.57 rad: {off}");
    for (limit, met) in [
        (format!("osmc0.position_rad={}", off * 1.01), 0),
        (format!("osmc0.position_rad={}", off * 0.99), 1),
        (format!("position={}deg", off.to_degrees() * 1.01), 0),
        (format!("osmc0.position={}deg", off.to_degrees() * 0.99), 1),
        ("settled=0".into(), 1),
    ] {
        let judged = replay(&[&other[..], &["--within", &limit]].concat());
        assert_eq!(code(&judged), Some(met), "{limit}: {}", stdout(&judged));
    }
    assert_eq!(code(&replay(&[&other[..], &["--exact"]].concat())), Some(1));
    let typo = replay(&["--within", "osmc7.position_rad=1"]);
    assert_eq!(code(&typo), Some(1));
    assert!(stderr(&typo).contains("neither run has a signal osmc7.position_rad"), "{}", stderr(&typo));
    assert_eq!(code(&replay(&["--within", "position"])), Some(2), "no limit");
    let real = replay(&["--board", "tcp:127.0.0.1:1"]);
    assert_eq!(code(&real), Some(3));
    assert!(stderr(&real).contains("needs a simulated one"), "{}", stderr(&real));
}

#[test]
fn info_tells_what_was_done_and_what_is_missing() {
    let folder = folder();
    let record = ["log", "record", "osmc0", "supply0", "--for", "2", "--pace", "max", "--rate", "50", "--json"];
    let record = r4(&folder, &record);
    assert_eq!(code(&record), Some(0), "{}", stderr(&record));
    let record = json(&record);
    assert_eq!(record["log"], "r4-1.mcap", "a name that was free");
    assert_eq!((&record["samples"], &record["missing"]), (&200.into(), &0.into()), "{record}");
    let again = r4(&folder, &["log", "record", "osmc0", "--for", "0.1", "--pace", "max", "--json"]);
    assert_eq!(json(&again)["log"], "r4-2.mcap");

    // More channels and samples than the link carries.
    let much = ["log", "record", "--board", "sim:every-interface", "--rate", "1000"];
    let much = r4(&folder, &[&much[..], &["--for", "0.5", "--pace", "max", "--json"]].concat());
    let missing = json(&much)["missing"].as_u64().expect("a number");
    assert!(missing > 1000 && code(&much) == Some(1), "{missing}");
    assert!(stderr(&much).contains(&format!("{missing} samples did not arrive")), "{}", stderr(&much));

    let refused = r4(&folder, &["clear", "--record", "clear.mcap"]);
    let refused_code = code(&refused);
    let info = json(&r4(&folder, &["log", "info", "clear.mcap", "--json"]));
    assert_eq!(info["requests"]["clear"], 1, "{info}");
    assert_eq!(info["refusals"].as_array().map(Vec::len), Some(usize::from(refused_code == Some(3))), "{info}");

    let info = json(&r4(&folder, &["log", "info", recorded(&folder), "--json"]));
    assert_eq!(
        (&info["robot"], &info["board"], &info["seed"]),
        (&"osmc-bench".into(), &"sim:osmc-bench".into(), &5.into())
    );
    assert_eq!(info["requests"], serde_json::json!({"arm": 1, "bye": 1, "disarm": 1, "set": 1, "subscribe": 1}));
    let states: Vec<_> = info["states"].as_array().expect("states").iter().map(|state| &state["state"]).collect();
    assert_eq!(states, ["disarmed", "armed"]);
    let (command, program) = (info["command"].as_str(), info["program"].as_str());
    assert_eq!(command, Some("r4 move osmc0 90deg --seed 5 --record move.mcap"), "{info}");
    assert!(program.is_some_and(|program| program.starts_with("r4 ")), "{info}");
    // The date is that of the machine's clock: not before this test was written, nor in the far future.
    let at = info["recorded_at"].as_str().expect("a date");
    assert!(("2025-01-01T00:00:00Z".."2200").contains(&at), "{at}");
    let told = stdout(&r4(&folder, &["log", "info", "move.mcap"]));
    for expected in ["recorded  20", "command   ", "seed 5", "1 arm", "osmc0", "100.0"] {
        assert!(told.contains(expected), "{expected}: {told}");
    }
}

#[test]
fn a_table_has_what_was_recorded() {
    let folder = folder();
    let log = recorded(&folder);
    let table = stdout(&r4(&folder, &["log", "export", log, "--csv", "-"]));
    let mut lines = table.lines().map(|line| line.split(',').collect::<Vec<_>>());
    let head = lines.next().expect("a head");
    let column = |name: &str| head.iter().position(|column| *column == name).unwrap_or_else(|| panic!("{name}"));
    let (time, position, state) = (column("time_s"), column("osmc0.position_rad"), column("state"));
    let rows: Vec<_> = lines.collect();
    let times: Vec<f64> = rows.iter().map(|row| row[time].parse().expect("a number")).collect();
    assert!(times.is_sorted());
    let positions: Vec<f64> = rows.iter().filter_map(|row| row[position].parse().ok()).collect();
    assert!(positions.len() > 100, "{}", positions.len());
    assert!((positions[positions.len() - 1] - std::f64::consts::FRAC_PI_2).abs() < 0.02);
    let armed: Vec<_> = rows.iter().filter(|row| row[state] == "armed").collect();
    assert_eq!(armed.len(), 1, "told when it changes");
    assert!(rows.iter().any(|row| row[position].is_empty() && row[column("request")] == "arm"));

    assert_eq!(code(&r4(&folder, &["log", "export", log, "--csv", "t.csv"])), Some(0));
    assert_eq!(bytes(&folder, "t.csv"), table.as_bytes());
}

#[test]
fn a_report_needs_nothing_else() {
    let folder = folder();
    let made = r4(&folder, &["report", recorded(&folder), "--title", "a & b"]);
    assert_eq!(code(&made), Some(0), "{}", stderr(&made));
    let page = String::from_utf8(bytes(&folder, "report.html")).expect("text");
    for expected in ["a &amp; b", "<svg", "Position (°)", "Requests", "disarm"] {
        assert!(page.contains(expected), "{expected}");
    }
    assert!(!page.contains("src=") && !page.contains("<link"));
}

#[test]
fn a_log_of_protocol_3_is_read_reported_and_replayed() {
    let folder = folder();
    let info = json(&r4(&folder, &["log", "info", PROTOCOL_3, "--json"]));
    assert_eq!((&info["protocol"], &info["seed"]), (&3.into(), &Value::Null));
    assert_eq!(info["warnings"], serde_json::json!([]));
    let report = r4(&folder, &["report", PROTOCOL_3]);
    assert_eq!(code(&report), Some(0), "{}", stderr(&report));
    let page = String::from_utf8(bytes(&folder, "report.html")).expect("text");
    assert!(page.contains("osmc0") && page.contains("tripped"));
    assert_eq!(code(&r4(&folder, &["log", "export", PROTOCOL_3, "--csv", "t.csv"])), Some(0));

    // The bench of the recording tripped at once; this one does not.
    let replay = r4(&folder, &["log", "replay", PROTOCOL_3, "--json", "--record", "again.mcap"]);
    assert_eq!(code(&replay), Some(0), "{}", stderr(&replay));
    let told = json(&replay);
    assert_eq!((&told["inferred"], &told["identical"]), (&true.into(), &false.into()));
    let again = json(&r4(&folder, &["log", "info", "again.mcap", "--json"]));
    for request in ["arm", "set"] {
        assert_eq!(again["requests"][request], 1, "{again}");
    }
    assert_eq!(again["refusals"], serde_json::json!([]), "armed in time for its set point");
    let limit = ["log", "replay", PROTOCOL_3, "--within", "state=0"];
    assert_eq!(code(&r4(&folder, &limit)), Some(1), "the trip did not come again");
}

#[test]
fn files_that_are_no_logs_are_told_with_what_to_do() {
    let folder = folder();
    let whole = {
        recorded(&folder);
        bytes(&folder, "move.mcap")
    };
    let write = |name: &str, bytes: &[u8]| fs::write(folder.path().join(name), bytes).expect("written");
    write("empty", b"");
    write("text", b"time_s,duty\n0.0,0.5\n");
    write("stub", &whole[..50]);
    let told = [
        ("empty", "record or copy it again"),
        ("text", "give a log that `r4` recorded"),
        ("stub", "copy it again, or record again"),
        ("nothing", "cannot read nothing"),
    ];
    for (file, advice) in told {
        for verb in [
            &["log", "info", file][..],
            &["log", "export", file, "--csv", "t"],
            &["log", "replay", file],
            &["report", file],
        ] {
            let refused = r4(&folder, verb);
            let said = stderr(&refused);
            assert_eq!(code(&refused), Some(1), "{verb:?}");
            assert!(said.contains(file) && said.contains(advice) && said.lines().count() == 1, "{verb:?}: {said}");
        }
    }
    assert!(!folder.path().join("t").exists(), "nothing is written for them");

    // Cut as a killed program leaves it, and damaged: the rest is shown, with a message that it is not all.
    write("cut", &whole[..whole.len() * 2 / 3]);
    let mut damaged = whole.clone();
    // The damage is in the compressed data of the first chunk.
    let at = damaged.windows(3).position(|bytes| bytes == b"lz4").expect("a compression") + 100;
    damaged[at] ^= 1;
    write("damaged", &damaged);
    for (file, said) in [("cut", "ends early"), ("damaged", "is damaged from byte")] {
        let info = r4(&folder, &["log", "info", file]);
        assert_eq!(code(&info), Some(1), "{file}: not the whole log: {}", stderr(&info));
        assert!(stderr(&info).contains(said), "{}", stderr(&info));
        // A damaged chunk is skipped as a whole; the next one is read.
        assert!(stdout(&info).contains("│ osmc0"), "what there is is shown: {info:?}");
        let table = r4(&folder, &["log", "export", file, "--csv", "-"]);
        assert_eq!(code(&table), Some(1), "{file}: not the whole table");
    }
    let replay = r4(&folder, &["log", "replay", "cut", "--within", "position_rad=0.001"]);
    assert_eq!(code(&replay), Some(0), "what is left of it: {}{}", stdout(&replay), stderr(&replay));
}

#[test]
fn what_cannot_be_recorded_is_told() {
    let folder = folder();
    let nowhere = r4(&folder, &["info", "--record", "no/such/folder.mcap"]);
    assert_eq!(code(&nowhere), Some(1));
    assert!(stderr(&nowhere).contains("cannot make the log no/such/folder.mcap"), "{}", stderr(&nowhere));
    let without = r4(&folder, &["ports", "--record", "ports.mcap"]);
    assert_eq!(code(&without), Some(1));
    assert!(stderr(&without).contains("nothing was recorded"), "{}", stderr(&without));
    let unknown = r4(&folder, &["log", "record", "osmc9", "--for", "1", "--pace", "max"]);
    assert_eq!(code(&unknown), Some(3));
    assert!(stderr(&unknown).contains("no channel osmc9"), "{}", stderr(&unknown));
}

/// Records a served board, in real time, until Ctrl-C.
#[test]
fn a_served_board_is_recorded_until_ctrl_c() {
    let folder = folder();
    let mut served =
        command(&folder, &["sim", "serve", "osmc-bench", "--tcp"]).stdout(Stdio::piped()).spawn().expect("r4");
    let mut first = String::new();
    BufReader::new(served.stdout.as_mut().expect("piped")).read_line(&mut first).expect("where it is");
    let at: Value = serde_json::from_str(&first).unwrap_or_else(|error| panic!("{error}: {first}"));
    let board = format!("tcp:{}", at["tcp"].as_str().unwrap_or_else(|| panic!("{first}")));
    let record = ["log", "record", "--board", &board, "--out", "served.mcap", "--json"];
    let mut recording =
        command(&folder, &record).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("r4 starts");
    // The recording has begun once its file has something in it: the head of the first chunk.
    let file = folder.path().join("served.mcap");
    while fs::metadata(&file).map_or(0, |file| file.len()) == 0 {
        assert!(matches!(recording.try_wait(), Ok(None)), "it ended by itself");
        std::thread::yield_now();
    }
    let interrupt = Command::new("kill").args(["-INT", &recording.id().to_string()]).status();
    assert!(interrupt.is_ok_and(|status| status.success()));
    let recorded = recording.wait_with_output().expect("it ends");
    let interrupt = Command::new("kill").args(["-INT", &served.id().to_string()]).status();
    assert!(interrupt.is_ok_and(|status| status.success()));
    served.wait().expect("it ends");
    assert_eq!(code(&recorded), Some(0), "{}{}", stdout(&recorded), stderr(&recorded));
    let info = json(&recorded);
    assert_eq!((&info["board"], &info["seed"]), (&board.as_str().into(), &Value::Null));
    assert_eq!((&info["warnings"], &info["requests"]["bye"]), (&serde_json::json!([]), &1.into()), "{info}");
}
