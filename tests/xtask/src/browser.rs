//! Chromium on this machine, for pictures of a report. The tests of `host/page` contain this file by `#[path]`.

use std::{env, path::PathBuf};

/// Names of the program in `PATH`.
const PROGRAMS: [&str; 3] = ["chromium", "chromium-browser", "google-chrome"];

/// Returns the program that the variable `CHROMIUM` names, or else the first of the known names in `PATH`.
///
/// # Errors
/// There is neither; the message says what to install.
pub(crate) fn chromium() -> Result<PathBuf, String> {
    if let Some(named) = env::var_os("CHROMIUM") {
        return Ok(named.into());
    }
    let folders: Vec<PathBuf> = env::var_os("PATH").map(|path| env::split_paths(&path).collect()).unwrap_or_default();
    PROGRAMS
        .into_iter()
        .flat_map(|name| folders.iter().map(move |folder| folder.join(name)))
        .find(|program| program.exists())
        .ok_or_else(|| {
            format!("none of {} is in PATH; install Chromium, or name a browser with CHROMIUM", PROGRAMS.join(", "))
        })
}
