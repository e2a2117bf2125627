//! Settings of a machine, reasons for stops, and errors.

use crate::context::ResetCause;
use crate::cpu::CoreError;
use crate::peripheral::{Size, Unmodelled};

/// Settings of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Instructions executed per virtual second, which sets how long a program takes in the emulator. It is a setting,
    /// not a measurement: caches, wait states, the bus and dual issue are not modelled, so that numbers of instructions
    /// are never cycles. The clock tree does not change it.
    pub instructions_per_second: u64,
    /// BKPT ends a run ([`Reason::Breakpoint`]), as with a debugger; otherwise it is the program's HardFault.
    pub stop_at_breakpoints: bool,
    /// Loops that poll registers are skipped until an event. No result depends on it.
    pub leave_out_polling: bool,
}

impl Default for Settings {
    /// Default: one instruction every two cycles of a 480 MHz core, without a debugger.
    fn default() -> Self {
        Self { instructions_per_second: 240_000_000, stop_at_breakpoints: false, leave_out_polling: true }
    }
}

/// Reason why [`Machine::run_until`](crate::Machine::run_until) returned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The requested time is reached.
    Time,
    /// A task outside waits: [`Chip::outside_waits`](crate::Chip::outside_waits).
    Outside,
    /// The next instruction is at an observed address.
    Observed {
        /// Address of the instruction.
        address: u32,
    },
    /// One instruction was executed, or one exception taken ([`Machine::step_until`](crate::Machine::step_until)).
    Stepped,
    /// The next instruction is BKPT; write PC to go on after it.
    Breakpoint {
        /// Operand of the instruction.
        operand: u8,
    },
    /// The chip was reset, and the processor is about to execute its first instruction.
    Reset(ResetCause),
}

/// Time and reason of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stopped {
    /// Virtual time of the stop, ns.
    pub at_ns: u64,
    /// Reason of the stop.
    pub reason: Reason,
}

/// Error after which a run cannot go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MachineError {
    /// The program uses something that is not modelled.
    #[error("{} {address:#010x} ({size}) at {at_ns} ns from {location}: {cause}", if *.write { "write of" } else { "read of" })]
    Unmodelled {
        /// Address of the access.
        address: u32,
        /// Width of the access.
        size: Size,
        /// True for a store.
        write: bool,
        /// Virtual time of the access, ns.
        at_ns: u64,
        /// PC, with the function's name if symbols are loaded.
        location: String,
        /// Register or use that is not modelled.
        cause: Unmodelled,
    },
    /// The processor is locked up (DDI0403E B1.5.15): it leaves that state only by a reset or an NMI.
    #[error("lock-up at {at_ns} ns from {location}: {what}")]
    LockUp {
        /// Virtual time of the lock-up, ns.
        at_ns: u64,
        /// PC with its function.
        location: String,
        /// Fault that could not be taken.
        what: String,
    },
    /// The program uses a function of the processor that is not modelled.
    #[error("at {at_ns} ns, {location}: {what}")]
    Processor {
        /// Virtual time of the use, ns.
        at_ns: u64,
        /// PC with its function.
        location: String,
        /// Description of the use.
        what: String,
    },
    /// The core has failed.
    #[error(transparent)]
    Core(#[from] CoreError),
}

/// Reason why a program cannot be loaded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LoadError {
    /// The file is not a readable ELF file.
    #[error("not an ELF file: {0}")]
    Format(String),
    /// The program is for another processor.
    #[error("the program is not for a 32-bit Arm processor")]
    Processor,
    /// A segment lies outside the chip's memories.
    #[error("the segment of {len} bytes at {address:#010x} is in no memory of the chip")]
    Segment {
        /// Load address of the segment.
        address: u32,
        /// Length of the segment, bytes.
        len: usize,
    },
}
