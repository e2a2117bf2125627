//! The peripherals, one module each.

pub(crate) mod access;
pub mod exti;
pub mod flash;
pub mod gpio;
pub mod pwr;
pub mod rcc;
pub mod dma;
pub mod tim;
mod width;
pub mod i2c;
pub mod usart;

#[cfg(test)]
mod bench;
pub mod syscfg;
