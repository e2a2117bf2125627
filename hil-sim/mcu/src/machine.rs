//! The machine: a core, the chip around it, and virtual time.

use crate::cpu::CoreError;
use crate::memory::Memory;
use crate::peripheral::{Size, Unmodelled};

/// How a machine runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Instructions executed in a virtual second: how long a program takes, as far as this emulator can say. It is a
    /// setting, not a measurement: caches, wait states, the bus and dual issue are not modelled, so that counts of
    /// instructions are never cycles. The clock tree does not change it.
    pub instructions_per_second: u64,
}

impl Default for Settings {
    /// One instruction every two cycles of a 480 MHz core.
    fn default() -> Self {
        Self { instructions_per_second: 240_000_000 }
    }
}

/// Why [`Machine::run_until`](crate::Machine::run_until) returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The moment is reached: at, or up to one block of instructions after it.
    Time,
    /// [`Chip::outside_waits`](crate::Chip::outside_waits).
    Outside,
    /// The instruction at an observed address is next.
    Observed {
        /// Its address.
        address: u32,
    },
    /// The chip was reset, and the processor is about to execute its first instruction.
    Reset(crate::ResetCause),
}

/// Where a run stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped {
    /// Virtual time.
    pub at_ns: u64,
    /// Why.
    pub reason: Reason,
}

/// Why a run cannot go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MachineError {
    /// The program uses what is not modelled.
    #[error("{} {address:#010x} ({size:?}) at {at_ns} ns from {location}: {cause}", if *.write { "write of" } else { "read of" })]
    Unmodelled {
        /// The address accessed.
        address: u32,
        /// Width.
        size: Size,
        /// A store.
        write: bool,
        /// Virtual time.
        at_ns: u64,
        /// PC, with the function's name where symbols are known.
        location: String,
        /// What.
        cause: Unmodelled,
    },
    /// The processor is locked up (DDI0403E B1.5.15): nothing but a reset or an NMI goes on from there.
    #[error("lock-up at {at_ns} ns from {location}: {what}")]
    LockUp {
        /// Virtual time.
        at_ns: u64,
        /// Where.
        location: String,
        /// The fault that could not be taken.
        what: String,
    },
    /// A use of the processor itself that is not modelled.
    #[error("at {at_ns} ns, {location}: {what}")]
    Processor {
        /// Virtual time.
        at_ns: u64,
        /// Where.
        location: String,
        /// What.
        what: String,
    },
    /// The backend.
    #[error(transparent)]
    Core(#[from] CoreError),
}

// The contract of this module for those who build on it:
//   Machine::new(core, chip, Settings) -> Result<Machine<C, S>, MachineError>
//   Machine::load_elf(&mut self, elf: &[u8]) -> Result<(), LoadError>   segments into memories, symbols kept
//   Machine::reset(&mut self, ResetCause); Machine::run_until(&mut self, t_ns) -> Result<Stopped, MachineError>
//   Machine::{now_ns, instructions, observe(&[u32]), symbol(name), start_trace, trace_hash, locate(pc)}, pub core, pub chip
const _: fn(&Memory) = |_| {};
