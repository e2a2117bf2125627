//! Python environments with the packages that a file pins, below the folder that cargo builds into.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use crate::toolchain::call;

/// Python environment in a folder.
pub(crate) struct Venv(PathBuf);

impl Venv {
    /// Returns the environment in `folder` with the packages of `pinned`, a file in the repository. Makes it unless it
    /// exists with just these.
    pub(crate) fn with(root: &Path, folder: &Path, pinned: &str) -> Result<Self, String> {
        let names = fs::read_to_string(root.join(pinned)).map_err(|error| format!("cannot read {pinned}: {error}"))?;
        let venv = Self(folder.join("environment"));
        let installed = folder.join("installed.txt");
        if fs::read_to_string(&installed).is_ok_and(|installed| installed == names) && venv.interpreter().exists() {
            return Ok(venv);
        }
        fs::create_dir_all(folder).map_err(|error| format!("cannot make {}: {error}", folder.display()))?;
        let python = env::var_os("PYTHON").unwrap_or_else(|| "python3".into());
        call(Command::new(python).args(["-m", "venv", "--clear"]).arg(&venv.0)).map_err(|problem| {
            format!("{problem}\nPython 3.10 or later with its module venv is needed; PYTHON names another")
        })?;
        call(venv.python().args(["-m", "pip", "install", "--quiet", "--requirement"]).arg(root.join(pinned)))?;
        fs::write(&installed, names).map_err(|error| format!("cannot write {}: {error}", installed.display()))?;
        Ok(venv)
    }

    pub(crate) fn interpreter(&self) -> PathBuf {
        self.0.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" })
    }

    /// Returns a command for its interpreter, with its programs first in PATH.
    pub(crate) fn python(&self) -> Command {
        let mut python = Command::new(self.interpreter());
        let programs = self.interpreter().parent().map(Path::to_owned).unwrap_or_default();
        let others = env::var_os("PATH").unwrap_or_default();
        if let Ok(path) = env::join_paths([programs].into_iter().chain(env::split_paths(&others))) {
            python.env("PATH", path);
        }
        // Only packages of the environment count, and no compiled files are left beside the sources.
        python.env_remove("PYTHONPATH").env("PYTHONDONTWRITEBYTECODE", "1").env("PIP_DISABLE_PIP_VERSION_CHECK", "1");
        python
    }
}
