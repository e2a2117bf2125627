//! Log of a board's firmware, as hosts get it. Decoding its bytes takes the ELF file that the board's image was made
//! from.

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Maximum number of bytes in one [`LogChunk`].
pub const MAX_LOG: usize = crate::message::MAX_RAW;

/// Length of the part of an image that [`fingerprint`] covers, bytes: the vector table of an STM32H747 (RM0399, NVIC:
/// 150 interrupts behind 16 words of the processor).
pub const IMAGE_BYTES: usize = 4 * (16 + 150);

/// Piece of the log, in the order of writing.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct LogChunk {
    /// Number of bytes written before these, since power-up, wrapping. A gap behind the previous piece is lost bytes.
    pub position: u32,
    /// Bytes in the encoding of the firmware's log (defmt).
    pub bytes: Vec<u8, MAX_LOG>,
}

/// Identity of a board's log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct LogInfo {
    /// Fingerprint of the image that runs: 32-bit FNV-1a over its vector table.
    pub image: u32,
}

/// Returns a number that identifies an image by the addresses of its functions: 32-bit FNV-1a over the vector table.
#[must_use]
pub fn fingerprint(vectors: &[u8; IMAGE_BYTES]) -> u32 {
    vectors.iter().fold(0x811C_9DC5, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_other_address_is_another_image() {
        let mut vectors = [0; IMAGE_BYTES];
        let zeros = fingerprint(&vectors);
        vectors[IMAGE_BYTES - 4] = 1;
        assert_ne!(fingerprint(&vectors), zeros);
        // FNV-1a of zeros is the offset basis times a power of the prime.
        let power = (0..IMAGE_BYTES).fold(1u32, |power, _| power.wrapping_mul(0x0100_0193));
        assert_eq!(zeros, power.wrapping_mul(0x811C_9DC5));
    }
}
