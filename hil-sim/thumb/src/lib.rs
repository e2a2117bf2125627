//! Instruction set of the emulated Cortex-M7: [`ThumbCore`] is an interpreter behind [`r4_mcu::cpu::Core`], after
//! DDI0403E (ARMv7E-M with FPv5-D16).
//!
//! - `decode` translates each instruction to one or a few simpler operations (`operation`). It computes once what is
//!   known before execution: expanded constants, addresses that depend on PC, literals in flash.
//! - `blocks` caches decoded code by address, as stretches (superblocks): a block, and those that follow it if
//!   conditional branches are not taken and others are. Interrupts and limits see single blocks only. A block ends at a
//!   branch, at an instruction that changes which interrupts may be taken, and at the end of a line of 128 bytes: a
//!   function of addresses alone, so that its point of entry does not matter.
//! - `execute` executes the operations of a block. It accesses memory directly where that is allowed (`memory`), and by
//!   the bus elsewhere; limits are checked between blocks.
//! - `float` executes the floating-point unit, coprocessors 10 and 11.

mod blocks;
mod core;
mod decode;
mod execute;
mod float;
mod memory;
mod operation;
mod state;
#[cfg(test)]
mod tests;

pub use core::ThumbCore;
