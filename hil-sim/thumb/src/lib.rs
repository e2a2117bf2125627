//! The instruction set of the emulated Cortex-M7: [`ThumbCore`] is an interpreter behind [`r4_mcu::cpu::Core`], after
//! DDI0403E (ARMv7E-M with FPv5-D16).
//!
//! - `decode` makes of each instruction one or a few simpler operations (`operation`): whatever is known of an instruction
//!   before it is executed — expanded constants, addresses that depend on PC, literals in flash — is computed there, once.
//! - `blocks` keeps what was decoded, by address, as stretches: a block, and those that follow it where conditional
//!   branches are not taken and others are. Interrupts and limits see blocks only. A block ends at a branch, at an
//!   instruction that changes what interrupts may be taken, and where a line of 128 bytes ends: a function of addresses
//!   alone, so that it does not matter where it is entered.
//! - `execute` carries the operations of a block out. Memory is accessed directly where it may be (`memory`), and by the bus
//!   elsewhere; a limit is looked at between blocks.
//! - `float` is coprocessors 10 and 11.

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
