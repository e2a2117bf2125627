//! The peripherals, one module each.

pub mod fdcan;
pub mod i2c;
pub mod rng;
pub mod spi;
pub mod usart;

#[cfg(test)]
mod bench;
