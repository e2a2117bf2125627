//! ELF file of an image: its location and its segments.

use std::{
    env, fmt, fs, io,
    ops::Range,
    path::{Path, PathBuf},
};

use crate::Place;

/// ELF file of an image, as it would be flashed.
#[derive(Clone)]
pub struct Image {
    path: PathBuf,
    elf: Vec<u8>,
}

/// Consecutive bytes of an image in flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    /// Address at which the program uses them.
    runs: u32,
    /// Address at which they are stored in flash.
    stored: u32,
    len: u32,
}

impl Segment {
    /// First of its addresses in flash.
    #[must_use]
    pub fn stored_at(self) -> u32 {
        self.stored
    }

    /// Address behind its last byte in flash.
    #[must_use]
    pub fn stored_end(self) -> u32 {
        self.stored.saturating_add(self.len)
    }

    /// Flash address of the byte that the program uses at `address`; `None` if it is not in this segment.
    #[must_use]
    pub fn stored(self, address: u32) -> Option<u32> {
        let offset = address.checked_sub(self.runs).filter(|offset| *offset < self.len)?;
        Some(self.stored + offset)
    }
}

/// Error of finding or reading a robot's image.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// There is no image at any of the expected places.
    #[error(
        "there is no firmware for {robot}: {} does not exist. Build it with `cargo xtask firmware --robot {robot} --image {kind}`, \
         or name an ELF file with R4_ELF",
        .path.display()
    )]
    Missing {
        /// Name of the robot.
        robot: String,
        /// Kind of image: bare or hosted.
        kind: &'static str,
        /// Path at which it was expected.
        path: PathBuf,
    },
    /// The file cannot be read.
    #[error("cannot read the firmware {}", .path.display())]
    Unreadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

impl Image {
    /// Finds the image for a robot: `R4_ELF` where that is set, else `firmware/<robot>-bare.elf` in the target folder
    /// of the calling program, where `cargo xtask firmware` puts it.
    ///
    /// # Errors
    /// [`FileError::Missing`] if there is none, [`FileError::Unreadable`] if it cannot be read.
    pub fn find(robot: &str) -> Result<Self, FileError> {
        match env::var_os("R4_ELF") {
            Some(path) => Self::read(Path::new(&path)),
            None => Self::built(robot, Place::Bare),
        }
    }

    /// Finds the image for a robot that `cargo xtask firmware` has built last.
    ///
    /// # Errors
    /// [`FileError::Missing`] if there is none, [`FileError::Unreadable`] if it cannot be read.
    pub fn built(robot: &str, place: Place) -> Result<Self, FileError> {
        let kind = place.name();
        // A robot may be named by the path of its file.
        let name = Path::new(robot).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let file = Path::new("firmware").join(format!("{name}-{kind}.elf"));
        let exe = env::current_exe().unwrap_or_default();
        // The program is target/debug/r4, or target/debug/deps/<a test>.
        let beside = exe.ancestors().skip(1).take(3).map(|folder| folder.join(&file));
        let mut places = beside.chain([Path::new("target").join(&file)]);
        match places.find(|path| path.is_file()) {
            Some(path) => Self::read(&path),
            None => Err(FileError::Missing { robot: robot.to_owned(), kind, path: Path::new("target").join(file) }),
        }
    }

    /// Reads the image in a file.
    ///
    /// # Errors
    /// [`FileError::Unreadable`] if it cannot be read.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let elf = fs::read(path).map_err(|source| FileError::Unreadable { path: path.to_owned(), source })?;
        Ok(Self { path: path.to_owned(), elf })
    }

    /// Returns the image with the same path and other contents, for tests and tools that change them.
    #[must_use]
    pub fn with_elf(&self, elf: Vec<u8>) -> Self {
        Self { path: self.path.clone(), elf }
    }

    /// Bytes of the ELF file.
    #[must_use]
    pub fn elf(&self) -> &[u8] {
        &self.elf
    }

    /// Path that the image was read from.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Flash address of its first segment, which begins with the vector table: where the chip boots, or where a
    /// bootloader jumps to. `None` if it is not an ELF file of 32 bits.
    #[must_use]
    pub fn start(&self) -> Option<u32> {
        self.segments().into_iter().map(|segment| segment.stored).min()
    }

    /// Segments of the file in flash; empty if it is not an ELF file of 32 bits (System V ABI, chapter 5: program
    /// headers).
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
