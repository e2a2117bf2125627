//! Task `cargo xtask package`: makes the crates as crates.io would get them, and compiles the program of these alone.

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

/// Package of the program.
const PROGRAM: &str = "r4";

#[derive(Deserialize)]
struct Package {
    name: String,
    version: String,
    /// Registries that the package may be published to: an empty list for none, `None` for any.
    publish: Option<Vec<String>>,
}

/// Packages all crates that can be published, and compiles the program from them.
pub(crate) fn check(root: &Path) -> Result<(), String> {
    let packages: Vec<Package> = toolchain::packages(root, false)?;
    let (kept, published): (Vec<_>, Vec<_>) = packages.iter().partition(|package| package.publish.is_some());
    let target = target_folder(root)?;
    let mut packaging = Command::new(toolchain::cargo());
    // Compiled below, all together, because cargo would compile each by itself. Uncommitted changes are allowed, so
    // that they can be tried.
    packaging.args(["package", "--quiet", "--workspace", "--no-verify", "--allow-dirty", "--locked"]);
    packaging.args(kept.iter().flat_map(|package| ["--exclude", &package.name]));
    call(packaging.env("CARGO_TARGET_DIR", &target).current_dir(root))?;
    let unpacked = unpack(&target.join("package"), &published)?;
    let program = published.iter().find(|package| package.name == PROGRAM).ok_or("the program is not published")?;
    let manifest = unpacked.join(folder(program)).join("Cargo.toml");
    let mut checking = Command::new(toolchain::cargo());
    checking.args(["check", "--quiet", "--manifest-path"]).arg(&manifest);
    // The workspace's settings, which the packages do not have: what the lints have checked of the dependencies is not checked again.
    checking
        .env("CARGO_TARGET_DIR", &target)
        .envs([("CARGO_PROFILE_DEV_OPT_LEVEL", "1"), ("CARGO_PROFILE_DEV_DEBUG", "false")]);
    // In the packages' own folder, so that no file of the repository is used.
    call(checking.current_dir(&unpacked))?;
    println!("{} packages, and {PROGRAM} compiled of them: {}", published.len(), manifest.display());
    Ok(())
}

fn folder(package: &Package) -> String {
    format!("{}-{}", package.name, package.version)
}

/// Unpacks the packages side by side; each replaces the crate of its name on crates.io.
fn unpack(packed: &Path, published: &[&Package]) -> Result<PathBuf, String> {
    let unpacked = packed.join("unpacked");
    // Files of an earlier run would be taken for this one's.
    let _ = fs::remove_dir_all(&unpacked);
    let failed = |error: std::io::Error| format!("{}: {error}", unpacked.display());
    fs::create_dir_all(unpacked.join(".cargo")).map_err(failed)?;
    let mut patches = "[patch.crates-io]\n".to_owned();
    for package in published {
        let archive = packed.join(format!("{}.crate", folder(package)));
        // With the present time (`-m`): the packages' own times are all the same, and cargo would not compile changed
        // files again.
        call(Command::new("tar").arg("-xzmf").arg(&archive).arg("-C").arg(&unpacked))?;
        let path = unpacked.join(folder(package));
        patches += &format!("{} = {{ path = {:?} }}\n", package.name, path.display().to_string());
    }
    fs::write(unpacked.join(".cargo/config.toml"), patches).map_err(failed)?;
    Ok(unpacked)
}
