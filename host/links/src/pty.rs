//! Pseudo-terminals: a board served on one end looks like a serial port to the program that opens the other.

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

/// Serving end of a pseudo-terminal.
#[derive(Debug)]
pub struct Pty {
    /// Descriptor that reads what clients write, and writes what they read.
    pub descriptor: Descriptor,
    path: PathBuf,
    /// Client end, kept open: without any client the serving end would read errors.
    _client: OwnedFd,
}

impl Pty {
    /// Opens a pseudo-terminal in raw mode: no echo, no changes to bytes.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn open() -> io::Result<Self> {
        let server = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
        // CLOEXEC is set separately, because `openpt` on macOS has no such flag.
        fcntl_setfd(&server, FdFlags::CLOEXEC)?;
        grantpt(&server)?;
        unlockpt(&server)?;
        let path = ptsname(&server, Vec::new())?;
        let path = PathBuf::from(path.into_string().map_err(|_| io::ErrorKind::InvalidData)?);
        let client = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())?;
        make_raw(&client, DEFAULT_BAUD)?;
        Ok(Self { descriptor: Descriptor::new(server)?, path, _client: client })
    }

    /// Path that clients open.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }
}

#[cfg(test)]
mod tests {
    use embedded_io_async::{Read, Write};
    use rustix::termios::tcgetattr;

    use super::*;
    use crate::{block_on, serial::open_port};

    /// No byte is echoed, changed or interpreted on the way, at any rate.
    #[test]
    fn a_port_carries_every_byte_both_ways() {
        let all: Vec<u8> = (0..=255).collect();
        for baud in [9600, 115_200, DEFAULT_BAUD] {
            let mut pty = Pty::open().expect("a terminal");
            let mut port = open_port(pty.path(), baud).expect("opened");
            assert_eq!(tcgetattr(&pty._client).expect("a terminal").output_speed(), baud);
            block_on(async {
                let mut heard = [0; 256];
                port.write_all(&all).await.expect("written");
                pty.descriptor.read_exact(&mut heard).await.expect("read");
                assert_eq!(heard[..], all);
                pty.descriptor.write_all(&all).await.expect("written");
                port.read_exact(&mut heard).await.expect("read");
                assert_eq!(heard[..], all);
            });
        }
    }

    #[test]
    fn a_port_is_opened_once_at_a_time() {
        let pty = Pty::open().expect("a terminal");
        let port = open_port(pty.path(), DEFAULT_BAUD).expect("opened");
        let second = open_port(pty.path(), DEFAULT_BAUD).expect_err("it is in use");
        assert_eq!(second.kind(), io::ErrorKind::ResourceBusy);
        drop(port);
    }

    /// An inherited handle would keep the port open in a program started later.
    #[cfg(target_os = "linux")]
    #[test]
    fn no_other_program_inherits_a_port() {
        const O_ACCMODE: u32 = 0o3;
        const O_RDWR: u32 = 0o2;
        const O_CLOEXEC: u32 = 0o2_000_000;
        let pty = Pty::open().expect("a terminal");
        let _port = open_port(pty.path(), DEFAULT_BAUD).expect("opened");
        let mut found = 0;
        for entry in std::fs::read_dir("/proc/self/fd").expect("of Linux").flatten() {
            if std::fs::read_link(entry.path()).is_ok_and(|path| path == pty.path()) {
                let info = Path::new("/proc/self/fdinfo").join(entry.file_name());
                let text = std::fs::read_to_string(info).expect("of Linux");
                let flags = text.lines().find_map(|line| line.strip_prefix("flags:")).expect("flags");
                let flags = u32::from_str_radix(flags.trim(), 8).expect("octal");
                assert_eq!((flags & O_ACCMODE, flags & O_CLOEXEC), (O_RDWR, O_CLOEXEC), "{flags:#o}");
                found += 1;
            }
        }
        assert_eq!(found, 2, "the port, and the end that keeps the terminal alive");
    }
}
