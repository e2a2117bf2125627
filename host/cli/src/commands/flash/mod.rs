//! `r4 flash`: the firmware's image into a board, over a debug probe or by the Arduino bootloader over USB; or what to do without
//! either.

mod dfu;
mod probe;

use std::{fs, path::PathBuf};

use anyhow::Context;
use clap::{ArgGroup, ValueEnum};
use r4_image::{Binary, Image, Place, Seal, dfu_util};
use serde::Serialize;

use crate::{args::Args, output};

#[derive(Clone, Debug, clap::Args)]
#[command(group = ArgGroup::new("what").required(true).args(["file", "robot"]))]
pub(crate) struct Flash {
    /// The image: an ELF file, as `cargo xtask firmware` builds it
    #[arg(value_name = "FILE")]
    pub(crate) file: Option<PathBuf>,
    /// The image that was built last for this robot
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) robot: Option<String>,
    /// Which image of the robot's [default: bare; with --dfu hosted]
    #[arg(long, conflicts_with = "file")]
    pub(crate) image: Option<Kind>,
    /// Which of several debug probes, as the message that there are several lists them
    #[arg(long, value_name = "VID:PID[:SERIAL]", conflicts_with = "dfu")]
    pub(crate) probe: Option<String>,
    /// Over USB, by the Arduino bootloader: restart the running board into it, write, read back, start, and ask the board which image
    /// it runs; --board serial: names one of several. A program built without `dfu` makes the file for dfu-util, and tells how
    #[arg(long)]
    pub(crate) dfu: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Kind {
    /// At 0x08000000, in the place of the Arduino bootloader
    Bare,
    /// At 0x08040000, started by the Arduino bootloader
    Hosted,
}

/// Why nothing was written.
#[derive(Debug, thiserror::Error)]
enum FlashError {
    #[error("{} cannot be flashed", .path.display())]
    Image { path: PathBuf, source: r4_image::ImageError },
    #[error(
        "{} is a bare image, which begins where the Arduino bootloader is: that takes the hosted one only, as \
         `cargo xtask firmware --image hosted` builds it. The bare one needs a debug probe",
        .0.display()
    )]
    NotHosted(PathBuf),
}

#[derive(Serialize)]
struct Report {
    file: PathBuf,
    /// Of the ELF file.
    sha256: String,
    /// `bare` or `hosted`.
    image: &'static str,
    /// Address of the first byte.
    start: u32,
    /// As many as whole flash words have.
    bytes: usize,
    /// The debug probe by which it was written, and read back.
    probe: Option<String>,
    /// CRC-32 of what is written, as the board tells it.
    crc: u32,
    /// It was written over USB: read back and the same; `null` where it was not written so.
    verified: Option<bool>,
    /// The board came back, and says that it runs this image.
    confirmed: Option<bool>,
    /// The file for dfu-util.
    binary: Option<PathBuf>,
    /// What writes that.
    command: Option<Vec<String>>,
}

pub(crate) fn run(args: &Args, flash: &Flash) -> anyhow::Result<bool> {
    let file = flash.find()?;
    let path = file.path();
    let refuse = |source| FlashError::Image { path: path.to_owned(), source };
    let binary = Binary::of(file.elf()).map_err(refuse)?;
    let place = Place::of(&binary).map_err(refuse)?;
    let seal = Seal::of(&binary).map_err(refuse)?;
    let mut report = Report {
        file: path.to_owned(),
        sha256: file.digest(),
        image: place.name(),
        start: binary.start,
        bytes: binary.bytes.len(),
        probe: None,
        crc: seal.crc,
        verified: None,
        confirmed: None,
        binary: None,
        command: None,
    };
    if flash.dfu {
        if place == Place::Bare {
            return Err(FlashError::NotHosted(path.to_owned()).into());
        }
        if cfg!(feature = "dfu") {
            eprintln!("r4: {}", report.subject());
        }
        if let Some(written) = dfu::write(args, &binary, seal)? {
            (report.verified, report.confirmed) = (Some(written.verified), Some(written.confirmed));
        } else {
            let raw = path.with_extension("bin");
            fs::write(&raw, &binary.bytes).with_context(|| format!("cannot write {}", raw.display()))?;
            report.command = Some(dfu_util(&raw).iter().map(|word| word.to_string_lossy().into_owned()).collect());
            report.binary = Some(raw);
        }
    } else {
        // Before it: whatever comes of it, the user knows of which file.
        eprintln!("r4: {}", report.subject());
        report.probe = Some(probe::write(&binary, flash.probe.as_deref())?);
    }
    if args.json {
        output::json(&report)?
    } else {
        report.print()?
    }
    Ok(true)
}

impl Flash {
    fn find(&self) -> anyhow::Result<Image> {
        let place = match self.image {
            Some(Kind::Bare) => Place::Bare,
            Some(Kind::Hosted) => Place::Hosted,
            None if self.dfu => Place::Hosted,
            None => Place::Bare,
        };
        Ok(match (&self.file, &self.robot) {
            (Some(file), _) => Image::read(file)?,
            (None, robot) => Image::built(robot.as_deref().unwrap_or_default(), place)?,
        })
    }
}

impl Report {
    fn subject(&self) -> String {
        format!(
            "{}, {} image, {} bytes from {:#010x}, CRC {:08x}, SHA-256 {}",
            self.file.display(),
            self.image,
            self.bytes,
            self.start,
            self.crc,
            self.sha256
        )
    }

    fn print(&self) -> anyhow::Result<()> {
        if let Some(probe) = &self.probe {
            output::line(format_args!("written, read back and started by {probe}"))?;
        }
        if let (Some(verified), Some(confirmed)) = (self.verified, self.confirmed) {
            let read_back = if verified { ", read back" } else { "" };
            output::line(match confirmed {
                true => format!("written{read_back} and started: the board runs it"),
                false => format!(
                    "written{read_back} and started, but no board has answered yet: `r4 ports` finds it; if it does not, press reset once"
                ),
            })?;
        }
        if let (Some(binary), Some(command)) = (&self.binary, &self.command) {
            output::line(self.subject())?;
            output::line(format_args!("for dfu-util: {}\n", binary.display()))?;
            output::line(
                "This r4 was built without USB's DFU: `cargo install --locked --path host/cli --features dfu` in the repository makes one",
            )?;
            output::line("that does all of what follows by itself.\n")?;
            output::line(
                "1. Press the board's reset button twice quickly: the green light pulses, the bootloader waits.",
            )?;
            output::line(format_args!("2. {}", command.join(" ")))?;
            output::line(
                "   (dfu-util comes from what installs software here: `sudo apt-get install dfu-util`, `brew install dfu-util`)",
            )?;
            output::line(
                "3. The board leaves for the program by itself; `r4 ports` finds it after a second. A message after",
            )?;
            output::line(
                "   \"downloaded successfully\" is the board leaving before it could answer, and all is well.",
            )?;
        }
        Ok(())
    }
}
