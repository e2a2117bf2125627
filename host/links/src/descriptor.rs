//! Pollable handle of the operating system as a byte link: a terminal, one end of a pseudo-terminal, or a connected
//! socket.

#[cfg(unix)]
use std::{fs::File, os::fd::OwnedFd};
use std::{
    io::{self, Read as _, Write as _},
    net::TcpStream,
    sync::Arc,
};

use async_io::Async;
use embedded_io_async::{ErrorType, Read, Write};

/// Unix: every pollable object is a file descriptor, read and written as a file.
#[cfg(unix)]
type Handle = File;
/// Windows: only sockets are pollable.
#[cfg(not(unix))]
type Handle = TcpStream;

/// Handle in non-blocking mode. Clones share it, one for each direction of a link.
#[derive(Clone, Debug)]
pub struct Descriptor(Arc<Async<Handle>>);

impl Descriptor {
    /// Wraps a pollable descriptor; a plain file is not pollable.
    ///
    /// # Errors
    /// Those of the operating system.
    #[cfg(unix)]
    pub fn new(descriptor: OwnedFd) -> io::Result<Self> {
        Ok(Self(Arc::new(Async::new(descriptor.into())?)))
    }

    /// Wraps a connected socket.
    ///
    /// # Errors
    /// Those of the operating system.
    pub fn socket(stream: TcpStream) -> io::Result<Self> {
        #[cfg(unix)]
        return Self::new(stream.into());
        #[cfg(not(unix))]
        return Ok(Self(Arc::new(Async::new(stream)?)));
    }

    /// Writes as many bytes as the receiver has room for, without waiting; returns 0 when there is none.
    ///
    /// # Errors
    /// Those of the operating system.
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

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::os::unix::net::UnixStream;

    use super::*;
    use crate::block_on;

    fn pair() -> [Descriptor; 2] {
        let (one, other) = UnixStream::pair().expect("sockets of this machine");
        [one, other].map(|end| Descriptor::new(end.into()).expect("it can be waited for"))
    }

    #[test]
    fn bytes_go_both_ways_until_the_other_end_is_gone() {
        let [mut one, mut other] = pair();
        block_on(async {
            let mut heard = [0; 5];
            one.write_all(b"there").await.expect("written");
            other.read_exact(&mut heard).await.expect("read");
            assert_eq!(&heard, b"there");
            other.write_all(b"and b").await.expect("written");
            one.read_exact(&mut heard).await.expect("read");
            assert_eq!(&heard, b"and b");
            drop(other);
            assert_eq!(one.read(&mut heard).await.expect("the end is no error"), 0);
        });
    }

    #[test]
    fn what_there_is_no_room_for_is_not_waited_for() {
        let [one, mut other] = pair();
        let mut written = 0;
        loop {
            match one.try_write(&[7; 1000]).expect("the other end is there") {
                0 => break,
                len => written += len,
            }
            assert!(written < 1 << 26, "no socket has so much room");
        }
        let mut heard = vec![0; written];
        block_on(other.read_exact(&mut heard)).expect("read");
        assert!(heard.iter().all(|byte| *byte == 7));
        assert_eq!(one.try_write(b"again").expect("there is room now"), 5);
        drop(other);
        assert_eq!(one.try_write(b"gone").expect_err("nobody").kind(), io::ErrorKind::BrokenPipe);
    }
}
