//! Interface between the machine and everything around the processor.

use crate::context::ResetCause;
use crate::memory::Memory;
use crate::peripheral::{Size, Unmodelled};

/// Reason why an access has no result.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AccessError {
    /// The bus answers with an error: the program sees a BusFault.
    #[error("bus error")]
    Bus,
    /// The bus stalls, and the core with it: the access must be repeated at that time.
    #[error("the bus waits until {until_ns} ns")]
    Busy {
        /// Virtual time of the repetition, ns.
        until_ns: u64,
    },
    /// The access is not modelled, which ends the run.
    #[error(transparent)]
    Unmodelled(#[from] Unmodelled),
}

/// Everything around the processor: peripherals, memories, clocks, resets. Times are virtual nanoseconds and never go
/// back.
pub trait Chip {
    /// Returns the memories, the same ones for the chip's life.
    fn memory(&self) -> &Memory;

    /// Loads from an address that the core cannot read directly: peripherals, flash sectors modelled access by access,
    /// memories without clock, unmapped addresses. Never from 0xE000_0000 on.
    ///
    /// # Errors
    /// [`AccessError`] names the reason.
    fn read(&mut self, now_ns: u64, address: u32, size: Size) -> Result<u32, AccessError>;

    /// Stores to an address that the core cannot write directly, including flash.
    ///
    /// # Errors
    /// [`AccessError`] names the reason.
    fn write(&mut self, now_ns: u64, address: u32, size: Size, value: u32) -> Result<(), AccessError>;

    /// Advances all peripherals to `now_ns`.
    fn advance(&mut self, now_ns: u64);

    /// Returns the time by which [`Chip::advance`] must be called, ns; `u64::MAX` for never. It is called after each
    /// access and advance, so it should be fast; these may make the time earlier. A past time counts as now, and so
    /// does a reset that [`Chip::take_reset`] has to return. After `advance(now)` and `take_reset` the next event is
    /// later than `now`.
    fn next_event_ns(&self) -> u64;

    /// Appends the changes of interrupt lines since the last call, in order: position of the line in RM0399's vector
    /// table (0 is the first after the system exceptions), and its level.
    fn take_irqs(&mut self, changes: &mut Vec<(u16, bool)>);

    /// Returns true if [`Chip::take_reset`] would return a reset.
    fn wants_reset(&self) -> bool {
        false
    }

    /// Takes a reset requested by the chip itself, as by a watchdog; the machine then calls [`Chip::reset`].
    fn take_reset(&mut self) -> Option<ResetCause>;

    /// Resets everything but the memories and what survives a reset of this kind. This includes the clocks of memories:
    /// [`Memory::set_enabled`] is called as after a reset.
    fn reset(&mut self, now_ns: u64, cause: ResetCause);

    /// Returns true if a task of the outside world wants to run now: [`Machine::run_until`](crate::Machine::run_until)
    /// returns early. Called after each access and advance.
    fn outside_waits(&self) -> bool {
        false
    }

    /// Returns the time until which loads from an address repeat the same value without side effects if nothing is
    /// stored, ns; at most [`Chip::next_event_ns`]. `None` where that is unknown.
    fn stable_until_ns(&self, _now_ns: u64, _address: u32) -> Option<u64> {
        None
    }

    /// Returns the time until which an instruction fetch from this address stalls, ns; `None` if it does not.
    fn fetch_waits_until_ns(&self, _address: u32) -> Option<u64> {
        None
    }

    /// Returns the level of the non-maskable interrupt's input.
    fn nmi(&self) -> bool {
        false
    }

    /// Returns true if the core cannot execute: it has no clock, or is held in reset. Time passes up to
    /// [`Chip::next_event_ns`].
    fn is_halted(&self) -> bool {
        self.core_hz() == 0
    }

    /// Returns the frequency of the core clock, Hz, for SysTick and the cycle counter; 0 if it is stopped.
    fn core_hz(&self) -> u64;

    /// Returns the address of the vector table after a reset: BOOT_CM7_ADD0 of the option bytes.
    fn vector_table(&self) -> u32 {
        0x0800_0000
    }
}
