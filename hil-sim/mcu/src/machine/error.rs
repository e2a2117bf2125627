//! How a machine runs, and how runs end.

use crate::context::ResetCause;
use crate::cpu::CoreError;
use crate::peripheral::{Size, Unmodelled};

/// How a machine runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Instructions executed in a virtual second: how long a program takes, as far as this emulator can say. It is a
    /// setting, not a measurement: caches, wait states, the bus and dual issue are not modelled, so that counts of
    /// instructions are never cycles. The clock tree does not change it.
    pub instructions_per_second: u64,
    /// BKPT ends a run ([`Reason::Breakpoint`]), as with a debugger; without, it is the program's HardFault.
    pub stop_at_breakpoints: bool,
    /// Loops that look at registers until something happens are not executed again and again. No result depends on it.
    pub leave_out_polling: bool,
}

impl Default for Settings {
    /// One instruction every two cycles of a 480 MHz core; no debugger.
    fn default() -> Self {
        Self { instructions_per_second: 240_000_000, stop_at_breakpoints: false, leave_out_polling: true }
    }
}

/// Why [`Machine::run_until`](crate::Machine::run_until) returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The moment is reached.
    Time,
    /// [`Chip::outside_waits`](crate::Chip::outside_waits).
    Outside,
    /// The instruction at an observed address is next.
    Observed {
        /// Its address.
        address: u32,
    },
    /// One instruction was executed, or an exception taken ([`Machine::step_until`](crate::Machine::step_until)).
    Stepped,
    /// BKPT is next; write PC to go on after it.
    Breakpoint {
        /// Its operand.
        operand: u8,
    },
    /// The chip was reset, and the processor is about to execute its first instruction.
    Reset(ResetCause),
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
    #[error("{} {address:#010x} ({size}) at {at_ns} ns from {location}: {cause}", if *.write { "write of" } else { "read of" })]
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

/// Why a program cannot be loaded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// It is not an ELF file that can be read.
    #[error("not an ELF file: {0}")]
    Format(String),
    /// It is for another processor.
    #[error("the program is not for a 32-bit Arm processor")]
    Processor,
    /// A segment lies where no memory is.
    #[error("the segment of {len} bytes at {address:#010x} is in no memory of the chip")]
    Segment {
        /// Load address.
        address: u32,
        /// Bytes.
        len: usize,
    },
}
