//! `cargo xtask python`: the Python package, built as a wheel, installed into an environment of its own, and tested there.

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

/// The package, in the repository.
const PACKAGE: &str = "host/python";
/// What tests need, with versions.
const PINNED: &str = "host/python/tests/requirements.txt";

/// What `cargo xtask python` is asked for.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Python {
    /// As given to others: optimised, and not the profile of the tests.
    dist: bool,
    /// Stops once the wheel is built.
    only_wheel: bool,
    /// Prints steps per second too.
    bench: bool,
}

impl Python {
    /// From the words behind `python`.
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

    /// Builds, installs and tests.
    pub(crate) fn test(&self, root: &Path) -> Result<(), String> {
        let folder = firmware::target_folder(root)?.join("python");
        let tools = Venv::with(root, &folder, PINNED)?;
        let wheel = self.wheel(root, &folder, &tools)?;
        println!("{}", wheel.display());
        if self.only_wheel {
            return Ok(());
        }
        let begin = Instant::now();
        // The same file name with other content: as one installs it, without what is installed already.
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
        // Serves boards for it, where it was built; the tests say that they were not run without it.
        let program = firmware::target_folder(root)?.join("debug").join("r4");
        let pytest = ["-m", "pytest", "--quiet", "--durations", "5", "-r", "s"];
        call(tools.python().args(pytest).env("R4_PROGRAM", program).current_dir(&package))?;
        if self.bench {
            call(tools.python().arg(package.join("tests/bench.py")).current_dir(&folder))?;
        }
        Ok(())
    }

    /// Builds the wheel; its path. With the profile of the tests it shares what they have compiled.
    fn wheel(&self, root: &Path, folder: &Path, tools: &Venv) -> Result<PathBuf, String> {
        let wheels = folder.join("wheels");
        // An older version's would be taken for this one's.
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
