//! Task `cargo xtask python`: builds the Python package as a wheel, installs it into an environment of its own, and
//! tests it there.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Instant,
};

use crate::{
    firmware,
    toolchain::{self, call},
    venv::Venv,
};

/// Folder of the package in the repository.
const PACKAGE: &str = "host/python";
/// Packages that the tests need, with versions.
const PINNED: &str = "host/python/tests/requirements.txt";

/// Options of `cargo xtask python`.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Python {
    /// True for the optimised profile of releases, in place of that of the tests.
    dist: bool,
    /// True to stop once the wheel is built.
    only_wheel: bool,
    /// True to print steps per second as well.
    bench: bool,
}

impl Python {
    /// Reads the words after `python`.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut python = Self::default();
        for word in words {
            match *word {
                "--dist" => python.dist = true,
                "--wheel" => python.only_wheel = true,
                "--bench" => python.bench = true,
                word => return Err(format!("`python` takes no `{word}`")),
            }
        }
        Ok(python)
    }

    /// Returns the folder of all that this task makes, and the environment in it.
    pub(crate) fn environment(root: &Path) -> Result<(PathBuf, Venv), String> {
        let folder = firmware::target_folder(root)?.join("python");
        let tools = Venv::with(root, &folder, PINNED)?;
        Ok((folder, tools))
    }

    /// Builds, installs and tests the package.
    pub(crate) fn test(&self, root: &Path) -> Result<(), String> {
        let (folder, tools) = Self::environment(root)?;
        let wheel = self.wheel(root, &folder, &tools)?;
        println!("{}", wheel.display());
        if self.only_wheel {
            return Ok(());
        }
        let begin = Instant::now();
        // Reinstalled by force, because the file name is the same and only the content differs.
        let install = ["-m", "pip", "install", "--quiet", "--force-reinstall", "--no-deps", "--no-index"];
        call(tools.python().args(install).arg(&wheel))?;
        let moved = "import r4; board = r4.sim('osmc-bench').blocking; board.arm(); \
                     print(board.osmc[0].move_to(1.57)); board.close()";
        call(tools.python().args(["-I", "-c", moved]).current_dir(&folder))?;
        println!("{:.1} s from `pip install` of the wheel to a motor that has moved", begin.elapsed().as_secs_f64());

        let package = root.join(PACKAGE);
        call(
            tools.python().args(["-m", "mypy", "--config-file", "pyproject.toml", "python/r4"]).current_dir(&package),
        )?;
        let stubs = ["-m", "mypy.stubtest", "r4._native", "--mypy-config-file"];
        call(tools.python().args(stubs).arg(package.join("pyproject.toml")).current_dir(&folder))?;
        // The tests serve boards with it; without it they print that they were not run.
        let program = firmware::target_folder(root)?.join("debug").join("r4");
        let pytest = ["-m", "pytest", "--quiet", "--durations", "5", "-r", "s"];
        call(tools.python().args(pytest).env("R4_PROGRAM", program).current_dir(&package))?;
        if self.bench {
            call(tools.python().arg(package.join("tests/bench.py")).current_dir(&folder))?;
        }
        Ok(())
    }

    /// Builds the wheel and returns its path. With the profile of the tests it shares their compiled crates.
    fn wheel(&self, root: &Path, folder: &Path, tools: &Venv) -> Result<PathBuf, String> {
        let wheels = folder.join("wheels");
        // A wheel of an earlier version would be taken for this one.
        let _ = fs::remove_dir_all(&wheels);
        let profile = if self.dist { "dist" } else { "dev" };
        let mut build = tools.python();
        build.args(["-m", "maturin", "build", "--quiet", "--locked", "--profile", profile, "--manifest-path"]);
        build.arg(root.join(PACKAGE).join("Cargo.toml")).arg("--interpreter").arg(tools.interpreter());
        build.arg("--out").arg(&wheels).env("CARGO", toolchain::cargo());
        call(&mut build)?;
        let mut built =
            fs::read_dir(&wheels).map_err(|error| format!("maturin has made no {}: {error}", wheels.display()))?;
        match built.next() {
            Some(Ok(wheel)) => Ok(wheel.path()),
            _ => Err(format!("maturin has left no wheel in {}", wheels.display())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_is_understood() {
        assert_eq!(Python::parse(&[]), Ok(Python::default()));
        assert_eq!(Python::parse(&["--dist", "--wheel"]), Ok(Python { dist: true, only_wheel: true, bench: false }));
        assert!(Python::parse(&["--fast"]).expect_err("unknown").contains("--fast"));
    }
}
