//! Flashing over USB by the Arduino bootloader, with the feature `dfu`.

#[cfg(feature = "dfu")]
pub(super) use with::write;
#[cfg(not(feature = "dfu"))]
pub(super) use without::write;

/// Result of flashing over USB.
pub(super) struct Written {
    /// Flash was read back and compared equal.
    pub(super) verified: bool,
    /// The board reconnected and reports that it runs the image.
    pub(super) confirmed: bool,
}

#[cfg(feature = "dfu")]
mod with {
    use std::{
        thread,
        time::{Duration, Instant},
    };

    use indicatif::{ProgressBar, ProgressStyle};
    use r4_dfu::{Asked, FlashError, Machine, Note, Progress, Running, device};
    use r4_driver::Error;
    use r4_image::{Binary, DFU_USB, Seal};
    use r4_links::{
        Address, BadAddress, Key,
        blocking::{Board, ConnectError},
        ports::{self, Port},
    };

    use super::Written;
    use crate::{
        args::Args,
        session::{self, Interrupted, Target},
    };

    /// Reason why a board is not flashed.
    #[derive(Debug, thiserror::Error)]
    enum DfuError {
        #[error(transparent)]
        Bootloader(#[from] device::OpenError),
        #[error("the board does not restart into its bootloader")]
        Board(#[source] Error),
        #[error("several boards are connected: name one with --board serial:\n{}", .0.join("\n"))]
        Several(Vec<String>),
        #[error("{0} is no board on USB: name one with --board serial:, or omit --board if only one is connected")]
        NotUsb(String),
        #[error(transparent)]
        Address(#[from] BadAddress),
        #[error(transparent)]
        Interrupted(#[from] Interrupted),
    }

    /// This machine: finds boards and bootloaders on its USB ports.
    struct Here {
        /// Address of the board that was named.
        named: Option<Address>,
        key: Option<Key>,
        began: Instant,
    }

    impl Here {
        /// Address of the running board; `None` where none is connected.
        fn address(&self) -> Result<Option<Address>, DfuError> {
            if let Some(named) = &self.named {
                return Ok(Some(named.clone()));
            }
            let boards: Vec<_> = ports::list().unwrap_or_default().into_iter().filter(Port::is_board).collect();
            match boards.as_slice() {
                [] => Ok(None),
                [only] => Ok(Some(format!("serial:{}", only.path.display()).parse()?)),
                several => Err(DfuError::Several(several.iter().map(|port| port.path.display().to_string()).collect())),
            }
        }
    }

    impl Machine for Here {
        type Device = device::Device;
        type Error = DfuError;

        fn bootloader(&mut self) -> Result<Option<device::Device>, DfuError> {
            if session::is_interrupted() {
                return Err(Interrupted.into());
            }
            Ok(device::Device::find(DFU_USB.0, DFU_USB.1)?)
        }

        fn ask(&mut self) -> Result<Asked, DfuError> {
            let Some(address) = self.address()? else { return Ok(Asked::NoBoard) };
            let board = match Board::connect(&address, self.key.as_ref()) {
                Ok(board) => board,
                // Firmware with another protocol, or not of this project.
                Err(ConnectError::Open(r4_links::OpenError::NoBoard)) => return Ok(Asked::NoBoard),
                Err(error) => return Ok(Asked::Cannot(format!("{address}: {error}"))),
            };
            eprintln!("r4: {address} is {}, firmware {}", board.info().robot, board.info().firmware);
            board.call(|board| Box::pin(board.restart_in_bootloader())).map_err(DfuError::Board)?;
            Ok(Asked::Restarts)
        }

        fn running(&mut self) -> Option<Running> {
            let address = self.address().ok()??;
            let board = Board::connect(&address, self.key.as_ref()).ok()?;
            let image = board.call(|board| Box::pin(board.image())).ok()?;
            Some(Running { bytes: image.bytes, crc: image.crc })
        }

        fn now(&self) -> Duration {
            self.began.elapsed()
        }

        fn sleep(&mut self, time: Duration) {
            thread::sleep(time);
        }
    }

    /// Writes the image, reads it back, starts it, and asks the board which image it runs.
    pub(in super::super) fn write(args: &Args, binary: &Binary, seal: Seal) -> anyhow::Result<Option<Written>> {
        let named = match (&args.board, args.is_board_named) {
            (_, false) => None,
            (Target::Link(address @ Address::Serial { .. }), true) => Some(address.clone()),
            (other, true) => return Err(DfuError::NotUsb(other.to_string()).into()),
        };
        // Ctrl-C must not stop between erasing and writing: `bootloader` checks for it only while waiting.
        session::catch_interrupts();
        let mut here = Here { named, key: session::key(args)?, began: Instant::now() };
        let wanted = Running { bytes: seal.bytes, crc: seal.crc };
        let mut bar = Bar::new();
        let flashed = r4_dfu::flash(&mut here, &binary.bytes, binary.start, wanted, &mut |note| bar.tell(note));
        bar.end();
        let flashed = flashed.map_err(|error| match error {
            FlashError::Machine(DfuError::Interrupted(interrupted)) => anyhow::Error::from(interrupted),
            other => other.into(),
        })?;
        Ok(Some(Written { verified: flashed.verified, confirmed: flashed.confirmed }))
    }

    /// Progress bar of one step at a time: erasing, writing, reading back.
    struct Bar {
        bar: ProgressBar,
        step: Option<r4_dfu::Step>,
    }

    impl Bar {
        fn new() -> Self {
            Self { bar: ProgressBar::hidden(), step: None }
        }

        fn end(&mut self) {
            self.bar.finish_and_clear();
        }

        fn tell(&mut self, note: Note) {
            let text = match note {
                Note::Progress(progress) => return self.show(progress),
                Note::Found => "a board waits in its bootloader".into(),
                Note::Restarts => "the board restarts into its bootloader".into(),
                Note::Starts => "written; the board starts it".into(),
                Note::PressReset { within_s, why } => {
                    let why = why.map(|why| format!("{why}\nr4: ")).unwrap_or_default();
                    format!(
                        "{why}press the board's reset button twice within half a second, so that the green light pulses; waiting for \
                         {within_s} s"
                    )
                }
            };
            self.end();
            eprintln!("r4: {text}");
        }

        fn show(&mut self, progress: Progress) {
            let Progress { step, done, all } = progress;
            if self.step != Some(step) {
                self.end();
                self.step = Some(step);
                let style = ProgressStyle::with_template("{elapsed} {msg} {bar:30} {bytes} of {total_bytes}");
                self.bar = ProgressBar::new(all as u64).with_style(style.unwrap_or(ProgressStyle::default_bar()));
                self.bar.set_message(step.to_string());
            }
            self.bar.set_position(done as u64);
        }
    }
}

#[cfg(not(feature = "dfu"))]
mod without {
    use r4_image::{Binary, Seal};

    use super::Written;
    use crate::args::Args;

    /// Returns `None`: without the feature `dfu`, the program only makes the file for dfu-util.
    #[allow(clippy::unnecessary_wraps, reason = "as in programs that are built with it")]
    pub(in super::super) fn write(_: &Args, _: &Binary, _: Seal) -> anyhow::Result<Option<Written>> {
        Ok(None)
    }
}
