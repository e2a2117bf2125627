//! SysTick timer (DDI0403E B3.3), computed from virtual time.

use crate::context::Ticks;

/// Divider of SysTick's external reference: HCLK/8 on this chip (RM0399 8.5.11). The AHB runs at the core clock or
/// slower; the model divides the core clock, because the processor knows no other.
const REFERENCE_DIVIDER: u64 = 8;

const MASK: u32 = 0x00FF_FFFF;

/// State of the SysTick timer.
#[derive(Clone, Debug)]
pub struct SysTick {
    enable: bool,
    interrupt: bool,
    core_clock: bool,
    reload: u32,
    /// Value of the counter at tick 0 of `clock`.
    value: u32,
    clock: Ticks,
    /// Time up to which zero crossings were reported, ns.
    told_ns: u64,
    count_flag: bool,
    core_hz: u64,
}

impl SysTick {
    /// Makes the timer in its reset state; the reload value, unknown on hardware, is zero.
    #[must_use]
    pub fn new(now_ns: u64, core_hz: u64) -> Self {
        Self {
            enable: false,
            interrupt: false,
            core_clock: false,
            reload: 0,
            value: 0,
            clock: Ticks { start_ns: now_ns, frequency_hz: core_hz, divider: REFERENCE_DIVIDER },
            told_ns: now_ns,
            count_flag: false,
            core_hz,
        }
    }

    /// Returns the value of the counter.
    fn counter(&self, now_ns: u64) -> u32 {
        if !self.enable {
            return self.value;
        }
        let ticks = self.clock.at(now_ns);
        let value = u64::from(self.value);
        // The first round begins at the present value; each further one takes RELOAD + 1 ticks.
        match ticks.checked_sub(value + 1) {
            None => (value - ticks) as u32,
            Some(past) => self.reload - (past % (u64::from(self.reload) + 1)) as u32,
        }
    }

    /// Returns the ticks from tick 0 to the `n`-th transition of the counter from 1 to 0, `n` from 0; `None` if it
    /// never occurs.
    fn zero(&self, n: u64) -> Option<u64> {
        let period = u64::from(self.reload) + 1;
        match (self.value, self.reload) {
            (0, 0) => None,
            (0, _) => Some((n + 1) * period),
            (_, 0) => (n == 0).then_some(self.value.into()),
            _ => Some(u64::from(self.value) + n * period),
        }
    }

    /// Returns the first time after `after_ns` at which zero is reached, ns; `u64::MAX` for never.
    fn next_zero_ns(&self, after_ns: u64) -> u64 {
        if !self.enable || after_ns == u64::MAX {
            return u64::MAX;
        }
        let Some(first) = self.zero(0) else { return u64::MAX };
        let period = u64::from(self.reload) + 1;
        let ticks = self.clock.at(after_ns);
        // The ticks are rounded down, so the estimate may be too early; the loop corrects it.
        let mut n = ticks.saturating_sub(first) / period;
        loop {
            let Some(zero) = self.zero(n) else { return u64::MAX };
            let at_ns = self.clock.when_ns(zero);
            if at_ns > after_ns {
                return at_ns;
            }
            n += 1;
        }
    }

    /// Returns the time of the next interrupt, ns; `u64::MAX` for never.
    #[must_use]
    pub fn next_event_ns(&self) -> u64 {
        if self.interrupt { self.next_zero_ns(self.told_ns) } else { u64::MAX }
    }

    /// Advances the timer to `now_ns`; returns true if the exception becomes pending.
    pub fn advance(&mut self, now_ns: u64) -> bool {
        let reached = self.next_zero_ns(self.told_ns) <= now_ns;
        self.told_ns = self.told_ns.max(now_ns);
        // COUNTFLAG is set without TICKINT too.
        self.count_flag |= reached;
        reached && self.interrupt
    }

    /// Restarts the count from the present value, before a change of its conditions.
    fn restart(&mut self, now_ns: u64) {
        self.value = self.counter(now_ns);
        let divider = if self.core_clock { 1 } else { REFERENCE_DIVIDER };
        self.clock = Ticks { start_ns: now_ns, frequency_hz: self.core_hz, divider };
    }

    /// Sets the frequency of the core clock, Hz.
    pub fn set_core_hz(&mut self, now_ns: u64, core_hz: u64) {
        self.restart(now_ns);
        self.core_hz = core_hz;
        self.clock.frequency_hz = core_hz;
    }

    /// Reads a register, offset from 0xE000_E010; call [`SysTick::advance`] first.
    pub fn read(&mut self, offset: u32, now_ns: u64) -> Option<u32> {
        Some(match offset {
            0x0 => {
                // A read of CSR clears COUNTFLAG.
                let flag = std::mem::take(&mut self.count_flag);
                u32::from(flag) << 16
                    | u32::from(self.core_clock) << 2
                    | u32::from(self.interrupt) << 1
                    | u32::from(self.enable)
            }
            0x4 => self.reload,
            0x8 => self.counter(now_ns),
            _ => return None,
        })
    }

    /// Writes a register; call [`SysTick::advance`] first.
    pub fn write(&mut self, offset: u32, value: u32, now_ns: u64) -> Option<()> {
        match offset {
            0x0 => {
                // The first restart counts up to now with the old settings, the second one applies the new clock.
                self.restart(now_ns);
                self.enable = value & 1 != 0;
                self.interrupt = value & 2 != 0;
                self.core_clock = value & 4 != 0;
                self.restart(now_ns);
            }
            0x4 => {
                self.restart(now_ns);
                self.reload = value & MASK;
            }
            0x8 => {
                // A write of any value clears the counter; the next tick reloads it.
                self.restart(now_ns);
                self.value = 0;
                self.count_flag = false;
            }
            _ => return None,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Timer at 1 GHz, so that a tick is a nanosecond.
    fn running(reload: u32, at_ns: u64) -> SysTick {
        let mut timer = SysTick::new(0, 1_000_000_000);
        timer.write(4, reload, at_ns).unwrap();
        timer.write(8, 0, at_ns).unwrap();
        timer.write(0, 7, at_ns).unwrap();
        timer
    }

    #[test]
    fn it_counts_from_the_reload_value_to_zero_in_one_more_ticks_than_that() {
        let mut timer = running(9, 100);
        let values: Vec<_> = [100, 101, 109, 110, 111].into_iter().map(|at| timer.read(8, at).unwrap()).collect();
        assert_eq!(values, [0, 9, 1, 0, 9]);
        assert_eq!(timer.next_event_ns(), 110);
        assert!(!timer.advance(109));
        assert!(timer.advance(110));
        assert!(!timer.advance(115));
        assert_eq!(timer.next_event_ns(), 120);
        assert!(timer.advance(1234));
        assert_eq!(timer.next_event_ns(), 1240);
    }

    #[test]
    fn the_count_flag_is_read_once() {
        let mut timer = running(9, 0);
        timer.advance(10);
        assert_eq!(timer.read(0, 10), Some(0x1_0007));
        assert_eq!(timer.read(0, 10), Some(0x7));
    }

    #[test]
    fn a_new_reload_value_counts_from_the_next_round() {
        let mut timer = running(9, 0);
        timer.write(4, 99, 5).unwrap();
        assert_eq!(timer.read(8, 5), Some(5));
        assert_eq!(timer.next_event_ns(), 10);
        assert!(timer.advance(10));
        assert_eq!(timer.next_event_ns(), 110);
    }

    #[test]
    fn without_a_reload_value_it_stops_at_zero() {
        let mut timer = running(9, 0);
        timer.write(4, 0, 5).unwrap();
        assert!(timer.advance(10));
        assert_eq!(timer.next_event_ns(), u64::MAX);
        assert_eq!(timer.read(8, 1000), Some(0));
        let timer = running(0, 0);
        assert_eq!(timer.next_event_ns(), u64::MAX);
    }

    #[test]
    fn the_reference_clock_is_an_eighth_and_stopping_keeps_the_value() {
        let mut timer = SysTick::new(0, 1_000_000_000);
        timer.write(4, 9, 0).unwrap();
        timer.write(0, 3, 0).unwrap();
        assert_eq!(timer.next_event_ns(), 80);
        timer.write(0, 2, 16).unwrap();
        assert_eq!((timer.read(8, 1000), timer.next_event_ns()), (Some(8), u64::MAX));
    }

    #[test]
    fn a_change_of_clock_keeps_the_count() {
        let mut timer = running(99, 0);
        timer.set_core_hz(50, 500_000_000);
        assert_eq!(timer.read(8, 50), Some(50));
        assert_eq!(timer.next_event_ns(), 150);
        timer.set_core_hz(60, 0);
        assert_eq!(timer.next_event_ns(), u64::MAX);
    }
}
