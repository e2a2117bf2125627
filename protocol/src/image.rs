//! Image of a board's firmware in flash: its identity, the check that it is whole, and the robot that it is for.
//!
//! Between its vector table and its code an image has a record, one flash word, and behind that the robot's
//! configuration ([`ROBOT_AT`]). The program that makes the image fills in both; the firmware compares the record with the flash at each start.
//!
//! | bytes of the record | hold |
//! | --- | --- |
//! | 0..4 | [`MAGIC`] |
//! | 4..8 | length of the image from its first byte, in bytes, little-endian; a multiple of [`RECORD_BYTES`] |
//! | 8..12 | CRC-32 over that length, little-endian, computed with 0xFF (erased flash) in place of these four bytes |
//! | 12..32 | 0xFF |
//!
//! The CRC is that of IEEE 802.3 (polynomial 0x04C1_1DB7, reflected, initial and final 0xFFFF_FFFF; "CRC-32/ISO-HDLC").

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Offset of the record in the image, bytes: behind the 664 bytes of an STM32H747's vector table.
pub const RECORD_AT: usize = 0x3E0;
/// Length of the record, bytes: one flash word of an STM32H7, which is programmed as a whole (RM0399, 4.3.8).
pub const RECORD_BYTES: usize = 32;
/// Offset of the CRC in the image, bytes.
pub const CRC_AT: usize = RECORD_AT + 8;
/// Offset of the robot's configuration in the image, bytes: a [`BoardConfig`](crate::config::BoardConfig) in postcard's format, then 0xFF. Images
/// for robots on the same carrier differ in nothing else but the record.
pub const ROBOT_AT: usize = RECORD_AT + RECORD_BYTES;
/// Length of the place for the configuration, bytes. The largest one of a built-in robot, `every-interface`, takes 1621.
pub const ROBOT_BYTES: usize = 4096;
/// Offset of the first code in the image, bytes.
pub const CODE_AT: usize = ROBOT_AT + ROBOT_BYTES;
/// First bytes of the record.
pub const MAGIC: [u8; 4] = *b"R4im";

/// Identity of the image that a board runs, from its record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct ImageInfo {
    /// True for an image that the Arduino bootloader starts.
    pub hosted: bool,
    /// Length of the image, bytes.
    pub bytes: u32,
    /// CRC-32 of the image.
    pub crc: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::IMAGE_BYTES;

    /// Checks the record against the table above and the linker script of the firmware.
    #[test]
    fn the_record_is_one_flash_word_behind_the_vectors() {
        // RM0399, table of the vectors: 166 words.
        assert_eq!(IMAGE_BYTES, 664);
        assert!(RECORD_AT >= IMAGE_BYTES && RECORD_AT.is_multiple_of(RECORD_BYTES));
        assert_eq!(CRC_AT - RECORD_AT, MAGIC.len() + size_of::<u32>(), "behind the magic and the length");
    }
}
