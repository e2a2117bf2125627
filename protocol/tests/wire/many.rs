//! Test with ten million damaged frames. Seeded, so that they are the same each time.
//!
//! The damage is of every kind that a link does: wrong bits; wrong, lost, repeated, inserted and swapped bytes; bursts;
//! cut frames; halves of two frames joined; noise. For each damaged frame the test checks that
//!
//! - nothing panics;
//! - the good frame behind it is taken or, where the damage took the delimiter, the one after that;
//! - every message taken was sent, except for as many as the checksum may miss.
//!
//! If damage makes every checksum equally likely, one in 2^16 of the damaged frames that get as far as the checksum
//! passes it. A few wrong bits and short bursts do not count: they are always detected where COBS leaves them in place
//! (see `damage`). The number is therefore an upper bound, with four standard deviations of a Poisson count allowed. Of
//! the frames that pass the checksum postcard refuses a part.
//!
//! Frames without any message are not counted: their checksum is 0x0000, so that damage sometimes makes valid ones of
//! `01 01 01`. They carry nothing, and are no message of any version.

use proptest::{
    strategy::{Strategy, ValueTree},
    test_runner::TestRunner,
};
use r4_protocol::{
    FrameDecoder, FrameError,
    frame::{Check, Message},
};

use crate::{frame, strategies};

/// Number of damaged frames in each direction.
const DAMAGED: u32 = 5_000_000;
/// Number of good frames that are damaged.
const GOOD: usize = 1024;

#[test]
fn five_million_damaged_frames_to_a_board() {
    damage_many(strategies::to_device(), 1);
}

#[test]
fn five_million_damaged_frames_to_a_host() {
    damage_many(strategies::to_host(), 2);
}

/// Frame without a message, delimiter left out.
const NOTHING: [u8; 3] = [1, 1, 1];

/// Counters of damaged frames.
#[derive(Debug, Default)]
struct Seen {
    /// Frames that reached the checksum.
    checked: u32,
    /// Frames that passed it, although they were never sent.
    passed: u32,
    /// Frames of these that postcard accepted.
    taken: u32,
    /// Commands among the accepted ones.
    commands: u32,
    /// Frames without a message.
    empty: u32,
    /// Frames that were sent after all, such as a frame that is there twice.
    sent: u32,
}

fn damage_many<T: Message>(messages: impl Strategy<Value = T>, seed: u64) {
    let mut runner = TestRunner::deterministic();
    let good: Vec<Vec<u8>> =
        (0..GOOD).map(|_| frame(&messages.new_tree(&mut runner).expect("no filters").current())).collect();
    let mut random = Random(seed);
    let mut decoder = FrameDecoder::new();
    let mut seen = Seen::default();
    let mut bad = Vec::new();
    for _ in 0..DAMAGED {
        let (of, other) = (&good[random.below(GOOD)], &good[random.below(GOOD)]);
        bad.clear();
        bad.extend_from_slice(of);
        random.damage(&mut bad, other);
        // A frame that lost its delimiter takes the next one with it, and no more.
        if bad.last().is_some_and(|last| *last != 0) {
            bad.extend_from_slice(&good[random.below(GOOD)]);
        }
        let mut from = 0;
        for (at, byte) in bad.iter().enumerate() {
            let heard = decoder.push::<T>(*byte);
            let piece = &bad[from..at];
            if *byte == 0 {
                from = at + 1;
            }
            match heard {
                None | Some(Err(FrameError::TooLong | FrameError::Malformed)) => {}
                Some(Err(FrameError::Checksum { .. })) => seen.checked += 1,
                Some(Err(FrameError::NotAMessage { .. })) if NOTHING == *piece => seen.empty += 1,
                Some(Err(FrameError::NotAMessage { .. })) => {
                    seen.checked += 1;
                    seen.passed += 1;
                }
                Some(Ok(message)) => {
                    let again = frame(&message);
                    let is_wrong = u32::from(again != *of && again != *other);
                    seen.sent += 1 - is_wrong;
                    seen.checked += is_wrong;
                    seen.passed += is_wrong;
                    seen.taken += is_wrong;
                    seen.commands += is_wrong * u32::from(message.check() == Check::Long);
                }
            }
        }
        let next = &good[random.below(GOOD)];
        let (end, before) = next.split_last().expect("a frame");
        let early = before.iter().filter(|byte| decoder.push::<T>(**byte).is_some()).count();
        let Some(Ok(message)) = decoder.push::<T>(*end) else { panic!("{next:02x?} is lost behind {bad:02x?}") };
        assert_eq!(early, 0);
        // Comparing all bytes of each next frame is slow: one in 64 suffices, and that a frame comes is checked always.
        if seen.checked % 64 == 0 {
            assert_eq!(frame(&message), *next, "behind {bad:02x?}");
        }
    }
    let expected = f64::from(seen.checked) / 65536.0;
    let most = expected + 4.0 * expected.sqrt();
    println!("{seen:?}; expected at most {expected:.1} past the checksum, bound {most:.1}");
    assert!(seen.checked > DAMAGED / 3, "{seen:?}: much of the damage must be for the checksum to find");
    // At one in 2^32, five million frames give a command in one of a thousand runs.
    assert_eq!(seen.commands, 0, "{seen:?}");
    assert!(f64::from(seen.passed) <= most, "{seen:?}: more than {most:.1} passed the checksum");
}

/// Generator xorshift64* (Vigna, "An experimental exploration of Marsaglia's xorshift generators, scrambled", 2016).
struct Random(u64);

impl Random {
    fn next(&mut self) -> u32 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 32) as u32
    }

    /// Returns a number from 0 to `end` - 1.
    fn below(&mut self, end: usize) -> usize {
        ((u64::from(self.next()) * end as u64) >> 32) as usize
    }

    /// Does one kind of damage to the frame `bytes`.
    fn damage(&mut self, bytes: &mut Vec<u8>, other: &[u8]) {
        let at = self.below(bytes.len());
        match self.below(12) {
            0 | 1 => bytes[at] ^= 1 << self.below(8),
            2 => (0..1 + self.below(8)).for_each(|_| {
                let at = self.below(bytes.len());
                bytes[at] ^= 1 << self.below(8);
            }),
            3 => bytes[at] = self.next() as u8,
            4 => drop(bytes.remove(at)),
            5 => bytes.insert(at, bytes[at]),
            6 => bytes.insert(at, self.next() as u8),
            7 => {
                let next = (at + 1) % bytes.len();
                bytes.swap(at, next);
            }
            // A burst of wrong bytes.
            8 => bytes.iter_mut().skip(at).take(2 + self.0 as usize % 14).for_each(|byte| {
                self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                *byte = (self.0 >> 56) as u8;
            }),
            // A frame that is cut, or whose beginning is lost.
            9 if self.below(2) == 0 => bytes.truncate(at),
            9 => drop(bytes.drain(..at)),
            10 => {
                bytes.truncate(at);
                bytes.extend_from_slice(&other[self.below(other.len())..]);
            }
            _ => bytes.iter_mut().for_each(|byte| *byte = self.next() as u8),
        }
    }
}
