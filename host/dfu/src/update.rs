//! Update of an image, from any state of the bootloader: it is written, read back and started.

use std::{fmt, time::Duration};

use dfu_core::{DfuProtocol, DfuSansIo, State, Status, download, get_status, memory_layout::MemoryLayout};

use crate::io::{Fault, GETSTATUS, Io, Usb, UsbError};

/// Requests of DFU (DFU 1.1, table 3.2).
const DNLOAD: u8 = 1;
const UPLOAD: u8 = 2;
const CLRSTATUS: u8 = 4;
const ABORT: u8 = 6;
/// Command "set address pointer" of a command block, which block number 0 marks (UM0424, 6.2).
const SET_ADDRESS: u8 = 0x21;
/// First block number of data: the address is the pointer's plus (number - 2) times the transfer size (AN3156, 5).
const FIRST_BLOCK: u16 = 2;
/// Minimum length of a status, bytes (DFU 1.1, 6.1.2).
const STATUS_BYTES: usize = 6;
/// Tries to bring an interrupted bootloader back to idle: each state needs one request, and an error state one more.
const TRIES: usize = 6;
/// Maximum number of polls of one operation: a bootloader that is busy for longer is stuck. The slowest operation is
/// the erase of a sector, 4 s by the data sheet, and bootloaders ask to be polled every 10 ms or less often.
const POLLS: usize = 2000;
/// Time between polls of a bootloader that names none.
const POLL: Duration = Duration::from_millis(5);
/// Number of times that a block is read again when it differs, and the time between: the Arduino bootloader reports a
/// block as programmed when it is only queued (mcuboot-arduino-stm32h7, app/dfu/usbd_dfu_flash.cpp, `writeQueue`).
const READ_AGAIN: usize = 10;
const READ_AGAIN_AFTER: Duration = Duration::from_millis(200);
/// Longest time that a bootloader may take to become idle by itself.
const BUSY_AT_MOST: Duration = Duration::from_secs(10);

/// Step of an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Ends an interrupted operation.
    Begin,
    /// Erases the sectors of the image.
    Erase,
    /// Writes the blocks of the image.
    Write,
    /// Reads the image back.
    Verify,
    /// Starts the program at the image's address.
    Leave,
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Begin => "beginning",
            Self::Erase => "erasing",
            Self::Write => "writing",
            Self::Verify => "reading back",
            Self::Leave => "starting the program",
        })
    }
}

/// Progress of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Step that is in progress.
    pub step: Step,
    /// Number of bytes that are done.
    pub done: usize,
    /// Number of bytes of the image.
    pub all: usize,
}

/// Result of an update.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Updated {
    /// True when the image was read back and is the same; false when the bootloader does not read back.
    pub verified: bool,
}

/// Reason why an update did not complete. The bootloader itself is intact in every case, so the same command may be
/// given again.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum UpdateError {
    /// The description of the memory is not understood.
    #[error(
        "the bootloader describes its memory as `{memory}`, which is not DfuSe: is it the Arduino bootloader of a Giga?"
    )]
    NotDfuSe {
        /// Description as the bootloader gives it.
        memory: String,
    },
    /// The bootloader's memory does not hold the image.
    #[error("the bootloader's memory `{memory}` has no whole sectors for {bytes} bytes at {address:#010x}")]
    NoRoom {
        /// Description as the bootloader gives it.
        memory: String,
        /// Address of the first byte.
        address: u32,
        /// Length of the image, bytes.
        bytes: usize,
    },
    /// The cable or the bootloader is gone.
    #[error(
        "{error} while {step}, {done} of {all} bytes: the board stays in its bootloader, or finds it again when reset is pressed \
         twice quickly. Check the cable and give the same command again"
    )]
    Interrupted {
        /// Step that was interrupted.
        step: Step,
        /// Number of bytes that were done.
        done: usize,
        /// Number of bytes of the image.
        all: usize,
        /// Error of the USB transfer.
        error: UsbError,
    },
    /// The bootloader refuses an operation.
    #[error(
        "the bootloader failed while {step} at {address:#010x}: {status}. It waits for another try: give the same command again. If it \
         fails again, press reset twice quickly before"
    )]
    Refused {
        /// Step that was refused.
        step: Step,
        /// Address of the operation; that of its block or sector.
        address: u32,
        /// Status of the bootloader.
        status: Status,
    },
    /// The bootloader is in a state that does not follow from the requests.
    #[error(
        "the bootloader is in the state \"{state}\" while {step}: press reset twice quickly and give the same command again"
    )]
    Lost {
        /// Step at which it was found.
        step: Step,
        /// Name of the state.
        state: String,
    },
    /// Flash differs from what was written.
    #[error(
        "flash holds something else at {address:#010x} than was written: give the same command again; if it differs again, the flash of \
         this board is worn out"
    )]
    Differs {
        /// Address of the first byte that differs.
        address: u32,
    },
}

/// Writes `image` to `address`, and reads it back where the bootloader can. The board stays in the bootloader:
/// [`leave`] starts the image.
///
/// # Errors
/// [`UpdateError`] when an operation fails.
pub fn update<U: Usb>(
    usb: &mut U,
    image: &[u8],
    address: u32,
    progress: &mut dyn FnMut(Progress),
) -> Result<Updated, UpdateError> {
    let descriptor = usb.descriptor();
    let not_dfuse = || UpdateError::NotDfuSe { memory: descriptor.memory.clone() };
    let functional = descriptor.functional;
    let protocol = DfuProtocol::new(&descriptor.memory, functional.dfu_version).map_err(|_| not_dfuse())?;
    let DfuProtocol::Dfuse { address: first, memory_layout } = protocol else { return Err(not_dfuse()) };
    // Checked before anything is erased: the image must begin at a sector and fit behind it.
    let no_room = UpdateError::NoRoom { memory: descriptor.memory.clone(), address, bytes: image.len() };
    let pages = pages_from(first, &memory_layout, address).ok_or(no_room.clone())?;
    if pages.iter().map(|page| u64::from(*page)).sum::<u64>() < image.len() as u64 || functional.transfer_size == 0 {
        return Err(no_room);
    }
    let protocol = DfuProtocol::Dfuse { address, memory_layout: MemoryLayout::from(pages) };
    let work = Work { io: Io::new(usb, functional, protocol), image, address };
    work.idle(Step::Begin)?;
    work.download(progress)?;
    if !functional.can_upload {
        return Ok(Updated { verified: false });
    }
    work.verify(progress)?;
    Ok(Updated { verified: true })
}

/// Starts the program at `address`. The bootloader is gone from USB then.
///
/// # Errors
/// [`UpdateError`] when the bootloader refuses; none where it was gone before it answered.
pub fn leave<U: Usb>(usb: &mut U, address: u32) -> Result<(), UpdateError> {
    let functional = usb.descriptor().functional;
    let protocol = DfuProtocol::Dfuse { address, memory_layout: MemoryLayout::new() };
    let work = Work { io: Io::new(usb, functional, protocol), image: &[], address };
    work.idle(Step::Leave)?;
    work.set_address(Step::Leave)?;
    // A block without data is "leave DFU mode", carried out at the next request for the status (AN3156, 5.3).
    let left = work.io.control_out(DNLOAD, FIRST_BLOCK, &[]);
    let status = left.and_then(|()| work.io.control_in(GETSTATUS, 0, &mut [0; STATUS_BYTES]));
    match status {
        Ok(_) if work.io.status() != Status::Ok => Err(work.refused(Step::Leave, address)),
        // The bootloader may be gone before it has answered.
        Ok(_) | Err(Fault::Usb(UsbError::Gone | UsbError::TimedOut | UsbError::System(_))) => Ok(()),
        Err(fault) => Err(work.error(Step::Leave, 0, fault)),
    }
}

/// Returns the sizes of the sectors from `address` on; `None` where no sector begins there.
fn pages_from(first: u32, layout: &[u32], address: u32) -> Option<Vec<u32>> {
    let mut begins = u64::from(first);
    for (index, page) in layout.iter().enumerate() {
        if begins == u64::from(address) {
            return Some(layout[index..].to_vec());
        }
        begins += u64::from(*page);
    }
    None
}

struct Work<'u, 'i, U> {
    io: Io<'u, U>,
    image: &'i [u8],
    address: u32,
}

impl<U: Usb> Work<'_, '_, U> {
    /// Brings the bootloader to idle from whatever operation it was interrupted in.
    fn idle(&self, step: Step) -> Result<(), UpdateError> {
        let mut last = State::DfuIdle;
        let mut waited = Duration::ZERO;
        let mut tries = 0;
        while tries < TRIES {
            let (state, poll) = match self.status(step) {
                Ok(status) => status,
                // A stall while busy: another program has begun an operation, and was asked before its time (DFU 1.1,
                // A.2.5). It is an error state from now on, which the next try clears.
                Err(UpdateError::Interrupted { error: UsbError::Stalled, .. } | UpdateError::Refused { .. })
                    if tries + 1 < TRIES =>
                {
                    tries += 1;
                    continue;
                }
                Err(error) => return Err(error),
            };
            last = state;
            match state {
                State::DfuIdle => return Ok(()),
                // Busy by itself, which is no failed try.
                State::DfuDnbusy | State::DfuManifest if waited < BUSY_AT_MOST => {
                    let pause = poll.max(POLL);
                    waited += pause;
                    self.io.sleep(pause);
                    continue;
                }
                State::DfuError => self.request(step, CLRSTATUS)?,
                _ => self.request(step, ABORT)?,
            }
            tries += 1;
        }
        Err(UpdateError::Lost { step, state: last.to_string() })
    }

    /// Sends a request without data in any state; the next status shows its effect.
    fn request(&self, step: Step, request: u8) -> Result<(), UpdateError> {
        match self.io.control_out(request, 0, &[]) {
            Ok(()) | Err(Fault::Usb(UsbError::Stalled)) => Ok(()),
            Err(fault) => Err(self.error(step, 0, fault)),
        }
    }

    fn status(&self, step: Step) -> Result<(State, Duration), UpdateError> {
        let mut status = [0; STATUS_BYTES];
        let length = self.io.control_in(GETSTATUS, 0, &mut status).map_err(|fault| self.error(step, 0, fault))?;
        if length < STATUS_BYTES {
            return Err(UpdateError::Lost { step, state: format!("a status of {length} bytes") });
        }
        let [_, low, middle, high, state, _] = status;
        Ok((state.into(), Duration::from_millis(u32::from_le_bytes([low, middle, high, 0]).into())))
    }

    /// Erases the sectors, and writes every block.
    fn download(&self, progress: &mut dyn FnMut(Progress)) -> Result<(), UpdateError> {
        let all = self.image.len();
        let dfu = DfuSansIo::new(*dfu_core::DfuIo::functional_descriptor(&self.io));
        let length = u32::try_from(all).unwrap_or(u32::MAX);
        let mut buffer = [0; STATUS_BYTES];
        let mut begin = || {
            let (command, mut control) =
                dfu.download(dfu_core::DfuIo::protocol(&self.io), length)?.get_status(&mut buffer);
            let got = control.execute(&self.io)?;
            let (command, control) = command.chain(&buffer[..got])?;
            if let Some(control) = control {
                control.execute(&self.io)?;
            }
            let (command, mut control) = command.get_status(&mut buffer);
            let got = control.execute(&self.io)?;
            Ok::<_, Fault>(command.chain(&buffer[..got])??)
        };
        let mut next = begin().map_err(|fault| self.error(Step::Begin, 0, fault))?;
        let (mut erased, mut done) = (0, 0);
        while done < all {
            let (step, at, came) = match next.next() {
                download::Step::Erase(command) => {
                    progress(Progress { step: Step::Erase, done: erased.min(all), all });
                    let came = command.erase().map_err(Fault::from).and_then(|(wait, control)| {
                        control.execute(&self.io)?;
                        self.finish(wait)
                    });
                    // The command has no size: the sector's size is in the memory layout.
                    let at = erased;
                    erased += self.page_at(erased);
                    (Step::Erase, at, came)
                }
                download::Step::SetAddress(command) => {
                    let (wait, control) = command.set_address();
                    (Step::Write, done, control.execute(&self.io).and_then(|()| self.finish(wait)))
                }
                download::Step::DownloadChunk(command) => {
                    progress(Progress { step: Step::Write, done, all });
                    let at = done;
                    let block = &self.image[done..all.min(done + self.block_bytes())];
                    let came = command.download(block).map_err(Fault::from).and_then(|(wait, control)| {
                        control.execute(&self.io)?;
                        self.finish(wait)
                    });
                    done += block.len();
                    (Step::Write, at, came)
                }
                // Both come behind an empty block, which is not sent here: the board must stay in its bootloader.
                download::Step::Break | download::Step::UsbReset => break,
            };
            next = came.map_err(|fault| self.error(step, at, fault))?;
        }
        progress(Progress { step: Step::Write, done: all, all });
        Ok(())
    }

    /// Waits for the end of an operation.
    fn finish<T>(&self, mut wait: get_status::WaitState<T>) -> Result<T, Fault> {
        let mut buffer = [0; STATUS_BYTES];
        for _ in 0..POLLS {
            wait = match wait.next() {
                get_status::Step::Break(next) => return Ok(next),
                get_status::Step::Wait(command, poll_ms) => {
                    self.io.sleep(Duration::from_millis(poll_ms));
                    let (command, mut control) = command.get_status(&mut buffer);
                    let got = control.execute(&self.io)?;
                    command.chain(&buffer[..got])??
                }
            };
        }
        Err(UsbError::TimedOut.into())
    }

    /// Sets the address pointer to the beginning of the image.
    fn set_address(&self, step: Step) -> Result<(), UpdateError> {
        let [a, b, c, d] = self.address.to_le_bytes();
        let command = self.io.control_out(DNLOAD, 0, &[SET_ADDRESS, a, b, c, d]);
        command.map_err(|fault| self.error(step, 0, fault))?;
        for _ in 0..POLLS {
            let (state, poll) = self.status(step)?;
            match state {
                State::DfuDnloadIdle => return Ok(()),
                State::DfuDnbusy | State::DfuDnloadSync => self.io.sleep(poll.max(POLL)),
                State::DfuError => return Err(self.refused(step, self.address)),
                other => return Err(UpdateError::Lost { step, state: other.to_string() }),
            }
        }
        Err(self.error(step, 0, UsbError::TimedOut.into()))
    }

    /// Reads the whole image back, and compares it.
    fn verify(&self, progress: &mut dyn FnMut(Progress)) -> Result<(), UpdateError> {
        let step = Step::Verify;
        let all = self.image.len();
        for again in (0..READ_AGAIN).rev() {
            self.idle(step)?;
            self.set_address(step)?;
            // Reading needs the idle state, which setting the address has left.
            self.idle(step)?;
            let Some(differs) = self.first_difference(progress)? else {
                progress(Progress { step, done: all, all });
                return self.idle(step);
            };
            if again == 0 {
                return Err(UpdateError::Differs { address: self.address.wrapping_add(differs as u32) });
            }
            self.io.sleep(READ_AGAIN_AFTER);
        }
        Ok(())
    }

    /// Returns the offset of the first byte that differs; `None` when all are the same.
    fn first_difference(&self, progress: &mut dyn FnMut(Progress)) -> Result<Option<usize>, UpdateError> {
        let mut buffer = vec![0; self.block_bytes()];
        let all = self.image.len();
        for (number, block) in self.image.chunks(self.block_bytes()).enumerate() {
            let done = number * self.block_bytes();
            progress(Progress { step: Step::Verify, done, all });
            let value = FIRST_BLOCK.wrapping_add(number as u16);
            let read = &mut buffer[..block.len()];
            let got = self.io.control_in(UPLOAD, value, read).map_err(|fault| self.error(Step::Verify, done, fault))?;
            // A short answer counts as a difference at its end.
            let same = block.iter().zip(&read[..got]).take_while(|(ours, theirs)| ours == theirs).count();
            if same < block.len() {
                return Ok(Some(done + same));
            }
        }
        Ok(None)
    }

    fn block_bytes(&self) -> usize {
        dfu_core::DfuIo::functional_descriptor(&self.io).transfer_size.into()
    }

    /// Returns the size of the sector at this offset from the beginning of the image, bytes.
    fn page_at(&self, offset: usize) -> usize {
        let DfuProtocol::Dfuse { memory_layout, .. } = dfu_core::DfuIo::protocol(&self.io) else { return usize::MAX };
        let mut begins = 0;
        for page in memory_layout.iter() {
            if begins >= offset {
                return *page as usize;
            }
            begins += *page as usize;
        }
        usize::MAX
    }

    fn refused(&self, step: Step, address: u32) -> UpdateError {
        UpdateError::Refused { step, address, status: self.io.status() }
    }

    fn error(&self, step: Step, done: usize, fault: Fault) -> UpdateError {
        let all = self.image.len();
        let address = self.address.wrapping_add(done as u32);
        match fault {
            // The bootloader stalls a request that it refuses, and its status has the reason.
            Fault::Usb(UsbError::Stalled) if step != Step::Begin => match self.io.control_in(GETSTATUS, 0, &mut [0; 6])
            {
                Ok(_) if self.io.status() != Status::Ok => self.refused(step, address),
                _ => UpdateError::Interrupted { step, done, all, error: UsbError::Stalled },
            },
            Fault::Usb(error) => UpdateError::Interrupted { step, done, all, error },
            Fault::Dfu(_) if self.io.status() != Status::Ok => self.refused(step, address),
            Fault::Dfu(dfu_core::Error::InvalidState { got, .. }) => UpdateError::Lost { step, state: got.to_string() },
            Fault::Dfu(error) => UpdateError::Lost { step, state: error.to_string() },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_are_those_from_the_address_on() {
        let layout = [16, 16, 64, 128];
        assert_eq!(pages_from(1000, &layout, 1032), Some(vec![64, 128]));
        assert_eq!(pages_from(1000, &layout, 1000), Some(layout.to_vec()));
        assert_eq!((pages_from(1000, &layout, 1040), pages_from(1000, &layout, 1224)), (None, None));
    }
}
