//! `cargo xtask probe`: builds the program that checks a Cortex-M7, for both of its memory layouts.
//!
//! The tests of `r4-unicorn` build it by themselves where nothing says that it is there; with the variables this prints they
//! use what was built here.

use std::{
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use crate::toolchain::{self, TARGET};

/// Where a program lies: the variable that tells the tests, and the features of the build.
const LAYOUTS: [(&str, &str, &[&str]); 2] =
    [("R4_PROBE_ELF", "stm32h747", &[]), ("R4_PROBE_AN500_ELF", "an500", &["--features", "an500"])];

/// Builds both, and prints where they are.
pub(crate) fn run(root: &Path) -> ExitCode {
    for (variable, layout, features) in LAYOUTS {
        match build(root, layout, features) {
            Ok(elf) => println!("{variable}={}", elf.display()),
            Err(problem) => {
                eprintln!("error: {problem}");
                return ExitCode::FAILURE;
            }
        }
    }
    ExitCode::SUCCESS
}

/// Builds one; the ELF.
fn build(root: &Path, layout: &str, features: &[&str]) -> Result<PathBuf, String> {
    // A folder each: both are called the same.
    let target = root.join("target/probe").join(layout);
    let status = Command::new(toolchain::cargo())
        .args(["build", "--release", "--locked"])
        .args(features)
        // The flags for this target are in the folder's own configuration.
        .current_dir(root.join("hil-sim/probe"))
        .env("CARGO_TARGET_DIR", &target)
        .env_remove("RUSTFLAGS")
        .status()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    let elf = target.join(TARGET).join("release/r4-probe");
    if status.success() { Ok(elf) } else { Err(format!("the probe for {layout} cannot be built, see above")) }
}
