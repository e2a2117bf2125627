//! Mutations of inputs: what a fuzzer does at random, but the same each time.

/// Generator of mutations; equal seeds make equal ones.
#[derive(Clone, Debug)]
pub struct Mutator {
    state: u64,
}

/// Bytes at which lengths, signs and texts change their meaning.
const TELLING: [u8; 16] = *b"\x00\x01\x7f\x80\xfe\xff\r\n\"-.:;=[9";

impl Mutator {
    /// Makes a generator, one for each target.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// Returns a random number by SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators",
    /// 2014).
    pub const fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ z >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ z >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ z >> 31
    }

    /// Returns a uniform number from 0 to `end` - 1; 0 when `end` is 0.
    pub const fn below(&mut self, end: usize) -> usize {
        // The bias does not matter, because 2^32 is far more than the length of any input.
        (((self.next() >> 32) * end as u64) >> 32) as usize
    }

    /// Returns `bytes` with one to eight changes; some of them use a part of `other`.
    #[must_use]
    pub fn neighbour(&mut self, bytes: &[u8], other: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        let changes = 1 + self.below(8);
        for _ in 0..changes {
            self.change(&mut bytes, other);
        }
        bytes
    }

    fn change(&mut self, bytes: &mut Vec<u8>, other: &[u8]) {
        let at = self.below(bytes.len());
        let piece = |mutator: &mut Self, of: &[u8]| {
            let from = mutator.below(of.len());
            let len = (1 + mutator.below(16)).min(of.len() - from);
            from..from + len
        };
        match self.below(10) {
            0 | 1 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte ^= 1 << self.below(8)),
            2 => bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = self.next() as u8),
            3 => {
                let telling = TELLING[self.below(TELLING.len())];
                bytes.iter_mut().skip(at).take(1).for_each(|byte| *byte = telling);
            }
            4 => bytes.insert(at, self.next() as u8),
            5 => bytes.insert(at, TELLING[self.below(TELLING.len())]),
            6 => {
                let gone = piece(self, bytes);
                bytes.drain(gone);
            }
            7 => {
                let again = piece(self, bytes);
                let again = bytes[again].to_vec();
                bytes.splice(at..at, again);
            }
            8 => {
                let of_other = piece(self, other);
                let end = if self.below(2) == 0 { at } else { bytes.len().min(at + of_other.len()) };
                bytes.splice(at..end, other[of_other].iter().copied());
            }
            _ => bytes.truncate(at.max(1)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_differ_and_come_again() {
        let seed = b"a seed of some length";
        let all = |seed_of| {
            let mut mutator = Mutator::new(seed_of);
            (0..1000).map(|_| mutator.neighbour(seed, b"another")).collect::<Vec<_>>()
        };
        assert_eq!(all(1), all(1));
        assert_ne!(all(1), all(2));
        let same = all(1).iter().filter(|bytes| bytes[..] == seed[..]).count();
        assert!(same < 30, "{same} of 1000 are no change");
        // An empty input is possible.
        let mut mutator = Mutator::new(1);
        (0..1000).for_each(|_| drop(mutator.neighbour(b"", b"")));
    }
}
