//! File that holds a virtual board's flash between two runs.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use r4_protocol::config::BoardConfig;
use r4_sim::{
    flash::{Flash, SECTOR_BYTES},
    kept::{self, Loaded, Saved},
};

use crate::Notice;

/// File of a virtual board's flash; it need not exist yet.
#[derive(Debug)]
pub struct FlashFile {
    path: PathBuf,
    /// Content of the file when it was opened; empty when there was none.
    before: Vec<u8>,
}

/// Error of reading or writing a flash file.
#[derive(Debug, thiserror::Error)]
pub enum FlashFileError {
    /// The file exists and cannot be read.
    #[error("cannot read the flash {path}")]
    NotReadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write the flash {path}")]
    NotWritable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file does not contain a flash.
    #[error(
        "{path} is not the flash of a simulated board, or not all of it ({len} bytes; a whole one has {whole}): name \
         another file, or move this one away to begin with an empty flash"
    )]
    NoFlash {
        /// Path of the file.
        path: PathBuf,
        /// Length of the file, bytes.
        len: usize,
        /// Length of a complete flash, bytes.
        whole: usize,
    },
}

impl FlashFile {
    pub(crate) fn open(path: &Path) -> Result<Self, FlashFileError> {
        let before = match fs::read(path) {
            Ok(before) => before,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(source) => return Err(FlashFileError::NotReadable { path: path.to_owned(), source }),
        };
        Ok(Self { path: path.to_owned(), before })
    }

    /// Returns the flash; `None` for a file that does not exist or is empty.
    pub(crate) fn flash(&self) -> Result<Option<Flash>, FlashFileError> {
        if self.before.is_empty() {
            return Ok(None);
        }
        let whole = Flash::<SECTOR_BYTES>::new(kept::SECTORS).to_bytes().len();
        let flash = Flash::from_bytes(&self.before).filter(|_| self.before.len() == whole);
        let no_flash = || FlashFileError::NoFlash { path: self.path.clone(), len: self.before.len(), whole };
        flash.map(Some).ok_or_else(no_flash)
    }

    /// Notice for the user when a board built with `config` leaves a part of `flash` unused; `None` otherwise.
    pub(crate) fn review(&self, flash: &Flash, config: &BoardConfig) -> Option<Notice> {
        let Loaded { saved, skipped, .. } = kept::review(flash, config);
        let is_used = matches!(saved, Saved::Nothing | Saved::Changes) && skipped.count == 0;
        let (path, robot) = (self.path.clone(), config.robot.to_string());
        (!is_used).then_some(Notice::FlashNotUsed { path, saved, skipped: skipped.count.into(), robot })
    }

    /// Writes the content of `flash`, completely or not at all.
    ///
    /// # Errors
    /// [`FlashFileError::NotWritable`] when the file cannot be written.
    pub fn write(&self, flash: &Flash) -> Result<(), FlashFileError> {
        let now = flash.to_bytes();
        if now == self.before {
            return Ok(());
        }
        // Written beside the file and renamed over it: a crash in between leaves the old flash.
        let mut beside = self.path.clone().into_os_string();
        beside.push(".new");
        let written = fs::write(&beside, &now).and_then(|()| fs::rename(&beside, &self.path));
        written.map_err(|source| FlashFileError::NotWritable { path: self.path.clone(), source })
    }
}
