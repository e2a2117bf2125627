//! Task `cargo xtask release`: packs the program with manual pages, completions, udev rules and licences into one
//! archive, and tries what is in it.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use crate::{
    firmware::target_folder,
    licences,
    toolchain::{self, call},
};

/// Features beside the default ones: debug probes, the emulated processor, live views. Gamepads are left out, because
/// they need a library of the system.
const FEATURES: &str = "dfu,emu,live,parquet,probe";
/// Shells whose completions are in the archive, with the names of the files.
const SHELLS: [(&str, &str); 4] = [("bash", "r4.bash"), ("zsh", "_r4"), ("fish", "r4.fish"), ("powershell", "r4.ps1")];
/// Files that are copied as they are.
const FILES: [&str; 4] = ["README.md", "LICENSE-MIT", "LICENSE-APACHE", "host/udev/70-r4.rules"];
/// File with the licences of packages of others that the program is linked with.
const NOTICES: &str = "THIRD-PARTY.txt";

/// Options of `cargo xtask release`.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Release {
    /// Path of a built program; `None` builds one with the release profile.
    program: Option<PathBuf>,
}

impl Release {
    /// Reads the words after `release`.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        match words {
            [] => Ok(Self::default()),
            ["--program", program] => Ok(Self { program: Some(program.into()) }),
            ["--program"] => Err("`--program` needs a file".into()),
            [extra, ..] => Err(format!("`release` takes no `{extra}`")),
        }
    }

    /// Makes the task for the program that the tests have built.
    pub(crate) fn of_tests(root: &Path) -> Result<Self, String> {
        Ok(Self { program: Some(built(&target_folder(root)?, "debug")) })
    }

    /// Packs the program into an archive for the host's system, and prints the path.
    pub(crate) fn make(&self, root: &Path) -> Result<(), String> {
        let target = target_folder(root)?;
        let program = match &self.program {
            Some(program) => program.clone(),
            None => {
                let mut build = Command::new(toolchain::cargo());
                build.args(["build", "--locked", "--package", "r4", "--profile", "dist", "--features", FEATURES]);
                call(build.current_dir(root))?;
                built(&target, "dist")
            }
        };
        let system = toolchain::host(root).ok_or("rustc does not say for what it compiles")?;
        let name = format!("r4-{}-{system}", env!("CARGO_PKG_VERSION"));
        let releases = target.join("release-archives");
        let folder = releases.join(&name);
        // Files of an earlier run would be taken for this one's.
        let _ = fs::remove_dir_all(&folder);
        fill(root, &program, &folder)?;
        let archive = releases.join(format!("{name}.tar.gz"));
        call(Command::new("tar").arg("-czf").arg(&archive).arg("-C").arg(&releases).arg(&name))?;
        try_out(&archive, &releases.join("tried"), &name)?;
        let bytes = |path: &Path| {
            fs::metadata(path).map(|file| file.len()).map_err(|error| format!("{}: {error}", path.display()))
        };
        println!("{}: {} bytes; the program in it: {} bytes", archive.display(), bytes(&archive)?, bytes(&program)?);
        Ok(())
    }
}

/// Returns the path to which cargo builds the program.
fn built(target: &Path, profile: &str) -> PathBuf {
    target.join(profile).join(format!("r4{}", std::env::consts::EXE_SUFFIX))
}

/// Puts all files into a folder; manual pages and completions are written by the program.
fn fill(root: &Path, program: &Path, folder: &Path) -> Result<(), String> {
    let failed = |path: &Path| {
        let path = path.display().to_string();
        move |error: std::io::Error| format!("{path}: {error}")
    };
    let (manual, completions) = (folder.join("man/man1"), folder.join("completions"));
    for folder in [&manual, &completions] {
        fs::create_dir_all(folder).map_err(failed(folder))?;
    }
    for file in FILES.map(|file| root.join(file)).iter().chain([&program.to_owned()]) {
        let to = folder.join(file.file_name().unwrap_or_default());
        fs::copy(file, to).map_err(failed(file))?;
    }
    let notices = folder.join(NOTICES);
    fs::write(&notices, licences::notices(root, "r4", FEATURES)?).map_err(failed(&notices))?;
    call(Command::new(program).args(["man", "--out"]).arg(&manual).stdout(std::process::Stdio::null()))?;
    for (shell, file) in SHELLS {
        // Run from the archive's own program, so that both always fit each other.
        let script = Command::new(program).args(["completions", shell]).output().map_err(failed(program))?;
        if !script.status.success() {
            return Err(format!("`r4 completions {shell}` ended with {}", script.status));
        }
        fs::write(completions.join(file), script.stdout).map_err(failed(&completions))?;
    }
    Ok(())
}

/// Unpacks an archive into a folder and moves a simulated motor with the program from there, as its user does.
fn try_out(archive: &Path, folder: &Path, name: &str) -> Result<(), String> {
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    // Files of an earlier run would be taken for this archive's.
    let _ = fs::remove_dir_all(folder);
    fs::create_dir_all(folder).map_err(failed)?;
    call(Command::new("tar").arg("-xzf").arg(archive).arg("-C").arg(folder))?;
    let unpacked = folder.join(name);
    let pages = fs::read_dir(unpacked.join("man/man1")).map_err(failed)?.count();
    if pages == 0 {
        return Err(format!("{} has no manual page", archive.display()));
    }
    for file in FILES.iter().chain([&NOTICES]).map(|file| Path::new(file).file_name().unwrap_or_default()) {
        fs::metadata(unpacked.join(file)).map_err(|error| format!("{file:?} in {}: {error}", archive.display()))?;
    }
    let program = built(&unpacked, "");
    call(Command::new(program).args(["--board", "sim:osmc-bench", "move", "osmc0", "10deg"]).current_dir(&unpacked))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_lines_are_understood() {
        assert_eq!(Release::parse(&[]), Ok(Release { program: None }));
        assert_eq!(Release::parse(&["--program", "a/r4"]), Ok(Release { program: Some("a/r4".into()) }));
        assert!(Release::parse(&["--program"]).is_err_and(|problem| problem.contains("needs a file")));
        assert!(Release::parse(&["--fast"]).is_err_and(|problem| problem.contains("--fast")));
    }

    /// Checks that this task understands the commands of the workflow for releases.
    #[test]
    fn the_workflow_types_what_is_understood() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let workflow = fs::read_to_string(root.join(".github/workflows/release.yml")).expect("it is there");
        let tasks: Vec<Vec<String>> = workflow
            .lines()
            .filter_map(|line| line.split_once("cargo xtask "))
            .map(|(_, words)| words.split_whitespace().map(String::from).collect())
            .collect();
        assert!(tasks.len() >= 2, "{tasks:?}");
        for words in tasks {
            crate::parse(&words).unwrap_or_else(|problem| panic!("{words:?}: {problem}"));
        }
        assert!(
            workflow.contains("target/release-archives/*.tar.gz") && workflow.contains("target/python/wheels/*.whl")
        );
        let container = fs::read_to_string(root.join("Containerfile")).expect("it is there");
        assert!(container.contains(&format!("--profile dist --features {FEATURES}\n")), "{container}");
    }
}
