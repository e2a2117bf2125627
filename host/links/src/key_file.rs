//! What reading a key asks of the operating system.

pub(crate) use system::{has_data, is_open_to_others, is_pipe, open};

#[cfg(unix)]
mod system {
    use std::{
        fs::{File, Metadata},
        io,
        os::{
            fd::AsFd,
            unix::fs::{FileTypeExt, PermissionsExt},
        },
        path::Path,
    };

    use rustix::{
        event::{PollFd, PollFlags, Timespec, poll},
        fs::{Mode, OFlags},
    };

    /// Opens a file or a pipe, without waiting for the writer of a pipe, or nothing could interrupt that.
    pub(crate) fn open(path: &Path) -> io::Result<File> {
        let flags = OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOCTTY;
        Ok(File::from(rustix::fs::open(path, flags, Mode::empty())?))
    }

    /// Whether other users may read it.
    pub(crate) fn is_open_to_others(metadata: &Metadata) -> bool {
        metadata.permissions().mode() & 0o077 != 0
    }

    pub(crate) fn is_pipe(metadata: &Metadata) -> bool {
        metadata.file_type().is_fifo()
    }

    /// Whether there is something to read, within 50 ms. The end is something, too.
    pub(crate) fn has_data(pipe: &File) -> io::Result<bool> {
        let mut waited = [PollFd::from_borrowed_fd(pipe.as_fd(), PollFlags::IN)];
        let timeout = Timespec { tv_sec: 0, tv_nsec: 50_000_000 };
        match poll(&mut waited, Some(&timeout)) {
            Ok(ready) => Ok(ready > 0),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }
}

/// Windows: plain files only, and no mode that could be too open: a user's own folder is closed to others there.
#[cfg(not(unix))]
mod system {
    use std::{
        fs::{File, Metadata},
        io,
        path::Path,
    };

    pub(crate) fn open(path: &Path) -> io::Result<File> {
        File::open(path)
    }

    pub(crate) fn is_open_to_others(_: &Metadata) -> bool {
        false
    }

    pub(crate) fn is_pipe(_: &Metadata) -> bool {
        false
    }

    pub(crate) fn has_data(_: &File) -> io::Result<bool> {
        Ok(true)
    }
}
