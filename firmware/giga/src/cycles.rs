//! Time by the processor's cycle counter: for waits before there is a clock, and for those that must not depend on one.

use cortex_m::peripheral::{DCB, DWT};

/// Highest processor clock before the clock tree is set up, MHz: the internal oscillator without a divider. If a
/// bootloader has left a divider, waits are longer.
pub(crate) const AT_RESET_MHZ: u32 = 64;
/// Processor clock after that, MHz.
pub(crate) const RUNNING_MHZ: u32 = 480;

/// Starts the cycle counter.
pub(crate) fn start(dcb: &mut DCB, dwt: &mut DWT) {
    dcb.enable_trace();
    DWT::unlock();
    dwt.enable_cycle_counter();
}

/// Deadline of a wait, at most 8.9 s ahead.
#[derive(Clone, Copy)]
pub(crate) struct Deadline {
    begin: u32,
    cycles: u32,
}

impl Deadline {
    /// Creates a deadline in `us` microseconds of a processor that runs at `mhz`.
    pub(crate) fn after_us(us: u32, mhz: u32) -> Self {
        Self { begin: DWT::cycle_count(), cycles: us.saturating_mul(mhz) }
    }

    /// Returns true once the deadline has passed.
    pub(crate) fn has_passed(self) -> bool {
        DWT::cycle_count().wrapping_sub(self.begin) >= self.cycles
    }

    /// Waits for the deadline; only interrupts run meanwhile.
    pub(crate) fn wait(self) {
        while !self.has_passed() {}
    }
}
