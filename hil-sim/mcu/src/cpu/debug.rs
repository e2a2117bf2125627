//! Debug components that firmware uses: the cycle counter of DWT, and the switches of ITM (DDI0403E C1).

use crate::context::Ticks;

/// Key of a lock access register (C1.2, CoreSight).
const KEY: u32 = 0xC5AC_CE55;

/// Bit DEMCR.TRCENA: trace components enabled.
const TRACE_ENABLE: u32 = 1 << 24;

/// Bit DWT_CTRL.CYCCNTENA: cycle counter enabled.
const CYCLE_COUNT_ENABLE: u32 = 1;

/// Read-only part of DWT_CTRL: four comparators, which are not modelled.
const DWT_CTRL_FIXED: u32 = 4 << 28;

/// Registers DEMCR, and those of DWT and ITM.
#[derive(Clone, Debug)]
pub struct Debug {
    demcr: u32,
    dwt_control: u32,
    dwt_locked: bool,
    itm_locked: bool,
    itm_enable: u32,
    itm_control: u32,
    /// Value of the cycle counter at tick 0 of `clock`.
    cycles: u32,
    clock: Ticks,
}

impl Debug {
    /// Makes the components in their power-on state: locked, as those of a Cortex-M7 are.
    #[must_use]
    pub fn new(now_ns: u64, core_hz: u64) -> Self {
        Self {
            demcr: 0,
            dwt_control: 0,
            dwt_locked: true,
            itm_locked: true,
            itm_enable: 0,
            itm_control: 0,
            cycles: 0,
            clock: Ticks { start_ns: now_ns, frequency_hz: core_hz, divider: 1 },
        }
    }

    fn counting(&self) -> bool {
        self.demcr & TRACE_ENABLE != 0 && self.dwt_control & CYCLE_COUNT_ENABLE != 0
    }

    /// Returns the cycle counter: cycles of the core clock while it counts, from virtual time, not from instructions.
    fn cycles(&self, now_ns: u64) -> u32 {
        if self.counting() { self.cycles.wrapping_add(self.clock.at(now_ns) as u32) } else { self.cycles }
    }

    fn restart(&mut self, now_ns: u64, cycles: u32) {
        self.cycles = cycles;
        self.clock.start_ns = now_ns;
    }

    /// Sets the frequency of the core clock, Hz.
    pub fn set_core_hz(&mut self, now_ns: u64, core_hz: u64) {
        self.restart(now_ns, self.cycles(now_ns));
        self.clock.frequency_hz = core_hz;
    }

    /// Returns the value of DEMCR.
    #[must_use]
    pub fn demcr(&self) -> u32 {
        self.demcr
    }

    /// Writes DEMCR; `None` for functions that need a debugger: vector catch, the monitor.
    pub fn set_demcr(&mut self, value: u32, now_ns: u64) -> Option<()> {
        if value & !TRACE_ENABLE != 0 {
            return None;
        }
        self.restart(now_ns, self.cycles(now_ns));
        self.demcr = value;
        Some(())
    }

    /// Reads a register, offset from 0xE000_0000; `None` where none is modelled.
    #[must_use]
    pub fn read(&self, offset: u32, now_ns: u64) -> Option<u32> {
        // Lock status: the lock is implemented; the second bit is its state.
        let lock = |locked: bool| 1 | u32::from(locked) << 1;
        Some(match offset {
            // ITM stimulus ports: a disabled port accepts nothing, which reads as "full"; an enabled one is ready.
            0x000..0x080 if offset & 3 == 0 => {
                u32::from(self.itm_control & 1 != 0 && self.itm_enable >> (offset / 4) & 1 != 0)
            }
            0xE00 => self.itm_enable,
            0xE80 => self.itm_control,
            0xFB4 => lock(self.itm_locked),
            0x1000 => DWT_CTRL_FIXED | self.dwt_control,
            0x1004 => self.cycles(now_ns),
            0x1FB4 => lock(self.dwt_locked),
            _ => return None,
        })
    }

    /// Writes a register; `None` if it is not modelled, or not with this value. A locked component ignores writes.
    pub fn write(&mut self, offset: u32, value: u32, now_ns: u64) -> Option<()> {
        match offset {
            0xFB0 => self.itm_locked = value != KEY,
            0x1FB0 => self.dwt_locked = value != KEY,
            0x000..0x080 => {}
            0xE00 if self.itm_locked => {}
            0xE00 => self.itm_enable = value,
            0xE80 if self.itm_locked => {}
            0xE80 => self.itm_control = value,
            0x1000 | 0x1004 if self.dwt_locked => {}
            0x1000 if value & !(CYCLE_COUNT_ENABLE | DWT_CTRL_FIXED) == 0 => {
                self.restart(now_ns, self.cycles(now_ns));
                self.dwt_control = value & CYCLE_COUNT_ENABLE;
            }
            0x1004 => self.restart(now_ns, value),
            _ => return None,
        }
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cycles_count_from_time_when_both_switches_are_on_and_the_lock_is_open() {
        let mut debug = Debug::new(0, 480_000_000);
        debug.set_demcr(TRACE_ENABLE, 0).unwrap();
        debug.write(0x1000, 1, 0).unwrap();
        assert_eq!(debug.read(0x1000, 0), Some(0x4000_0000), "locked");
        debug.write(0x1FB0, KEY, 0).unwrap();
        debug.write(0x1000, 1, 1000).unwrap();
        assert_eq!(debug.read(0x1004, 2000), Some(480));
        debug.set_core_hz(2000, 240_000_000);
        assert_eq!(debug.read(0x1004, 3000), Some(720));
        debug.write(0x1004, u32::MAX, 3000).unwrap();
        assert_eq!(debug.read(0x1004, 4000), Some(239));
        debug.set_demcr(0, 4000).unwrap();
        assert_eq!(debug.read(0x1004, 9000), Some(239));
    }

    #[test]
    fn what_needs_a_debugger_is_not_taken() {
        let mut debug = Debug::new(0, 1);
        assert_eq!(debug.set_demcr(1, 0), None);
        debug.write(0x1FB0, KEY, 0).unwrap();
        assert_eq!(debug.write(0x1000, 1 << 16, 0), None);
        assert_eq!((debug.write(0x1020, 0, 0), debug.read(0x1020, 0)), (None, None));
    }
}
