//! `--record`: a file with the traffic of a session's link.

use std::{
    env,
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::bail;
use r4_rig::recording::{self, Output, SharedTap};

use crate::{args::Args, live};

/// Tap for a session with the board that `args` name.
pub(crate) fn tap(args: &Args, output: Output) -> SharedTap {
    let program = concat!("r4 ", env!("CARGO_PKG_VERSION")).to_owned();
    recording::tap(&args.board, args.seed, program, typed(env::args().skip(1)), output)
}

/// Command line of these arguments, quoted for a shell.
fn typed(arguments: impl Iterator<Item = String>) -> String {
    let plain = |char: char| char.is_ascii_alphanumeric() || "-_./:=,@%+#".contains(char);
    let quoted = |word: String| match !word.is_empty() && word.chars().all(plain) {
        true => word,
        false => format!("'{}'", word.replace('\'', r"'\''")),
    };
    // The log must not reveal the seed of a blind board.
    let mut seed_follows = false;
    let told = arguments.filter(|word| {
        let is_hidden = seed_follows || word == "--blind" || word.starts_with("--blind=");
        seed_follows = word == "--blind" && !seed_follows;
        !is_hidden
    });
    told.map(quoted).fold("r4".to_owned(), |line, word| line + " " + &word)
}

/// True once a recording of a session was begun.
static RECORDED: AtomicBool = AtomicBool::new(false);

/// Returns whether a session was recorded.
pub(crate) fn is_recorded() -> bool {
    RECORDED.load(Ordering::Relaxed)
}

/// Marks a session as recorded.
pub(crate) fn is_made() {
    RECORDED.store(true, Ordering::Relaxed);
}

/// Recording of one session to a file, or of several separated by a lost link.
pub(crate) struct Recording {
    /// File name; `None` for a recording that is discarded, as of a live view without `--record`.
    path: Option<String>,
    recording: recording::Recording,
}

impl Recording {
    /// Opens the recording that `--record` and `--foxglove` ask for; `None` without them.
    pub(crate) fn open(args: &Args) -> anyhow::Result<Option<Self>> {
        if args.record.is_none() && args.live.is_none() {
            return Ok(None);
        }
        let live = args.live.map(live::serve).transpose()?;
        let tap = |output| {
            let tap = tap(args, output);
            if let Some(live) = live {
                tap.borrow_mut().tell(live);
            }
            tap
        };
        let Some(path) = args.record.clone() else {
            return Ok(Some(Self { path: None, recording: recording::Recording::nowhere(tap) }));
        };
        if RECORDED.swap(true, Ordering::Relaxed) {
            bail!("--record holds one session, and this opens several: it cannot be recorded as a whole");
        }
        let name = path.display().to_string();
        Ok(Some(Self { path: Some(name), recording: recording::Recording::create(path, tap)? }))
    }

    pub(crate) fn tap(&self) -> SharedTap {
        self.recording.tap()
    }

    /// Closes the file after the session. An error of the session takes precedence over one of the file.
    pub(crate) fn close<T>(self, result: anyhow::Result<T>) -> anyhow::Result<T> {
        let recording::Closed { bad_frames, result: closed } = self.recording.close();
        if let (1.., Some(path)) = (bad_frames, &self.path) {
            eprintln!("r4: {bad_frames} frames from the board were damaged: their content is missing from {path}");
        }
        match (result, closed) {
            (Ok(value), Ok(())) => Ok(value),
            (Ok(_), Err(error)) => Err(error.into()),
            (Err(error), Ok(())) => Err(error),
            (Err(error), Err(closed)) => {
                eprintln!("r4: {:#}", anyhow::Error::from(closed));
                Err(error)
            }
        }
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
