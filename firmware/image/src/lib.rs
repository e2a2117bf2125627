//! The firmware's ELF as it is written into flash, and whether a board would start it: for all that flashes.
//!
//! | module | subject |
//! | --- | --- |
//! | `binary` | the bytes that go into flash, out of an ELF file |
//! | `elf` | the file: where it is looked for, and which it is |
//! | `seal` | the record by which an image is known to be whole |
//! | `place` | where images lie, and what is expected of them there |

mod binary;
mod elf;
mod place;
mod seal;

pub use binary::Binary;
pub use elf::{FileError, Image, Segment};
pub use place::{CHIP, DFU_DEVICE, DFU_USB, Place, dfu_util};
pub use r4_protocol::image::{RECORD_AT, RECORD_BYTES};
pub use seal::{Seal, seal, seal_elf};

use sha2::{Digest, Sha256};

/// Why a file cannot be flashed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// Something else, or the beginning of one.
    #[error("no ELF file of 32 bits, or one that is cut off")]
    NoElf,
    /// Without a segment that is loaded.
    #[error("nothing in it is loaded into flash")]
    Empty,
    /// A file for another processor, or a damaged one.
    #[error("its segments lie {bytes} bytes apart, more than there is flash")]
    Apart {
        /// From the first byte to the last.
        bytes: usize,
    },
    /// A damaged file.
    #[error("two of its segments overlap at {address:#010x}")]
    Overlap {
        /// Where the second begins.
        address: u32,
    },
    /// An image that neither the processor nor the bootloader would start, or that reaches into bank 2.
    #[error(
        "it is for {start:#010x} to {end:#010x}: an image begins at {:#010x} (bare), or at {:#010x} behind the bootloader \
         (hosted), and ends by 0x08100000, where a board keeps its parameters",
        Place::Bare.start(),
        Place::Hosted.start()
    )]
    Elsewhere {
        /// Of the first byte.
        start: u32,
        /// Behind the last byte.
        end: u64,
    },
    /// No vector table in front.
    #[error("its first word is {word:#010x}, which is no stack in RAM: the bootloader takes that for no program")]
    NoStack {
        /// What is there.
        word: u32,
    },
    /// Not made by the program that makes images, or of before there was a record.
    #[error("it has no record of its CRC at {address:#010x}: build it with `cargo xtask firmware`")]
    NoRecord {
        /// Where it belongs.
        address: u32,
    },
    /// Changed since it was made, or never finished.
    #[error(
        "its record says {bytes} bytes with CRC {crc:#010x}, but the file has {found_bytes} with {found:#010x}: the board would only \
         hold its outputs safe. Build it again with `cargo xtask firmware`"
    )]
    Damaged {
        /// Length by the record.
        bytes: u32,
        /// CRC by the record.
        crc: u32,
        /// Length in the file.
        found_bytes: u32,
        /// CRC of what is in the file.
        found: u32,
    },
    /// No vector table in front.
    #[error("its second word is {word:#010x}, which is no function of it: the processor could not start there")]
    NoEntry {
        /// What is there.
        word: u32,
    },
}

/// SHA-256 of a file, as `sha256sum` prints it.
#[must_use]
pub fn digest(file: &[u8]) -> String {
    Sha256::digest(file).iter().map(|byte| format!("{byte:02x}")).collect()
}
