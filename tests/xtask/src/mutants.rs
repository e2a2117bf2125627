//! Task `cargo xtask mutants`: runs cargo-mutants on the crates whose tests must notice every change, and compares the
//! survivors with the list of known ones.
//!
//! It takes hours, so CI does not run it: choose a file or a shard.

use std::{
    collections::BTreeSet,
    fs,
    path::Path,
    process::{Command, ExitCode, Stdio},
};

use serde::Deserialize;

use crate::toolchain;

/// Packages that are mutated by default.
const PACKAGES: [&str; 3] = ["r4-firmware", "r4-protocol", "r4-links"];
/// Profile of the workspace's `Cargo.toml`.
const PROFILE: &str = "mutants";
/// File with the list of known survivors, from the workspace's root.
const LIST: &str = "tests/mutants.toml";

/// Options of `cargo xtask mutants`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Mutants {
    package: Option<String>,
    files: Vec<String>,
    /// Shard in cargo-mutants' syntax: `0/8` to `7/8`.
    shard: Option<String>,
    /// Filter expression of nextest: only these tests run.
    tests: Option<String>,
}

/// Mutant that no test of its crate notices.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
struct Survivor {
    /// Name by cargo-mutants, without line and column.
    mutant: String,
    verdict: Verdict,
    /// Reason why nothing is to be done, or the test that notices it.
    why: String,
}

/// Verdict on a survivor.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "kebab-case")]
enum Verdict {
    /// The program behaves the same.
    Equivalent,
    /// A test of another crate notices it.
    TestedAbove,
    /// It is not tested, for the given reason.
    Accepted,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct List {
    #[serde(default)]
    survivor: Vec<Survivor>,
}

impl Mutants {
    /// Reads the words after `mutants`.
    ///
    /// # Errors
    /// The word that is no option.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut mutants = Self::default();
        let mut words = words.iter();
        while let Some(word) = words.next() {
            let mut value = || words.next().map(|value| (*value).to_owned()).ok_or(format!("`{word}` needs a value"));
            match *word {
                "--package" => {
                    let package = value()?;
                    if !PACKAGES.contains(&package.as_str()) {
                        return Err(format!("`--package` is one of {}, not `{package}`", PACKAGES.join(", ")));
                    }
                    mutants.package = Some(package);
                }
                "--file" => mutants.files.push(value()?),
                "--shard" => mutants.shard = Some(value()?),
                "--tests" => mutants.tests = Some(value()?),
                other => return Err(format!("`mutants` takes no `{other}`")),
            }
        }
        Ok(mutants)
    }

    /// Runs cargo-mutants and compares its survivors with the list. Fails when one of them is not in it.
    pub(crate) fn run(&self, root: &Path) -> ExitCode {
        match self.survivors(root).and_then(|survivors| compare(&survivors, &list(root)?)) {
            Ok(()) => ExitCode::SUCCESS,
            Err(problem) => {
                eprintln!("error: {problem}");
                ExitCode::FAILURE
            }
        }
    }

    fn arguments(&self, output: &Path) -> Vec<String> {
        let mut arguments: Vec<String> =
            // Compiling takes most of the time: a profile that compiles quickly, and only the tests.
            ["mutants", "--test-tool", "nextest", "--profile", PROFILE, "--cargo-arg", "--tests", "--jobs", "1", "--output"]
                .map(String::from)
                .into();
        arguments.push(output.display().to_string());
        let packages = self.package.as_deref().map_or(PACKAGES.to_vec(), |package| vec![package]);
        for package in packages {
            arguments.extend(["--package".into(), package.into()]);
        }
        for file in &self.files {
            arguments.extend(["--file".into(), file.clone()]);
        }
        if let Some(shard) = &self.shard {
            arguments.extend(["--shard".into(), shard.clone()]);
        }
        if let Some(tests) = &self.tests {
            arguments.extend(["--".into(), "-E".into(), tests.clone()]);
        }
        arguments
    }

    /// Returns the survivors, without lines and columns.
    fn survivors(&self, root: &Path) -> Result<BTreeSet<String>, String> {
        let installed = Command::new(toolchain::cargo())
            .args(["mutants", "--version"])
            .current_dir(root)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        if !installed.is_ok_and(|status| status.success()) {
            return Err("cargo-mutants is not installed: cargo install cargo-mutants --locked".into());
        }
        let output = crate::firmware::target_folder(root)?.join("mutants");
        fs::create_dir_all(&output).map_err(|error| format!("{}: {error}", output.display()))?;
        let status = Command::new(toolchain::cargo()).args(self.arguments(&output)).current_dir(root).status();
        // Exit codes: 0 when all were caught, 2 when some were missed, 3 when some tests did not end
        // (https://mutants.rs/exit-codes.html).
        match status.map(|status| status.code()) {
            Ok(Some(0 | 2 | 3)) => {}
            Ok(_) => return Err("cargo-mutants could not test, see above".into()),
            Err(error) => return Err(format!("cargo cannot be started: {error}")),
        }
        let missed = output.join("mutants.out/missed.txt");
        let missed = fs::read_to_string(&missed).map_err(|error| format!("{}: {error}", missed.display()))?;
        Ok(missed.lines().map(without_place).collect())
    }
}

/// Returns `FILE:LINE:COLUMN: what` without line and column, which every edit changes.
fn without_place(line: &str) -> String {
    let mut parts = line.splitn(4, ':');
    match (parts.next(), parts.next(), parts.next(), parts.next()) {
        (Some(file), Some(_), Some(_), Some(what)) => format!("{file}:{what}"),
        _ => line.to_owned(),
    }
}

fn list(root: &Path) -> Result<Vec<Survivor>, String> {
    let text = fs::read_to_string(root.join(LIST)).map_err(|error| format!("{LIST}: {error}"))?;
    read(&text)
}

fn read(text: &str) -> Result<Vec<Survivor>, String> {
    toml::from_str(text).map(|list: List| list.survivor).map_err(|error| format!("{LIST}: {error}"))
}

/// Prints the survivors with their verdicts.
///
/// # Errors
/// The survivors without a verdict.
fn compare(survivors: &BTreeSet<String>, list: &[Survivor]) -> Result<(), String> {
    let mut unknown = Vec::new();
    for survivor in survivors {
        match list.iter().find(|known| known.mutant == *survivor) {
            Some(Survivor { verdict, why, .. }) => println!("{survivor}\n    {verdict:?}: {why}"),
            None => unknown.push(survivor.as_str()),
        }
    }
    if unknown.is_empty() {
        return Ok(());
    }
    Err(format!("no test notices these changes; write one, or judge them in {LIST}:\n  {}", unknown.join("\n  ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_lines_are_understood() {
        let of = |line: &str| Mutants::parse(&line.split_whitespace().collect::<Vec<_>>());
        assert_eq!(of(""), Ok(Mutants::default()));
        let chosen = of("--package r4-firmware --file a.rs --file b.rs --shard 0/8").expect("good");
        assert_eq!(
            chosen.arguments(Path::new("out")).join(" "),
            "mutants --test-tool nextest --profile mutants --cargo-arg --tests --jobs 1 --output out --package r4-firmware --file a.rs --file b.rs --shard 0/8"
        );
        assert!(of("").expect("good").arguments(Path::new("out")).ends_with(&["--package".into(), "r4-links".into()]));
        let filtered = of("--tests test(safety)").expect("good").arguments(Path::new("out"));
        assert!(filtered.ends_with(&["--".into(), "-E".into(), "test(safety)".into()]));
        for (line, word) in [("--package r4", "one of"), ("--shard", "needs a value"), ("all", "all")] {
            assert!(of(line).expect_err(line).contains(word), "{line}");
        }
    }

    #[test]
    fn a_survivor_is_known_wherever_it_has_moved_to() {
        let line = "firmware/core/src/a.rs:12:5: replace f::g -> bool with true";
        let mutant = "firmware/core/src/a.rs: replace f::g -> bool with true";
        assert_eq!(without_place(line), mutant);
        let known = read(&format!("[[survivor]]\nmutant = \"{mutant}\"\nverdict = \"tested-above\"\nwhy = \"b.rs\"\n"));
        let known = known.expect("good");
        assert_eq!(compare(&[without_place(line)].into(), &known), Ok(()));
        let other = compare(&["firmware/core/src/a.rs: replace f::h".into()].into(), &known);
        assert!(other.expect_err("nobody has judged it").contains("f::h"));
    }

    #[test]
    fn the_list_can_be_read_and_each_has_a_reason() {
        let list = list(&crate::root()).expect("good");
        assert!(list.iter().all(|survivor| survivor.why.len() > 10));
    }
}
