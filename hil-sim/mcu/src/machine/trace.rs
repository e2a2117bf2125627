//! Trace of a program's exceptions and its digest.

/// First EXC_RETURN value (DDI0403E B1.5.8).
const EXC_RETURN: u32 = 0xFFFF_FF00;

/// Entry into an exception, or return from one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// Virtual time of the change, ns.
    pub at_ns: u64,
    /// PC before: the next instruction of the interrupted code, or EXC_RETURN.
    pub from: u32,
    /// PC after the change.
    pub to: u32,
    /// Exception whose handler was executed; 0 for none.
    pub before: u16,
    /// Exception whose handler is executed now; 0 for none.
    pub after: u16,
}

impl Change {
    /// Returns true for a return: to the interrupted code, or (tail-chaining) to the handler of a pending exception.
    #[must_use]
    pub fn is_return(&self) -> bool {
        self.from >= EXC_RETURN
    }
}

/// Hash over all exception entries and returns: times, and program counters before and after. Equal for two runs that
/// did the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trace {
    hash: u64,
    exceptions: u64,
}

impl Trace {
    pub(super) fn new() -> Self {
        // The start value is FNV-1a's offset basis.
        Self { hash: 0xCBF2_9CE4_8422_2325, exceptions: 0 }
    }

    pub(super) fn exception(&mut self, at_ns: u64, from: u32, to: u32, active: u16) {
        let places = u64::from(from) << 32 | u64::from(to);
        for byte in [at_ns, places, active.into()].iter().flat_map(|word| word.to_le_bytes()) {
            self.hash = (self.hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01B3);
        }
        self.exceptions += 1;
    }

    /// Returns the hash of all exceptions so far.
    #[must_use]
    pub fn hash(&self) -> u64 {
        self.hash
    }

    /// Returns the number of exception entries and returns.
    #[must_use]
    pub fn exceptions(&self) -> u64 {
        self.exceptions
    }
}
