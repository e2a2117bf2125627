//! `cargo xtask test`.

use std::{
    env,
    io::{self, Write},
    path::Path,
    process::{Command, ExitCode},
};

use crate::{
    firmware,
    images::{self, Background},
    licences,
    meter::Meter,
    package,
    peers::Peers,
    programs,
    python::Python,
    release::Release,
    summary::{Outcome, Summary},
    toolchain::{self, SYSTEMS, TARGET},
    wire::Wire,
};

/// Stand for the folders in which the board's image and the probe are built.
const GIGA_TARGET: &str = "target/giga";
const PROBE_TARGET: &str = "target/probe";

/// How much is tested.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Extent {
    /// What CI tests.
    Full,
    /// What a change is tried with many times a day: without the emulated processor, the library in C that it is compared with,
    /// the corpus of bad input, and the documentation.
    Quick,
}

struct Step {
    name: &'static str,
    run: Run,
}

/// What a step does.
enum Run {
    /// Looks for what the others need, and adds what is missing.
    Toolchain(Extent),
    /// Begins to build the board's images that tests run, beside the steps that follow.
    ImagesBegin,
    /// Waits for these images.
    Images,
    /// Tests the program beside programs of others.
    Peers,
    /// Runs the test programs that these arguments of cargo build, and names the slowest tests.
    Tests(&'static [&'static str]),
    /// Compares the page of the protocol and what goes with it with what the protocol's types make.
    Protocol,
    /// Compares licences and sources of what is linked in with what may be.
    Licences,
    /// Packages the crates and compiles the program of these.
    Packages,
    /// Makes the archive of a release, of the program that the tests have built.
    Release,
    /// Builds the Python package, installs it and runs its tests.
    Python,
    /// Calls cargo.
    Cargo {
        /// Within the repository: each has a workspace.
        folder: &'static str,
        arguments: &'static [&'static str],
        /// For where the caller's says nothing.
        environment: &'static [(&'static str, &'static str)],
    },
}

const fn step(name: &'static str, run: Run) -> Step {
    Step { name, run }
}

const fn cargo(folder: &'static str, arguments: &'static [&'static str]) -> Run {
    Run::Cargo { folder, arguments, environment: &[] }
}

/// The same cases of property tests each time: what turns red is the change. Other cases are for who works on the code.
const SAME_CASES: &[(&str, &str)] = &[("PROPTEST_RNG_SEED", "1")];

/// Features of the program that tests use.
const TESTED: &str = "r4/emu,r4/live,r4/parquet,r4/ros2";

/// Cheapest first: what fails most often is seen soonest. The steps for the tests differ in what they do, not in what they
/// compile: first everything is built, then run.
const FULL: &[Step] = &[
    step("toolchain", Run::Toolchain(Extent::Full)),
    FORMAT,
    FORMAT_GIGA,
    FORMAT_PROBE,
    PROTOCOL,
    step("licences", Run::Licences),
    // With what the program leaves out by default and needs nothing that is not everywhere.
    step(
        "lints",
        cargo(
            ".",
            &[
                "clippy",
                "--workspace",
                "--all-targets",
                "--features",
                "r4/dfu,r4/emu,r4/live,r4/parquet,r4/probe,r4/ros2",
                "--",
                "-D",
                "warnings",
            ],
        ),
    ),
    // Only the program is another one without it.
    step("lints, default", cargo(".", &["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"])),
    step(
        "lints, probe",
        cargo(
            "hil-sim/probe",
            &["clippy", "--release", "--locked", "--target-dir", PROBE_TARGET, "--", "-D", "warnings"],
        ),
    ),
    step(
        "lints, giga",
        cargo(
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
    ),
    step("images, begin", Run::ImagesBegin),
    // Compiled and not linked: it needs no tools of theirs.
    step("other systems", cargo(".", &["check", "--package", "r4", "--target", SYSTEMS[0], "--target", SYSTEMS[1]])),
    step("packages", Run::Packages),
    step("build tests", cargo(".", &["test", "--workspace", "--features", TESTED, "--no-run"])),
    step("images", Run::Images),
    step("tests", Run::Tests(&["test", "--workspace", "--features", TESTED])),
    step("peers", Run::Peers),
    step("python", Run::Python),
    step("archive", Run::Release),
    step("examples", cargo(".", &["test", "--workspace", "--features", TESTED, "--doc"])),
    step(
        "docs",
        Run::Cargo {
            folder: ".",
            arguments: &["doc", "--workspace", "--no-deps"],
            environment: &[("RUSTDOCFLAGS", "-D warnings")],
        },
    ),
];

const QUICK: &[Step] = &[
    step("toolchain", Run::Toolchain(Extent::Quick)),
    FORMAT,
    FORMAT_GIGA,
    FORMAT_PROBE,
    PROTOCOL,
    step(
        "lints",
        cargo(".", &["clippy", "--workspace", "--exclude", "r4-unicorn", "--all-targets", "--", "-D", "warnings"]),
    ),
    step("build tests", cargo(".", QUICK_TESTS_BUILT)),
    step("tests", Run::Tests(QUICK_TESTS)),
];

const FORMAT: Step = step("format", cargo(".", &["fmt", "--all", "--check"]));
const FORMAT_GIGA: Step = step("format, giga", cargo("firmware/giga", &["fmt", "--check"]));
const FORMAT_PROBE: Step = step("format, probe", cargo("hil-sim/probe", &["fmt", "--check"]));
const PROTOCOL: Step = step("protocol", Run::Protocol);

const QUICK_TESTS: &[&str] =
    &["test", "--workspace", "--exclude", "r4-unicorn", "--exclude", "r4-emu", "--exclude", "r4-fuzz"];
const QUICK_TESTS_BUILT: &[&str] =
    &["test", "--workspace", "--exclude", "r4-unicorn", "--exclude", "r4-emu", "--exclude", "r4-fuzz", "--no-run"];

/// Runs the steps up to the first that fails, and says what became of each.
pub(crate) fn run(root: &Path, extent: Extent) -> ExitCode {
    let steps = match extent {
        Extent::Full => FULL,
        Extent::Quick => QUICK,
    };
    let mut images = None;
    let (summary, problem) = run_all(steps, |step| execute(step, root, &mut images));
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
fn run_all(steps: &[Step], mut execute: impl FnMut(&Step) -> Result<(), String>) -> (Summary, String) {
    let mut summary = Summary::default();
    let mut problem = String::new();
    for step in steps {
        if summary.failed().is_some() {
            summary.add(step.name, Outcome::NotRun);
            continue;
        }
        println!("\n==> {}: {}", step.name, step.command_line());
        let meter = Meter::start();
        let result = execute(step);
        let cost = meter.cost();
        summary.add(step.name, if result.is_ok() { Outcome::Ok(cost) } else { Outcome::Failed(cost) });
        problem = result.err().unwrap_or_default();
    }
    (summary, problem)
}

/// Carries out a step. `images` is the build of images that was begun and not waited for.
fn execute(step: &Step, root: &Path, images: &mut Option<Background>) -> Result<(), String> {
    match &step.run {
        Run::Toolchain(Extent::Quick) => toolchain::complete(root, &[]),
        Run::Toolchain(Extent::Full) => {
            toolchain::complete(root, &toolchain::SYSTEMS)?;
            toolchain::emulator(root)
        }
        Run::ImagesBegin => {
            *images = Some(Background::start(root)?);
            Ok(())
        }
        Run::Images => images.take().map_or_else(|| images::build(root), Background::finish),
        Run::Peers => Peers::of_tests(root)?.test(root),
        Run::Protocol => Wire::Check.go(root),
        Run::Licences => licences::check(root),
        Run::Packages => package::check(root),
        Run::Release => Release::of_tests(root)?.make(root),
        Run::Python => Python::default().test(root),
        Run::Tests(arguments) => programs::run(root, arguments, &unless_set(SAME_CASES)),
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
                .envs(unless_set(environment))
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

/// What the caller's environment says nothing of.
fn unless_set(environment: &[(&'static str, &'static str)]) -> Vec<(&'static str, &'static str)> {
    environment.iter().filter(|(name, _)| env::var_os(name).is_none()).copied().collect()
}

impl Step {
    /// As a person would type it.
    fn command_line(&self) -> String {
        match &self.run {
            Run::Toolchain(Extent::Quick) => format!("rustfmt, clippy, the target {TARGET}"),
            Run::Toolchain(Extent::Full) => {
                format!("rustfmt, clippy, the targets {TARGET}, {}, cmake and libclang", SYSTEMS.join(", "))
            }
            Run::Tests(arguments) => command_line(".", SAME_CASES, arguments),
            Run::Protocol => "cargo xtask protocol --check".into(),
            Run::Licences => "cargo xtask licences".into(),
            Run::Packages => "cargo xtask package".into(),
            Run::Release => "cargo xtask release --program target/debug/r4".into(),
            Run::Python => "cargo xtask python".into(),
            Run::ImagesBegin => "cargo xtask images, beside the next steps".into(),
            Run::Images => "the end of cargo xtask images".into(),
            Run::Peers => "cargo xtask peers --program target/debug/r4".into(),
            Run::Cargo { folder, arguments, environment } => command_line(folder, environment, arguments),
        }
    }
}

fn command_line(folder: &str, environment: &[(&str, &str)], arguments: &[&str]) -> String {
    let into = if folder == "." { String::new() } else { format!("cd {folder} && ") };
    let set: String = environment.iter().map(|(name, value)| format!("{name}='{value}' ")).collect();
    format!("{into}{set}cargo {}", arguments.join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_failure_ends_the_run() {
        let mut executed = Vec::new();
        let (summary, problem) = run_all(FULL, |step| {
            executed.push(step.name);
            if step.name == "lints" { Err("a warning".into()) } else { Ok(()) }
        });
        assert_eq!(executed, ["toolchain", "format", "format, giga", "format, probe", "protocol", "licences", "lints"]);
        assert_eq!(summary.failed(), Some("lints"));
        assert_eq!(problem, "a warning");
        assert_eq!(summary.to_string().matches("not run").count(), FULL.len() - 7, "{summary}");
    }

    #[test]
    fn a_run_without_failure_has_every_step() {
        for steps in [FULL, QUICK] {
            let (summary, _) = run_all(steps, |_| Ok(()));
            assert_eq!(summary.failed(), None);
            assert_eq!(summary.to_string().matches("  ok\n").count(), steps.len(), "{summary}");
        }
    }

    #[test]
    fn a_step_is_shown_as_a_person_would_type_it() {
        let docs = FULL.iter().find(|step| step.name == "docs").expect("there is one");
        assert_eq!(docs.command_line(), "RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps");
    }
}
