//! `r4 flash`: writes a firmware image to a board over a debug probe or by the Arduino bootloader over USB; without
//! either, prints the steps for dfu-util.

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
    /// ELF file of the image, as built by `cargo xtask firmware`
    #[arg(value_name = "FILE")]
    pub(crate) file: Option<PathBuf>,
    /// Use the image that was built last for this robot
    #[arg(long, value_name = "NAME|FILE")]
    pub(crate) robot: Option<String>,
    /// Image of the robot to use [default: bare; with --dfu hosted]
    #[arg(long, conflicts_with = "file")]
    pub(crate) image: Option<Kind>,
    /// Debug probe to use, in hex; `r4 flash` lists them when there are several; example: 0483:374e
    #[arg(long, value_name = "VID:PID[:SERIAL]", conflicts_with = "dfu")]
    pub(crate) probe: Option<String>,
    /// Flash over USB by the Arduino bootloader: restart the running board into it, write, read back, start, and check
    /// which image the board runs. Several boards: name one with --board serial:. Without the feature `dfu`, write the
    /// file for dfu-util and print its steps
    #[arg(long)]
    pub(crate) dfu: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum Kind {
    /// Image at 0x08000000, which replaces the Arduino bootloader
    Bare,
    /// Image at 0x08040000, started by the Arduino bootloader
    Hosted,
}

/// Reason why an image is not written.
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
    /// SHA-256 of the ELF file, in hex.
    sha256: String,
    /// Kind of the image: `bare` or `hosted`.
    image: &'static str,
    /// Address of the image's first byte.
    start: u32,
    /// Length of the image, rounded up to whole flash words.
    bytes: usize,
    /// Debug probe that wrote the image and read it back; `null` over USB.
    probe: Option<String>,
    /// CRC-32 of the image, as the board reports it.
    crc: u32,
    /// Result of reading back over USB; `null` with a debug probe or dfu-util.
    verified: Option<bool>,
    /// The board reconnected and reports that it runs this image; `null` with a debug probe or dfu-util.
    confirmed: Option<bool>,
    /// File for dfu-util, if one was written.
    binary: Option<PathBuf>,
    /// Command that flashes `binary`, as words.
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
        // The bare image would overwrite the bootloader that has to write it.
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
        // Print the image first: the user sees which file is used even if writing fails.
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
            output::line("that performs the following steps itself.\n")?;
            output::line(
                "1. Press the board's reset button twice quickly: the green light pulses, the bootloader waits.",
            )?;
            output::line(format_args!("2. {}", command.join(" ")))?;
            output::line(
                "   (install dfu-util with the package manager: `sudo apt-get install dfu-util`, `brew install dfu-util`)",
            )?;
            output::line(
                "3. The board starts the program by itself; `r4 ports` finds it after a second. An error message after",
            )?;
            output::line("   \"downloaded successfully\" only means that the board left before it could answer.")?;
        }
        Ok(())
    }
}
