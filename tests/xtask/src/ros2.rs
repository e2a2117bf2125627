//! Task `cargo xtask ros2`: tests the node of `r4 ros2` beside stock rclpy.

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

/// Folder of the tests in the repository, with a file of pinned packages for each distribution.
const TESTS: &str = "host/ros2/tests";
/// Distributions of ROS 2 whose wheels are pinned there.
const DISTRIBUTIONS: [&str; 2] = ["jazzy", "kilted"];
/// Variable that is 1 where missing wheels are an error: in CI.
const REQUIRED: &str = "R4_ROS2_REQUIRED";

/// Options of `cargo xtask ros2`.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Ros2 {
    /// Distribution to test; `None` for all of them.
    only: Option<&'static str>,
    /// Path of a built program; `None` builds one.
    program: Option<PathBuf>,
}

impl Ros2 {
    /// Reads the words after `ros2`.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut ros2 = Self::default();
        let mut words = words.iter();
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("`{word}` needs a value"));
            match *word {
                "--only" => {
                    let asked = value()?;
                    let known = DISTRIBUTIONS.into_iter().find(|distribution| distribution == asked);
                    ros2.only =
                        Some(known.ok_or_else(|| {
                            format!("`--only` takes one of {}, not `{asked}`", DISTRIBUTIONS.join(", "))
                        })?);
                }
                "--program" => ros2.program = Some(value()?.into()),
                word => return Err(format!("`ros2` takes no `{word}`")),
            }
        }
        Ok(ros2)
    }

    /// Builds the program and tests it beside each distribution.
    pub(crate) fn test(&self, root: &Path) -> Result<(), String> {
        let target = firmware::target_folder(root)?;
        let mut peers = Vec::new();
        for distribution in DISTRIBUTIONS.into_iter().filter(|name| self.only.is_none_or(|only| only == *name)) {
            let pinned = format!("{TESTS}/{distribution}.txt");
            match Venv::with(root, &target.join("ros2").join(distribution), &pinned) {
                Ok(venv) => peers.push((distribution, venv)),
                Err(problem) if env::var_os(REQUIRED).is_some_and(|value| value == "1") => {
                    return Err(format!("{problem}\n{REQUIRED}=1, so this is no reason to skip {distribution}"));
                }
                Err(problem) => {
                    println!("\n*** SKIPPED: r4 ros2 IS NOT TESTED beside {distribution}: {problem} ***\n");
                }
            }
        }
        if peers.is_empty() {
            return Ok(());
        }
        let program = match &self.program {
            Some(program) => std::path::absolute(program).map_err(|error| format!("{}: {error}", program.display()))?,
            None => {
                let mut build = Command::new(toolchain::cargo());
                call(build.args(["build", "--package", "r4", "--features", "ros2"]).current_dir(root))?;
                target.join("debug").join("r4")
            }
        };
        for (distribution, venv) in peers {
            let begin = Instant::now();
            println!("{distribution}:");
            let pytest = ["-m", "pytest", "--quiet", "--durations", "5", "-r", "sP", "-p", "no:cacheprovider"];
            let mut tests = venv.python();
            // The tests set these variables of the node; the caller's would change its domain or its peers.
            for name in ["ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_STATIC_PEERS"] {
                tests.env_remove(name);
            }
            call(tests.args(pytest).env("R4_PROGRAM", &program).current_dir(root.join(TESTS)))?;
            println!("{distribution}: {:.0} s", begin.elapsed().as_secs_f64());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_is_understood() {
        assert_eq!(Ros2::parse(&[]), Ok(Ros2::default()));
        let both = Ros2 { only: Some("kilted"), program: Some("r4".into()) };
        assert_eq!(Ros2::parse(&["--only", "kilted", "--program", "r4"]), Ok(both));
        for (words, says) in
            [(&["--only"][..], "value"), (&["--only", "foxy"], "jazzy, kilted"), (&["--fast"], "--fast")]
        {
            assert!(Ros2::parse(words).expect_err("refused").contains(says), "{words:?}");
        }
    }
}
