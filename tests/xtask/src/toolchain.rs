//! Parts of the Rust toolchain that the steps need beyond cargo and rustc.
//!
//! Missing parts are found by asking the tools, so that a Rust that did not come from rustup works. Only adding missing
//! parts needs rustup.

use std::{
    env,
    ffi::OsString,
    path::{Path, PathBuf},
    process::Command,
};

use serde::{Deserialize, de::DeserializeOwned};

/// Target of the Giga's Cortex-M7.
pub(crate) const TARGET: &str = "thumbv7em-none-eabihf";
/// Other systems for which the program is checked.
pub(crate) const SYSTEMS: [&str; 2] = ["aarch64-apple-darwin", "x86_64-pc-windows-gnu"];

/// Returns the cargo that runs this task, so that every step uses the same toolchain.
pub(crate) fn cargo() -> OsString {
    env::var_os("CARGO").unwrap_or_else(|| "cargo".into())
}

/// Returns the compiler of the toolchain that runs this task; cargo and rustup name it or put it first into `PATH`.
fn rustc() -> OsString {
    env::var_os("RUSTC").unwrap_or_else(|| "rustc".into())
}

/// Returns packages as `cargo metadata` reports them: those of this repository, or with others those of every feature.
pub(crate) fn packages<P: DeserializeOwned>(root: &Path, with_others: bool) -> Result<Vec<P>, String> {
    #[derive(Deserialize)]
    struct Metadata<P> {
        packages: Vec<P>,
    }

    let which = if with_others { "--all-features" } else { "--no-deps" };
    let metadata = Command::new(cargo())
        .args(["metadata", "--format-version", "1", "--locked", which])
        .current_dir(root)
        .output()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    if !metadata.status.success() {
        return Err(String::from_utf8_lossy(&metadata.stderr).into_owned());
    }
    let read: Result<Metadata<P>, _> = serde_json::from_slice(&metadata.stdout);
    read.map(|metadata| metadata.packages).map_err(|error| format!("cargo metadata: {error}"))
}

/// Line of `cargo tree`: a package that another one needs.
#[derive(Debug, PartialEq)]
pub(crate) struct Node {
    /// Number of dependencies between the program and the package.
    pub(crate) depth: usize,
    pub(crate) name: String,
    pub(crate) version: String,
}

impl Node {
    /// Reads a line like `2rustix v1.1.6`, or `None` for one that is no package.
    pub(crate) fn read(line: &str) -> Option<Self> {
        let digits = line.find(|letter: char| !letter.is_ascii_digit())?;
        let mut words = line[digits..].split(' ');
        let (name, version) = (words.next()?.to_owned(), words.next()?.trim_start_matches('v').to_owned());
        Some(Self { depth: line[..digits].parse().ok()?, name, version })
    }
}

/// Returns the packages that a package of this repository is built from with its default features, in the order and
/// with the depths of `cargo tree`.
pub(crate) fn tree(root: &Path, package: &str) -> Result<Vec<Node>, String> {
    let arguments = ["tree", "--locked", "--package", package, "--edges", "normal,build", "--prefix", "depth"];
    let output = Command::new(cargo())
        .args(arguments)
        .current_dir(root)
        .output()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    if !output.status.success() {
        return Err(format!("cargo tree: {}", String::from_utf8_lossy(&output.stderr)));
    }
    Ok(String::from_utf8_lossy(&output.stdout).lines().filter_map(Node::read).collect())
}

/// Runs a command, which prints its own output and errors.
pub(crate) fn call(command: &mut Command) -> Result<(), String> {
    let status = command.status();
    let words = [command.get_program()].into_iter().chain(command.get_args());
    let shown = words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ");
    match status {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(format!("`{shown}` ended with {status}")),
        Err(error) => Err(format!("`{shown}` cannot be started: {error}")),
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Part {
    Rustfmt,
    Clippy,
    Target(&'static str),
}

/// Parts that every run needs.
const ALWAYS: [Part; 3] = [Part::Rustfmt, Part::Clippy, Part::Target(TARGET)];

impl Part {
    fn is_there(self, root: &Path) -> bool {
        match self {
            Self::Rustfmt => output(Command::new(cargo()).args(["fmt", "--version"]), root).is_some(),
            Self::Clippy => output(Command::new(cargo()).args(["clippy", "--version"]), root).is_some(),
            Self::Target(target) => {
                output(Command::new(rustc()).args(["--print", "target-libdir", "--target", target]), root)
                    .is_some_and(|folder| Path::new(folder.trim()).is_dir())
            }
        }
    }

    /// Returns arguments for `rustup`. Called in the workspace, it works on the toolchain that runs this task.
    fn rustup_arguments(self) -> [&'static str; 3] {
        match self {
            Self::Rustfmt => ["component", "add", "rustfmt"],
            Self::Clippy => ["component", "add", "clippy"],
            Self::Target(target) => ["target", "add", target],
        }
    }

    fn name(self) -> &'static str {
        self.rustup_arguments()[2]
    }
}

/// Returns the folder of the toolchain that builds in `root`.
pub(crate) fn sysroot(root: &Path) -> Option<PathBuf> {
    output(Command::new(rustc()).args(["--print", "sysroot"]), root).map(|folder| folder.trim().into())
}

/// Returns the system for which the toolchain that builds in `root` compiles, in the compiler's notation.
pub(crate) fn host(root: &Path) -> Option<String> {
    let said = output(Command::new(rustc()).arg("-vV"), root)?;
    said.lines().find_map(|line| line.strip_prefix("host: ")).map(Into::into)
}

/// Adds missing parts, including those of `targets` besides the board's.
///
/// # Errors
/// The parts that a person has to install.
pub(crate) fn complete(root: &Path, targets: &[&'static str]) -> Result<(), String> {
    let needed = || ALWAYS.into_iter().chain(targets.iter().copied().map(Part::Target));
    let missing = || needed().filter(|part| !part.is_there(root)).collect::<Vec<_>>();
    for part in missing() {
        eprintln!("{} is missing: rustup {}", part.name(), part.rustup_arguments().join(" "));
        // The exit code is ignored, because the check is repeated below.
        let _ = Command::new("rustup").args(part.rustup_arguments()).current_dir(root).status();
    }
    match &missing()[..] {
        [] => Ok(()),
        missing => Err(advice(missing, output(Command::new("rustup").arg("--version"), root).is_some())),
    }
}

/// Checks the tools that build Unicorn, against which the emulated processor is tested: a C compiler, cmake, and
/// libclang for the bindings. As root on a Debian, as in CI, missing ones are installed.
///
/// # Errors
/// The packages that a person has to install.
pub(crate) fn emulator(root: &Path) -> Result<(), String> {
    let is_there = || {
        let libraries = output(Command::new("ldconfig").arg("-p"), root).unwrap_or_default();
        output(Command::new("cmake").arg("--version"), root).is_some()
            && (libraries.contains("libclang") || env::var_os("LIBCLANG_PATH").is_some() || cfg!(target_os = "macos"))
    };
    if is_there() {
        return Ok(());
    }
    println!("cmake or libclang is missing: apt-get install cmake libclang-dev");
    for arguments in
        [&["update", "-q"][..], &["install", "-q", "-y", "--no-install-recommends", "cmake", "libclang-dev"]]
    {
        // The exit code is ignored, because the check is repeated below.
        let _ = Command::new("apt-get").args(arguments).status();
    }
    let advice = "the tests of the emulated processor need cmake and libclang, and apt-get could not install them, see above. Install them \
                  with what installs software on this machine, as in `sudo apt-get install cmake libclang-dev`, or say \
                  with LIBCLANG_PATH where libclang is";
    if is_there() { Ok(()) } else { Err(advice.into()) }
}

fn advice(missing: &[Part], with_rustup: bool) -> String {
    let names: Vec<_> = missing.iter().map(|part| part.name()).collect();
    let commands: String =
        missing.iter().map(|part| format!("\n  rustup {}", part.rustup_arguments().join(" "))).collect();
    let how = if with_rustup {
        "rustup could not add them, see above. When it can, run in this folder:"
    } else {
        "there is no rustup to add them. Install them with what installed your Rust, or install rustup \
         (https://rustup.rs) and run in this folder:"
    };
    format!("this Rust toolchain lacks {}.\n{how}{commands}", names.join(", "))
}

/// Returns the output of a command, or `None` when it cannot be run or fails.
fn output(command: &mut Command, folder: &Path) -> Option<String> {
    let output = command.current_dir(folder).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tests_run_with_the_oldest_supported_rust() {
        let text = |file: &str| std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("../..").join(file));
        let read = |file| text(file).expect("it is there").parse::<toml::Table>().expect("it is TOML");
        let pinned = &read("rust-toolchain.toml")["toolchain"]["channel"];
        let promised = &read("Cargo.toml")["workspace"]["package"]["rust-version"];
        let promised = promised.as_str().expect("a version");
        assert_eq!(pinned.as_str(), Some(format!("{promised}.0").as_str()), "what CI runs is what manifests promise");
    }

    #[test]
    fn lines_of_a_tree_are_packages() {
        let node =
            |depth, name: &str, version: &str| Some(Node { depth, name: name.to_owned(), version: version.to_owned() });
        assert_eq!(Node::read("0r4 v0.1.0 (/r/host/cli)"), node(0, "r4", "0.1.0"));
        assert_eq!(Node::read("12syn v2.0.119 (*)"), node(12, "syn", "2.0.119"));
        assert_eq!(Node::read(""), None);
        assert_eq!(Node::read("[build-dependencies]"), None);
    }

    #[test]
    fn the_advice_names_every_missing_part_and_its_command() {
        for with_rustup in [false, true] {
            let advice = advice(&[Part::Clippy, Part::Target(TARGET)], with_rustup);
            assert!(advice.contains("lacks clippy, thumbv7em-none-eabihf"), "{advice}");
            assert!(advice.contains("\n  rustup component add clippy\n"), "{advice}");
            assert!(advice.ends_with("\n  rustup target add thumbv7em-none-eabihf"), "{advice}");
            assert!(!advice.contains("rustfmt"), "{advice}");
        }
    }
}
