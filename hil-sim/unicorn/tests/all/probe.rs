//! Runs the probe (hil-sim/probe) on every backend, and on qemu where that is installed: every check passes, and all
//! agree word for word.

#![allow(clippy::unwrap_used, reason = "failing is a test's way to speak")]

use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

use crate::common::{Tested, for_every_core, machine, run_semihosted};
use r4_mcu::{ResetCause, Settings, Size};

#[path = "../../../probe/src/arithmetic.rs"]
mod arithmetic;

/// Time limit longer than the probe takes, ns of virtual time.
const LONG_NS: u64 = 60_000_000_000;

/// ELF file of the probe: the one named by `R4_PROBE_ELF` (for qemu's layout `R4_PROBE_AN500_ELF`), or built now.
fn probe(variable: &str, features: &[&str]) -> Vec<u8> {
    let path = env::var_os(variable).map_or_else(|| build(features), PathBuf::from);
    fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn build(features: &[&str]) -> PathBuf {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../probe");
    // A folder for each layout: they are built at the same time, under the same name.
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("probe{}", features.concat()));
    let output = Command::new(env!("CARGO"))
        .args(["build", "--release", "--locked", "--features", &features.join(",")])
        .current_dir(&root)
        .env("CARGO_TARGET_DIR", &target)
        // The flags of the calling environment are for another target.
        .env_remove("RUSTFLAGS")
        .env_remove("CARGO_ENCODED_RUSTFLAGS")
        .output()
        .expect("cargo can be started");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    target.join("thumbv7em-none-eabihf/release/r4-probe")
}

fn on<C: Tested>() -> (String, u64, u64) {
    let mut machine = machine::<C>(Settings { stop_at_breakpoints: true, ..Settings::default() });
    machine.load_elf(&probe("R4_PROBE_ELF", &[])).unwrap();
    machine.reset(ResetCause::PowerOn).unwrap();
    machine.start_trace();
    let (text, passed) = run_semihosted(&mut machine, LONG_NS);
    let failed: Vec<_> = text.lines().filter(|line| line.contains("FAILED")).collect();
    assert!(passed && failed.is_empty(), "{failed:#?}");
    // The block in memory has the same results.
    let block = machine.symbols().address("R4_PROBE").unwrap();
    let word = |offset: u32| machine.chip.memory.read(block + offset, Size::Word).unwrap();
    assert_eq!(word(0), u32::from_le_bytes(*b"R4PB"));
    assert_eq!((word(4) as usize, word(8)), (text.lines().count() - 1, 0));
    (text, machine.trace().unwrap().hash(), machine.instructions())
}

fn every_check_passes_and_a_second_run_does_the_same<C: Tested>() {
    let (text, hash, instructions) = on::<C>();
    let again = on::<C>();
    assert_eq!((&text, hash, instructions), (&again.0, again.1, again.2));
}

fn qemu_agrees_word_for_word<C: Tested>() {
    if Command::new("qemu-system-arm").arg("--version").output().is_err() {
        println!("there is no qemu-system-arm here: nothing compared");
        return;
    }
    let elf = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("probe-an500-{}.elf", std::process::id()));
    fs::write(&elf, probe("R4_PROBE_AN500_ELF", &["an500"])).unwrap();
    // Time by instructions, 64 ns each, so that the load of the PC does not matter: otherwise SysTick runs in real
    // time.
    let output = Command::new("qemu-system-arm")
        .args(["-icount", "shift=6,sleep=off"])
        .args(["-M", "mps2-an500", "-display", "none", "-monitor", "none", "-serial", "none"])
        .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
        .arg(&elf)
        .output()
        .unwrap();
    let theirs = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    let (ours, ..) = on::<C>();
    for (ours, theirs) in ours.lines().zip(theirs.lines()) {
        assert_eq!(ours, theirs);
    }
    assert_eq!(ours.lines().count(), theirs.lines().count(), "{theirs}");
}

#[test]
fn the_probe_expects_what_a_pc_computes() {
    assert_eq!(arithmetic::double_digest(10_000), 0x8BAC_74FA_B83C_6F7E);
    assert_eq!(arithmetic::single_digest(10_000), 0xF1A5_E73E);
    assert_eq!(arithmetic::integer_digest(10_000), 0xF493_F723);
}

for_every_core!(every_check_passes_and_a_second_run_does_the_same, qemu_agrees_word_for_word,);
