//! `--log` on a board at the other end of a link: what its firmware logs comes over the link too, and the ELF decodes it.

use std::{env, path::PathBuf, thread};

use anyhow::Context;
use futures::channel::oneshot;
use r4_driver::{Board, Clock as _, LogStream};
use r4_emu::log::{Decoder, Record};
use r4_image::{Binary, Image, Place};
use r4_protocol::log::{LogChunk, fingerprint};

use super::board::print;
use crate::{args::LogLevel, session::HostClock};

/// The log of a board, from the oldest that it still has on.
pub(crate) struct LinkLog {
    stream: LogStream,
    decoder: Decoder,
    clock: HostClock,
    from: LogLevel,
    /// Position behind what has come; none before the first.
    behind: Option<u32>,
}

/// No ELF decodes what the board logs.
#[derive(Debug, thiserror::Error)]
#[error(
    "the board runs another image than {}: name the ELF file that was flashed with R4_ELF, or flash this one",
    .0.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(" and ")
)]
struct OtherImage(Vec<PathBuf>);

impl LinkLog {
    /// Asks for the log and finds the ELF file of the image that writes it. Records from level `from` on will be printed.
    pub(crate) async fn open(board: &Board<HostClock>, clock: HostClock, from: LogLevel) -> anyhow::Result<Self> {
        let (info, stream) = board.log().await.context("no log")?;
        let (done, decoder) = oneshot::channel();
        let robot = board.info().robot.clone();
        // Not here: megabytes are read, and heartbeats must go on meanwhile.
        thread::spawn(move || {
            // Nobody waits for it any more where the link ended meanwhile.
            let _ = done.send(decoder_of(&robot, info.image));
        });
        let decoder = decoder.await.context("reading the ELF file failed")?.context("the log cannot be decoded")?;
        Ok(Self { stream, decoder, clock, from, behind: None })
    }

    /// Prints it as it comes, until the link ends.
    pub(crate) async fn follow(&mut self) {
        while let Ok(chunk) = self.stream.next().await {
            self.take(&chunk);
        }
    }

    /// Prints what has come.
    pub(crate) fn rest(&mut self) {
        while let Some(chunk) = self.stream.try_next() {
            self.take(&chunk);
        }
    }

    fn take(&mut self, chunk: &LogChunk) {
        let now_ns = self.clock.now_us() * 1000;
        match self.behind {
            // It began long ago.
            None if chunk.position != 0 => self.decoder.lost(),
            Some(behind) if chunk.position != behind => {
                let lost = chunk.position.wrapping_sub(behind);
                self.decoder.lost();
                let note = format!("({lost} bytes of the log are lost: more was written than the link carried)");
                print(self.from, &Record::note(now_ns, note));
            }
            _ => {}
        }
        self.behind = Some(chunk.position.wrapping_add(chunk.bytes.len() as u32));
        self.decoder.push(&chunk.bytes, now_ns, |record| print(self.from, &record));
    }
}

/// What decodes the log of the image that tells itself by `image`; stderr says of which file it was made.
fn decoder_of(robot: &str, image: u32) -> anyhow::Result<Decoder> {
    let image = find(robot, image)?;
    let decoder = Decoder::new(image.elf())?;
    eprintln!("r4: log decoded by {}, SHA-256 {}", image.path().display(), image.digest());
    Ok(decoder)
}

/// The ELF file of an image for `robot`: `R4_ELF`, or what was built last.
fn find(robot: &str, image: u32) -> anyhow::Result<Image> {
    let first = Image::find(robot);
    // Without `R4_ELF` there may be two.
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

/// By what a board tells its image from others.
fn of(image: &Image) -> Option<u32> {
    Binary::of(image.elf()).ok()?.bytes.first_chunk().map(fingerprint)
}
