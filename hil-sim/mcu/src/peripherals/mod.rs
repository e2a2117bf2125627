//! The peripherals, one module each.

pub(crate) mod access;
pub mod exti;
pub mod flash;
pub mod gpio;
pub mod pwr;
pub mod rcc;
pub mod syscfg;
