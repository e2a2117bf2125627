//! Position of a client in the log of the board's firmware.

use r4_protocol::LogChunk;

/// Position of one client in the log.
#[derive(Default)]
pub(crate) struct LogReader {
    /// Position behind the last byte that the client has; `None` before the first chunk.
    next: Option<u32>,
}

impl LogReader {
    /// Returns the part of a chunk that the client does not have yet, `None` if it has all. The board restarts its
    /// log for each client that asks for it, so chunks repeat.
    pub(crate) fn unread(&mut self, chunk: &LogChunk) -> Option<LogChunk> {
        let end = chunk.position.wrapping_add(chunk.bytes.len() as u32);
        // Positions wrap at 2^32: a difference of less than half the range counts as ahead.
        let known = self.next.map_or(0, |next| next.wrapping_sub(chunk.position).cast_signed()).max(0) as usize;
        let bytes = chunk.bytes.get(known..).filter(|bytes| !bytes.is_empty())?;
        self.next = Some(end);
        let position = chunk.position.wrapping_add(known as u32);
        // The part fits: it is no longer than the chunk.
        Some(LogChunk { position, bytes: bytes.iter().copied().collect() })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Chunks of one log from a board that restarts it now and then: a client gets each byte once, in order.
        #[test]
        fn each_byte_is_read_once(
            first in any::<u32>(),
            pieces in prop::collection::vec((0_usize..40, any::<bool>()), 1..40),
        ) {
            let byte = |position: u32| (position.wrapping_sub(first) % 251) as u8;
            let (mut at, mut reader, mut read) = (first, LogReader::default(), Vec::new());
            for (len, anew) in pieces {
                let bytes = (0..len as u32).map(|place| byte(at.wrapping_add(place))).collect();
                if let Some(chunk) = reader.unread(&LogChunk { position: at, bytes }) {
                    prop_assert_eq!(chunk.position, first.wrapping_add(read.len() as u32));
                    read.extend_from_slice(&chunk.bytes);
                }
                at = if anew { first } else { at.wrapping_add(len as u32) };
            }
            let expected: Vec<u8> = (0..read.len() as u32).map(|place| byte(first.wrapping_add(place))).collect();
            prop_assert_eq!(read, expected);
        }
    }
}
