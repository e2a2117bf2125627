//! `cargo xtask peers`: the program beside programs of others, which are Python packages from PyPI.

use std::{
    env,
    path::{Path, PathBuf},
    process::Command,
    time::Instant,
};

use crate::{
    firmware,
    toolchain::{self, call},
    venv::Venv,
};

/// Features that the tests need, beside the default ones.
const FEATURES: &str = "live,ros2";
/// Environment variable that makes missing packages an error where it is 1: set in CI.
const REQUIRED: &str = "R4_PEERS_REQUIRED";

/// Tests beside one peer.
#[derive(Debug, PartialEq)]
pub(crate) struct Suite {
    name: &'static str,
    /// Folder of the tests in the repository.
    tests: &'static str,
    /// File there with the pinned packages.
    pinned: &'static str,
}

static SUITES: [Suite; 4] = [
    Suite { name: "access", tests: "tests/access", pinned: "pinned.txt" },
    Suite { name: "foxglove", tests: "tests/foxglove", pinned: "pinned.txt" },
    Suite { name: "jazzy", tests: "host/ros2/tests", pinned: "jazzy.txt" },
    Suite { name: "kilted", tests: "host/ros2/tests", pinned: "kilted.txt" },
];

/// Options of `cargo xtask peers`.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Peers {
    /// Name of the one suite to run; all without it.
    only: Option<&'static str>,
    /// Program that is already built with the features; without it one is built.
    program: Option<PathBuf>,
}

impl Peers {
    /// Reads the words after `peers`.
    ///
    /// # Errors
    /// The first word that is no option, or an option without its value.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut peers = Self::default();
        let mut words = words.iter();
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("`{word}` needs a value"));
            match *word {
                "--only" => {
                    let asked = value()?;
                    let known = SUITES.iter().map(|suite| suite.name).find(|name| name == asked);
                    peers.only = Some(known.ok_or_else(|| {
                        let names = SUITES.each_ref().map(|suite| suite.name).join(", ");
                        format!("`--only` takes one of {names}, not `{asked}`")
                    })?);
                }
                "--program" => peers.program = Some(value()?.into()),
                word => return Err(format!("`peers` takes no `{word}`")),
            }
        }
        Ok(peers)
    }

    /// Tests the program that the tests of the workspace have built.
    ///
    /// # Errors
    /// There is no target folder.
    pub(crate) fn of_tests(root: &Path) -> Result<Self, String> {
        Ok(Self { only: None, program: Some(firmware::target_folder(root)?.join("debug").join("r4")) })
    }

    /// Makes the environments of the suites, and returns those whose packages can be installed.
    ///
    /// # Errors
    /// A suite's packages are missing where that is an error.
    pub(crate) fn environments(&self, root: &Path) -> Result<Vec<(&'static Suite, Venv)>, String> {
        let target = firmware::target_folder(root)?;
        let mut ready = Vec::new();
        for suite in SUITES.iter().filter(|suite| self.only.is_none_or(|only| only == suite.name)) {
            let pinned = format!("{}/{}", suite.tests, suite.pinned);
            match Venv::with(root, &target.join("peers").join(suite.name), &pinned) {
                Ok(venv) => ready.push((suite, venv)),
                Err(problem) if env::var_os(REQUIRED).is_some_and(|value| value == "1") => {
                    return Err(format!("{problem}\n{REQUIRED}=1, so this is no reason to skip {}", suite.name));
                }
                Err(problem) => {
                    println!("\n*** SKIPPED: r4 IS NOT TESTED beside {}: {problem} ***\n", suite.name);
                }
            }
        }
        Ok(ready)
    }

    /// Builds the program and runs the suites whose packages can be installed.
    ///
    /// # Errors
    /// The first suite that fails, or whose packages are missing where that is an error.
    pub(crate) fn test(&self, root: &Path) -> Result<(), String> {
        let target = firmware::target_folder(root)?;
        let ready = self.environments(root)?;
        if ready.is_empty() {
            return Ok(());
        }
        let program = match &self.program {
            Some(program) => std::path::absolute(program).map_err(|error| format!("{}: {error}", program.display()))?,
            None => {
                let mut build = Command::new(toolchain::cargo());
                call(build.args(["build", "--package", "r4", "--features", FEATURES]).current_dir(root))?;
                target.join("debug").join("r4")
            }
        };
        for (suite, venv) in ready {
            let begin = Instant::now();
            println!("{}:", suite.name);
            let pytest = ["-m", "pytest", "--quiet", "--durations", "5", "-r", "sP", "-p", "no:cacheprovider"];
            let mut tests = venv.python();
            // The tests set the node's variables themselves; those of the caller would interfere.
            for name in ["ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"] {
                tests.env_remove(name);
            }
            call(tests.args(pytest).env("R4_PROGRAM", &program).current_dir(root.join(suite.tests)))?;
            println!("{}: {:.0} s", suite.name, begin.elapsed().as_secs_f64());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_read() {
        assert_eq!(Peers::parse(&[]), Ok(Peers::default()));
        let both = Peers { only: Some("kilted"), program: Some("r4".into()) };
        assert_eq!(Peers::parse(&["--only", "kilted", "--program", "r4"]), Ok(both));
        for (words, says) in
            [(&["--only"][..], "value"), (&["--only", "foxy"], "foxglove, jazzy, kilted"), (&["--fast"], "--fast")]
        {
            assert!(Peers::parse(words).expect_err("refused").contains(says), "{words:?}");
        }
    }

    #[test]
    fn pinned_packages_are_there() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        for suite in &SUITES {
            assert!(root.join(suite.tests).join(suite.pinned).is_file(), "{suite:?}");
        }
    }
}
