//! Durations of SCL's low and high phases (RM0399, 50.4.9, "I2C master initialization").
//!
//! The low phase is counted from the controller's detection of its own falling edge, the high phase from that of the
//! rising one. So each is longer than TIMINGR by a delay: tSYNC1 after the falling, tSYNC2 after the rising edge. The
//! manual gives their components, not their values. The model assumes:
//!
//! - synchronisation: 3 periods of the kernel clock (manual: 2 to 3);
//! - digital filter: DNF periods;
//! - analog filter, when it is on: 50 ns (the least that it suppresses; DS12930, I2C analog filter characteristics);
//! - slopes up to the input's threshold: 10 ns falling, 100 ns rising (a bus of some 100 pF pulled up by 1 to 2 kΩ).

use super::registers::cr1;

const SYNCHRONISATION_PERIODS: u64 = 3;
const ANALOG_FILTER_NS: u64 = 50;
const FALL_NS: u64 = 10;
const RISE_NS: u64 = 100;

/// Durations of SCL's phases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Timing {
    kernel_hz: u64,
    low_periods: u64,
    high_periods: u64,
    setup_periods: u64,
    filter_ns: u64,
}

impl Timing {
    pub(super) fn new(kernel_hz: u64, timingr: u32, cr1: u32) -> Self {
        let prescaler = u64::from(timingr >> 28) + 1;
        let field = |at: u32, mask: u32| (u64::from(timingr >> at & mask) + 1) * prescaler;
        let delay = SYNCHRONISATION_PERIODS + u64::from(cr1 >> cr1::DNF_AT & 0xF);
        Self {
            kernel_hz,
            low_periods: field(0, 0xFF) + delay,
            high_periods: field(8, 0xFF) + delay,
            setup_periods: field(20, 0xF),
            filter_ns: if cr1 & cr1::ANFOFF == 0 { ANALOG_FILTER_NS } else { 0 },
        }
    }

    /// Returns the duration of `low` and `high` phases, rounded up to a nanosecond once; `u64::MAX` for a stopped
    /// clock.
    pub(super) fn phases_ns(&self, low: u64, high: u64) -> u64 {
        self.periods_ns(low * self.low_periods + high * self.high_periods)
            .saturating_add(low * (self.filter_ns + FALL_NS) + high * (self.filter_ns + RISE_NS))
    }

    pub(super) fn bits_ns(&self, bits: u64) -> u64 {
        self.phases_ns(bits, bits)
    }

    /// Returns the set-up time of SDA before SCL rises (SCLDEL), ns.
    pub(super) fn setup_ns(&self) -> u64 {
        self.periods_ns(self.setup_periods)
    }

    /// Returns the duration of `periods` of the kernel clock, ns.
    pub(super) fn periods_ns(&self, periods: u64) -> u64 {
        if self.kernel_hz == 0 {
            return u64::MAX;
        }
        let ns = (u128::from(periods) * 1_000_000_000).div_ceil(u128::from(self.kernel_hz));
        u64::try_from(ns).unwrap_or(u64::MAX)
    }
}
