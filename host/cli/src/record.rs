//! `--record`: what goes over a session's link, in a file.

use std::{
    cell::RefCell,
    env,
    fs::{self, File},
    io::{self, BufWriter, Cursor, Write},
    path::PathBuf,
    rc::Rc,
    sync::atomic::{AtomicBool, Ordering},
    time::{SystemTime, UNIX_EPOCH},
};

use anyhow::{Context, bail};
use embedded_io_async::{ErrorType, Read};
use r4_driver::Clock as _;
use r4_links::RealClock;
use r4_log::{About, Tap, Wall};
use r4_sim::Pace;

use crate::{
    args::Args,
    session::{self, Elapsed, HostClock, Session, Target},
};

/// Where a recording goes.
pub(crate) enum Output {
    File(BufWriter<File>),
    Memory(Cursor<Vec<u8>>),
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::File(file) => file.write(bytes),
            Self::Memory(memory) => memory.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::File(file) => file.flush(),
            Self::Memory(memory) => memory.flush(),
        }
    }
}

/// A recording that the link, the session and whoever started it share.
pub(crate) type SharedTap = Rc<RefCell<Tap<Output>>>;

/// A tap for a session with the board that `args` name.
pub(crate) fn tap(args: &Args, output: Output) -> SharedTap {
    let seed = match args.board {
        Target::Sim(_) | Target::Emu(_) => Some(args.seed),
        Target::Link(_) => None,
    };
    let unix_ns = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as u64;
    let wall = match args.board {
        Target::Sim(_) | Target::Emu(_) => Wall::Began { unix_ns },
        Target::Link(_) => Wall::Runs { unix_ns_at_zero: unix_ns.saturating_sub(RealClock.now_us() * 1_000) },
    };
    let about = About {
        board: args.board.to_string(),
        seed,
        program: concat!("r4 ", env!("CARGO_PKG_VERSION")).to_owned(),
        command: typed(env::args().skip(1)),
        wall,
    };
    Rc::new(RefCell::new(Tap::new(output, about)))
}

/// The command line with these arguments, as a shell reads it.
fn typed(arguments: impl Iterator<Item = String>) -> String {
    let plain = |char: char| char.is_ascii_alphanumeric() || "-_./:=,@%+#".contains(char);
    let quoted = |word: String| match !word.is_empty() && word.chars().all(plain) {
        true => word,
        false => format!("'{}'", word.replace('\'', r"'\''")),
    };
    // What a blind board has must not be told by its log.
    let mut seed_follows = false;
    let told = arguments.filter(|word| {
        let is_hidden = seed_follows || word == "--blind" || word.starts_with("--blind=");
        seed_follows = word == "--blind" && !seed_follows;
        !is_hidden
    });
    told.map(quoted).fold("r4".to_owned(), |line, word| line + " " + &word)
}

/// A session has been recorded, or is being.
static RECORDED: AtomicBool = AtomicBool::new(false);

/// Whether a session has been recorded.
pub(crate) fn is_recorded() -> bool {
    RECORDED.load(Ordering::Relaxed)
}

/// A session and its recording.
pub(crate) struct Recorded<T> {
    /// Result of the session; where that went well, why the recording is not complete.
    pub(crate) result: anyhow::Result<(T, Elapsed)>,
    /// The log as far as it came; empty if the board never described itself.
    pub(crate) log: Vec<u8>,
}

/// Runs `work` in a session as [`session::run`] does and records it in memory, for verbs that read their own log. `--record`
/// gets the same bytes.
pub(crate) fn in_memory<T>(
    args: &Args,
    default_pace: Pace,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> Recorded<T> {
    let tap = tap(args, Output::Memory(Cursor::new(Vec::new())));
    let result = session::run_with(args, default_pace, Some(tap.clone()), work);
    let (log, closed) = match finish(tap) {
        Ok(Some(Output::Memory(memory))) => {
            let log = memory.into_inner();
            let kept = args.record.as_ref().map_or(Ok(()), |path| {
                RECORDED.store(true, Ordering::Relaxed);
                fs::write(path, &log).with_context(|| format!("cannot write {}", path.display()))
            });
            (log, kept)
        }
        Ok(Some(Output::File(_)) | None) => (Vec::new(), Ok(())),
        Err(error) => (Vec::new(), Err(error)),
    };
    Recorded { result: result.and_then(|value| closed.map(|()| value)), log }
}

/// The recording of one session, or of several that a lost link parts, to a file.
pub(crate) struct Recording {
    path: PathBuf,
    tap: SharedTap,
}

impl Recording {
    /// What `--record` asks for.
    pub(crate) fn open(args: &Args) -> anyhow::Result<Option<Self>> {
        let Some(path) = args.record.clone() else { return Ok(None) };
        if RECORDED.swap(true, Ordering::Relaxed) {
            bail!("--record holds one session, and this opens several: it cannot be recorded as a whole");
        }
        let file = File::create(&path).with_context(|| format!("cannot make the log {}", path.display()))?;
        let tap = tap(args, Output::File(BufWriter::new(file)));
        Ok(Some(Self { path, tap }))
    }

    pub(crate) fn tap(&self) -> SharedTap {
        self.tap.clone()
    }

    /// Ends the file once the session is over. What went wrong in the session goes before what went wrong here.
    pub(crate) fn close<T>(self, result: anyhow::Result<T>) -> anyhow::Result<T> {
        let path = self.path.display();
        let bad_frames = self.tap.borrow().bad_frames();
        if bad_frames > 0 {
            eprintln!("r4: {bad_frames} frames from the board were damaged: what they said is not in {path}");
        }
        let closed = match finish(self.tap) {
            Ok(Some(_)) => Ok(()),
            Ok(None) => {
                // The board never said what it is, which is what the session failed with.
                let _ = fs::remove_file(&self.path);
                Ok(())
            }
            Err(error) => Err(error.context(format!("{path} is not complete"))),
        };
        match (result, closed) {
            (Ok(value), Ok(())) => Ok(value),
            (Ok(_), Err(error)) => Err(error),
            (Err(error), Ok(())) => Err(error),
            (Err(error), Err(closed)) => {
                eprintln!("r4: {closed:#}");
                Err(error)
            }
        }
    }
}

/// Writes the end of a recording and gives back where it went; `None` if nothing was written.
pub(crate) fn finish(tap: SharedTap) -> anyhow::Result<Option<Output>> {
    match Rc::try_unwrap(tap) {
        Ok(tap) => Ok(tap.into_inner().finish()?),
        Err(_) => bail!("the recording is still in use"),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_kept_as_a_shell_reads_it() {
        let words = ["uart", "0", "--write", "it's 5 V", "--board", "can:can0#5", ""];
        let kept = typed(words.into_iter().map(str::to_owned));
        assert_eq!(kept, r"r4 uart 0 --write 'it'\''s 5 V' --board can:can0#5 ''");
    }

    #[test]
    fn the_seed_of_a_blind_board_is_not_kept() {
        for line in ["--blind 7 move osmc0 1rad", "--blind=7 move osmc0 1rad", "move osmc0 1rad --blind 7"] {
            assert_eq!(typed(line.split(' ').map(str::to_owned)), "r4 move osmc0 1rad", "{line}");
        }
    }
}
