//! Task `cargo xtask probe`: builds the program that checks a Cortex-M7, for both of its memory layouts.
//!
//! The tests of `r4-unicorn` build it by themselves unless a variable names a built one. With the variables that this
//! task prints they use the programs built here.

use std::{
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use crate::toolchain::{self, TARGET};

/// Layouts of the program: the variable for the tests, its name, and the features of the build.
const LAYOUTS: [(&str, &str, &[&str]); 2] =
    [("R4_PROBE_ELF", "stm32h747", &[]), ("R4_PROBE_AN500_ELF", "an500", &["--features", "an500"])];

/// Builds both programs, and prints their paths.
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

/// Builds one program and returns the path of its ELF file.
fn build(root: &Path, layout: &str, features: &[&str]) -> Result<PathBuf, String> {
    // One folder for each layout, because both programs have the same name.
    let target = root.join("target/probe").join(layout);
    let status = Command::new(toolchain::cargo())
        .args(["build", "--release", "--locked"])
        .args(features)
        // Compiler flags for this target are in the folder's own configuration.
        .current_dir(root.join("hil-sim/probe"))
        .env("CARGO_TARGET_DIR", &target)
        .env_remove("RUSTFLAGS")
        .status()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    let elf = target.join(TARGET).join("release/r4-probe");
    if status.success() { Ok(elf) } else { Err(format!("the probe for {layout} cannot be built, see above")) }
}
