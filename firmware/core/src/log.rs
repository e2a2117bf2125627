//! Log of a board's firmware, for hosts that ask for it. Here it is bytes; decoding them needs the ELF of the firmware.
//!
//! Logging never waits: when [`SIZE`] more bytes are written, unread ones are overwritten. Hosts see how much they have
//! missed by the position of the bytes they get.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering};

use embassy_time::{Duration, Instant};
use r4_protocol::log::{LogChunk, MAX_LOG};

/// Size of the ring, bytes.
pub const SIZE: usize = 1024;
/// Interval between two log messages, behind all answers and telemetry: 6.4 kB/s, 7 % of the slowest link but CAN.
const PERIOD: Duration = Duration::from_millis(10);

// Positions wrap at 2^32, so indices modulo SIZE must wrap there too.
const _: () = assert!(SIZE.is_power_of_two());

/// Ring with the last bytes of a log.
///
/// There is one writer at a time, which no reader interrupts: on the board it is a critical section, and all readers
/// are tasks.
pub struct Ring {
    bytes: [AtomicU8; SIZE],
    /// Number of bytes ever written, wrapping.
    written: AtomicU32,
}

impl Default for Ring {
    fn default() -> Self {
        Self::new()
    }
}

impl Ring {
    /// Creates an empty ring.
    #[must_use]
    pub const fn new() -> Self {
        Self { bytes: [const { AtomicU8::new(0) }; SIZE], written: AtomicU32::new(0) }
    }

    /// Address of the bytes: byte number n of all ever written is at index n modulo [`SIZE`].
    #[must_use]
    pub const fn place(&self) -> *const AtomicU8 {
        self.bytes.as_ptr()
    }

    /// Number of bytes ever written, wrapping.
    #[must_use]
    pub fn written(&self) -> u32 {
        self.written.load(Ordering::Acquire)
    }

    /// Appends `bytes`, overwriting the oldest.
    pub fn push(&self, bytes: &[u8]) {
        let mut at = self.written.load(Ordering::Relaxed);
        for byte in bytes {
            self.bytes[at as usize % SIZE].store(*byte, Ordering::Relaxed);
            at = at.wrapping_add(1);
        }
        self.written.store(at, Ordering::Release);
    }

    /// Position of the oldest byte that is kept.
    fn oldest(&self) -> u32 {
        self.written().saturating_sub(SIZE as u32)
    }

    /// Reads the bytes from `position` on that are still kept, as many as a message holds.
    fn read(&self, position: u32) -> LogChunk {
        loop {
            let behind = self.written().wrapping_sub(position) as usize;
            let position = position.wrapping_add(behind.saturating_sub(SIZE) as u32);
            let place = |index: usize| &self.bytes[(position as usize).wrapping_add(index) % SIZE];
            let bytes = (0..behind.min(SIZE).min(MAX_LOG)).map(|index| place(index).load(Ordering::Relaxed)).collect();
            // Read again if new bytes may have overwritten those just read.
            if self.written().wrapping_sub(position) as usize <= SIZE {
                return LogChunk { position, bytes };
            }
        }
    }
}

/// Log of a board, with its image.
#[derive(Clone, Copy)]
pub struct Log {
    /// Ring that the firmware logs to.
    pub ring: &'static Ring,
    /// Fingerprint of the image whose ELF decodes the log, by [`r4_protocol::log::fingerprint`].
    pub image: u32,
}

/// Position up to which the host of one link has read, and the time of its next message; `None` without a request.
#[derive(Default)]
pub(crate) struct Feed(Option<(u32, Instant)>);

impl Feed {
    pub(crate) fn clear(&mut self) {
        self.0 = None;
    }

    /// Begins with the oldest byte that is kept, unless the feed has begun.
    pub(crate) fn begin(&mut self, log: &Log, now: Instant) {
        self.0.get_or_insert_with(|| (log.ring.oldest(), now));
    }

    pub(crate) fn next_due(&self) -> Instant {
        self.0.map_or(Instant::MAX, |(_, due)| due)
    }

    /// Next message of the log; `None` without new bytes.
    pub(crate) fn chunk(&mut self, log: &Log) -> Option<LogChunk> {
        let (position, due) = self.0.as_mut()?;
        *due = Instant::now() + PERIOD;
        let chunk = log.ring.read(*position);
        *position = chunk.position.wrapping_add(chunk.bytes.len() as u32);
        (!chunk.bytes.is_empty()).then_some(chunk)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    #[test]
    fn what_is_kept_is_read_once_and_in_order() {
        let ring = Ring::new();
        assert_eq!(ring.read(0), LogChunk { position: 0, bytes: heapless::Vec::new() });
        let all: Vec<u8> = (0..150).collect();
        ring.push(&all[..70]);
        ring.push(&all[70..]);
        let (mut at, mut read) = (ring.oldest(), Vec::new());
        while at != ring.written() {
            let chunk = ring.read(at);
            assert_eq!(chunk.position, at);
            at += chunk.bytes.len() as u32;
            read.extend(chunk.bytes);
        }
        assert_eq!(read, all);
        // A debugger finds the bytes there.
        assert_eq!(ring.place(), ring.bytes.as_ptr());
    }

    /// The feed begins with the oldest byte and sends at most a message each 10 ms; a second request does not restart
    /// it.
    #[test]
    fn a_host_is_fed_message_by_message() {
        let ring: &'static Ring = std::boxed::Box::leak(std::boxed::Box::default());
        let (log, mut feed, mut tasks) = (Log { ring, image: 0 }, Feed::default(), crate::testing::Tasks::default());
        assert_eq!((feed.next_due(), feed.chunk(&log)), (Instant::MAX, None));
        let all: Vec<u8> = (0..MAX_LOG + 5).map(|index| index as u8).collect();
        ring.push(&all);
        let begin = Instant::now();
        feed.begin(&log, begin);
        assert_eq!(feed.next_due(), begin);
        for (period, piece) in (1..).zip([&all[..MAX_LOG], &all[MAX_LOG..]]) {
            let position = (period - 1) * MAX_LOG as u32;
            let bytes = piece.iter().copied().collect();
            assert_eq!(feed.chunk(&log), Some(LogChunk { position, bytes }));
            assert_eq!(feed.next_due(), begin + PERIOD * period);
            tasks.advance(PERIOD);
            feed.begin(&log, begin);
        }
        // No new bytes.
        assert_eq!((feed.chunk(&log), feed.next_due()), (None, begin + PERIOD * 3));
        ring.push(b"more");
        assert_eq!(feed.chunk(&log).map(|chunk| chunk.position), Some(all.len() as u32));
        feed.clear();
        assert_eq!((feed.next_due(), feed.chunk(&log)), (Instant::MAX, None));
    }

    /// Also where the count of all bytes wraps.
    #[test]
    fn what_was_overwritten_is_left_out_and_the_position_tells_how_much() {
        for begin in [0, 5, u32::MAX - 700] {
            let ring = Ring::new();
            ring.written.store(begin, Ordering::Relaxed);
            let all: Vec<u8> = (0..SIZE + 300).map(|index| (index % 251) as u8).collect();
            all.chunks(40).for_each(|piece| ring.push(piece));
            let chunk = ring.read(begin);
            assert_eq!(chunk.position.wrapping_sub(begin), 300);
            assert_eq!(chunk.bytes[..], all[300..300 + MAX_LOG]);
            let last = ring.read(ring.written().wrapping_sub(3));
            assert_eq!(last.bytes[..], all[SIZE + 297..]);
        }
    }
}
