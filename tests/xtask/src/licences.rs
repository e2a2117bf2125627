//! Task `cargo xtask licences`: checks that every package linked in may be distributed, by `deny.toml`, and comes from
//! the right registry.
//!
//! It reads the lists that cargo-deny reads, so that each test run can check them without a program that takes minutes
//! to build.

use std::{collections::BTreeMap, fs, path::Path};

use serde::Deserialize;
use spdx::{Expression, ParseMode};

use crate::toolchain;

/// Only registry that packages may come from.
const REGISTRY: &str = "registry+https://github.com/rust-lang/crates.io-index";
const POLICY: &str = "deny.toml";
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

/// Checks every package that any feature of the workspace links.
pub(crate) fn check(root: &Path) -> Result<(), String> {
    let policy = fs::read_to_string(root.join(POLICY)).map_err(|error| format!("cannot read {POLICY}: {error}"))?;
    let policy: Policy = toml::from_str(&policy).map_err(|error| format!("{POLICY}: {error}"))?;
    let packages: Vec<Package> = toolchain::packages(root, true)?;
    let others: Vec<&Package> = packages.iter().filter(|package| package.source.is_some()).collect();
    let problems = problems(&policy.licenses, &others);
    if problems.is_empty() {
        println!("{} packages of others, all under licences of {POLICY}", others.len());
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
}
