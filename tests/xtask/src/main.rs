//! Tasks of this repository: `cargo xtask test` is what CI runs.
//!
//! | module | subject |
//! | --- | --- |
//! | `probe` | builds the program that checks an emulated Cortex-M7 |
//! | `test` | the steps of `cargo xtask test`, in their order |
//! | `python` | `cargo xtask python`: the Python package as a wheel, installed and tested |
//! | `peers` | `cargo xtask peers`: the program beside stock rclpy, and a WebSocket client |
//! | `venv` | Python environments with what is pinned |
//! | `firmware` | `cargo xtask firmware`: the image for the Giga |
//! | `flash` | `cargo xtask flash`: the image written into the board |
//! | `size` | `cargo xtask size`: the size of that image, against its budgets |
//! | `protocol` | `cargo xtask size --protocol`: the size of encoding and decoding frames |
//! | `images` | `cargo xtask images`: the images that tests run |
//! | `background` | tasks beside the steps of `cargo xtask test` |
//! | `image` | sizes and symbols of an ELF file |
//! | `mutants` | `cargo xtask mutants`: changes that no test notices, against a list of those that are judged |
//! | `miri` | `cargo xtask miri`: tests of what runs on the board, interpreted by Miri |
//! | `toolchain` | the parts of the Rust toolchain the steps need |
//! | `programs` | the test programs, and the slowest tests in them |
//! | `summary` | outcome of each step, as a table |
//! | `meter` | wall-clock time and processor time |
//! | `wire` | `cargo xtask protocol`: the wire protocol as a page, a schema, a header and a dissector |
//! | `licences` | `cargo xtask licences`: licences, sources and second versions of what is linked in |
//! | `package` | `cargo xtask package`: the crates as they are published, and the program built of them |
//! | `release` | `cargo xtask release`: the program in an archive, with what goes with it |
//! | `pictures` | `cargo xtask pictures`: the pictures on the first page |
//! | `browser` | Chromium on this machine |
//! | `prose` | `cargo xtask prose`: counts that show how readable comments and pages are |
//! | `arrows` | test: the source files of a crate use each other one way |
//! | `weight` | `cargo xtask weight`: what a build of `r4` takes, and what it is spent on |

#[cfg(test)]
mod arrows;
mod background;
mod browser;
mod firmware;
mod flash;
mod image;
mod images;
mod licences;
mod meter;
mod miri;
mod mutants;
mod package;
mod peers;
mod pictures;
mod programs;
mod prose;
mod protocol;
mod python;
mod release;
mod size;
mod summary;
mod test;
mod toolchain;
mod venv;
mod weight;
mod wire;

mod probe;

use std::{
    env,
    path::{Path, PathBuf},
    process::ExitCode,
};

use firmware::Firmware;
use flash::Flash;
use miri::Miri;
use mutants::Mutants;
use peers::Peers;
use pictures::Pictures;
use prose::Prose;
use python::Python;
use release::Release;
use size::Size;
use test::Extent;
use weight::Weight;
use wire::Wire;

const USAGE: &str = "\
usage: cargo xtask <task>

  probe         builds the program that checks a Cortex-M7, for the STM32H747's memory and for qemu's mps2-an500
  test          everything CI checks: format, lints, firmware for the board, tests, documentation
  test --from STEP
                the same from a step of it on, by its name in the table: after one that failed
  test --quick  for daily work: without the emulated processor, the corpus of bad input and the documentation
  python        the Python package (host/python): a wheel, installed into an environment of its own and tested there; [--wheel] only
                the wheel, [--dist] as it is given to others, [--bench] with steps of environments per second
  peers         the program with its features live and ros2 beside programs of others, each in a Python environment of its own: a
                WebSocket client for Foxglove's protocol, stock rclpy of ROS 2 Jazzy and Kilted; skipped where their packages
                cannot be had, an error instead with R4_PEERS_REQUIRED=1: [--only foxglove|jazzy|kilted],
                [--program FILE] one that is built already
  environments  the Python environments of `python` and `peers` alone
  firmware      the image for the Arduino Giga, into target/firmware:
                [--robot NAME|FILE.toml] (default osmc-bench), [--image bare|hosted] (default bare)
  images        the images that tests run on the emulated board
  flash         the same, built and written into the board: by probe-rs over a debug probe [--probe VID:PID[:SERIAL]],
                or by dfu-util over USB (--dfu: the hosted image; press reset twice before).
                --dry-run prints the commands
  size          what that image takes of flash, RAM and the processor; fails over 768 KiB, 128 KiB, or 4 % of it for a control
                tick:
                [--robot NAME|FILE.toml] (default osmc-bench), [--json]
  size --protocol
                what encoding and decoding of frames takes; fails over 4 KiB of code for cycles: [--json]
  weight        what `cargo run --release -p r4` takes to build from an empty folder, and its slowest crates; fails over
                400 s of processor time. --dist: as it is given to others; fails over 15 MB of program. [--json]
  protocol      docs/protocol.md and what is beside protocol/src, from the protocol's types, comments and constants;
                --check fails for a file that is not what they make now
  licences      licences and sources of all that is linked in, and second versions in the default build, by deny.toml
  package       the crates as crates.io would get them, and the program compiled of these
  release       the program with manual pages, completions and udev rules in an archive, for the system that this runs on:
                target/release-archives; [--program FILE] packs that and builds none
  pictures      docs/pictures, of what the program makes now; needs Chromium: [--program FILE] one that is built already
  prose         counts of comments and pages that are hard to read, by the words of docs/glossary.md: [--json];
                --check fails where they exceed their limits
  mutants       changes to firmware/core, protocol and host/links that no test notices, by cargo-mutants, and how each is judged
                (tests/mutants.toml); fails for one that is not. Hours: [--package r4-firmware|r4-protocol|r4-links]
                [--file FILE]... [--shard K/N] [--tests FILTER] (nextest's)
  miri          unit tests of firmware/core and protocol under Miri, which reports undefined behaviour, with a nightly Rust that
                it installs by rustup: [--tests FILTER]";

/// Exit code for a command line that has no meaning here.
const USAGE_ERROR: u8 = 2;

#[derive(Debug, PartialEq)]
enum Task {
    Help,
    Probe,
    Test(Extent, Option<&'static str>),
    Python(Python),
    Peers(Peers),
    Images,
    Environments,
    Firmware(Firmware),
    Flash(Flash),
    Size(Size),
    Protocol { json: bool },
    Mutants(Mutants),
    Miri(Miri),
    Weight(Weight),
    Wire(Wire),
    Licences,
    Package,
    Pictures(Pictures),
    Prose(Prose),
    Release(Release),
}

fn main() -> ExitCode {
    // Cargo calls this program in place of the compiler, so that `cargo xtask weight` can measure each crate.
    if let Some(exit) = weight::compiler() {
        return exit;
    }
    let arguments: Vec<String> = env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    match parse(&arguments) {
        Ok(Task::Help) => {
            println!("{USAGE}");
            ExitCode::SUCCESS
        }
        Ok(Task::Probe) => probe::run(&root()),
        Ok(Task::Test(extent, from)) => test::run(&root(), extent, from),
        Ok(Task::Python(python)) => ended(python.test(&root())),
        Ok(Task::Peers(peers)) => ended(peers.test(&root())),
        Ok(Task::Images) => ended(images::build(&root())),
        Ok(Task::Environments) => ended(environments(&root())),
        Ok(Task::Firmware(firmware)) => firmware.run(&root()),
        Ok(Task::Flash(flash)) => flash.run(&root()),
        Ok(Task::Size(size)) => size.run(&root()),
        Ok(Task::Protocol { json }) => protocol::run(&root(), json),
        Ok(Task::Mutants(mutants)) => mutants.run(&root()),
        Ok(Task::Miri(miri)) => ended(miri.test(&root())),
        Ok(Task::Weight(weight)) => weight.run(&root()),
        Ok(Task::Wire(wire)) => wire.run(&root()),
        Ok(Task::Licences) => ended(licences::check(&root())),
        Ok(Task::Package) => ended(package::check(&root())),
        Ok(Task::Pictures(pictures)) => ended(pictures.make(&root())),
        Ok(Task::Prose(prose)) => prose.run(&root()),
        Ok(Task::Release(release)) => ended(release.make(&root())),
        Err(problem) => {
            eprintln!("error: {problem}\n\n{USAGE}");
            ExitCode::from(USAGE_ERROR)
        }
    }
}

/// Makes the Python environments of `python` and `peers`.
fn environments(root: &Path) -> Result<(), String> {
    Python::environment(root)?;
    Peers::default().environments(root).map(drop)
}

/// Prints a problem, if there is one, and returns the exit code of the task.
fn ended(result: Result<(), String>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(problem) => {
            eprintln!("error: {problem}");
            ExitCode::FAILURE
        }
    }
}

fn parse(arguments: &[String]) -> Result<Task, String> {
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["help" | "--help" | "-h"]
        | [
            "test" | "python" | "peers" | "firmware" | "flash" | "size" | "weight" | "pictures" | "prose" | "mutants"
            | "protocol" | "release" | "miri",
            "--help" | "-h",
        ] => Ok(Task::Help),
        ["test"] => Ok(Task::Test(Extent::Full, None)),
        ["test", "--quick"] => Ok(Task::Test(Extent::Quick, None)),
        ["test", "--from", step] => test::step_named(step).map(|step| Task::Test(Extent::Full, Some(step))),
        ["python", ref words @ ..] => Python::parse(words).map(Task::Python),
        ["peers", ref words @ ..] => Peers::parse(words).map(Task::Peers),
        ["images"] => Ok(Task::Images),
        ["environments"] => Ok(Task::Environments),
        ["firmware", ref words @ ..] => Firmware::parse(words).map(Task::Firmware),
        ["flash", ref words @ ..] => Flash::parse(words).map(Task::Flash),
        ["size", "--protocol"] => Ok(Task::Protocol { json: false }),
        ["size", "--protocol", "--json"] => Ok(Task::Protocol { json: true }),
        ["protocol", ref words @ ..] => Wire::parse(words).map(Task::Wire),
        ["weight", ref words @ ..] => Weight::parse(words).map(Task::Weight),
        ["pictures", ref words @ ..] => Pictures::parse(words).map(Task::Pictures),
        ["prose", ref words @ ..] => Prose::parse(words).map(Task::Prose),
        ["miri", ref words @ ..] => Miri::parse(words).map(Task::Miri),
        ["size", ref words @ ..] => Size::parse(words).map(Task::Size),
        ["mutants", ref words @ ..] => Mutants::parse(words).map(Task::Mutants),
        [] => Err("no task given".into()),
        ["test", "--from"] => Err("`--from` needs a step".into()),
        ["test", "--quick", extra, ..] | ["test", "--from", _, extra, ..] | ["test", extra, ..] => {
            Err(format!("`test` takes no `{extra}`"))
        }
        ["probe"] => Ok(Task::Probe),
        ["licences"] => Ok(Task::Licences),
        ["package"] => Ok(Task::Package),
        ["release", ref words @ ..] => Release::parse(words).map(Task::Release),
        [unknown, ..] => Err(format!("there is no task `{unknown}`")),
    }
}

/// Returns the folder of the workspace, two above this crate, whatever the current folder is.
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
        assert_eq!(of("test"), Ok(Task::Test(Extent::Full, None)));
        assert_eq!(of("test --quick"), Ok(Task::Test(Extent::Quick, None)));
        assert_eq!(of("test --from peers"), Ok(Task::Test(Extent::Full, Some("peers"))));
        assert_eq!(of("probe"), Ok(Task::Probe));
        assert_eq!(of("python"), Ok(Task::Python(Python::default())));
        assert_eq!(of("size --protocol"), Ok(Task::Protocol { json: false }));
        assert_eq!(of("size --protocol --json"), Ok(Task::Protocol { json: true }));
        assert_eq!(of("--help"), Ok(Task::Help));
        assert_eq!(of("test --help"), Ok(Task::Help));
    }

    #[test]
    fn others_are_refused_by_the_word_that_is_wrong() {
        for (line, word) in [
            ("", "no task"),
            ("tset", "tset"),
            ("test fast", "fast"),
            ("test --quick -x", "-x"),
            ("test --from teas", "docs"),
        ] {
            assert!(of(line).expect_err(line).contains(word), "{line}");
        }
    }

    #[test]
    fn the_root_is_the_workspace() {
        let manifest = std::fs::read_to_string(root().join("Cargo.toml")).expect("the root has a manifest");
        assert!(manifest.starts_with("[workspace]"));
    }
}
