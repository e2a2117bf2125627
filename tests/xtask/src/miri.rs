//! Task `cargo xtask miri`: the tests of what runs on the board, under Miri, which reports undefined behaviour.
//!
//! Of the two packages only the firmware has `unsafe` code (`root.rs`), but both rely on that of their dependencies. Miri
//! interprets the program, which is far slower than running it: CI does not run it, and not all tests were run under it yet.

use std::{path::Path, process::Command};

use crate::toolchain::call;

/// Toolchain with Miri, which is part of nightly ones only. Pinned, so that a new lint does not fail an old commit.
const NIGHTLY: &str = "nightly-2026-10-30";
/// Packages whose unit tests run.
const PACKAGES: [&str; 2] = ["r4-protocol", "r4-firmware"];

/// Options of `cargo xtask miri`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Miri {
    /// Part of the names of the tests that run; all if `None`.
    tests: Option<String>,
}

impl Miri {
    /// Reads the words after `miri`.
    ///
    /// # Errors
    /// The word that is no option.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        match *words {
            [] => Ok(Self::default()),
            ["--tests", tests] => Ok(Self { tests: Some(tests.to_owned()) }),
            ["--tests"] => Err("`--tests` needs a value".into()),
            [other, ..] => Err(format!("`miri` takes no `{other}`")),
        }
    }

    pub(crate) fn test(self, root: &Path) -> Result<(), String> {
        let profile = ["--profile", "minimal", "--component", "miri", "--component", "rust-src"];
        call(Command::new("rustup").args(["toolchain", "install", NIGHTLY]).args(profile))?;
        let mut miri = Command::new("rustup");
        miri.args(["run", NIGHTLY, "cargo", "miri", "test", "--locked", "--lib"]);
        miri.args(PACKAGES.map(|package| format!("--package={package}")));
        miri.arg("--target-dir").arg(crate::firmware::target_folder(root)?.join("miri"));
        miri.args(self.tests);
        // Isolated tests may not read the files of golden bytes and robots. Few cases of properties: the paths through the
        // code are the same in all of them.
        miri.env("MIRIFLAGS", "-Zmiri-disable-isolation").env("PROPTEST_CASES", "2");
        // The toolchain that runs this task would be used instead of the nightly one.
        miri.env_remove("CARGO").env_remove("RUSTUP_TOOLCHAIN").current_dir(root);
        call(&mut miri)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_lines_are_understood() {
        assert_eq!(Miri::parse(&[]), Ok(Miri::default()));
        assert_eq!(Miri::parse(&["--tests", "root"]), Ok(Miri { tests: Some("root".into()) }));
        assert!(
            Miri::parse(&["--tests"]).is_err() && Miri::parse(&["--fast"]).is_err_and(|text| text.contains("--fast"))
        );
    }
}
