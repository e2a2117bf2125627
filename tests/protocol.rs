//! Tests of a client on served boards, which was written from `docs/protocol.md` and `protocol/schema.json` alone, without
//! a look at the sources; and of the files for C and Wireshark beside the schema.

use std::{
    fmt::Write as _,
    fs,
    path::Path,
    process::{Command, Stdio},
};

use crate::program::*;
use r4_protocol::VERSION;
use serde_json::Value;

const CLIENT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/protocol/client.py");
const DISSECTOR: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocol/r4.lua");
const FRAME_C: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/protocol/frame.c");
const SCHEMA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocol/schema.json");

/// Runs the client and returns its output; `None` on a machine without Python, where nothing is tested.
fn client(arguments: &[&str]) -> Option<Value> {
    let started = Command::new("python3").args([CLIENT, SCHEMA]).args(arguments).stdin(Stdio::null()).output();
    let Ok(output) = started else {
        eprintln!("not run: python3 cannot be started");
        return None;
    };
    let err = String::from_utf8_lossy(&output.stderr);
    let out = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{arguments:?}: {out}{err}");
    Some(object(&out))
}

#[test]
fn a_codec_by_the_page_reads_and_writes_every_golden_frame() {
    let Some(seen) = client(&["vectors"]) else { return };
    let schema = object(&fs::read_to_string(SCHEMA).expect("it is there"));
    let vectors = ["to_device", "to_host"].map(|direction| array(&schema["vectors"], direction).len());
    assert!(vectors.iter().all(|count| *count > 0), "{vectors:?}");
    assert_eq!(seen["vectors"], vectors.iter().sum::<usize>());
}

/// Runs over each kind of link, on each of which it negotiates from a version that does not exist yet, and through a
/// broker.
#[test]
fn a_client_by_the_page_moves_a_motor() {
    let first = VERSION + 1;
    let newer = ["--first-version", &first.to_string()];
    let sim = |link| ["sim", "serve", "osmc-bench", link];
    let shared = ["serve", "sim:osmc-bench", "--tcp", "127.0.0.1:0"];
    let negotiated: (&[&str], &[u16]) = (&newer, &[first]);
    for (serve, kind, scheme, (options, refused)) in [
        (&sim("--tcp")[..], "tcp", "", negotiated),
        (&sim("--pty"), "pty", "serial:", negotiated),
        (&sim("--slcan"), "slcan", "slcan:", negotiated),
        (&shared, "tcp", "", (&[], &[])),
    ] {
        let mut server = start(command(serve));
        let place = object(&next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line"));
        server.out = None;
        let link = format!("{scheme}{}", text(&place, kind));
        let Some(seen) = client(&[&[link.as_str()], options].concat()) else { return };
        assert_eq!((text(&seen, "robot"), text(&seen, "state")), ("osmc-bench", "Disarmed"));
        assert_eq!(
            (&seen["protocol_version"], &seen["refused_versions"]),
            (&VERSION.into(), &refused.into()),
            "{link}"
        );
        assert!(number(&seen, "channels") > 1.0 && number(&seen, "telemetry") > 1.0, "{seen}");
        // The motor goes 0.3 rad at less than 2.5 rad/s: that takes several heartbeats at 50 ms.
        assert!(number(&seen, "heartbeats") > 2.0, "{seen}");
        // The motor settles within 2.7 mrad of its target, and a count of its encoder is 2.6 mrad.
        let (target, end) = (number(&seen, "target_rad"), number(&seen, "to_rad"));
        assert!(target - number(&seen, "from_rad") > 0.29 && (target - end).abs() < 0.006, "{seen}");
    }
}

/// The header is C99 without a warning, and its numbers make a golden frame.
#[test]
fn a_c_program_by_the_header_makes_a_golden_frame() {
    let folder = tempfile::tempdir().expect("a folder");
    let program = folder.path().join("frame");
    let header = Path::new(SCHEMA).parent().expect("a folder");
    let compiled = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .args([header, Path::new(FRAME_C), Path::new("-o"), &program])
        .output();
    let Ok(compiled) = compiled else {
        eprintln!("not run: cc cannot be started");
        return;
    };
    assert!(compiled.status.success(), "{}", String::from_utf8_lossy(&compiled.stderr));
    let printed = Command::new(program).output().expect("it starts").stdout;
    let schema = object(&fs::read_to_string(SCHEMA).expect("it is there"));
    let bye = array(&schema["vectors"], "to_device").iter().find(|vector| vector["name"] == "bye").expect("a vector");
    assert_eq!(String::from_utf8_lossy(&printed), text(bye, "frame"));
}

/// Returns the dissector's name of a message: its variant, and that of the request or answer in it.
fn called(value: &Value) -> String {
    let variant = |value: &Value| match value {
        Value::String(name) => name.clone(),
        other => other.as_object().and_then(|object| object.keys().next()).expect("a variant").clone(),
    };
    let inner = [&value["Request"]["request"], &value["Response"]["result"]["Ok"], &value["Response"]["result"]["Err"]];
    match inner.into_iter().find(|inner| !inner.is_null()) {
        Some(inner) => format!("{} {}", variant(value), variant(inner)),
        None => variant(value),
    }
}

#[test]
fn the_dissector_names_every_golden_frame() {
    let folder = tempfile::tempdir().expect("a folder");
    let schema = object(&fs::read_to_string(SCHEMA).expect("it is there"));
    for (direction, ports) in [("to_device", "40000,5000"), ("to_host", "5000,40000")] {
        let vectors = array(&schema["vectors"], direction);
        let mut dump = String::new();
        for vector in vectors {
            let frame = text(vector, "frame").as_bytes();
            let bytes: Vec<&str> = frame.chunks(2).filter_map(|pair| str::from_utf8(pair).ok()).collect();
            writeln!(dump, "000000 {}\n", bytes.join(" ")).expect("a string takes it");
        }
        let (hex, pcap) = (folder.path().join("hex"), folder.path().join("pcap"));
        fs::write(&hex, dump).expect("written");
        let made = Command::new("text2pcap").args(["-q", "-T", ports]).args([&hex, &pcap]).output();
        let Ok(made) = made else {
            eprintln!("not run: text2pcap, which comes with tshark, cannot be started");
            return;
        };
        assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
        let seen = Command::new("tshark")
            .arg("-r")
            .arg(&pcap)
            .args(["-X", &format!("lua_script:{DISSECTOR}"), "-d", "tcp.port==5000,r4"])
            .args(["-T", "fields", "-e", "r4.message"])
            .output()
            .expect("tshark starts");
        let seen = String::from_utf8_lossy(&seen.stdout).into_owned();
        let expected: Vec<String> = vectors.iter().map(|vector| called(&vector["value"])).collect();
        assert_eq!(seen.lines().collect::<Vec<_>>(), expected, "{direction}");
    }
}
