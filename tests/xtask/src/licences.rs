//! Task `cargo xtask licences`: checks that every package linked in may be distributed, by `deny.toml`, comes from
//! the right registry, and is not compiled in two versions without a reason.
//!
//! It reads the lists that cargo-deny reads, so that each test run can check them without a program that takes minutes
//! to build.
//!
//! [`notices`] collects the licences' texts for the archive of a release: most demand that they go with the program.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use serde::Deserialize;
use spdx::{Expression, ParseMode};

use crate::toolchain::{self, Node};

/// Only registry that packages may come from.
const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";
const POLICY: &str = "deny.toml";
/// Package whose default build has every dependency once.
const PROGRAM: &str = "r4";
/// Syntax of licences in manifests. It includes the one from before SPDX: `MIT/Apache-2.0`.
const WRITTEN: ParseMode = ParseMode {
    allow_deprecated: true,
    allow_imprecise_license_names: true,
    allow_postfix_plus_on_gpl: true,
    allow_slash_as_or_operator: true,
    allow_unknown: true,
};

#[derive(Deserialize)]
struct Policy {
    licenses: Licences,
    bans: Bans,
}

#[derive(Deserialize)]
struct Bans {
    /// Versions that are compiled beside another version of the same package.
    skip: Vec<Skip>,
}

#[derive(Deserialize)]
struct Skip {
    /// Name and version, as in `bitflags@1.3.2`.
    #[serde(rename = "crate")]
    version: String,
}

#[derive(Deserialize)]
struct Licences {
    allow: Vec<String>,
    exceptions: Vec<Exception>,
}

#[derive(Deserialize)]
struct Exception {
    #[serde(rename = "crate")]
    name: String,
    allow: Vec<String>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    version: String,
    license: Option<String>,
    /// Registry of the package; `None` for packages of this repository.
    source: Option<String>,
}

/// Package with the place of its sources.
#[derive(Deserialize)]
struct Sources {
    name: String,
    version: String,
    license: Option<String>,
    authors: Vec<String>,
    source: Option<String>,
    manifest_path: PathBuf,
}

/// Beginnings of the names of files with a licence's text, in capitals.
const TEXTS: [&str; 5] = ["LICENSE", "LICENCE", "COPYING", "NOTICE", "UNLICENSE"];

/// Returns the licences of all packages of others that `program` with these features links on this system, each text once
/// with the packages that have it. A package without a text is listed with its licence's name and its authors.
pub(crate) fn notices(root: &Path, program: &str, features: &str) -> Result<String, String> {
    let linked = linked(root, program, features)?;
    let packages: Vec<Sources> = toolchain::packages(root, true)?;
    let is_linked = |package: &&Sources| {
        package.source.is_some() && linked.contains(&format!("{} v{}", package.name, package.version))
    };
    let mut by_text: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    let mut without = String::new();
    for package in packages.iter().filter(is_linked) {
        let licence = package.license.as_deref().unwrap_or_default();
        let name = format!("{} {} ({licence})", package.name, package.version);
        let texts = texts(package.manifest_path.parent().unwrap_or(root))?;
        if texts.is_empty() {
            let _ = writeln!(without, "{name}: {}", package.authors.join(", "));
        }
        texts.into_iter().for_each(|text| {
            by_text.entry(text).or_default().insert(name.clone());
        });
    }
    let mut notices = "The program r4 is linked with the packages listed here, each under the licence behind its name. Their sources are on \
                       crates.io.\n\nPackages that contain no text of their licence, with their authors:\n\n"
        .to_owned();
    notices += &without;
    for (text, names) in by_text {
        let names: Vec<String> = names.into_iter().collect();
        let _ = write!(notices, "\n{}\n\n{}\n\n{}\n", "=".repeat(80), names.join("\n"), text.trim_end());
    }
    Ok(notices)
}

/// Returns the packages that a program links, as `name vVERSION`.
fn linked(root: &Path, program: &str, features: &str) -> Result<BTreeSet<String>, String> {
    let tree = ["tree", "--locked", "--edges", "normal", "--prefix", "none", "--format", "{p}"];
    let listed = Command::new(toolchain::cargo())
        .args(tree)
        .args(["--package", program, "--features", features])
        .current_dir(root)
        .output()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    if !listed.status.success() {
        return Err(String::from_utf8_lossy(&listed.stderr).into_owned());
    }
    let words = |line: &str| line.split_whitespace().take(2).collect::<Vec<_>>().join(" ");
    Ok(String::from_utf8_lossy(&listed.stdout).lines().map(words).collect())
}

/// Returns the texts of licences in the folder of a package.
fn texts(folder: &Path) -> Result<Vec<String>, String> {
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    let mut texts = Vec::new();
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_uppercase();
        if path.is_file() && TEXTS.iter().any(|begin| name.starts_with(begin)) {
            let text = fs::read(&path).map_err(failed)?;
            texts.push(String::from_utf8_lossy(&text).replace("\r\n", "\n"));
        }
    }
    Ok(texts)
}

/// Checks every package that any feature of the workspace links.
pub(crate) fn check(root: &Path) -> Result<(), String> {
    let policy = fs::read_to_string(root.join(POLICY)).map_err(|error| format!("cannot read {POLICY}: {error}"))?;
    let policy: Policy = toml::from_str(&policy).map_err(|error| format!("{POLICY}: {error}"))?;
    let packages: Vec<Package> = toolchain::packages(root, true)?;
    let others: Vec<&Package> = packages.iter().filter(|package| package.source.is_some()).collect();
    let mut problems = problems(&policy.licenses, &others);
    problems.extend(doubled(&policy.bans.skip, &toolchain::tree(root, PROGRAM)?));
    if problems.is_empty() {
        println!(
            "{} packages of others, all under licences of {POLICY}; {} are in the default build in a second version",
            others.len(),
            policy.bans.skip.len()
        );
        Ok(())
    } else {
        Err(problems.join("\n"))
    }
}

fn problems(policy: &Licences, packages: &[&Package]) -> Vec<String> {
    let exceptions: BTreeMap<&str, &[String]> =
        policy.exceptions.iter().map(|exception| (exception.name.as_str(), exception.allow.as_slice())).collect();
    let unused = exceptions.keys().filter(|name| packages.iter().all(|package| package.name != **name));
    let unused = unused.map(|name| format!("{name}: has an exception in {POLICY} and is not linked: remove that"));
    let of_packages = packages.iter().filter_map(|package| {
        let allowed = policy.allow.iter().chain(exceptions.get(package.name.as_str()).copied().unwrap_or_default());
        let problem = problem(package, &allowed.map(String::as_str).collect::<Vec<_>>())?;
        Some(format!("{} {}: {problem}", package.name, package.version))
    });
    of_packages.chain(unused).collect()
}

/// Returns packages that are built in more versions than `skip` permits, and entries of `skip` without effect.
fn doubled(skip: &[Skip], built: &[Node]) -> Vec<String> {
    let mut versions: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for node in built {
        versions.entry(&node.name).or_default().insert(&node.version);
    }
    let is_skipped = |name: &str, version: &str| skip.iter().any(|skip| skip.version == format!("{name}@{version}"));
    let too_many = versions.iter().filter_map(|(name, versions)| {
        let left: Vec<&str> = versions.iter().copied().filter(|version| !is_skipped(name, version)).collect();
        (left.len() > 1).then(|| {
            let left = left.join(" and ");
            format!(
                "{name} is compiled as {left}: let its users agree on one (`cargo tree --duplicates`), or list one in {POLICY} with the reason"
            )
        })
    });
    let unused = skip.iter().filter_map(|skip| {
        let (name, version) = skip.version.split_once('@').unwrap_or((&skip.version, ""));
        let is_doubled = versions.get(name).is_some_and(|versions| versions.len() > 1 && versions.contains(version));
        (!is_doubled).then(|| format!("{}: is listed in {POLICY} and is no second version: remove that", skip.version))
    });
    too_many.chain(unused).collect()
}

fn problem(package: &Package, allowed: &[&str]) -> Option<String> {
    if package.source.as_deref() != Some(REGISTRY) {
        return Some(format!("comes from {}, not from crates.io", package.source.as_deref().unwrap_or("nowhere")));
    }
    let Some(licence) = &package.license else { return Some("names no licence".into()) };
    let Ok(expression) = Expression::parse_mode(licence, WRITTEN) else {
        return Some(format!("its licence `{licence}` is no SPDX expression"));
    };
    let is_allowed = expression.evaluate(|requirement| allowed.contains(&requirement.to_string().as_str()));
    (!is_allowed)
        .then(|| format!("its licence `{licence}` is none of those in {POLICY}: leave it out, or give a reason there"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(licence: Option<&str>, source: &str) -> Option<String> {
        let package = Package {
            name: "some".into(),
            version: "1.0.0".into(),
            license: licence.map(Into::into),
            source: Some(source.into()),
        };
        problem(&package, &["MIT", "Apache-2.0 WITH LLVM-exception", "BSD-3-Clause"])
    }

    #[test]
    fn expressions_are_judged_as_they_mean() {
        for good in [
            "MIT",
            "MIT/Apache-2.0",
            "GPL-3.0-only OR MIT",
            "(Zlib OR MIT) AND BSD-3-Clause",
            "Apache-2.0 WITH LLVM-exception",
        ] {
            assert_eq!(of(Some(good), REGISTRY), None, "{good}");
        }
        for bad in ["GPL-2.0", "Apache-2.0", "MIT AND GPL-2.0-only", "see the file"] {
            assert!(of(Some(bad), REGISTRY).is_some_and(|problem| problem.contains(bad)), "{bad}");
        }
        assert!(of(None, REGISTRY).is_some() && of(Some("MIT"), "git+https://example.org").is_some());
    }

    #[test]
    fn exceptions_are_for_what_is_there() {
        let exception = Exception { name: "gone".into(), allow: vec!["MPL-2.0".into()] };
        let policy = Licences { allow: vec!["MIT".into()], exceptions: vec![exception] };
        assert_eq!(problems(&policy, &[]).len(), 1);
    }

    #[test]
    fn a_second_version_needs_an_entry_and_an_entry_a_second_version() {
        let built: Vec<Node> = ["0r4 v0.1.0", "1syn v2.0.1", "2syn v3.0.9", "1libm v1.0.0"]
            .iter()
            .filter_map(|line| Node::read(line))
            .collect();
        let skip = |versions: &[&str]| -> Vec<Skip> {
            versions.iter().map(|version| Skip { version: (*version).to_owned() }).collect()
        };
        assert_eq!(doubled(&skip(&["syn@2.0.1"]), &built), Vec::<String>::new());
        assert!(doubled(&[], &built)[0].starts_with("syn is compiled as 2.0.1 and 3.0.9"));
        for stale in ["libm@1.0.0", "syn@1.0.0", "gone"] {
            let problems = doubled(&skip(&["syn@2.0.1", stale]), &built);
            assert!(problems.len() == 1 && problems[0].starts_with(stale), "{problems:?}");
        }
    }
}
