//! `cargo xtask test`.

use std::{
    env,
    io::{self, Write},
    path::Path,
    process::{Command, ExitCode},
    time::Instant,
};

use crate::{
    firmware::{self, Firmware},
    summary::{Outcome, Summary},
    toolchain::{self, TARGET},
};

/// Stand for the folders in which the board's image and the probe are built.
const GIGA_TARGET: &str = "target/giga";
const PROBE_TARGET: &str = "target/probe";

struct Step {
    name: &'static str,
    run: Run,
    /// Left out by `--fast`.
    slow: bool,
}

/// What a step does.
enum Run {
    /// Looks for what the others need, and adds what is missing.
    Toolchain,
    /// Builds the board's images that the tests run.
    Images,
    /// Calls cargo.
    Cargo {
        /// Within the repository: each has a workspace.
        folder: &'static str,
        arguments: &'static [&'static str],
        /// For where the caller's says nothing.
        environment: &'static [(&'static str, &'static str)],
    },
}

const fn cargo(folder: &'static str, arguments: &'static [&'static str]) -> Run {
    Run::Cargo { folder, arguments, environment: &[] }
}

/// The images that tests run on the emulated board.
const IMAGES: [(&str, &str); 4] =
    [("osmc-bench", "bare"), ("osmc-bench", "hosted"), ("openscout", "bare"), ("every-interface", "bare")];

/// Cheapest first: what fails most often is seen soonest.
const STEPS: [Step; 11] = [
    Step { name: "toolchain", run: Run::Toolchain, slow: false },
    Step { name: "format", run: cargo(".", &["fmt", "--all", "--check"]), slow: false },
    Step { name: "format, giga", run: cargo("firmware/giga", &["fmt", "--check"]), slow: false },
    Step { name: "format, probe", run: cargo("hil-sim/probe", &["fmt", "--check"]), slow: false },
    Step {
        name: "lints",
        run: cargo(".", &["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"]),
        slow: false,
    },
    // What the program leaves out by default and needs nothing that is not everywhere.
    Step {
        name: "lints, flash",
        run: cargo(".", &["clippy", "--package", "r4", "--features", "probe", "--", "-D", "warnings"]),
        slow: false,
    },
    Step {
        name: "lints, probe",
        run: cargo(
            "hil-sim/probe",
            &["clippy", "--release", "--locked", "--target-dir", PROBE_TARGET, "--", "-D", "warnings"],
        ),
        slow: false,
    },
    Step {
        name: "lints, giga",
        run: cargo(
            "firmware/giga",
            &[
                "clippy",
                "--release",
                "--locked",
                "--bins",
                "--tests",
                "--target-dir",
                GIGA_TARGET,
                "--",
                "-D",
                "warnings",
            ],
        ),
        slow: false,
    },
    Step { name: "images", run: Run::Images, slow: false },
    // Without further arguments cargo runs the documentation's examples too.
    Step {
        name: "tests",
        run: Run::Cargo {
            folder: ".",
            arguments: &["test", "--workspace"],
            // The same cases each time: what turns red is the change. Other cases are for who works on the code.
            environment: &[("PROPTEST_RNG_SEED", "1")],
        },
        slow: false,
    },
    Step {
        name: "docs",
        run: Run::Cargo {
            folder: ".",
            arguments: &["doc", "--workspace", "--no-deps"],
            environment: &[("RUSTDOCFLAGS", "-D warnings")],
        },
        slow: true,
    },
];

/// Runs the steps up to the first that fails, and says what became of each.
pub(crate) fn run(root: &Path, fast: bool) -> ExitCode {
    let steps = STEPS.iter().filter(|step| !(fast && step.slow));
    let (summary, problem) = run_all(steps, |step| execute(step, root));
    println!("\n{summary}");
    // What is said on stderr comes last.
    let _ = io::stdout().flush();
    match summary.failed() {
        None => ExitCode::SUCCESS,
        Some(step) => {
            eprintln!("error: the step `{step}` failed: {problem}");
            ExitCode::FAILURE
        }
    }
}

/// The summary, and what the failed step said.
fn run_all<'s>(
    steps: impl Iterator<Item = &'s Step>,
    mut execute: impl FnMut(&Step) -> Result<(), String>,
) -> (Summary, String) {
    let mut summary = Summary::default();
    let mut problem = String::new();
    for step in steps {
        if summary.failed().is_some() {
            summary.add(step.name, Outcome::NotRun);
            continue;
        }
        println!("\n==> {}: {}", step.name, step.command_line());
        let start = Instant::now();
        let result = execute(step);
        let took = start.elapsed();
        summary.add(step.name, if result.is_ok() { Outcome::Ok(took) } else { Outcome::Failed(took) });
        problem = result.err().unwrap_or_default();
    }
    (summary, problem)
}

fn execute(step: &Step, root: &Path) -> Result<(), String> {
    match &step.run {
        Run::Toolchain => toolchain::complete(root).and_then(|()| toolchain::emulator(root)),
        Run::Images => IMAGES.iter().try_for_each(|(robot, image)| {
            println!("{}", Firmware::new(robot, image).build(root)?);
            Ok(())
        }),
        Run::Cargo { folder, arguments, environment } => {
            let target = firmware::target_folder(root)?;
            let (giga, probe) = (target.join("giga"), target.join("probe"));
            let arguments = arguments.iter().map(|word| match *word {
                GIGA_TARGET => giga.as_os_str(),
                PROBE_TARGET => probe.as_os_str(),
                word => word.as_ref(),
            });
            let status = Command::new(toolchain::cargo())
                .args(arguments)
                .envs(environment.iter().filter(|(name, _)| env::var_os(name).is_none()).copied())
                .current_dir(root.join(folder))
                .status()
                .map_err(|error| format!("cargo cannot be started: {error}"))?;
            if status.success() {
                Ok(())
            } else {
                Err(format!("see above. To run it alone:\n  {}", step.command_line()))
            }
        }
    }
}

impl Step {
    /// As a person would type it.
    fn command_line(&self) -> String {
        match &self.run {
            Run::Toolchain => format!("rustfmt, clippy, the target {TARGET}, cmake and libclang"),
            Run::Images => "cargo xtask firmware, for each robot that tests emulate".into(),
            Run::Cargo { folder, arguments, environment } => {
                let into = if *folder == "." { String::new() } else { format!("cd {folder} && ") };
                let set: String = environment.iter().map(|(name, value)| format!("{name}='{value}' ")).collect();
                format!("{into}{set}cargo {}", arguments.join(" "))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_failure_ends_the_run() {
        let mut executed = Vec::new();
        let (summary, problem) = run_all(STEPS.iter(), |step| {
            executed.push(step.name);
            if step.name == "lints" { Err("a warning".into()) } else { Ok(()) }
        });
        assert_eq!(executed, ["toolchain", "format", "format, giga", "format, probe", "lints"]);
        assert_eq!(summary.failed(), Some("lints"));
        assert_eq!(problem, "a warning");
        assert_eq!(summary.to_string().matches("not run").count(), 6, "{summary}");
    }

    #[test]
    fn a_run_without_failure_has_every_step() {
        let (summary, _) = run_all(STEPS.iter(), |_| Ok(()));
        assert_eq!(summary.failed(), None);
        assert_eq!(summary.to_string().matches("  ok\n").count(), STEPS.len(), "{summary}");
    }

    #[test]
    fn a_step_is_shown_as_a_person_would_type_it() {
        let docs = STEPS.iter().find(|step| step.name == "docs").expect("there is one");
        assert_eq!(docs.command_line(), "RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps");
    }
}
