//! The image of a board's firmware in flash: which it is, and how it is known to be whole.
//!
//! An image has a record, one flash word, between its vector table and its code. Whoever makes the image fills it in, the
//! firmware compares it with the flash at each start.
//!
//! | bytes of the record | hold |
//! | --- | --- |
//! | 0..4 | [`MAGIC`] |
//! | 4..8 | length of the image, bytes, little-endian, a multiple of [`RECORD_BYTES`]; from its first byte on |
//! | 8..12 | CRC-32 of that many bytes, little-endian, taken with these four as an erased flash has them, 0xFF |
//! | 12..32 | 0xFF |
//!
//! The CRC is that of IEEE 802.3 (polynomial 0x04C1_1DB7, reflected, initial and final 0xFFFF_FFFF; "CRC-32/ISO-HDLC").

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Where the record begins, bytes from the beginning of the image: behind the 664 bytes of an STM32H747's vector table.
pub const RECORD_AT: usize = 0x3E0;
/// Length of the record: a flash word of an STM32H7, which is programmed as one (RM0399, 4.3.8).
pub const RECORD_BYTES: usize = 32;
/// Where the CRC is, bytes from the beginning of the image.
pub const CRC_AT: usize = RECORD_AT + 8;
/// How the record begins.
pub const MAGIC: [u8; 4] = *b"R4im";

/// The image that a board runs, as its record says.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct ImageInfo {
    /// Whether it is behind the Arduino bootloader.
    pub hosted: bool,
    /// Its length, bytes.
    pub bytes: u32,
    /// Its CRC-32.
    pub crc: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::log::IMAGE_BYTES;

    /// As the table above has it, and the linker script of the firmware.
    #[test]
    fn the_record_is_one_flash_word_behind_the_vectors() {
        // RM0399, table of the vectors: 166 words.
        assert_eq!(IMAGE_BYTES, 664);
        assert!(RECORD_AT >= IMAGE_BYTES && RECORD_AT.is_multiple_of(RECORD_BYTES));
        assert_eq!(CRC_AT - RECORD_AT, MAGIC.len() + size_of::<u32>(), "behind the magic and the length");
    }
}
