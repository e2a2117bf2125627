//! How long SCL is low and high (RM0399, 50.4.9, "I2C master initialization").
//!
//! The low phase is counted from where the controller sees its own falling edge, the high phase from where it sees the rising
//! one, so that each is longer than TIMINGR says by a delay: tSYNC1 after the falling, tSYNC2 after the rising edge. The
//! manual gives what they are made of, not their values. Taken here:
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

/// Phases of SCL.
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

    /// So many low and high phases, rounded up to a nanosecond once; `u64::MAX` while the clock stands still.
    pub(super) fn phases_ns(&self, low: u64, high: u64) -> u64 {
        self.periods_ns(low * self.low_periods + high * self.high_periods)
            .saturating_add(low * (self.filter_ns + FALL_NS) + high * (self.filter_ns + RISE_NS))
    }

    pub(super) fn bits_ns(&self, bits: u64) -> u64 {
        self.phases_ns(bits, bits)
    }

    /// SDA is set up before SCL rises (SCLDEL).
    pub(super) fn setup_ns(&self) -> u64 {
        self.periods_ns(self.setup_periods)
    }

    /// So many periods of the kernel clock.
    pub(super) fn periods_ns(&self, periods: u64) -> u64 {
        if self.kernel_hz == 0 {
            return u64::MAX;
        }
        let ns = (u128::from(periods) * 1_000_000_000).div_ceil(u128::from(self.kernel_hz));
        u64::try_from(ns).unwrap_or(u64::MAX)
    }
}
