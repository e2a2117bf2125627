//! A digest of what a program did.

/// A hash over all exceptions: when they were taken and left, from where to where. Equal for two runs that did the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trace {
    hash: u64,
    exceptions: u64,
}

impl Trace {
    pub(super) fn new() -> Self {
        // FNV-1a's offset basis.
        Self { hash: 0xCBF2_9CE4_8422_2325, exceptions: 0 }
    }

    pub(super) fn exception(&mut self, at_ns: u64, from: u32, to: u32, active: u16) {
        let places = u64::from(from) << 32 | u64::from(to);
        for byte in [at_ns, places, active.into()].iter().flat_map(|word| word.to_le_bytes()) {
            self.hash = (self.hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
        }
        self.exceptions += 1;
    }

    /// The hash.
    #[must_use]
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// Exceptions taken and left.
    #[must_use]
    pub fn exceptions(&self) -> u64 {
        self.exceptions
    }
}
