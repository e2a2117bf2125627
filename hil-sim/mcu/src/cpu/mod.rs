//! What a Cortex-M7 has around its instruction set, from the ARMv7-M manual (DDI0403E) and the Cortex-M7's (DDI0489).

pub mod core;

pub use core::{Access, Core, CoreBus, CoreError, CoreStop, Fault, Limits, NoResult, Register, Why};
