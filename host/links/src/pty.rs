//! Pseudo-terminals: what serves a board on one looks like a serial port to whoever opens its other end.

use std::{
    io,
    os::fd::OwnedFd,
    path::{Path, PathBuf},
};

use rustix::{
    fs::{Mode, OFlags},
    io::{FdFlags, fcntl_setfd},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
};

use crate::{DEFAULT_BAUD, Descriptor, serial::make_raw};

/// The serving end of a pseudo-terminal.
#[derive(Debug)]
pub struct Pty {
    /// Reads what a client writes, and the other way round.
    pub descriptor: Descriptor,
    path: PathBuf,
    /// Kept open: without any client the serving end would read errors.
    _client: OwnedFd,
}

impl Pty {
    /// A new one, raw from the start: nothing is echoed or changed.
    ///
    /// # Errors
    /// The operating system's.
    pub fn open() -> io::Result<Self> {
        let server = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        // By itself and not as a flag of the call: macOS has no such flag.
        fcntl_setfd(&server, FdFlags::CLOEXEC)?;
        grantpt(&server)?;
        unlockpt(&server)?;
        let path = ptsname(&server, Vec::new())?;
        let path = PathBuf::from(path.into_string().map_err(|_| io::ErrorKind::InvalidData)?);
        let client = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        make_raw(&client, DEFAULT_BAUD)?;
        Ok(Self { descriptor: Descriptor::new(server)?, path, _client: client })
    }

    /// What a client opens.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}
