//! What goes over a session's link, as a log.

use std::{
    cell::RefCell,
    fs::{self, File},
    io::{self, BufWriter, Cursor, Write},
    path::PathBuf,
    rc::Rc,
    time::{SystemTime, UNIX_EPOCH},
};

use embedded_io_async::{ErrorType, Read};
use r4_driver::Clock as _;
use r4_links::RealClock;
use r4_log::{About, RecordError, Tap, Wall};

use crate::{HostClock, Target};

/// Where a recording goes.
#[derive(Debug)]
pub enum Output {
    /// Into a file.
    File(BufWriter<File>),
    /// Into memory.
    Memory(Cursor<Vec<u8>>),
    /// Discarded: the recording is for live views only ([`Tap::tell`]).
    Nowhere(io::Sink),
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.write(bytes),
            Self::Memory(memory) => memory.write(bytes),
            Self::Nowhere(sink) => sink.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::File(file) => file.flush(),
            Self::Memory(memory) => memory.flush(),
            Self::Nowhere(sink) => sink.flush(),
        }
    }
}

/// A recording that the link, the session and the caller share.
pub type SharedTap = Rc<RefCell<Tap<Output>>>;

/// A recording is not complete.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// Its file cannot be created.
    #[error("cannot make the log {path}")]
    NotCreated {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The end of the log cannot be written.
    #[error(transparent)]
    NotWritten(#[from] RecordError),
    /// The end of a file cannot be written.
    #[error("{path} is not complete")]
    NotComplete {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: Box<Self>,
    },
    /// Something else still records into it.
    #[error("the recording is still in use")]
    InUse,
}

/// A tap for a session with the board at `target`, recorded by `program` for `command`, a command line without secrets.
#[must_use]
pub fn tap(target: &Target, seed: u64, program: String, command: String, output: Output) -> SharedTap {
    let unix_ns = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as u64;
    let (seed, wall) = match target {
        Target::Sim(_) | Target::Emu(_) => (Some(seed), Wall::Began { unix_ns }),
        Target::Link(_) => (None, Wall::Runs { unix_ns_at_zero: unix_ns.saturating_sub(RealClock.now_us() * 1_000) }),
    };
    let about = About { board: target.to_string(), seed, program, command, wall };
    Rc::new(RefCell::new(Tap::new(output, about)))
}

/// Writes the end of a recording and returns where it went; `None` if nothing was written.
///
/// # Errors
/// When the session still has it, or the end cannot be written.
pub fn finish(tap: SharedTap) -> Result<Option<Output>, RecordingError> {
    match Rc::try_unwrap(tap) {
        Ok(tap) => Ok(tap.into_inner().finish()?),
        Err(_) => Err(RecordingError::InUse),
    }
}

/// The log of a recording in memory, after [`finish`]; empty if the board never described itself.
#[must_use]
pub fn bytes(output: Option<Output>) -> Vec<u8> {
    match output {
        Some(Output::Memory(memory)) => memory.into_inner(),
        Some(Output::File(_) | Output::Nowhere(_)) | None => Vec::new(),
    }
}

/// The recording of one session, or of several that a lost link parts, in a file.
pub struct Recording {
    /// `None` for a recording that is discarded.
    path: Option<PathBuf>,
    tap: SharedTap,
}

/// End of a recording that went into a file.
#[derive(Debug)]
pub struct Closed {
    /// Frames from the board that were damaged: their content is not in the file.
    pub bad_frames: u64,
    /// Why the file is not complete, if it is not.
    pub result: Result<(), RecordingError>,
}

impl Recording {
    /// Makes the file `path`; `tap` makes the recording of it.
    ///
    /// # Errors
    /// [`RecordingError::NotCreated`]
    pub fn create(path: PathBuf, tap: impl FnOnce(Output) -> SharedTap) -> Result<Self, RecordingError> {
        match File::create(&path) {
            Ok(file) => Ok(Self { tap: tap(Output::File(BufWriter::new(file))), path: Some(path) }),
            Err(source) => Err(RecordingError::NotCreated { path, source }),
        }
    }

    /// Makes a recording without a file, for live views.
    pub fn nowhere(tap: impl FnOnce(Output) -> SharedTap) -> Self {
        Self { tap: tap(Output::Nowhere(io::sink())), path: None }
    }

    /// The recording, for a session.
    #[must_use]
    pub fn tap(&self) -> SharedTap {
        self.tap.clone()
    }

    /// Ends the file once the session is over. A file of a board that never described itself is removed.
    #[must_use]
    pub fn close(self) -> Closed {
        let bad_frames = self.tap.borrow().bad_frames();
        let result = match finish(self.tap) {
            Ok(Some(_)) => Ok(()),
            Ok(None) => {
                // The session failed, and says why.
                if let Some(path) = &self.path {
                    let _ = fs::remove_file(path);
                }
                Ok(())
            }
            Err(source) => Err(match self.path {
                Some(path) => RecordingError::NotComplete { path, source: Box::new(source) },
                None => source,
            }),
        };
        Closed { bad_frames, result }
    }
}

/// One direction of a link, listened to.
pub(crate) struct Listened<L> {
    link: L,
    tap: Option<SharedTap>,
    clock: HostClock,
}

impl<L> Listened<L> {
    pub(crate) fn new(link: L, tap: Option<&SharedTap>, clock: &HostClock) -> Self {
        Self { link, tap: tap.cloned(), clock: clock.clone() }
    }
}

impl<L: ErrorType> ErrorType for Listened<L> {
    type Error = L::Error;
}

impl<L: Read> Read for Listened<L> {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, L::Error> {
        let len = self.link.read(buffer).await?;
        if let Some(tap) = &self.tap {
            tap.borrow_mut().received(self.clock.now_us(), &buffer[..len]);
        }
        Ok(len)
    }
}

impl<L: embedded_io_async::Write> embedded_io_async::Write for Listened<L> {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, L::Error> {
        // Before it waits: when the host wanted it sent.
        let now_us = self.clock.now_us();
        let len = self.link.write(bytes).await?;
        if let Some(tap) = &self.tap {
            tap.borrow_mut().sent(now_us, &bytes[..len]);
        }
        Ok(len)
    }

    async fn flush(&mut self) -> Result<(), L::Error> {
        self.link.flush().await
    }
}
