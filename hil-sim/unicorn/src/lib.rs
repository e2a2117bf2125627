//! The instruction set of the emulated Cortex-M7: [`UnicornCore`] is Unicorn 2.1 (QEMU's translator, as a library) behind
//! [`r4_mcu::cpu::Core`].
//!
//! Unicorn executes instructions and nothing else of a Cortex-M; what it cannot say, this crate finds out:
//!
//! - It reports no instruction counts: `blocks` decodes the lengths of a block's instructions, once.
//! - SEV is a no-operation to it, and it allows floating point whatever CPACR says: blocks that hold such instructions
//!   are marked when they are decoded.
//! - A load or store outside mapped memory cannot be given a result and a program counter at once. Everything that is not
//!   direct memory is therefore mapped as I/O *without permission*: the permission hook runs with the program counter
//!   known, makes the access, and lets it pass; the I/O callback only hands over the result.
//! - A stop takes effect at the next block. Loads that fault are the exception, they end at the instruction.
//! - WFI, WFE, SVC, YIELD, BKPT and undefined instructions come back as a handful of errors: the opcode tells.

mod blocks;
mod conditional;
mod core;
mod hooks;
mod mapping;
mod registers;
mod state;

pub use core::UnicornCore;
