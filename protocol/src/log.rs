//! The log of a board's firmware, as hosts get it. What is in it only the ELF tells from which the board's image was made.

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Most bytes in one [`LogChunk`].
pub const MAX_LOG: usize = crate::message::MAX_RAW;

/// Bytes of an image that [`fingerprint`] is of, from its beginning: the vector table of an STM32H747 (RM0399, NVIC: 150
/// interrupts, behind 16 words of the processor).
pub const IMAGE_BYTES: usize = 4 * (16 + 150);

/// What is written into the log, in its order.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct LogChunk {
    /// How many bytes were written before the first of these, since power-up, wrapping. Where it is not the position behind the
    /// chunk before, what is between is lost.
    pub position: u32,
    /// In the encoding that the firmware's log has.
    pub bytes: Vec<u8, MAX_LOG>,
}

/// The log of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct LogInfo {
    /// [`fingerprint`] of the image that runs.
    pub image: u32,
}

/// Tells images apart by where their functions are: FNV-1a of 32 bits over the vector table.
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
        // What FNV-1a is of zeros: the offset times a power of the prime.
        let power = (0..IMAGE_BYTES).fold(1u32, |power, _| power.wrapping_mul(0x0100_0193));
        assert_eq!(zeros, power.wrapping_mul(0x811C_9DC5));
    }
}
