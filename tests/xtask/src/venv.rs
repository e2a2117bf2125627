//! Python environments with what is pinned in a file, below the folder that cargo builds into.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use crate::toolchain::call;

/// A Python environment.
pub(crate) struct Venv(PathBuf);

impl Venv {
    /// The environment in `folder` with what `pinned` names, a file in the repository; made unless there is one with just that.
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

    /// Its interpreter, with its programs in front of others'.
    pub(crate) fn python(&self) -> Command {
        let mut python = Command::new(self.interpreter());
        let programs = self.interpreter().parent().map(Path::to_owned).unwrap_or_default();
        let others = env::var_os("PATH").unwrap_or_default();
        if let Ok(path) = env::join_paths([programs].into_iter().chain(env::split_paths(&others))) {
            python.env("PATH", path);
        }
        // What is in the environment only, and no files beside the sources.
        python.env_remove("PYTHONPATH").env("PYTHONDONTWRITEBYTECODE", "1").env("PIP_DISABLE_PIP_VERSION_CHECK", "1");
        python
    }
}
