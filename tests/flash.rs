//! Tests of `r4 flash` without a debug probe.

use std::{fs, path::PathBuf};

use crate::program::*;
use r4_image::{RECORD_AT, seal_elf};
use sha2::{Digest, Sha256};
use tempfile::TempDir;

/// Length of the segment, bytes.
const BYTES: usize = 1100;

/// Makes an ELF file with one segment at `address` that begins with these words, and with the record of its CRC.
fn elf(address: u32, stack: u32, entry: u32) -> Vec<u8> {
    let mut elf = vec![0; 52];
    elf[..6].copy_from_slice(b"\x7fELF\x01\x01");
    (elf[0x1C], elf[0x2A], elf[0x2C]) = (52, 32, 1);
    for value in [1, 84, address, address, BYTES as u32, BYTES as u32, 5, 4, stack, entry] {
        elf.extend(u32::to_le_bytes(value));
    }
    elf.resize(84 + BYTES, 0x5A);
    elf[84 + RECORD_AT..][..32].fill(0xFF);
    elf[84 + RECORD_AT..][..4].copy_from_slice(b"R4im");
    seal_elf(&mut elf).expect("it has a place for it");
    elf
}

fn file(folder: &TempDir, name: &str, content: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, content).expect("a temporary folder can be written");
    path
}

fn hosted() -> Vec<u8> {
    elf(0x0804_0000, 0x2401_0000, 0x0804_0041)
}

fn bare() -> Vec<u8> {
    elf(0x0800_0000, 0x2401_0000, 0x0800_0041)
}

fn hex_digest(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn files_that_no_board_would_start_are_refused_before_a_probe_is_looked_for() {
    let folder = TempDir::new().expect("a folder");
    let text = file(&folder, "text.elf", b"not an image");
    let cut = file(&folder, "cut.elf", &bare()[..120]);
    let elsewhere = file(&folder, "elsewhere.elf", &elf(0x0810_0000, 0x2401_0000, 0x0810_0041));
    let no_stack = file(&folder, "no-stack.elf", &elf(0x0800_0000, 0x1001_0000, 0x0800_0041));
    let mut flipped = bare();
    flipped[84 + 1000] ^= 1;
    let flipped = file(&folder, "flipped.elf", &flipped);
    let mut other = bare();
    other[84 + RECORD_AT] = 0;
    let other = file(&folder, "other.elf", &other);
    let no_entry = file(&folder, "no-entry.elf", &elf(0x0800_0000, 0x2401_0000, 0x0804_0041));
    let bare = file(&folder, "bare.elf", &bare());
    all_refused([
        (&["flash", path(&text)][..], &["text.elf", "no ELF file"][..]),
        (&["flash", path(&cut)], &["cut.elf", "cut off"]),
        (&["flash", path(&elsewhere)], &["0x08100000", "(bare)", "(hosted)"]),
        (&["flash", path(&no_stack)], &["0x10010000", "no stack"]),
        (&["flash", path(&no_entry)], &["0x08040041", "no function"]),
        (&["flash", path(&flipped)], &["flipped.elf", "its record says 1120 bytes", "Build it again"]),
        (&["flash", path(&other)], &["other.elf", "no record of its CRC at 0x080003e0"]),
        (&["flash", "nowhere.elf"], &["cannot read", "nowhere.elf"]),
        (&["flash", "--robot", "no-such-robot"], &["no-such-robot-bare.elf", "cargo xtask firmware"]),
        (&["flash", "--robot", "no-such-robot", "--dfu"], &["no-such-robot-hosted.elf", "--image hosted"]),
        (&["flash", path(&bare), "--dfu"], &["bare image", "--image hosted"]),
        (&["flash", path(&bare), "--dfu", "--probe", "0483:374e"], &["--probe"]),
        (&["flash"], &["FILE"]),
    ]);
}

/// Flashes on a machine without a probe: the test asks for one by a number that no probe has.
#[test]
fn without_a_probe_it_says_which_image_it_would_have_been_and_what_to_do() {
    let folder = TempDir::new().expect("a folder");
    let image = file(&folder, "robot-bare.elf", &bare());
    let seen = r4(&["flash", path(&image), "--probe", "0483:374e:NO-SUCH-PROBE"]);
    assert!(seen.code == Some(1) && seen.out.is_empty(), "{seen:?}");
    let mut says = vec!["bare image, 1120 bytes from 0x08000000", "r4 flash --dfu"];
    if cfg!(feature = "probe") {
        says.extend(["no debug probe", "probe-setup", "NO-SUCH-PROBE"]);
    } else {
        says.extend(["built without debug probes", "--features probe", "--connect-under-reset"]);
    }
    let digest = hex_digest(&bare());
    says.push(&digest);
    for says in says {
        assert!(seen.err.contains(says), "{says}: {}", seen.err);
    }
}

#[cfg(not(feature = "dfu"))]
#[test]
fn dfu_makes_the_file_and_tells_how_it_is_written() {
    let folder = TempDir::new().expect("a folder");
    let image = file(&folder, "robot-hosted.elf", &hosted());
    let raw = folder.path().join("robot-hosted.bin");
    let told = good(&["flash", path(&image), "--dfu"]);
    let command = format!("dfu-util -d 2341:0366 -a 0 -s 0x08040000:leave -D {}", path(&raw));
    for says in ["twice", "--features dfu", &command, &hex_digest(&hosted())] {
        assert!(told.contains(says), "{says}: {told}");
    }
    // The file has whole flash words, the last one padded as erased flash is.
    let written = fs::read(&raw).expect("the file is there");
    assert_eq!(written[..BYTES], hosted()[84..]);
    assert_eq!(written[BYTES..], [0xFF; 20]);

    let report = good_json(&["flash", path(&image), "--dfu", "--json"]);
    assert_eq!((text(&report, "image"), number(&report, "bytes")), ("hosted", 1120.0));
    assert_eq!(text(&report, "sha256"), hex_digest(&hosted()));
    assert_eq!(array(&report, "command").len(), 9);
}

/// The board is refused before the program looks for anything on USB.
#[cfg(feature = "dfu")]
#[test]
fn dfu_goes_to_no_board_that_is_not_on_usb() {
    let folder = TempDir::new().expect("a folder");
    let image = file(&folder, "robot-hosted.elf", &hosted());
    for board in ["sim:osmc-bench", "tcp:localhost:1"] {
        let seen = r4(&["flash", path(&image), "--dfu", "--board", board]);
        assert!(seen.code == Some(1) && seen.err.contains("no board on USB"), "{seen:?}");
    }
}
