//! Firmware images for all tools that flash: the raw image of an ELF file, and a check that a board would start it.
//!
//! | module | subject |
//! | --- | --- |
//! | `binary` | raw flash image out of an ELF file |
//! | `elf` | the ELF file: its location and its segments |
//! | `robot` | the configuration of the robot that an image is for |
//! | `seal` | the record of length and CRC that shows that an image is complete |
//! | `place` | start addresses of images, and the requirements there |

mod binary;
mod elf;
mod place;
mod robot;
mod seal;

pub use binary::Binary;
pub use elf::{FileError, Image, Segment};
pub use place::{CHIP, DFU_DEVICE, DFU_USB, Place, dfu_util};
pub use r4_protocol::image::{CODE_AT, RECORD_AT, RECORD_BYTES};
pub use robot::set_robot;
pub use seal::{Seal, seal, seal_elf};

use sha2::{Digest, Sha256};

/// Reason why a file cannot be flashed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// Another kind of file, or a truncated one.
    #[error("no ELF file of 32 bits, or one that is cut off")]
    NoElf,
    /// No segment of the file is loaded.
    #[error("nothing in it is loaded into flash")]
    Empty,
    /// The file is for another processor, or damaged.
    #[error("its segments lie {bytes} bytes apart, more than there is flash")]
    Apart {
        /// Distance from the first byte to the last.
        bytes: usize,
    },
    /// The file is damaged: segments overlap.
    #[error("two of its segments overlap at {address:#010x}")]
    Overlap {
        /// Start address of the second segment.
        address: u32,
    },
    /// Neither the processor nor the bootloader would start the image, or it reaches into bank 2.
    #[error(
        "it is for {start:#010x} to {end:#010x}: an image begins at {:#010x} (bare), or at {:#010x} behind the bootloader \
         (hosted), and ends by 0x08100000, where a board keeps its parameters",
        Place::Bare.start(),
        Place::Hosted.start()
    )]
    Elsewhere {
        /// Address of the first byte.
        start: u32,
        /// Address behind the last byte.
        end: u64,
    },
    /// The image has no vector table in front: invalid stack pointer.
    #[error("its first word is {word:#010x}, which is no stack in RAM: the bootloader takes that for no program")]
    NoStack {
        /// First word of the image.
        word: u32,
    },
    /// The image was not made by `cargo xtask firmware`, or by a version without a record.
    #[error("it has no record of its CRC at {address:#010x}: build it with `cargo xtask firmware`")]
    NoRecord {
        /// Address at which the record belongs.
        address: u32,
    },
    /// The image is that of another program, or of a version into which the configuration was compiled.
    #[error("it has no place for a robot's configuration at {address:#010x}: build it with `cargo xtask firmware`")]
    NoRobot {
        /// Address at which the configuration belongs.
        address: u32,
    },
    /// The robot has a larger configuration than images have room for.
    #[error(
        "the robot's configuration takes more than the {room} bytes that an image has for it: use fewer channels or shorter names"
    )]
    RobotTooLarge {
        /// Length of the place for it, bytes.
        room: usize,
    },
    /// The image was changed since it was made, or never finished.
    #[error(
        "its record says {bytes} bytes with CRC {crc:#010x}, but the file has {found_bytes} with {found:#010x}: the board would only \
         hold its outputs safe. Build it again with `cargo xtask firmware`"
    )]
    Damaged {
        /// Length according to the record.
        bytes: u32,
        /// CRC according to the record.
        crc: u32,
        /// Length of the file's image, bytes.
        found_bytes: u32,
        /// CRC of the file's image.
        found: u32,
    },
    /// The image has no vector table in front: invalid reset vector.
    #[error("its second word is {word:#010x}, which is no function of it: the processor could not start there")]
    NoEntry {
        /// Second word of the image.
        word: u32,
    },
}

/// SHA-256 of a file, as `sha256sum` prints it.
#[must_use]
pub fn digest(file: &[u8]) -> String {
    Sha256::digest(file).iter().map(|byte| format!("{byte:02x}")).collect()
}
