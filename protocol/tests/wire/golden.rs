//! Tests of the bytes of `tests/golden/v<VERSION>.txt`, and of the encodings that must never change.
//!
//! A changed row is a changed protocol: bump `VERSION`, write a line in `CHANGELOG.md`, then let
//! `R4_UPDATE_GOLDEN=1 cargo test -p r4-protocol --test wire golden` write the table of the new version.

use std::{collections::BTreeMap, env, fmt::Write, fs, path::PathBuf};

use r4_protocol::{FrameDecoder, Refusal, Request, SCHEMA_HASH, ToDevice, ToHost, VERSION, version::SPOKEN};

use crate::{coverage, frame, gives_back, payload, samples};

/// Schema hash of `VERSION` 14.
const PINNED_SCHEMA_HASH: u64 = 0xEDD7_792C_D1FE_369F;

#[test]
fn every_message_has_the_bytes_of_the_golden_table() {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/v{VERSION}.txt"));
    let ours = table();
    if env::var_os("R4_UPDATE_GOLDEN").is_some() {
        fs::write(&path, &ours).expect("the table can be written");
    }
    let golden = fs::read_to_string(&path).unwrap_or_default();
    let (golden, ours) = (rows(&golden), rows(&ours));
    let mut wrong = String::new();
    for (name, hex) in &ours {
        match golden.get(name) {
            None => writeln!(wrong, "no golden row:  {name} {hex}").expect("a string takes it"),
            Some(old) if old != hex => {
                writeln!(wrong, "changed bytes:  {name}\n  golden {old}\n  now    {hex}").expect("a string takes it");
            }
            Some(_) => {}
        }
    }
    // A row without a sample is a message that is not tested any more.
    for name in golden.keys().filter(|name| !ours.contains_key(*name)) {
        writeln!(wrong, "no sample for:  {name}").expect("a string takes it");
    }
    assert!(wrong.is_empty(), "{} and the code differ:\n{wrong}", path.display());
}

#[test]
fn every_golden_frame_is_taken() {
    for (name, message) in samples::to_device() {
        assert!(gives_back(&frame(&message), &message), "to-device {name}");
    }
    for (name, message) in samples::to_host() {
        assert!(gives_back(&frame(&message), &message), "to-host {name}");
    }
}

/// Checks each version that is spoken: every message is decoded as it was, and encoded as it was.
#[test]
fn every_message_of_every_spoken_version_has_kept_its_bytes() {
    fn again<T: r4_protocol::frame::Message>(hex: &str) -> String {
        let mut decoder = FrameDecoder::new();
        let bytes = (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex"));
        let message = bytes.filter_map(|byte| decoder.push::<T>(byte)).next().expect("a frame");
        message.map_or_else(|error| format!("{error:?}"), |message| self::hex(&frame(&message)))
    }
    for spoken in SPOKEN {
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("tests/golden/v{}.txt", spoken.version));
        let golden = fs::read_to_string(&path).unwrap_or_else(|why| panic!("{}: {why}", path.display()));
        // An empty or cut table would pass the loop below.
        assert!(rows(&golden).len() > 100, "{}", path.display());
        for (name, hex) in rows(&golden) {
            let now = if name.starts_with("to-device") { again::<ToDevice>(hex) } else { again::<ToHost>(hex) };
            assert_eq!(now, hex, "{name} of version {}", spoken.version);
        }
    }
}

#[test]
fn the_golden_table_has_every_variant() {
    let mut seen = coverage::Variants::new();
    samples::to_device().iter().for_each(|(_, message)| coverage::note(message, &mut seen));
    samples::to_host().iter().for_each(|(_, message)| coverage::note(message, &mut seen));
    let missing: Vec<_> = coverage::all().difference(&seen).cloned().collect();
    assert!(missing.is_empty(), "no sample, so no golden row, has {missing:?}: add one to tests/wire/samples.rs");
}

#[test]
fn the_schema_of_this_version_is_pinned() {
    assert_eq!(VERSION, 14, "the hash below belongs to version 14: pin the new one beside the new version");
    assert_eq!(
        SCHEMA_HASH, PINNED_SCHEMA_HASH,
        "the shape of a message changed ({SCHEMA_HASH:#018x}): bump VERSION, write a line in CHANGELOG.md, pin this hash"
    );
}

/// Checks the bytes by which a board and a host of any two versions agree or refuse each other: they never change,
/// whatever `VERSION` is.
#[test]
fn hello_and_its_refusal_are_frozen_for_ever() {
    let hello =
        // Numbers that take varints of several bytes, up to the longest.
        ToDevice::Request { seq: 0x1234, request: Request::Hello { version: 0x0102, schema: 0x8000_0000_0000_0001 } };
    let request = [
        0, // ToDevice::Request
        0xB4, 0x24, // seq
        0,    // Request::Hello
        0x82, 0x02, // version
        0x81, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x01, // schema
    ];
    assert_eq!(payload(&hello), request);

    let refusal = Refusal::ProtocolMismatch { version: 0x0102, schema: 0x8000_0000_0000_0001 };
    let response = [
        0, // ToHost::Response
        0xB4, 0x24, // seq
        1,    // Err
        0,    // Refusal::ProtocolMismatch
        0x82, 0x02, // version
        0x81, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x01, // schema
    ];
    assert_eq!(payload(&ToHost::Response { seq: 0x1234, result: Err(refusal) }), response);

    assert_eq!(
        hex(&frame(&hello)),
        "0103b4240f820281808080808080808001ce3200",
        "COBS, the checksum and its place are frozen with it"
    );
}

/// Returns the table, one row for each sample: `direction name hex`.
fn table() -> String {
    let mut table = format!(
        "# Frames of r4-protocol version {VERSION}: direction, name, bytes with COBS, CRC and delimiter.\n\
         # tests/wire/samples.rs says what is in each. A changed row is a changed protocol: see CHANGELOG.md.\n"
    );
    for (name, message) in samples::to_device() {
        writeln!(table, "to-device {name} {}", hex(&frame(&message))).expect("a string takes it");
    }
    for (name, message) in samples::to_host() {
        writeln!(table, "to-host {name} {}", hex(&frame(&message))).expect("a string takes it");
    }
    table
}

/// Splits a table into its rows, from `direction name` to hex.
fn rows(table: &str) -> BTreeMap<&str, &str> {
    let mut rows = BTreeMap::new();
    for line in table.lines().filter(|line| !line.starts_with('#')) {
        let (name, hex) = line.rsplit_once(' ').expect("a row is a name and bytes");
        assert!(rows.insert(name, hex).is_none(), "{name} is there twice");
    }
    rows
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
