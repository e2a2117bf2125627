//! Processor around the instruction set of a Cortex-M7, after the ARMv7-M manual (DDI0403E) and the Cortex-M7's
//! (DDI0489).
//!
//! [`Core`] is the instruction set. [`Processor`] is the rest that a program can see: exceptions and their controller,
//! the system control block, SysTick, the cycle counter, the registers of the memory protection unit and of floating
//! point. [`take::Taker`] moves a core into a handler and back.
//!
//! There are two simplifications that a program can notice: floating-point registers are saved immediately at exception
//! entry, where the processor would save them when the handler uses them (FPCCR.LSPACT is never set), and unprivileged
//! code may do everything that privileged code may.

mod bits;
pub mod core;
pub mod debug;
pub mod exceptions;
#[cfg(test)]
mod fake;
pub mod faults;
pub mod mpu;
mod nvic;
mod registers;
pub mod systick;
pub mod take;

pub use core::{Access, Core, CoreBus, CoreError, CoreStop, Fault, Limits, NoResult, Register, Why};
pub use exceptions::{Exceptions, Masks, number};
pub use faults::{Cause, FaultStatus};
pub use mpu::{Protection, Purpose};
pub use registers::{Processor, Requests};
