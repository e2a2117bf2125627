//! Model of an STM32H747 as a program sees it: peripherals at the level of registers, exceptions, exact virtual time.
//!
//! The instruction set is behind [`cpu::Core`]; the world at the pins is behind [`Outside`]. The models follow RM0399
//! (rev. 4), the datasheet DS12930 and the ARMv7-M architecture manual (DDI0403E), and share no constant with the
//! firmware or its libraries. Violations of the manual are reported ([`Misuse`]); uses that are not modelled end the
//! run ([`Unmodelled`]), with their address and the place in the program.

pub mod chip;
pub mod context;
pub mod cpu;
pub mod machine;
pub mod memory;
pub mod outside;
pub mod peripheral;
pub mod peripherals;
pub mod soc;
#[cfg(test)]
#[allow(dead_code, reason = "which of it a test needs is its own business")]
mod testing;

pub use chip::{AccessError, Chip};
pub use context::{Clocks, Context, Misuse, ResetCause, Signal, Ticks};
pub use machine::{LoadError, Machine, MachineError, Moment, Profile, Reason, Settings, StackArea, Stopped, Symbols};
pub use memory::{Bank, Memory, Region};
pub use outside::{CanFrame, CanOutcome, Edge, I2cResponse, Level, Outside, Pin, UartByte};
pub use peripheral::{Peripheral, Size, Unmodelled};
