//! `cargo xtask firmware`: the image for the Giga, as an ELF with what debuggers and emulators need.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use sha2::{Digest, Sha256};

use crate::toolchain::{self, TARGET};

/// What to build.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Firmware {
    /// A built-in robot, or the path of its file.
    robot: String,
    /// `bare` or `hosted`.
    image: String,
}

impl Firmware {
    /// The image of one kind for one robot.
    pub(crate) fn new(robot: &str, image: &str) -> Self {
        Self { robot: robot.into(), image: image.into() }
    }

    /// Reads the words after `firmware`.
    ///
    /// # Errors
    /// The word that means nothing.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        let mut firmware = Self { robot: "osmc-bench".into(), image: "bare".into() };
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

    /// Builds it, copies it to where others look for it, and says what it is.
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

    /// Builds it, and tells where it is and what.
    ///
    /// # Errors
    /// What a person has to do.
    pub(crate) fn build(&self, root: &Path) -> Result<String, String> {
        toolchain::complete(root)?;
        let target = target_folder(root)?;
        let status = Command::new(toolchain::cargo())
            .args(["build", "--release", "--locked", "--target-dir"])
            .arg(target.join("giga"))
            .env("R4_ROBOT", self.robot_for_build()?)
            .env("R4_IMAGE", &self.image)
            // Its own workspace, with its own configuration of cargo.
            .current_dir(root.join("firmware/giga"))
            .status()
            .map_err(|error| format!("cargo cannot be started: {error}"))?;
        if !status.success() {
            return Err("the firmware does not build, see above".into());
        }
        let built = target.join("giga").join(TARGET).join("release/r4-giga");
        let elf = fs::read(&built).map_err(|error| format!("{}: {error}", built.display()))?;
        let sizes = Sizes::of(&elf).ok_or_else(|| format!("{} is no ELF file of 32 bits", built.display()))?;
        let path = self.elf(root)?;
        fs::create_dir_all(path.parent().unwrap_or(root))
            .and_then(|()| fs::write(&path, &elf))
            .map_err(|error| format!("{}: {error}", path.display()))?;
        let Sizes { text, data, bss } = sizes;
        let digest: String = Sha256::digest(&elf).iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(format!("{}\n  text {text}, data {data}, bss {bss} bytes\n  SHA-256 {digest}", path.display()))
    }

    /// Where [`Self::build`] puts it.
    ///
    /// # Errors
    /// There is no current folder.
    pub(crate) fn elf(&self, root: &Path) -> Result<PathBuf, String> {
        Ok(target_folder(root)?.join("firmware").join(format!("{}-{}.elf", self.name(), self.image)))
    }

    /// Whether it is for behind the Arduino bootloader.
    pub(crate) fn is_hosted(&self) -> bool {
        self.image == "hosted"
    }

    /// A file's path holds wherever the build script runs.
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

/// The folder that cargo builds into, whole.
pub(crate) fn target_folder(root: &Path) -> Result<PathBuf, String> {
    let target = env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    std::path::absolute(&target).map_err(|error| format!("{}: {error}", target.display()))
}

/// Bytes of an image by what becomes of them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Sizes {
    /// In flash only.
    text: u32,
    /// In flash, and copied into RAM.
    data: u32,
    /// In RAM only, the stack not counted.
    bss: u32,
}

impl Sizes {
    /// From the section headers (System V ABI, chapter 4); `None` when it is no little-endian ELF file of 32 bits.
    fn of(elf: &[u8]) -> Option<Self> {
        const NOBITS: u32 = 8;
        const NOTES: u32 = 7;
        const WRITE: u32 = 1;
        const ALLOCATED: u32 = 2;
        let word = |at: usize| Some(u32::from_le_bytes(elf.get(at..at + 4)?.try_into().ok()?));
        let half = |at: usize| Some(usize::from(u16::from_le_bytes(elf.get(at..at + 2)?.try_into().ok()?)));
        if elf.get(..6)? != b"\x7fELF\x01\x01" {
            return None;
        }
        let (table, entry, count) = (word(0x20)? as usize, half(0x2E)?, half(0x30)?);
        let mut sizes = Self::default();
        for header in (0..count).map(|index| table + index * entry) {
            let (kind, flags, size) = (word(header + 4)?, word(header + 8)?, word(header + 20)?);
            match (flags & ALLOCATED != 0, kind, flags & WRITE != 0) {
                (false, ..) | (_, NOTES, _) => {}
                (_, NOBITS, _) => sizes.bss += size,
                (_, _, true) => sizes.data += size,
                (_, _, false) => sizes.text += size,
            }
        }
        Some(sizes)
    }
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
    fn others_are_refused_by_the_word_that_is_wrong() {
        for (line, word) in [("--image flash", "flash"), ("--robot", "needs a value"), ("now", "now")] {
            assert!(of(line).expect_err(line).contains(word), "{line}");
        }
    }

    /// A header and five sections: code, data, bss, notes and debug information.
    #[test]
    fn sizes_are_those_of_the_allocated_sections() {
        let sections = [(1, 6, 100), (1, 3, 20), (8, 3, 3000), (7, 2, 7), (1, 0, 50_000)];
        let mut elf = vec![0; 52];
        elf[..6].copy_from_slice(b"\x7fELF\x01\x01");
        elf[0x20] = 52;
        elf[0x2E] = 40;
        elf[0x30] = sections.len() as u8;
        for (kind, flags, size) in sections {
            let mut header = [0; 40];
            for (at, value) in [(4, kind), (8, flags), (20, size)] {
                header[at..at + 4].copy_from_slice(&u32::to_le_bytes(value));
            }
            elf.extend(header);
        }
        assert_eq!(Sizes::of(&elf), Some(Sizes { text: 100, data: 20, bss: 3000 }));
        assert_eq!(Sizes::of(&elf[..elf.len() - 30]), None, "cut off");
        assert_eq!(Sizes::of(b"\x7fELF\x02\x01"), None, "64 bits");
    }
}
