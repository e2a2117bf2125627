//! What a Cortex-M7 has around its instruction set, from the ARMv7-M manual (DDI0403E) and the Cortex-M7's (DDI0489).
//!
//! [`Core`] is the instruction set. [`Processor`] is the rest that a program can see: exceptions and their controller,
//! the system control block, SysTick, the cycle counter, the registers of the memory protection unit and of floating
//! point. [`take::Taker`] moves a core into a handler and back.
//!
//! Two simplifications a program can notice: registers of floating point are saved on exception entry at once where the
//! processor would do so when the handler uses them (FPCCR.LSPACT is never set), and a processor in unprivileged mode may
//! do what a privileged one may.

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
