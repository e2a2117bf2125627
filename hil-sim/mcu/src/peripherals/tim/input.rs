//! Input of a timer with its digital filter.

/// Number of samples, and divider of f_DTS, for each value of ICxF (RM0399, TIMx_CCMR1, IC1F); divider 0 means
/// f_CK_INT.
const FILTER: [(u64, u64); 16] = [
    (0, 0),
    (2, 0),
    (4, 0),
    (8, 0),
    (6, 2),
    (8, 2),
    (6, 4),
    (8, 4),
    (6, 8),
    (8, 8),
    (5, 16),
    (6, 16),
    (8, 16),
    (5, 32),
    (6, 32),
    (8, 32),
];

/// Returns the time that a level must last to pass a filter, ns, rounded up. `division` is CKD's divider of f_DTS.
///
/// The phase of the sampling clock is not modelled: the level passes exactly this long after its edge.
pub(super) fn filter_ns(icf: u32, division: u64, hz: u64) -> u64 {
    let (samples, divider) = FILTER[(icf & 15) as usize];
    let clocks = samples * if divider == 0 { 1 } else { divider * division };
    if hz == 0 { 0 } else { (clocks * 1_000_000_000).div_ceil(hz) }
}

/// State of an input, TI1 to TI4.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Input {
    /// Level at the pin.
    pub(super) raw: bool,
    /// Level behind the filter.
    pub(super) filtered: bool,
    /// Time at which the filter will follow the pin, ns.
    pub(super) passes_ns: Option<u64>,
}

impl Input {
    /// Handles an edge at the pin; returns true if the level behind the filter follows at once.
    pub(super) fn edge(&mut self, high: bool, at_ns: u64, filter_ns: u64) -> bool {
        self.raw = high;
        if high == self.filtered {
            // The level returned before the filter followed: the pulse was too short.
            self.passes_ns = None;
            return false;
        }
        if filter_ns > 0 {
            self.passes_ns = Some(at_ns.saturating_add(filter_ns));
            return false;
        }
        self.filtered = high;
        true
    }

    /// Lets the filter follow the pin.
    pub(super) fn pass(&mut self) {
        self.passes_ns = None;
        self.filtered = self.raw;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_filters_of_the_manual() {
        // At 240 MHz two samples at the timer's clock are 8.3 ns; 8 samples of f_DTS/32 with CKD = 4 are 4267 ns.
        assert_eq!(filter_ns(0, 1, 240_000_000), 0);
        assert_eq!(filter_ns(1, 4, 240_000_000), 9);
        assert_eq!(filter_ns(15, 4, 240_000_000), 4267);
        assert_eq!(filter_ns(4, 1, 240_000_000), 50);
    }
}
