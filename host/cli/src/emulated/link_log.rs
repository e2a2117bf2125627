//! `--log` on a board at the other end of a link: the link carries the firmware's log, and the ELF file decodes it.

use std::{env, path::PathBuf, thread};

use anyhow::Context;
use futures::channel::oneshot;
use r4_driver::{Board, Clock as _, LogStream};
use r4_emu::log::{Decoder, Record};
use r4_image::{Binary, Image, Place};
use r4_protocol::log::{LogChunk, fingerprint};

use super::board::print;
use crate::{args::LogLevel, session::HostClock};

/// Log of a board, from its oldest stored record on.
pub(crate) struct LinkLog {
    stream: LogStream,
    decoder: Decoder,
    clock: HostClock,
    from: LogLevel,
    /// Position after the last received byte; `None` before the first.
    behind: Option<u32>,
}

/// Error: no known ELF file decodes the board's log.
#[derive(Debug, thiserror::Error)]
#[error(
    "the board runs another image than {}: name the ELF file that was flashed with R4_ELF, or flash this one",
    .0.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(" and ")
)]
struct OtherImage(Vec<PathBuf>);

impl LinkLog {
    /// Requests the log and finds the ELF file of the board's image. Records from level `from` on are printed.
    pub(crate) async fn open(board: &Board<HostClock>, clock: HostClock, from: LogLevel) -> anyhow::Result<Self> {
        let (info, stream) = board.log().await.context("no log")?;
        let (done, decoder) = oneshot::channel();
        let robot = board.info().robot.clone();
        // Read the ELF file in a thread: it has megabytes, and the heartbeat must continue.
        thread::spawn(move || {
            // Sending fails if the link ended meanwhile; no task waits for it then.
            let _ = done.send(decoder_of(&robot, info.image));
        });
        let decoder = decoder.await.context("reading the ELF file failed")?.context("the log cannot be decoded")?;
        Ok(Self { stream, decoder, clock, from, behind: None })
    }

    /// Prints the log as it arrives, until the link ends.
    pub(crate) async fn follow(&mut self) {
        while let Ok(chunk) = self.stream.next().await {
            self.take(&chunk);
        }
    }

    /// Prints what has already arrived.
    pub(crate) fn rest(&mut self) {
        while let Some(chunk) = self.stream.try_next() {
            self.take(&chunk);
        }
    }

    fn take(&mut self, chunk: &LogChunk) {
        let now_ns = self.clock.now_us() * 1000;
        match self.behind {
            // The log's beginning was overwritten before this session.
            None if chunk.position != 0 => self.decoder.lost(),
            Some(behind) if chunk.position != behind => {
                let lost = chunk.position.wrapping_sub(behind);
                self.decoder.lost();
                let note = format!("({lost} bytes of the log are lost: more was written than the link carried)");
                print(self.from, &Record::note(now_ns, note));
            }
            _ => {}
        }
        // Positions count bytes modulo 2^32.
        self.behind = Some(chunk.position.wrapping_add(chunk.bytes.len() as u32));
        self.decoder.push(&chunk.bytes, now_ns, |record| print(self.from, &record));
    }
}

/// Decoder for the log of the image with fingerprint `image`; prints on stderr the ELF file it uses.
fn decoder_of(robot: &str, image: u32) -> anyhow::Result<Decoder> {
    let image = find(robot, image)?;
    let decoder = Decoder::new(image.elf())?;
    eprintln!("r4: log decoded by {}, SHA-256 {}", image.path().display(), image.digest());
    Ok(decoder)
}

/// Finds the ELF file of an image for `robot`: that of `R4_ELF`, or the last build.
fn find(robot: &str, image: u32) -> anyhow::Result<Image> {
    let first = Image::find(robot);
    // Without `R4_ELF` there may be a bare and a hosted build.
    let second = if env::var_os("R4_ELF").is_some() { None } else { Image::built(robot, Place::Hosted).ok() };
    let (found, missing): (Vec<_>, Vec<_>) =
        [Some(first), second.map(Ok)].into_iter().flatten().partition(Result::is_ok);
    let found: Vec<Image> = found.into_iter().flatten().collect();
    if let Some(other) = found.iter().find(|found| of(found) == Some(image)) {
        return Ok(other.clone());
    }
    match missing.into_iter().find_map(Result::err) {
        Some(error) if found.is_empty() => Err(error.into()),
        _ => Err(OtherImage(found.iter().map(|image| image.path().to_owned()).collect()).into()),
    }
}

/// Fingerprint of an image, by which a board identifies its own.
fn of(image: &Image) -> Option<u32> {
    Binary::of(image.elf()).ok()?.bytes.first_chunk().map(fingerprint)
}
