//! Recording of a session's link traffic as a log.

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

/// Destination of a recording.
#[derive(Debug)]
pub enum Output {
    /// File on disk, buffered.
    File(BufWriter<File>),
    /// Buffer in memory, which grows.
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

/// Recording that the link, the session and the caller share.
pub type SharedTap = Rc<RefCell<Tap<Output>>>;

/// Error of a recording that is not complete.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The log file cannot be created.
    #[error("cannot make the log {path}")]
    NotCreated {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The end of the log cannot be written.
    #[error(transparent)]
    NotWritten(#[from] RecordError),
    /// The end of a log file cannot be written.
    #[error("{path} is not complete")]
    NotComplete {
        /// Path of the file.
        path: PathBuf,
        /// Error of writing the end.
        source: Box<Self>,
    },
    /// The recording is still shared, so that its end cannot be written.
    #[error("the recording is still in use")]
    InUse,
}

/// Creates a tap for a session with the board at `target`, recorded by `program` for `command`, a command line without
/// secrets.
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

/// Writes the end of a recording and returns its output; `None` if nothing was written.
///
/// # Errors
/// [`RecordingError::InUse`] while the session holds it; [`RecordingError::NotWritten`] when the end cannot be written.
pub fn finish(tap: SharedTap) -> Result<Option<Output>, RecordingError> {
    match Rc::try_unwrap(tap) {
        Ok(tap) => Ok(tap.into_inner().finish()?),
        Err(_) => Err(RecordingError::InUse),
    }
}

/// Returns the log of a recording in memory, after [`finish`]; empty if the board never described itself.
#[must_use]
pub fn bytes(output: Option<Output>) -> Vec<u8> {
    match output {
        Some(Output::Memory(memory)) => memory.into_inner(),
        Some(Output::File(_) | Output::Nowhere(_)) | None => Vec::new(),
    }
}

/// Recording of one session, or of several that a lost link separates, in a file.
pub struct Recording {
    /// Path of the file; `None` for a recording that is discarded.
    path: Option<PathBuf>,
    tap: SharedTap,
}

/// End of a recording that went into a file.
#[derive(Debug)]
pub struct Closed {
    /// Number of damaged frames from the board: their content is not in the file.
    pub bad_frames: u64,
    /// Error when the file is not complete.
    pub result: Result<(), RecordingError>,
}

impl Recording {
    /// Creates the file `path`; `tap` creates the recording on it.
    ///
    /// # Errors
    /// [`RecordingError::NotCreated`] when the file cannot be created.
    pub fn create(path: PathBuf, tap: impl FnOnce(Output) -> SharedTap) -> Result<Self, RecordingError> {
        match File::create(&path) {
            Ok(file) => Ok(Self { tap: tap(Output::File(BufWriter::new(file))), path: Some(path) }),
            Err(source) => Err(RecordingError::NotCreated { path, source }),
        }
    }

    /// Creates a recording without a file, for live views.
    pub fn nowhere(tap: impl FnOnce(Output) -> SharedTap) -> Self {
        Self { tap: tap(Output::Nowhere(io::sink())), path: None }
    }

    /// Returns the tap for a session.
    #[must_use]
    pub fn tap(&self) -> SharedTap {
        self.tap.clone()
    }

    /// Completes the file after the session. A file of a board that never described itself is removed.
    #[must_use]
    pub fn close(self) -> Closed {
        let bad_frames = self.tap.borrow().bad_frames();
        let result = match finish(self.tap) {
            Ok(Some(_)) => Ok(()),
            Ok(None) => {
                // The session has failed and reports the reason itself.
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

/// Wrapper of one direction of a link that records its bytes.
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
        // Taken before the write, which may wait: the log has the time at which the host sent.
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
