//! The ELF file of an image: where it is, and which it is.

use std::{
    env, fmt, fs, io,
    ops::Range,
    path::{Path, PathBuf},
};

use crate::Place;

/// An ELF file as it would be flashed.
#[derive(Clone)]
pub struct Image {
    path: PathBuf,
    elf: Vec<u8>,
}

/// Consecutive bytes of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    /// The address at which the program uses them.
    runs: u32,
    /// Where the flash has them.
    stored: u32,
    len: u32,
}

impl Segment {
    /// The first of its addresses in flash.
    #[must_use]
    pub fn stored_at(self) -> u32 {
        self.stored
    }

    /// Behind the last of its addresses in flash.
    #[must_use]
    pub fn stored_end(self) -> u32 {
        self.stored.saturating_add(self.len)
    }

    /// Where the flash has what the program uses at `address`.
    #[must_use]
    pub fn stored(self, address: u32) -> Option<u32> {
        let offset = address.checked_sub(self.runs).filter(|offset| *offset < self.len)?;
        Some(self.stored + offset)
    }
}

/// There is no image for a robot.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// None is where it is looked for.
    #[error(
        "there is no firmware for {robot}: {} does not exist. Build it with `cargo xtask firmware --robot {robot} --image {kind}`, \
         or name an ELF file with R4_ELF",
        .path.display()
    )]
    Missing {
        /// Robot.
        robot: String,
        /// Kind of image.
        kind: &'static str,
        /// Where it was looked for.
        path: PathBuf,
    },
    /// It cannot be read.
    #[error("cannot read the firmware {}", .path.display())]
    Unreadable {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl Image {
    /// The image for a robot: `R4_ELF` where that is set, else `firmware/<robot>-bare.elf` in the target folder of the
    /// program that asks, where `cargo xtask firmware` puts it.
    ///
    /// # Errors
    /// When it is not there.
    pub fn find(robot: &str) -> Result<Self, FileError> {
        match env::var_os("R4_ELF") {
            Some(path) => Self::read(Path::new(&path)),
            None => Self::built(robot, Place::Bare),
        }
    }

    /// The image for a robot that `cargo xtask firmware` has built last.
    ///
    /// # Errors
    /// When it is not there.
    pub fn built(robot: &str, place: Place) -> Result<Self, FileError> {
        let kind = place.name();
        let name = Path::new(robot).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let file = Path::new("firmware").join(format!("{name}-{kind}.elf"));
        let exe = env::current_exe().unwrap_or_default();
        // target/debug/r4, or target/debug/deps/<a test>.
        let beside = exe.ancestors().skip(1).take(3).map(|folder| folder.join(&file));
        let mut places = beside.chain([Path::new("target").join(&file)]);
        match places.find(|path| path.is_file()) {
            Some(path) => Self::read(&path),
            None => Err(FileError::Missing { robot: robot.to_owned(), kind, path: Path::new("target").join(file) }),
        }
    }

    /// The image in a file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let elf = fs::read(path).map_err(|source| FileError::Unreadable { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), elf })
    }

    /// The same file with other contents, as a test or a tool has made them.
    #[must_use]
    pub fn with_elf(&self, elf: Vec<u8>) -> Self {
        Self { path: self.path.clone(), elf }
    }

    /// Its bytes.
    #[must_use]
    pub fn elf(&self) -> &[u8] {
        &self.elf
    }

    /// Where it came from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Where its first segment is stored in flash, which begins with the vector table: where the chip boots, or where a
    /// bootloader jumps to. `None` for what is no ELF file of 32 bits.
    #[must_use]
    pub fn start(&self) -> Option<u32> {
        self.segments().into_iter().map(|segment| segment.stored).min()
    }

    /// What the file has for the flash; nothing for what is no ELF file of 32 bits (System V ABI, chapter 5: program headers).
    #[must_use]
    pub fn segments(&self) -> Vec<Segment> {
        const LOAD: u32 = 1;
        const FLASH: Range<u32> = 0x0800_0000..0x0820_0000;
        let bytes = |at: usize, len: usize| self.elf.get(at..at + len);
        let word = |at| Some(u32::from_le_bytes(bytes(at, 4)?.try_into().ok()?));
        let half = |at| Some(usize::from(u16::from_le_bytes(bytes(at, 2)?.try_into().ok()?)));
        // A segment that is empty in the file is in RAM only.
        let segment = |header: usize| {
            let [kind, runs, stored, len] = [word(header)?, word(header + 8)?, word(header + 12)?, word(header + 16)?];
            (kind == LOAD && len > 0 && FLASH.contains(&stored)).then_some(Segment { runs, stored, len })
        };
        let all = || {
            bytes(0, 6).filter(|ident| ident == b"\x7fELF\x01\x01")?;
            let (table, entry, count) = (word(0x1C)? as usize, half(0x2A)?, half(0x2C)?);
            Some((0..count).filter_map(|index| segment(table + index * entry)).collect())
        };
        all().unwrap_or_default()
    }

    /// SHA-256 of the file, as `sha256sum` prints it.
    #[must_use]
    pub fn digest(&self) -> String {
        crate::digest(&self.elf)
    }
}

impl fmt::Debug for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Image").field("path", &self.path).field("bytes", &self.elf.len()).finish()
    }
}
