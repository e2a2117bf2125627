//! `cargo xtask test`.

use std::{
    io::{self, Write},
    path::Path,
    process::{Command, ExitCode},
    time::Instant,
};

use crate::{
    summary::{Outcome, Summary},
    toolchain::{self, TARGET},
};

struct Step {
    name: &'static str,
    /// For cargo; the toolchain step has none.
    arguments: &'static [&'static str],
    environment: &'static [(&'static str, &'static str)],
    /// Left out by `--fast`.
    slow: bool,
}

/// Cheapest first: what fails most often is seen soonest.
const STEPS: [Step; 6] = [
    Step { name: "toolchain", arguments: &[], environment: &[], slow: false },
    Step { name: "format", arguments: &["fmt", "--all", "--check"], environment: &[], slow: false },
    Step {
        name: "lints",
        arguments: &["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"],
        environment: &[],
        slow: false,
    },
    Step {
        name: "firmware",
        arguments: &["build", "--release", "--target", TARGET, "-p", "r4-firmware", "-p", "r4-protocol"],
        environment: &[],
        slow: false,
    },
    // Without further arguments cargo runs the documentation's examples too.
    Step { name: "tests", arguments: &["test", "--workspace"], environment: &[], slow: false },
    Step {
        name: "docs",
        arguments: &["doc", "--workspace", "--no-deps"],
        environment: &[("RUSTDOCFLAGS", "-D warnings")],
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
    if step.arguments.is_empty() {
        return toolchain::complete(root);
    }
    let status = Command::new(toolchain::cargo())
        .args(step.arguments)
        .envs(step.environment.iter().copied())
        .current_dir(root)
        .status()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    if status.success() { Ok(()) } else { Err(format!("see above. To run it alone:\n  {}", step.command_line())) }
}

impl Step {
    /// As a person would type it.
    fn command_line(&self) -> String {
        if self.arguments.is_empty() {
            return format!("rustfmt, clippy and the target {TARGET}");
        }
        let environment: String = self.environment.iter().map(|(name, value)| format!("{name}='{value}' ")).collect();
        format!("{environment}cargo {}", self.arguments.join(" "))
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
        assert_eq!(executed, ["toolchain", "format", "lints"]);
        assert_eq!(summary.failed(), Some("lints"));
        assert_eq!(problem, "a warning");
        assert_eq!(summary.to_string().matches("not run").count(), 3, "{summary}");
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
