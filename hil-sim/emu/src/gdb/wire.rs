//! TCP connection to gdb.

use std::{
    collections::VecDeque,
    io::{self, Read, Write},
    net::TcpStream,
    time::{Duration, Instant},
};

use gdbstub::conn::Connection;

/// Real time between polls for gdb's bytes while the machine runs.
const LOOK_EVERY: Duration = Duration::from_millis(20);
/// Real time that a halted machine waits for bytes before it checks for an interruption.
const WAIT: Duration = Duration::from_millis(100);

/// TCP connection that collects the bytes of an answer and sends them in one piece.
pub(super) struct Wire {
    stream: TcpStream,
    received: VecDeque<u8>,
    to_send: Vec<u8>,
    looked: Instant,
}

impl Wire {
    pub(super) fn new(stream: TcpStream) -> io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_read_timeout(Some(WAIT))?;
        Ok(Self { stream, received: VecDeque::new(), to_send: Vec::new(), looked: Instant::now() })
    }

    /// Returns the next byte, waiting up to [`WAIT`] for it.
    pub(super) fn wait(&mut self) -> io::Result<Option<u8>> {
        if self.received.is_empty() {
            self.receive()?;
        }
        Ok(self.received.pop_front())
    }

    /// Returns the next byte if there is one. Does not wait, and reads the socket only every [`LOOK_EVERY`].
    pub(super) fn look(&mut self) -> io::Result<Option<u8>> {
        if self.received.is_empty() && self.looked.elapsed() >= LOOK_EVERY {
            self.looked = Instant::now();
            self.stream.set_nonblocking(true)?;
            let result = self.receive();
            self.stream.set_nonblocking(false)?;
            result?;
        }
        Ok(self.received.pop_front())
    }

    fn receive(&mut self) -> io::Result<()> {
        let mut bytes = [0; 4096];
        match self.stream.read(&mut bytes) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                self.received.extend(&bytes[..count]);
                Ok(())
            }
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => Ok(()),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(()),
            Err(error) => Err(error),
        }
    }
}

impl Connection for Wire {
    type Error = io::Error;

    fn write(&mut self, byte: u8) -> io::Result<()> {
        self.to_send.push(byte);
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        Write::write_all(&mut self.stream, &self.to_send)?;
        self.to_send.clear();
        Ok(())
    }
}
