//! The file that holds a virtual board's flash between two runs.

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

/// A file with a virtual board's flash, or the place for one.
#[derive(Debug)]
pub struct FlashFile {
    path: PathBuf,
    /// Content when it was opened; empty before there was a file.
    before: Vec<u8>,
}

/// The flash cannot be taken from its file, or put there.
#[derive(Debug, thiserror::Error)]
pub enum FlashFileError {
    /// There is a file, and it cannot be read.
    #[error("cannot read the flash {path}")]
    NotReadable {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("cannot write the flash {path}")]
    NotWritable {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// Its content is something else.
    #[error(
        "{path} is not the flash of a simulated board, or not all of it ({len} bytes; a whole one has {whole}): name \
         another file, or move this one away to begin with an empty flash"
    )]
    NoFlash {
        /// The file.
        path: PathBuf,
        /// Its length, bytes.
        len: usize,
        /// Length of a flash, bytes.
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

    /// The flash, or `None` where nothing was ever written.
    pub(crate) fn flash(&self) -> Result<Option<Flash>, FlashFileError> {
        if self.before.is_empty() {
            return Ok(None);
        }
        let whole = Flash::<SECTOR_BYTES>::new(kept::SECTORS).to_bytes().len();
        let flash = Flash::from_bytes(&self.before).filter(|_| self.before.len() == whole);
        let no_flash = || FlashFileError::NoFlash { path: self.path.clone(), len: self.before.len(), whole };
        flash.map(Some).ok_or_else(no_flash)
    }

    /// Why a board that was built with `config` leaves something of `flash` unused, if it does.
    pub(crate) fn review(&self, flash: &Flash, config: &BoardConfig) -> Option<Notice> {
        let Loaded { saved, skipped, .. } = kept::review(flash, config);
        let is_used = matches!(saved, Saved::Nothing | Saved::Changes) && skipped.count == 0;
        let (path, robot) = (self.path.clone(), config.robot.to_string());
        (!is_used).then_some(Notice::FlashNotUsed { path, saved, skipped: skipped.count.into(), robot })
    }

    /// Writes what `flash` holds now: all of it, or nothing.
    ///
    /// # Errors
    /// [`FlashFileError::NotWritable`]
    pub fn write(&self, flash: &Flash) -> Result<(), FlashFileError> {
        let now = flash.to_bytes();
        if now == self.before {
            return Ok(());
        }
        let mut beside = self.path.clone().into_os_string();
        beside.push(".new");
        let written = fs::write(&beside, &now).and_then(|()| fs::rename(&beside, &self.path));
        written.map_err(|source| FlashFileError::NotWritable { path: self.path.clone(), source })
    }
}
