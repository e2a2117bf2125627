//! `cargo xtask package`: the crates as crates.io would get them, and whether the program can be built of these alone.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use serde::Deserialize;

use crate::{
    firmware::target_folder,
    toolchain::{self, call},
};

/// The program's package.
const PROGRAM: &str = "r4";

#[derive(Deserialize)]
struct Package {
    name: String,
    version: String,
    /// Registries that it may be published to: none, or `None` for any.
    publish: Option<Vec<String>>,
}

/// Packages all that can be published, and compiles the program of what is in the packages.
pub(crate) fn check(root: &Path) -> Result<(), String> {
    let packages: Vec<Package> = toolchain::packages(root, false)?;
    let (kept, published): (Vec<_>, Vec<_>) = packages.iter().partition(|package| package.publish.is_some());
    let target = target_folder(root)?;
    let mut packaging = Command::new(toolchain::cargo());
    // Compiled below, all together: cargo would compile each for itself. What is not committed may be tried, too.
    packaging.args(["package", "--quiet", "--workspace", "--no-verify", "--allow-dirty", "--locked"]);
    packaging.args(kept.iter().flat_map(|package| ["--exclude", &package.name]));
    call(packaging.env("CARGO_TARGET_DIR", &target).current_dir(root))?;
    let unpacked = unpack(&target.join("package"), &published)?;
    let program = published.iter().find(|package| package.name == PROGRAM).ok_or("the program is not published")?;
    let manifest = unpacked.join(folder(program)).join("Cargo.toml");
    let mut checking = Command::new(toolchain::cargo());
    checking.args(["check", "--quiet", "--manifest-path"]).arg(&manifest);
    // In the packages' own folder: nothing beside them is seen.
    call(checking.env("CARGO_TARGET_DIR", &target).current_dir(&unpacked))?;
    println!("{} packages, and {PROGRAM} compiled of them: {}", published.len(), manifest.display());
    Ok(())
}

fn folder(package: &Package) -> String {
    format!("{}-{}", package.name, package.version)
}

/// Unpacks the packages side by side, each to be taken for what crates.io would have under its name.
fn unpack(packed: &Path, published: &[&Package]) -> Result<PathBuf, String> {
    let unpacked = packed.join("unpacked");
    // An older one's files would be taken for this one's.
    let _ = fs::remove_dir_all(&unpacked);
    let failed = |error: std::io::Error| format!("{}: {error}", unpacked.display());
    fs::create_dir_all(unpacked.join(".cargo")).map_err(failed)?;
    let mut patches = "[patch.crates-io]\n".to_owned();
    for package in published {
        let archive = packed.join(format!("{}.crate", folder(package)));
        // As of now: the packages' own times are all the same, and cargo would take changed files for those compiled before.
        call(Command::new("tar").arg("-xzmf").arg(&archive).arg("-C").arg(&unpacked))?;
        let path = unpacked.join(folder(package));
        patches += &format!("{} = {{ path = {:?} }}\n", package.name, path.display().to_string());
    }
    fs::write(unpacked.join(".cargo/config.toml"), patches).map_err(failed)?;
    Ok(unpacked)
}
