//! Task `cargo xtask test`: the steps that check a change.

use std::{
    env, fs,
    io::{self, Write},
    path::Path,
    process::{Command, ExitCode},
};

use crate::{
    background::Background,
    firmware, images, licences,
    meter::Meter,
    package,
    peers::Peers,
    programs, prose,
    python::Python,
    release::Release,
    summary::{Outcome, Summary},
    toolchain::{self, SYSTEMS, TARGET},
    wire::Wire,
};

/// Folders in the place of those in which the board's image and the probe are built.
const GIGA_TARGET: &str = "target/giga";
const PROBE_TARGET: &str = "target/probe";

/// Extent of the tests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Extent {
    /// All that CI tests.
    Full,
    /// Selection to try a change many times a day: without the emulated processor, the library in C that it is compared
    /// with, the corpus of bad input, and the documentation.
    Quick,
}

struct Step {
    name: &'static str,
    run: Run,
}

/// Action of a step.
enum Run {
    /// Looks for the tools that the other steps need, and adds the missing ones.
    Toolchain(Extent),
    /// Begins to build the board's images that tests run, beside the steps that follow.
    ImagesBegin,
    /// Waits for these images.
    Images,
    /// Begins to make the Python environments of later steps.
    EnvironmentsBegin,
    /// Waits for these environments.
    Environments,
    /// Tests the program beside programs of others.
    Peers,
    /// Runs the test programs that these arguments of cargo build, and lists the slowest tests.
    Tests(&'static [&'static str]),
    /// Compares the page of the protocol and the files beside it with the output of the protocol's types.
    Protocol,
    /// Compares counts of comments and pages with their limits.
    Prose,
    /// Compares licences and sources of what is linked in with the permitted ones.
    Licences,
    /// Packages the crates and compiles the program from the packages.
    Packages,
    /// Makes the archive of a release, with the program that the tests have built, and tries it.
    Release,
    /// Builds the Python package, installs it and runs its tests.
    Python,
    /// Runs a command of cargo.
    Cargo {
        /// Folder in the repository; each has a workspace.
        folder: &'static str,
        arguments: &'static [&'static str],
        /// Variables that are set unless the caller's environment has them.
        environment: &'static [(&'static str, &'static str)],
    },
}

const fn step(name: &'static str, run: Run) -> Step {
    Step { name, run }
}

const fn cargo(folder: &'static str, arguments: &'static [&'static str]) -> Run {
    Run::Cargo { folder, arguments, environment: &[] }
}

/// Seed of property tests in CI: the cases are the same each time, so that a failure comes from the change. Developers
/// may try other cases.
const SAME_CASES: &[(&str, &str)] = &[("PROPTEST_RNG_SEED", "1")];

/// Features of the program that need nothing beyond the usual tools, for lints and documentation: both check the dependencies alike.
const CHECKED: &str = "r4/dfu,r4/emu,r4/live,r4/parquet,r4/probe,r4/ros2";

/// Features of the program that tests use.
const TESTED: &str = "r4/emu,r4/live,r4/parquet,r4/ros2";

/// Steps of a full test, the cheapest first: the most frequent failures are reported soonest. The steps of tests
/// compile the same: first everything is built, then it runs.
const FULL: &[Step] = &[
    step("toolchain", Run::Toolchain(Extent::Full)),
    FORMAT,
    FORMAT_GIGA,
    FORMAT_PROBE,
    PROTOCOL,
    step("prose", Run::Prose),
    step("licences", Run::Licences),
    step(
        "lints",
        cargo(".", &["clippy", "--workspace", "--all-targets", "--features", CHECKED, "--", "-D", "warnings"]),
    ),
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
    step("environments, begin", Run::EnvironmentsBegin),
    step("images, begin", Run::ImagesBegin),
    // With the default features alone; tests with these are linted by `--quick`. Checked and not linked, so that it needs no tools of those systems.
    step(
        "lints, other systems",
        cargo(
            ".",
            &["clippy", "--package", "r4", "--target", SYSTEMS[0], "--target", SYSTEMS[1], "--", "-D", "warnings"],
        ),
    ),
    step("packages", Run::Packages),
    step("build tests", cargo(".", &["test", "--workspace", "--features", TESTED, "--no-run"])),
    step("images", Run::Images),
    step("tests", Run::Tests(&["test", "--workspace", "--features", TESTED])),
    step("environments", Run::Environments),
    step("peers", Run::Peers),
    step("python", Run::Python),
    step("archive", Run::Release),
    step("examples", cargo(".", &["test", "--workspace", "--features", TESTED, "--doc"])),
    step(
        "docs",
        Run::Cargo {
            folder: ".",
            arguments: &["doc", "--workspace", "--no-deps", "--features", CHECKED],
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

/// Returns the name of the step of a full test that is called `name`.
///
/// # Errors
/// There is none; the message lists all.
pub(crate) fn step_named(name: &str) -> Result<&'static str, String> {
    FULL.iter().map(|step| step.name).find(|known| *known == name).ok_or_else(|| {
        let names: Vec<String> = FULL.iter().map(|step| format!("{:?}", step.name)).collect();
        format!("`{name}` is no step; the steps are {}", names.join(", "))
    })
}

/// Runs the steps, beginning with the one named `from` if it is given, up to the first that fails, and prints the outcome of each.
pub(crate) fn run(root: &Path, extent: Extent, from: Option<&str>) -> ExitCode {
    let steps = match extent {
        Extent::Full => FULL,
        Extent::Quick => QUICK,
    };
    let first = steps.iter().position(|step| from.is_some_and(|from| from == step.name)).unwrap_or(0);
    let steps = &steps[first..];
    let summary = match Summary::compared(root) {
        Ok(summary) => summary,
        Err(problem) => {
            eprintln!("error: {problem}");
            return ExitCode::FAILURE;
        }
    };
    let mut begun = Begun::default();
    let (summary, problem) = run_all(steps, summary, |step| execute(step, root, &mut begun));
    println!("\n{summary}");
    if from.is_none()
        && let Err(problem) = keep(root, extent, &summary)
    {
        eprintln!("warning: {problem}");
    }
    // Flushed, so that the message on stderr comes last.
    let _ = io::stdout().flush();
    match summary.failed() {
        None => ExitCode::SUCCESS,
        Some(step) => {
            eprintln!("error: the step `{step}` failed: {problem}");
            ExitCode::FAILURE
        }
    }
}

/// Writes the figures of a full run without failure below the target folder, to be committed in place of the older ones.
fn keep(root: &Path, extent: Extent, summary: &Summary) -> Result<(), String> {
    if extent == Extent::Quick || summary.failed().is_some() {
        return Ok(());
    }
    let file = firmware::target_folder(root)?.join("figures.toml");
    fs::write(&file, summary.figures()).map_err(|error| format!("{}: {error}", file.display()))
}

/// Returns the filled summary, and the message of the failed step.
fn run_all(
    steps: &[Step],
    mut summary: Summary,
    mut execute: impl FnMut(&Step) -> Result<(), String>,
) -> (Summary, String) {
    let mut problem = String::new();
    for step in steps {
        // Later steps are listed, so that the summary shows what was not tested.
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

/// Tasks that were begun and not waited for.
#[derive(Default)]
struct Begun {
    images: Option<Background>,
    environments: Option<Background>,
}

/// Carries out a step.
fn execute(step: &Step, root: &Path, begun: &mut Begun) -> Result<(), String> {
    match &step.run {
        Run::Toolchain(Extent::Quick) => toolchain::complete(root, &[]),
        Run::Toolchain(Extent::Full) => {
            toolchain::complete(root, &toolchain::SYSTEMS)?;
            toolchain::emulator(root)
        }
        Run::ImagesBegin => {
            begun.images = Some(Background::start(root, "images")?);
            Ok(())
        }
        Run::Images => begun.images.take().map_or_else(|| images::build(root), Background::finish),
        Run::EnvironmentsBegin => {
            begun.environments = Some(Background::start(root, "environments")?);
            Ok(())
        }
        Run::Environments => {
            // What could not be installed is tried again by the step that needs it, which decides whether that is an error.
            let made = begun.environments.take().map_or(Ok(()), Background::finish);
            made.unwrap_or_else(|problem| println!("{problem}"));
            Ok(())
        }
        Run::Peers => Peers::of_tests(root)?.test(root),
        Run::Protocol => Wire::Check.go(root),
        Run::Prose => prose::check(root),
        Run::Licences => licences::check(root),
        Run::Packages => package::check(root),
        Run::Release => Release::of_tests(root)?.make(root),
        Run::Python => Python::default().test(root),
        Run::Tests(arguments) => programs::run(root, arguments, &unless_set(SAME_CASES)),
        Run::Cargo { folder, arguments, environment } => {
            let target = firmware::target_folder(root)?;
            let (giga, probe) = (target.join("giga"), target.join("probe"));
            // The constants stand for folders that are known only at run time.
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

/// Returns the variables that the caller's environment does not set.
fn unless_set(environment: &[(&'static str, &'static str)]) -> Vec<(&'static str, &'static str)> {
    environment.iter().filter(|(name, _)| env::var_os(name).is_none()).copied().collect()
}

impl Step {
    /// Returns the command as a person would type it.
    fn command_line(&self) -> String {
        match &self.run {
            Run::Toolchain(Extent::Quick) => format!("rustfmt, clippy, the target {TARGET}"),
            Run::Toolchain(Extent::Full) => {
                format!("rustfmt, clippy, the targets {TARGET}, {}, cmake and libclang", SYSTEMS.join(", "))
            }
            Run::Tests(arguments) => command_line(".", SAME_CASES, arguments),
            Run::Protocol => "cargo xtask protocol --check".into(),
            Run::Prose => "cargo xtask prose --check".into(),
            Run::Licences => "cargo xtask licences".into(),
            Run::Packages => "cargo xtask package".into(),
            Run::Release => "cargo xtask release --program target/debug/r4".into(),
            Run::Python => "cargo xtask python".into(),
            Run::ImagesBegin => "cargo xtask images, beside the next steps".into(),
            Run::Images => "the end of cargo xtask images".into(),
            Run::EnvironmentsBegin => "cargo xtask environments, beside the next steps".into(),
            Run::Environments => "the end of cargo xtask environments".into(),
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
        let (summary, problem) = run_all(FULL, Summary::default(), |step| {
            executed.push(step.name);
            if step.name == "lints" { Err("a warning".into()) } else { Ok(()) }
        });
        assert_eq!(
            executed,
            ["toolchain", "format", "format, giga", "format, probe", "protocol", "prose", "licences", "lints"]
        );
        assert_eq!(summary.failed(), Some("lints"));
        assert_eq!(problem, "a warning");
        assert_eq!(summary.to_string().matches("not run").count(), FULL.len() - 8, "{summary}");
    }

    #[test]
    fn a_run_without_failure_has_every_step() {
        for steps in [FULL, QUICK] {
            let (summary, _) = run_all(steps, Summary::default(), |_| Ok(()));
            assert_eq!(summary.failed(), None);
            assert_eq!(summary.to_string().matches("  ok\n").count(), steps.len(), "{summary}");
        }
    }

    #[test]
    fn a_step_is_shown_as_a_person_would_type_it() {
        let docs = FULL.iter().find(|step| step.name == "docs").expect("there is one");
        let typed = format!("RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps --features {CHECKED}");
        assert_eq!(docs.command_line(), typed);
    }
}
