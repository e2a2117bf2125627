//! A file descriptor as a byte link: a terminal, a pseudo-terminal's end, a connected socket.

use std::{
    io,
    os::fd::{AsFd, OwnedFd},
    sync::Arc,
};

use async_io::Async;
use embedded_io_async::{ErrorType, Read, Write};

/// One descriptor, in non-blocking mode. Clones are the same one: a link's two directions.
#[derive(Clone, Debug)]
pub struct Descriptor(Arc<Async<OwnedFd>>);

impl Descriptor {
    /// Takes a descriptor that can be waited for, which a plain file cannot.
    ///
    /// # Errors
    /// The operating system's.
    pub fn new(descriptor: OwnedFd) -> io::Result<Self> {
        Ok(Self(Arc::new(Async::new(descriptor)?)))
    }

    /// Writes what the receiver has room for, and does not wait: 0 bytes when there is none.
    ///
    /// # Errors
    /// The operating system's.
    pub fn try_write(&self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            match rustix::io::write(self.0.get_ref().as_fd(), bytes) {
                Ok(len) => return Ok(len),
                Err(rustix::io::Errno::AGAIN) => return Ok(0),
                Err(rustix::io::Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// The descriptor itself.
    #[must_use]
    pub fn get(&self) -> &OwnedFd {
        self.0.get_ref()
    }
}

impl ErrorType for Descriptor {
    type Error = io::Error;
}

impl Read for Descriptor {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read_with(|descriptor| Ok(rustix::io::read(descriptor, &mut *buffer)?)).await
    }
}

impl Write for Descriptor {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write_with(|descriptor| Ok(rustix::io::write(descriptor, bytes)?)).await
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
