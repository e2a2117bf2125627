//! What the machine needs of everything around the processor.

use crate::context::ResetCause;
use crate::memory::Memory;
use crate::peripheral::{Size, Unmodelled};

/// Why an access has no result.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AccessError {
    /// The bus answers with an error: the program sees a BusFault.
    #[error("bus error")]
    Bus,
    /// The bus waits, and the core with it: the access is to be made again then.
    #[error("the bus waits until {until_ns} ns")]
    Busy {
        /// Virtual time.
        until_ns: u64,
    },
    /// The run ends.
    #[error(transparent)]
    Unmodelled(#[from] Unmodelled),
}

/// Everything around the processor: peripherals, memories, clocks, resets. Times are virtual nanoseconds and never go back.
pub trait Chip {
    /// The memories. The same ones for the chip's life.
    fn memory(&self) -> &Memory;

    /// A load from where the core cannot read directly: peripherals, flash sectors modelled access by access, memories
    /// without clock, nothing at all. Never from 0xE000_0000 on.
    ///
    /// # Errors
    /// [`AccessError`].
    fn read(&mut self, now_ns: u64, address: u32, size: Size) -> Result<u32, AccessError>;

    /// A store to where the core cannot write directly; flash, too.
    ///
    /// # Errors
    /// [`AccessError`].
    fn write(&mut self, now_ns: u64, address: u32, size: Size, value: u32) -> Result<(), AccessError>;

    /// Brings everything to a moment.
    fn advance(&mut self, now_ns: u64);

    /// When [`Chip::advance`] must be called at the latest; `u64::MAX` is never. Asked after each access and advance, so that
    /// it should cost little; it may become earlier by them. A moment that is past counts as now: so does a reset that
    /// [`Chip::take_reset`] has to tell. After `advance(now)` and `take_reset` the next event is later than `now`.
    fn next_event_ns(&self) -> u64;

    /// Appends the changes of interrupt lines since the last call, in order: position of the line in RM0399's vector
    /// table (0 is the first after the system exceptions), and its level.
    fn take_irqs(&mut self, changes: &mut Vec<(u16, bool)>);

    /// [`Chip::take_reset`] would give one.
    fn wants_reset(&self) -> bool {
        false
    }

    /// A reset that the chip itself wants (a watchdog); the machine then calls [`Chip::reset`].
    fn take_reset(&mut self) -> Option<ResetCause>;

    /// Resets everything but the memories and what survives a reset of this kind. Clocks of memories count too:
    /// [`Memory::set_enabled`] is called as after a reset.
    fn reset(&mut self, now_ns: u64, cause: ResetCause);

    /// Whoever drives the world outside wants to run now: [`Machine::run_until`](crate::Machine::run_until) returns
    /// early. Asked after each access and advance.
    fn outside_waits(&self) -> bool {
        false
    }

    /// Until when loads from an address give the same again and change nothing, if nothing is stored; at most
    /// [`Chip::next_event_ns`]. `None` where that is not known.
    fn stable_until_ns(&self, _now_ns: u64, _address: u32) -> Option<u64> {
        None
    }

    /// Until when a fetch of an instruction from here waits.
    fn fetch_waits_until_ns(&self, _address: u32) -> Option<u64> {
        None
    }

    /// Level of the non-maskable interrupt's input.
    fn nmi(&self) -> bool {
        false
    }

    /// The core cannot execute: it has no clock, or is held in reset. Time passes up to [`Chip::next_event_ns`].
    fn is_halted(&self) -> bool {
        self.core_hz() == 0
    }

    /// Frequency of the core clock, for SysTick and the cycle counter; 0 is stopped.
    fn core_hz(&self) -> u64;

    /// The word at which the vector table lies after a reset: BOOT_CM7_ADD0 of the option bytes.
    fn vector_table(&self) -> u32 {
        0x0800_0000
    }
}
