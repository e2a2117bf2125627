//! Test programs of the workspace, run one after the other, and their slowest tests.

use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

use serde_json::Value;

use crate::toolchain;

/// Number of slow tests that are listed.
const SLOWEST: usize = 10;

/// Test program that cargo has built.
#[derive(Debug, PartialEq)]
struct Program {
    /// Name of package and target, as in `r4-sim, all`.
    name: String,
    executable: PathBuf,
    /// Folder in which cargo runs it.
    folder: PathBuf,
}

/// Test with its duration.
#[derive(Debug, PartialEq)]
struct Timed {
    seconds: f64,
    name: String,
}

/// Builds the test programs with `arguments` of `cargo test`, runs all of them, and lists the slowest tests.
///
/// # Errors
/// The programs with tests that failed.
pub(crate) fn run(root: &Path, arguments: &[&str], environment: &[(&str, &str)]) -> Result<(), String> {
    let (mut slowest, mut failed) = (Vec::new(), Vec::new());
    for program in built(root, arguments)? {
        println!("\n--> {}", program.name);
        if !run_one(&program, environment, &mut slowest)? {
            failed.push(program.name);
        }
    }
    slowest.sort_by(|a: &Timed, b| b.seconds.total_cmp(&a.seconds));
    println!("\nslowest tests, s:");
    for test in slowest.iter().take(SLOWEST) {
        println!("{:>8.1}  {}", test.seconds, test.name);
    }
    if failed.is_empty() { Ok(()) } else { Err(format!("tests failed in {}, see above", failed.join("; "))) }
}

fn built(root: &Path, arguments: &[&str]) -> Result<Vec<Program>, String> {
    let output = Command::new(toolchain::cargo())
        .args(arguments)
        .args(["--no-run", "--message-format", "json-render-diagnostics"])
        .current_dir(root)
        .stderr(Stdio::inherit())
        .output()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    if !output.status.success() {
        return Err("the tests do not build, see above".into());
    }
    Ok(String::from_utf8_lossy(&output.stdout).lines().filter_map(program).collect())
}

/// Reads a test program from one of cargo's messages; `None` for messages about something else.
fn program(message: &str) -> Option<Program> {
    let message: Value = serde_json::from_str(message).ok()?;
    if message["profile"]["test"] != true {
        return None;
    }
    let folder = Path::new(message["manifest_path"].as_str()?).parent()?.to_owned();
    // The id is path+file:///folder/of/it#name@version, or #version where the folder has the package's name.
    let id = message["package_id"].as_str()?;
    let (path, rest) = id.rsplit_once('#')?;
    let package = rest.split_once('@').map_or_else(|| path.rsplit('/').next(), |(name, _)| Some(name))?;
    Some(Program {
        name: format!("{package}, {}", message["target"]["name"].as_str()?),
        executable: message["executable"].as_str()?.into(),
        folder,
    })
}

/// Runs one program and returns whether all its tests passed.
fn run_one(program: &Program, environment: &[(&str, &str)], tests: &mut Vec<Timed>) -> Result<bool, String> {
    let cannot = |error| format!("{} cannot be run: {error}", program.executable.display());
    let mut child = Command::new(&program.executable)
        // The pinned toolchain reports times only with unstable options:
        // https://github.com/rust-lang/rust/issues/64888.
        .env("RUSTC_BOOTSTRAP", "1")
        .args(["-Zunstable-options", "--report-time"])
        .env("CARGO_MANIFEST_DIR", &program.folder)
        .envs(environment.iter().copied())
        .current_dir(&program.folder)
        .stdout(Stdio::piped())
        .spawn()
        .map_err(cannot)?;
    if let Some(stdout) = child.stdout.take() {
        for line in BufReader::new(stdout).split(b'\n') {
            let line = line.map_err(cannot)?;
            let line = String::from_utf8_lossy(&line);
            println!("{line}");
            tests.extend(
                timed(&line).map(|(name, seconds)| Timed { seconds, name: format!("{}: {name}", program.name) }),
            );
        }
    }
    Ok(child.wait().map_err(cannot)?.success())
}

/// Reads name and duration from a line like `test stops::dead_man ... ok <0.312s>`.
fn timed(line: &str) -> Option<(&str, f64)> {
    let (name, result) = line.strip_prefix("test ")?.split_once(" ... ")?;
    let seconds = result.rsplit_once('<')?.1.strip_suffix("s>")?;
    Some((name, seconds.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_where_there_are_any() {
        assert_eq!(timed("test stops::dead_man ... ok <0.312s>"), Some(("stops::dead_man", 0.312)));
        assert_eq!(timed("test a ... FAILED <12.000s>"), Some(("a", 12.0)));
        assert_eq!(timed("test can::all ... ignored, needs a kernel"), None);
        assert_eq!(timed("test result: ok. 3 passed; 0 failed; finished in 0.31s"), None);
        assert_eq!(timed("running 3 tests"), None);
    }

    #[test]
    fn programs_are_found_in_what_cargo_says() {
        let said = r#"{"reason":"compiler-artifact","package_id":"path+file:///r/hil-sim/board#r4-sim@0.1.0",
            "manifest_path":"/r/hil-sim/board/Cargo.toml","target":{"name":"all"},"profile":{"test":true},
            "executable":"/r/target/debug/deps/all-1"}"#;
        let found = program(said).expect("a test program");
        assert_eq!(found.name, "r4-sim, all");
        assert_eq!(found.folder, Path::new("/r/hil-sim/board"));
        let named_by_folder = said.replace("board#r4-sim@0.1.0", "xtask#0.1.0");
        assert_eq!(program(&named_by_folder).expect("a test program").name, "xtask, all");
        assert_eq!(program(&said.replace("true", "false")), None);
        assert_eq!(program(r#"{"reason":"build-finished","success":true}"#), None);
    }
}
