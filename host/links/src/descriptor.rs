//! One waitable handle of the operating system as a byte link: a terminal, a pseudo-terminal's end, a connected socket.

#[cfg(unix)]
use std::{fs::File, os::fd::OwnedFd};
use std::{
    io::{self, Read as _, Write as _},
    net::TcpStream,
    sync::Arc,
};

use async_io::Async;
use embedded_io_async::{ErrorType, Read, Write};

/// On Unix everything that can be waited for is a file descriptor, and reads and writes like a file.
#[cfg(unix)]
type Handle = File;
/// Windows waits for sockets only.
#[cfg(not(unix))]
type Handle = TcpStream;

/// One handle in non-blocking mode. Clones share it: a link's two directions.
#[derive(Clone, Debug)]
pub struct Descriptor(Arc<Async<Handle>>);

impl Descriptor {
    /// Takes a descriptor that can be waited for, which a plain file cannot.
    ///
    /// # Errors
    /// The operating system's.
    #[cfg(unix)]
    pub fn new(descriptor: OwnedFd) -> io::Result<Self> {
        Ok(Self(Arc::new(Async::new(descriptor.into())?)))
    }

    /// Takes a connected socket.
    ///
    /// # Errors
    /// The operating system's.
    pub fn socket(stream: TcpStream) -> io::Result<Self> {
        #[cfg(unix)]
        return Self::new(stream.into());
        #[cfg(not(unix))]
        return Ok(Self(Arc::new(Async::new(stream)?)));
    }

    /// Writes what the receiver has room for, and does not wait: 0 bytes when there is none.
    ///
    /// # Errors
    /// The operating system's.
    pub fn try_write(&self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            match (&mut self.0.get_ref()).write(bytes) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(0),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                result => return result,
            }
        }
    }
}

impl ErrorType for Descriptor {
    type Error = io::Error;
}

impl Read for Descriptor {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read_with(|mut handle| handle.read(&mut *buffer)).await
    }
}

impl Write for Descriptor {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write_with(|mut handle| handle.write(bytes)).await
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
