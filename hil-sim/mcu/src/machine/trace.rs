//! A digest of what a program did, and its parts.

/// EXC_RETURN values begin here (DDI0403E B1.5.8).
const EXC_RETURN: u32 = 0xFFFF_FF00;

/// An exception was taken or left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// When.
    pub at_ns: u64,
    /// PC before: the next instruction of what was interrupted, or EXC_RETURN.
    pub from: u32,
    /// PC after.
    pub to: u32,
    /// The exception whose handler was executed; 0 is none.
    pub before: u16,
    /// The exception whose handler is executed now; 0 is none.
    pub after: u16,
}

impl Change {
    /// A handler has returned: to what it interrupted, or (tail-chaining) to the handler of one that waited.
    #[must_use]
    pub fn is_return(&self) -> bool {
        self.from >= EXC_RETURN
    }
}

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
