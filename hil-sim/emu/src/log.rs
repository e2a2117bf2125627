//! Firmware log: decoding with the ELF file ([`Decoder`]), and reading from an emulated board's RAM as a debugger does
//! ([`Log`]).
//!
//! RTT keeps a control block in RAM, at the symbol `_SEGGER_RTT`: 16 bytes of identification, the numbers of channels
//! to and from the host, then for each channel its name, buffer, size, and the positions of writer and reader. The
//! reader advances its own position. The firmware never waits for it: between two slices more may be written than the
//! buffer holds; the loss is reported as a record that cannot be decoded.

use defmt_decoder::{DecodeError, Encoding, Table};
use r4_image::Image;
use r4_mcu::{Chip as _, MachineError, Memory, Size, Stopped, cpu::Core};

use crate::watch::{SharedMachine, Watcher};

/// Identification of the control block, absent until the program has written the block.
const IDENTIFICATION: &[u8; 16] = b"SEGGER RTT\0\0\0\0\0\0";
/// Offset of the first channel to the host in the control block, behind the identification and two counts.
const UP_CHANNEL: u32 = 24;

/// Severity of a record, in ascending order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// Finest detail, for tracing.
    Trace,
    /// Detail for the firmware's developers.
    Debug,
    /// Normal operation of the firmware.
    Info,
    /// Unexpected condition that the firmware handles.
    Warn,
    /// Failure of an operation.
    Error,
}

impl Level {
    /// Returns the level as printed, padded to five characters.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Trace => "TRACE",
            Self::Debug => "DEBUG",
            Self::Info => "INFO ",
            Self::Warn => "WARN ",
            Self::Error => "ERROR",
        }
    }
}

/// Record of the log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Record {
    /// Virtual time of reading, ns: the end of the slice of at most 10 ms in which it was written.
    pub read_ns: u64,
    /// Firmware's own time stamp, in the format of its log.
    pub stamp: String,
    /// Severity; `None` for text printed without a level.
    pub level: Option<Level>,
    /// Formatted text of the record.
    pub message: String,
}

impl Record {
    /// Makes a warning about the log itself, which the firmware did not write.
    #[must_use]
    pub fn note(read_ns: u64, message: impl Into<String>) -> Self {
        Self { read_ns, stamp: String::new(), level: Some(Level::Warn), message: message.into() }
    }
}

/// Reason why a log cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The image has no log section or no control block.
    #[error("the image has no defmt log: no section .defmt, or no symbol _SEGGER_RTT")]
    None,
    /// The image's log has an unknown defmt format.
    #[error("the image's log cannot be decoded: {0}")]
    Format(String),
}

/// Decoder of defmt's bytes into records, from RAM or from a link.
pub struct Decoder {
    table: Table,
    /// Beginning of an incomplete frame.
    rest: Vec<u8>,
    /// The bytes up to the next end of a frame belong to a frame whose beginning was lost.
    skips: bool,
}

impl Decoder {
    /// Makes a decoder for the image with this ELF file.
    ///
    /// # Errors
    /// [`LogError`] names the reason.
    pub fn new(elf: &[u8]) -> Result<Self, LogError> {
        let table = Table::parse(elf).map_err(|error| LogError::Format(error.to_string()))?.ok_or(LogError::None)?;
        // Only rzCOBS, defmt's default encoding, has an end of frame that can be found again after a loss.
        if !matches!(table.encoding(), Encoding::Rzcobs) {
            return Err(LogError::Format("its encoding is raw, not rzCOBS".into()));
        }
        Ok(Self { table, rest: Vec::new(), skips: false })
    }

    /// Notes a gap: the following bytes do not continue the previous ones.
    pub fn lost(&mut self) {
        self.rest.clear();
        self.skips = true;
    }

    /// Takes the next bytes and passes the completed records to `sink`.
    pub fn push(&mut self, mut bytes: &[u8], read_ns: u64, mut sink: impl FnMut(Record)) {
        if self.skips {
            let Some(end) = bytes.iter().position(|byte| *byte == 0) else { return };
            bytes = &bytes[end + 1..];
            self.skips = false;
        }
        self.rest.extend(bytes);
        let Some(end) = self.rest.iter().rposition(|byte| *byte == 0) else { return };
        let frames: Vec<u8> = self.rest.drain(..=end).collect();
        let mut decoder = self.table.new_stream_decoder();
        decoder.received(&frames);
        loop {
            sink(match decoder.decode() {
                Ok(frame) => Record {
                    read_ns,
                    stamp: frame.display_timestamp().map(|stamp| stamp.to_string()).unwrap_or_default(),
                    level: frame.level().map(|known| level(known.as_str())),
                    message: frame.display_message().to_string(),
                },
                Err(DecodeError::UnexpectedEof) => break,
                Err(DecodeError::Malformed) => {
                    Record::note(read_ns, "(a record that cannot be decoded: more was written than the buffer holds)")
                }
            });
        }
    }
}

/// Reader and decoder of a machine's log.
pub struct Log<F> {
    decoder: Decoder,
    control_block: u32,
    sink: F,
}

impl<F: FnMut(Record)> Log<F> {
    /// Makes a reader for an image; `sink` gets every record.
    ///
    /// # Errors
    /// [`LogError`] names the reason.
    pub fn new(image: &Image, control_block: Option<u32>, sink: F) -> Result<Self, LogError> {
        let control_block = control_block.ok_or(LogError::None)?;
        Ok(Self { decoder: Decoder::new(image.elf())?, control_block, sink })
    }

    /// Reads and decodes the bytes written since the last call.
    pub fn poll(&mut self, memory: &Memory, now_ns: u64) {
        let Some(bytes) = take(memory, self.control_block) else { return };
        self.decoder.push(&bytes, now_ns, &mut self.sink);
    }
}

fn level(name: &str) -> Level {
    match name {
        "trace" => Level::Trace,
        "debug" => Level::Debug,
        "info" => Level::Info,
        "warn" => Level::Warn,
        _ => Level::Error,
    }
}

/// Takes the bytes that the program has written to its first channel since the last call; `None` while the channel does
/// not exist.
fn take(memory: &Memory, control_block: u32) -> Option<Vec<u8>> {
    let mut identification = [0; 16];
    memory.read_slice(control_block, &mut identification)?;
    if &identification != IDENTIFICATION {
        return None;
    }
    let word = |index: u32| memory.read(control_block + UP_CHANNEL + 4 * index, Size::Word);
    let (buffer, size, written, read) = (word(1)?, word(2)?, word(3)?, word(4)?);
    if written >= size || read >= size {
        return None;
    }
    let part = |from: u32, to: u32| {
        let mut bytes = vec![0; (to - from) as usize];
        memory.read_slice(buffer + from, &mut bytes).map(|()| bytes)
    };
    let bytes = if read <= written { part(read, written)? } else { [part(read, size)?, part(0, written)?].concat() };
    memory.write(control_block + UP_CHANNEL + 16, Size::Word, written)?;
    Some(bytes)
}

impl<C: Core, F: FnMut(Record)> Watcher<C> for Log<F> {
    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped) {
        self.poll(machine.borrow().chip.memory(), stopped.at_ns);
    }

    fn failed(&mut self, machine: &SharedMachine<C>, _: &MachineError) {
        let machine = machine.borrow();
        self.poll(machine.chip.memory(), machine.now_ns());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK: u32 = 0x2000_0000;
    const BUFFER: u32 = 0x2000_0100;

    fn memory(written: u32, read: u32) -> Memory {
        let memory = Memory::new();
        memory.write_slice(BLOCK, IDENTIFICATION).unwrap();
        for (index, value) in [1, 0, 0, BUFFER, 8, written, read, 0].into_iter().enumerate() {
            memory.write(BLOCK + 16 + 4 * index as u32, Size::Word, value).unwrap();
        }
        memory.write_slice(BUFFER, b"01234567").unwrap();
        memory
    }

    #[test]
    fn what_is_between_reader_and_writer_is_taken_once_also_around_the_end() {
        let straight = memory(5, 2);
        assert_eq!(take(&straight, BLOCK).as_deref(), Some(&b"234"[..]));
        assert_eq!(take(&straight, BLOCK).as_deref(), Some(&b""[..]));
        assert_eq!(straight.read(BLOCK + 40, Size::Word), Some(5), "the reader's position");
        assert_eq!(take(&memory(2, 6), BLOCK).as_deref(), Some(&b"6701"[..]));
    }

    #[test]
    fn before_the_program_has_made_its_control_block_there_is_nothing() {
        assert_eq!(take(&Memory::new(), BLOCK), None);
        assert_eq!(take(&memory(8, 0), BLOCK), None, "positions are below the size");
    }
}
