//! A client that knows the protocol by `docs/protocol.md` and `protocol/schema.json` alone, on a served board.

use std::process::{Command, Stdio};

use crate::program::*;
use serde_json::Value;

const CLIENT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/protocol/client.py");
const SCHEMA: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../protocol/schema.json");

/// What the client prints; `None` on a machine without Python, where nothing is tested.
fn client(argument: &str) -> Option<Value> {
    let started = Command::new("python3").args([CLIENT, SCHEMA, argument]).stdin(Stdio::null()).output();
    let Ok(output) = started else {
        eprintln!("not run: python3 cannot be started");
        return None;
    };
    let err = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{argument}: {err}");
    Some(object(&String::from_utf8_lossy(&output.stdout)))
}

#[test]
fn a_codec_by_the_page_reads_and_writes_every_golden_frame() {
    let Some(seen) = client("vectors") else { return };
    let schema = object(&std::fs::read_to_string(SCHEMA).expect("it is there"));
    let vectors = ["to_device", "to_host"].map(|direction| array(&schema["vectors"], direction).len());
    assert!(vectors.iter().all(|count| *count > 0), "{vectors:?}");
    assert_eq!(seen["vectors"], vectors.iter().sum::<usize>());
}

#[test]
fn a_client_by_the_page_moves_a_motor() {
    let mut server = start(command(&["sim", "serve", "osmc-bench", "--tcp"]));
    let place = object(&next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line"));
    server.out = None;
    let Some(seen) = client(text(&place, "tcp")) else { return };
    assert_eq!((text(&seen, "robot"), text(&seen, "state")), ("osmc-bench", "Disarmed"));
    assert!(number(&seen, "channels") > 1.0 && number(&seen, "telemetry") > 1.0, "{seen}");
    // The motor goes 0.3 rad at less than 2.5 rad/s: that takes several of the heartbeats, 50 ms apart.
    assert!(number(&seen, "heartbeats") > 2.0, "{seen}");
    // It counts as settled within 2.7 mrad of its target, and a count of its encoder is 2.6 mrad.
    let (target, end) = (number(&seen, "target_rad"), number(&seen, "to_rad"));
    assert!(target - number(&seen, "from_rad") > 0.29 && (target - end).abs() < 0.006, "{seen}");
}
