//! Oscillator at TI1 in place of the pin (RM0399, TIM15_TISEL, TIM16_TISEL, TIM17_TISEL; the codes are recalled, not
//! looked up).

use super::Tim;
use crate::context::{Clocks, Context, Ticks};

/// Clock at TI1 of a timer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Source {
    select: u32,
    /// Half periods: TI1 is high after an odd number.
    halves: Ticks,
    told: u64,
}

/// Returns the frequency of a selected clock, Hz; `None` for one that is not modelled.
fn hz(timer: u8, select: u32, clocks: &Clocks) -> Option<u64> {
    match (timer, select) {
        (15, 4) | (16, 2) => Some(clocks.lse_hz),
        (16, 1) => Some(clocks.lsi_ready_hz),
        (17, 2) => Some(clocks.hse_rtc_hz),
        _ => None,
    }
}

impl Source {
    /// Makes the source for a TI1SEL other than 0.
    pub(super) fn new(timer: u8, select: u32, now_ns: u64, clocks: &Clocks) -> Option<Self> {
        let hz = hz(timer, select, clocks)?;
        Some(Self { select, halves: Ticks { start_ns: now_ns, frequency_hz: 2 * hz, divider: 1 }, told: 0 })
    }

    pub(super) fn select(&self) -> u32 {
        self.select
    }

    /// Takes over a changed frequency of the oscillator.
    pub(super) fn follow(&mut self, timer: u8, now_ns: u64, clocks: &Clocks) {
        let frequency_hz = 2 * hz(timer, self.select, clocks).unwrap_or(0);
        if frequency_hz != self.halves.frequency_hz {
            // A change of frequency begins a new period.
            (self.halves, self.told) = (Ticks { start_ns: now_ns, frequency_hz, divider: 1 }, 0);
        }
    }

    fn next_ns(&self) -> u64 {
        self.halves.when_ns(self.told + 1)
    }
}

impl Tim {
    /// Returns the time of the next edge at TI1, ns, if it is captured.
    pub(super) fn next_source_ns(&self) -> Option<u64> {
        let source = self.source.as_ref()?;
        self.capturing(0).next()?;
        Some(source.next_ns())
    }

    /// Returns the time of the next capture, ns, if it must be reported at once.
    pub(super) fn source_event_ns(&self) -> u64 {
        let Some(source) = self.source.as_ref().filter(|_| self.watches(1)) else { return u64::MAX };
        if self.filter_ns(0) > 0 {
            return source.next_ns();
        }
        let captures = self
            .capturing(0)
            .map(|channel| source.halves.when_ns(source.told + self.halves_to_capture(channel, source.told)));
        captures.min().unwrap_or(u64::MAX)
    }

    /// Handles an edge of the clock at TI1.
    pub(super) fn source_edge(&mut self, at_ns: u64, context: &mut Context<'_>) {
        let Some(source) = &mut self.source else { return };
        source.told += 1;
        let high = source.told & 1 != 0;
        let filter_ns = self.filter_ns(0);
        if self.inputs[0].edge(high, at_ns, filter_ns) {
            self.input_changed(0, at_ns, context);
        }
    }

    /// Skips the edges of the clock that no channel captures.
    pub(super) fn skip_source(&mut self, now_ns: u64) {
        let idle = self.capturing(0).next().is_none();
        if let Some(source) = self.source.as_mut().filter(|_| idle) {
            source.told = source.halves.at(now_ns);
            let high = source.told & 1 != 0;
            (self.inputs[0].raw, self.inputs[0].filtered, self.inputs[0].passes_ns) = (high, high, None);
        }
    }
}
