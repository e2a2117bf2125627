//! Time by the processor's cycles: for what waits before there is a clock, and for what must not depend on one.

use cortex_m::peripheral::{DCB, DWT};

/// The processor's clock before the clock tree is set up, MHz, at most: the internal oscillator without a divider. Where a
/// bootloader has left a divider, waits are longer.
pub(crate) const AT_RESET_MHZ: u32 = 64;
/// The processor's clock after that, MHz.
pub(crate) const RUNNING_MHZ: u32 = 480;

/// Starts the counter.
pub(crate) fn start(dcb: &mut DCB, dwt: &mut DWT) {
    dcb.enable_trace();
    DWT::unlock();
    dwt.enable_cycle_counter();
}

/// A moment up to which something is waited for, at most 8.9 s ahead.
#[derive(Clone, Copy)]
pub(crate) struct Deadline {
    begin: u32,
    cycles: u32,
}

impl Deadline {
    /// In so many microseconds of a processor that runs at `mhz`.
    pub(crate) fn after_us(us: u32, mhz: u32) -> Self {
        Self { begin: DWT::cycle_count(), cycles: us.saturating_mul(mhz) }
    }

    /// Whether it has come.
    pub(crate) fn has_passed(self) -> bool {
        DWT::cycle_count().wrapping_sub(self.begin) >= self.cycles
    }

    /// Waits for it; nothing else runs meanwhile but interrupts.
    pub(crate) fn wait(self) {
        while !self.has_passed() {}
    }
}
