//! Tasks of this repository: `cargo xtask test` is what CI runs.
//!
//! | module | subject |
//! | --- | --- |
//! | `test` | the steps of `cargo xtask test`, in their order |
//! | `firmware` | `cargo xtask firmware`: the image for the Giga |
//! | `size` | `cargo xtask size`: what that image takes, and whether it may |
//! | `image` | what an ELF file takes in flash and RAM |
//! | `toolchain` | the parts of the Rust toolchain the steps need |
//! | `summary` | what became of each step, as a table |

mod firmware;
mod image;
mod size;
mod summary;
mod test;
mod toolchain;

use std::{env, path::PathBuf, process::ExitCode};

use firmware::Firmware;
use size::Size;

const USAGE: &str = "\
usage: cargo xtask <task>

  test          everything CI checks: format, lints, firmware for the board, tests, documentation
  test --fast   without the documentation
  firmware      the image for the Arduino Giga, into target/firmware:
                [--robot NAME|FILE.toml] (default osmc-bench), [--image bare|hosted] (default bare)
  size          what that image takes in flash and RAM; fails over 256 KiB of flash or 128 KiB of RAM:
                [--robot NAME|FILE.toml] (default osmc-bench), [--json]";

/// The exit code for a command line that means nothing here.
const USAGE_ERROR: u8 = 2;

#[derive(Debug, PartialEq)]
enum Task {
    Help,
    Test { fast: bool },
    Firmware(Firmware),
    Size(Size),
}

fn main() -> ExitCode {
    let arguments: Vec<String> = env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    match parse(&arguments) {
        Ok(Task::Help) => {
            println!("{USAGE}");
            ExitCode::SUCCESS
        }
        Ok(Task::Test { fast }) => test::run(&root(), fast),
        Ok(Task::Firmware(firmware)) => firmware.run(&root()),
        Ok(Task::Size(size)) => size.run(&root()),
        Err(problem) => {
            eprintln!("error: {problem}\n\n{USAGE}");
            ExitCode::from(USAGE_ERROR)
        }
    }
}

fn parse(arguments: &[String]) -> Result<Task, String> {
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["help" | "--help" | "-h"] | ["test" | "firmware" | "size", "--help" | "-h"] => Ok(Task::Help),
        ["test"] => Ok(Task::Test { fast: false }),
        ["test", "--fast"] => Ok(Task::Test { fast: true }),
        ["firmware", ref words @ ..] => Firmware::parse(words).map(Task::Firmware),
        ["size", ref words @ ..] => Size::parse(words).map(Task::Size),
        [] => Err("no task given".into()),
        ["test", "--fast", extra, ..] | ["test", extra, ..] => Err(format!("`test` takes no `{extra}`")),
        [unknown, ..] => Err(format!("there is no task `{unknown}`")),
    }
}

/// The workspace: two folders above this crate, wherever the command was given.
fn root() -> PathBuf {
    concat!(env!("CARGO_MANIFEST_DIR"), "/../..").into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(line: &str) -> Result<Task, String> {
        parse(&line.split_whitespace().map(String::from).collect::<Vec<_>>())
    }

    #[test]
    fn command_lines_are_understood() {
        assert_eq!(of("test"), Ok(Task::Test { fast: false }));
        assert_eq!(of("test --fast"), Ok(Task::Test { fast: true }));
        assert_eq!(of("--help"), Ok(Task::Help));
        assert_eq!(of("test --help"), Ok(Task::Help));
    }

    #[test]
    fn others_are_refused_by_the_word_that_is_wrong() {
        for (line, word) in [("", "no task"), ("tset", "tset"), ("test fast", "fast"), ("test --fast -x", "-x")] {
            assert!(of(line).expect_err(line).contains(word), "{line}");
        }
    }

    #[test]
    fn the_root_is_the_workspace() {
        let manifest = std::fs::read_to_string(root().join("Cargo.toml")).expect("the root has a manifest");
        assert!(manifest.starts_with("[workspace]"));
    }
}
