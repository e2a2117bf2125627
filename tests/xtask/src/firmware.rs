//! Task `cargo xtask firmware`: builds the image for the Giga, as an ELF with what debuggers and emulators need.

use std::{
    env, fmt, fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use r4_image::Seal;

use crate::{
    image::{Image, Sizes},
    toolchain::{self, TARGET},
};

/// Robot that firmware is linked for; images for other robots on its carrier replace the configuration.
const LINKED_ROBOT: &str = "osmc-bench";

/// Image to build: for which robot, and of which kind.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Firmware {
    /// Name of a built-in robot, or the path of a robot's file.
    robot: String,
    /// Kind of image: `bare` or `hosted`.
    image: String,
}

impl Firmware {
    /// Makes the task for the image of one kind for one robot.
    pub(crate) fn new(robot: &str, image: &str) -> Self {
        Self { robot: robot.into(), image: image.into() }
    }

    /// Reads the words after `firmware`.
    ///
    /// # Errors
    /// The word that is no option.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut firmware = Self { robot: LINKED_ROBOT.into(), image: "bare".into() };
        let mut words = words.iter();
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or_else(|| format!("`{word}` needs a value"));
            match *word {
                "--robot" => firmware.robot = (*value()?).into(),
                "--image" => match *value()? {
                    image @ ("bare" | "hosted") => firmware.image = image.into(),
                    other => return Err(format!("an image is `bare` or `hosted`, not `{other}`")),
                },
                other => return Err(format!("`firmware` takes no `{other}`")),
            }
        }
        Ok(firmware)
    }

    /// Builds the image, copies it to where other tasks look for it, and prints what it is.
    pub(crate) fn run(&self, root: &Path) -> ExitCode {
        match self.build(root) {
            Ok(report) => {
                println!("{report}");
                ExitCode::SUCCESS
            }
            Err(problem) => {
                eprintln!("error: {problem}");
                ExitCode::FAILURE
            }
        }
    }

    /// Builds the image. Images for robots on the same carrier are linked once, and differ in the configuration that is written into them.
    ///
    /// # Errors
    /// The instruction for a person to solve the problem.
    pub(crate) fn build(&self, root: &Path) -> Result<Built, String> {
        toolchain::complete(root, &[])?;
        let robot = r4_boards::load(&self.robot).map_err(|problem| problem.to_string())?;
        let linked = r4_boards::load(LINKED_ROBOT).map_err(|problem| problem.to_string())?;
        let linked =
            if robot.carrier == linked.carrier { PathBuf::from(LINKED_ROBOT) } else { self.robot_for_build()? };
        let target = target_folder(root)?;
        // The folder has a workspace and a configuration of cargo of its own.
        let folder = root.join("firmware/giga");
        // Fetches first: `short_paths` needs the sources of dependencies.
        run(Command::new(toolchain::cargo()).args(["fetch", "--quiet", "--locked"]).current_dir(&folder))?;
        run(Command::new(toolchain::cargo())
            .args(["build", "--release", "--locked", "--config", &short_paths(root), "--target-dir"])
            .arg(target.join("giga"))
            .env("R4_ROBOT", linked)
            .env("R4_IMAGE", &self.image)
            .current_dir(&folder))?;
        let built = target.join("giga").join(TARGET).join("release/r4-giga");
        let mut elf = fs::read(&built).map_err(|error| format!("{}: {error}", built.display()))?;
        let seal = r4_image::set_robot(&mut elf, &robot.config).and_then(|()| r4_image::seal_elf(&mut elf));
        let seal = seal.map_err(|error| format!("{}: {error}", built.display()))?;
        let image = Image::read(&elf).ok_or_else(|| format!("{} is no ELF file of 32 bits", built.display()))?;
        let path = self.elf(root)?;
        fs::create_dir_all(path.parent().unwrap_or(root))
            .and_then(|()| fs::write(&path, &elf))
            .map_err(|error| format!("{}: {error}", path.display()))?;
        Ok(Built { path, digest: r4_image::digest(&elf), seal, image })
    }

    /// Returns the path to which [`Self::build`] copies the ELF file.
    ///
    /// # Errors
    /// The target folder is relative, and there is no current folder.
    pub(crate) fn elf(&self, root: &Path) -> Result<PathBuf, String> {
        Ok(target_folder(root)?.join("firmware").join(format!("{}-{}.elf", self.name(), self.image)))
    }

    /// Returns whether the image is started by the Arduino bootloader.
    pub(crate) fn is_hosted(&self) -> bool {
        self.image == "hosted"
    }

    /// Returns the robot for the build script. A path is made absolute, because the build script runs in another
    /// folder.
    fn robot_for_build(&self) -> Result<PathBuf, String> {
        if self.robot.ends_with(".toml") {
            return fs::canonicalize(&self.robot).map_err(|error| format!("{}: {error}", self.robot));
        }
        Ok(PathBuf::from(&self.robot))
    }

    fn name(&self) -> String {
        let file = Path::new(&self.robot).file_name().unwrap_or_default().to_string_lossy();
        file.strip_suffix(".toml").unwrap_or(&file).to_owned()
    }
}

/// Image that has been built.
pub(crate) struct Built {
    /// Path of the ELF file, where other tasks look for it.
    pub(crate) path: PathBuf,
    /// SHA-256 of the file.
    digest: String,
    /// Record with which the board compares its flash.
    seal: Seal,
    /// Sizes and symbols of the image.
    pub(crate) image: Image,
}

impl fmt::Display for Built {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Sizes { text, data, bss } = self.image.sizes;
        writeln!(f, "{}\n  text {text}, data {data}, bss {bss} bytes", self.path.display())?;
        writeln!(f, "  {} bytes in flash, CRC {:08x}", self.seal.bytes, self.seal.crc)?;
        write!(f, "  SHA-256 {}", self.digest)
    }
}

fn run(command: &mut Command) -> Result<(), String> {
    let status = command.status().map_err(|error| format!("cargo cannot be started: {error}"))?;
    if status.success() { Ok(()) } else { Err("the firmware does not build, see above".into()) }
}

/// Returns compiler flags that shorten paths. A panic's location has the name of a file, which takes flash. Without the
/// folders of this machine the image is 6 KB smaller, and the same on every machine.
fn short_paths(root: &Path) -> String {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| env::home_dir().map(|home| home.join(".cargo"))).unwrap_or_default();
    let registries = fs::read_dir(home.join("registry/src")).into_iter().flatten().flatten().map(|entry| entry.path());
    let library = toolchain::sysroot(root).map(|sysroot| (sysroot.join("lib/rustlib/src/rust"), "rust/"));
    let here = fs::canonicalize(root).ok();
    let folders = registries.chain(here).map(|folder| (folder, "")).chain(library);
    let flags = folders.map(|(folder, name)| format!("--remap-path-prefix={}/={name}", folder.display()));
    config(flags)
}

/// Makes an argument for cargo that adds flags to the configuration of `firmware/giga`.
fn config(flags: impl Iterator<Item = String>) -> String {
    // A Rust string literal is a TOML string, too.
    format!("target.{TARGET}.rustflags={:?}", flags.collect::<Vec<_>>())
}

/// Returns the absolute path of the folder that cargo builds into.
pub(crate) fn target_folder(root: &Path) -> Result<PathBuf, String> {
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    std::path::absolute(&target).map_err(|error| format!("{}: {error}", target.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(line: &str) -> Result<Firmware, String> {
        Firmware::parse(&line.split_whitespace().collect::<Vec<_>>())
    }

    #[test]
    fn command_lines_are_understood() {
        let firmware = |robot: &str, image: &str| Firmware { robot: robot.into(), image: image.into() };
        assert_eq!(of(""), Ok(firmware("osmc-bench", "bare")));
        assert_eq!(of("--image hosted --robot a/b.toml"), Ok(firmware("a/b.toml", "hosted")));
        assert_eq!(of("--robot a/b.toml").expect("good").name(), "b");
        assert_eq!(of("--robot openscout").expect("good").name(), "openscout");
    }

    #[test]
    fn flags_are_one_word_each() {
        let flags = ["--remap-path-prefix=/a b/=".to_owned(), "-g".into()].into_iter();
        assert_eq!(config(flags), format!(r#"target.{TARGET}.rustflags=["--remap-path-prefix=/a b/=", "-g"]"#));
    }

    #[test]
    fn others_are_refused_by_the_word_that_is_wrong() {
        for (line, word) in [("--image flash", "flash"), ("--robot", "needs a value"), ("now", "now")] {
            assert!(of(line).expect_err(line).contains(word), "{line}");
        }
    }
}
