//! Instruction set of the emulated Cortex-M7: [`UnicornCore`] is Unicorn 2.1 (QEMU's translator, as a library) behind
//! [`r4_mcu::cpu::Core`].
//!
//! Unicorn executes instructions and nothing else of a Cortex-M; this crate adds what it does not report:
//!
//! - It reports no instruction counts: `blocks` decodes the lengths of a block's instructions, once.
//! - SEV is a no-operation to it, and it allows floating point regardless of CPACR: blocks with such instructions are
//!   marked when they are decoded.
//! - A load or store outside mapped memory cannot be given a result and a program counter at once. Everything that is
//!   not direct memory is therefore mapped as I/O *without permission*: the permission hook runs with the program
//!   counter known, makes the access, and permits it; the I/O callback only returns the result.
//! - A stop takes effect at the next block, except for loads that fault, which end at the instruction.
//! - WFI, WFE, SVC, YIELD, BKPT and undefined instructions are reported by a small number of errors: the opcode
//!   distinguishes them.

mod blocks;
mod conditional;
mod core;
mod hooks;
mod mapping;
mod registers;
mod state;

pub use core::UnicornCore;
