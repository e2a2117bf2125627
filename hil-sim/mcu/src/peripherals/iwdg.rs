//! Independent watchdog IWDG1 (RM0399, 49), clocked by LSI.
//!
//! Started by 0xCCCC, it counts down from 0xFFF; RLR is loaded at the first refresh only. Only a reset of the chip
//! stops it. It requests one when the count ends, or at a refresh outside its window. Changes of PR, RLR and WINR act
//! five LSI cycles after the write, the longest delay that the manual allows; SR shows it until then. A changed
//! prescaler begins a new prescaler period.

use crate::{Context, Peripheral, ResetCause, Signal, Size, Ticks, Unmodelled};

const KR: u32 = 0x00;
const PR: u32 = 0x04;
const RLR: u32 = 0x08;
const SR: u32 = 0x0C;
const WINR: u32 = 0x10;

const REFRESH: u32 = 0xAAAA;
const UNLOCK: u32 = 0x5555;
const START: u32 = 0xCCCC;

const COUNT_AT_START: u32 = 0xFFF;
const UPDATE_CYCLES: u64 = 5;

/// Register whose writes take effect later.
#[derive(Clone, Copy)]
struct Delayed {
    value: u32,
    next: Option<(u64, u32)>,
}

impl Delayed {
    const fn new(value: u32) -> Self {
        Self { value, next: None }
    }

    fn settle(&mut self, now_ns: u64) -> Option<u64> {
        let (at_ns, value) = self.next.filter(|(at_ns, _)| *at_ns <= now_ns)?;
        (self.value, self.next) = (value, None);
        Some(at_ns)
    }
}

/// Down-counter while it runs.
#[derive(Clone, Copy)]
struct Counter {
    from: u32,
    ticks: Ticks,
}

impl Counter {
    fn count(&self, now_ns: u64) -> u32 {
        u64::from(self.from).saturating_sub(self.ticks.at(now_ns)) as u32
    }

    /// Returns the time of the tick after 0, ns.
    fn ends_ns(&self) -> u64 {
        self.ticks.when_ns(u64::from(self.from) + 1)
    }
}

/// State of the watchdog IWDG1.
pub struct Iwdg {
    unlocked: bool,
    prescaler: Delayed,
    reload: Delayed,
    window: Delayed,
    counter: Option<Counter>,
    /// The reset was requested.
    fired: bool,
}

impl Default for Iwdg {
    fn default() -> Self {
        Self::new()
    }
}

impl Iwdg {
    /// Makes the watchdog in its reset state, not running.
    #[must_use]
    pub fn new() -> Self {
        Self {
            unlocked: false,
            prescaler: Delayed::new(0),
            reload: Delayed::new(0xFFF),
            window: Delayed::new(0xFFF),
            counter: None,
            fired: false,
        }
    }

    /// Returns true after the watchdog was started.
    #[must_use]
    pub fn is_running(&self) -> bool {
        self.counter.is_some()
    }

    /// Starts the watchdog: by its key, or by the option bytes (IWDG1_SW) at each reset.
    pub fn start(&mut self, context: &mut Context<'_>) {
        if self.counter.is_none() {
            self.count_from(COUNT_AT_START, context.now_ns, context);
        }
    }

    /// Returns the number of LSI cycles per count.
    fn divider(&self) -> u64 {
        4 << self.prescaler.value.min(6)
    }

    fn count_from(&mut self, from: u32, start_ns: u64, context: &Context<'_>) {
        let ticks = Ticks { start_ns, frequency_hz: context.clocks.lsi_hz, divider: self.divider() };
        self.counter = Some(Counter { from, ticks });
    }

    fn write_key(&mut self, key: u32, context: &mut Context<'_>) {
        self.unlocked = key == UNLOCK;
        match key {
            UNLOCK => {}
            START => self.start(context),
            REFRESH => {
                let Some(counter) = self.counter else { return };
                if counter.count(context.now_ns) > self.window.value {
                    self.fire(context);
                } else {
                    self.count_from(self.reload.value, context.now_ns, context);
                }
            }
            // Any other value only protects the registers again.
            _ => {}
        }
    }

    fn fire(&mut self, context: &mut Context<'_>) {
        self.fired = true;
        context.signals.push(Signal::Reset(ResetCause::Watchdog));
    }

    fn write_delayed(&mut self, offset: u32, value: u32, context: &mut Context<'_>) {
        if !self.unlocked {
            context.misuse("IWDG", "a register is written without its key; the chip ignores it (RM0399, 49.3.4)");
            return;
        }
        let lsi = Ticks { start_ns: context.now_ns, frequency_hz: context.clocks.lsi_hz, divider: 1 };
        let (register, mask) = match offset {
            PR => (&mut self.prescaler, 0x7),
            RLR => (&mut self.reload, 0xFFF),
            _ => (&mut self.window, 0xFFF),
        };
        if register.next.is_some() {
            context
                .misuse("IWDG", "a register is written while SR says that its last value is not taken yet (IWDG_SR)");
            return;
        }
        register.next = Some((lsi.when_ns(UPDATE_CYCLES), value & mask));
        // The write refreshes the counter, inside the window or not: "Write to the window register. This automatically
        // refreshes the counter" (RM0399, 49.3.3).
        if offset == WINR && self.counter.is_some() {
            self.count_from(self.reload.value, context.now_ns, context);
        }
    }
}

impl Peripheral for Iwdg {
    fn read(&mut self, offset: u32, _: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.advance(context);
        let latest = |register: &Delayed| register.next.map_or(register.value, |(_, value)| value);
        let updating = |register: &Delayed| u32::from(register.next.is_some());
        match offset {
            KR => Ok(0),
            PR => Ok(latest(&self.prescaler)),
            RLR => Ok(latest(&self.reload)),
            SR => Ok(updating(&self.prescaler) | updating(&self.reload) << 1 | updating(&self.window) << 2),
            WINR => Ok(latest(&self.window)),
            _ => Err(Unmodelled::register("IWDG", offset)),
        }
    }

    fn write(&mut self, offset: u32, _: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.advance(context);
        match offset {
            KR => self.write_key(value & 0xFFFF, context),
            PR | RLR | WINR => self.write_delayed(offset, value, context),
            SR => {}
            _ => return Err(Unmodelled::register("IWDG", offset)),
        }
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        let Some(counter) = self.counter.filter(|_| !self.fired) else { return u64::MAX };
        // A pending change of the prescaler moves the end.
        self.prescaler.next.map_or(u64::MAX, |(at_ns, _)| at_ns).min(counter.ends_ns())
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.reload.settle(context.now_ns);
        self.window.settle(context.now_ns);
        if let Some(at_ns) = self.prescaler.settle(context.now_ns)
            && let Some(counter) = self.counter
        {
            self.count_from(counter.count(at_ns), at_ns, context);
        }
        if self.counter.is_some_and(|counter| counter.ends_ns() <= context.now_ns) && !self.fired {
            self.fire(context);
        }
    }

    fn clocks_changed(&mut self, context: &mut Context<'_>) {
        let Some(counter) = self.counter else { return };
        if counter.ticks.frequency_hz != context.clocks.lsi_hz {
            self.count_from(counter.count(context.now_ns), context.now_ns, context);
        }
    }

    /// Handles a reset of the chip, the only way to stop the watchdog.
    fn reset(&mut self, _: &mut Context<'_>) {
        *self = Self::new();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Bench;

    const RESET: [Signal; 1] = [Signal::Reset(ResetCause::Watchdog)];
    /// LSI frequency of the bench, Hz.
    const LSI_HZ: u64 = 32_000;

    /// Starts the watchdog as a driver does: /32 and 99, so 100 ms, then started, and refreshed once the values have
    /// taken effect.
    fn running() -> (Iwdg, Bench) {
        let (mut iwdg, mut bench) = (Iwdg::new(), Bench::default());
        for (at, value) in [(KR, UNLOCK), (PR, 3), (RLR, 99), (KR, START)] {
            bench.write(&mut iwdg, at, value);
        }
        bench.run(&mut iwdg, 1_000_000);
        assert_eq!(bench.read(&mut iwdg, SR), 0);
        bench.write(&mut iwdg, KR, REFRESH);
        (iwdg, bench)
    }

    #[test]
    fn it_resets_the_chip_when_it_is_not_refreshed() {
        let (mut iwdg, mut bench) = running();
        let expiry_ns = 1_000_000 + 100 * 32 * 1_000_000_000 / LSI_HZ;
        assert_eq!(iwdg.next_event_ns(), expiry_ns);
        bench.run(&mut iwdg, expiry_ns - 1);
        assert_eq!(bench.take_signals(), []);
        bench.run(&mut iwdg, expiry_ns);
        assert_eq!(bench.take_signals(), RESET);
        bench.run(&mut iwdg, 2 * expiry_ns);
        assert_eq!(bench.take_signals(), [], "once");
        bench.assert_no_misuse();
    }

    #[test]
    fn refreshed_in_time_it_never_does() {
        let (mut iwdg, mut bench) = running();
        for _ in 0..100 {
            bench.run(&mut iwdg, bench.now_ns + 99_000_000);
            bench.write(&mut iwdg, KR, REFRESH);
        }
        assert_eq!(bench.take_signals(), []);
        assert!(iwdg.is_running());
    }

    #[test]
    fn without_a_refresh_the_first_period_is_that_of_the_full_count() {
        let (mut iwdg, mut bench) = (Iwdg::new(), Bench::default());
        for (at, value) in [(KR, UNLOCK), (RLR, 9), (KR, START)] {
            bench.write(&mut iwdg, at, value);
        }
        // The first period is 4096 counts of four cycles: 512 ms.
        assert_eq!(iwdg.next_event_ns(), 512_000_000);
        assert_eq!(bench.read(&mut iwdg, SR), 0b10, "RVU");
        bench.run(&mut iwdg, UPDATE_CYCLES * 1_000_000_000 / LSI_HZ);
        assert_eq!(bench.read(&mut iwdg, SR), 0);
    }

    #[test]
    fn it_cannot_be_stopped_and_its_registers_need_the_key() {
        let (mut iwdg, mut bench) = running();
        bench.write(&mut iwdg, KR, 0);
        bench.write(&mut iwdg, PR, 6);
        bench.write(&mut iwdg, KR, UNLOCK);
        bench.write(&mut iwdg, RLR, 5);
        bench.write(&mut iwdg, RLR, 6);
        assert_eq!(bench.take_misuse().len(), 2, "PR without the key, RLR twice");
        assert_eq!(iwdg.next_event_ns(), 101_000_000, "as before");
        iwdg.reset(&mut bench.context());
        assert!(!iwdg.is_running());
    }

    #[test]
    fn a_refresh_before_the_window_resets_the_chip() {
        let (mut iwdg, mut bench) = running();
        bench.write(&mut iwdg, KR, UNLOCK);
        bench.write(&mut iwdg, WINR, 49);
        bench.run(&mut iwdg, 1_000_000 + 49_999_999);
        bench.write(&mut iwdg, KR, REFRESH);
        assert_eq!(bench.take_signals(), RESET, "the count is 50");
        let (mut iwdg, mut bench) = running();
        bench.write(&mut iwdg, KR, UNLOCK);
        bench.write(&mut iwdg, WINR, 49);
        bench.run(&mut iwdg, 1_000_000 + 50_000_000);
        bench.write(&mut iwdg, KR, REFRESH);
        assert_eq!(bench.take_signals(), []);
    }

    #[test]
    fn a_write_of_the_window_refreshes_the_count() {
        let (mut iwdg, mut bench) = running();
        bench.run(&mut iwdg, 51_000_000);
        bench.write(&mut iwdg, KR, UNLOCK);
        bench.write(&mut iwdg, WINR, 49);
        assert_eq!(iwdg.next_event_ns(), 151_000_000);
        assert_eq!(bench.take_signals(), []);
        bench.assert_no_misuse();
    }

    #[test]
    fn a_slow_oscillator_gives_more_time() {
        let (mut iwdg, mut bench) = running();
        // Range of LSI in DS12930: 31.4 to 32.6 kHz at 30 °C.
        bench.clocks.lsi_hz = 31_400;
        iwdg.clocks_changed(&mut bench.context());
        assert_eq!(iwdg.next_event_ns(), 1_000_000 + (100 * 32 * 1_000_000_000_u64).div_ceil(31_400));
    }
}
