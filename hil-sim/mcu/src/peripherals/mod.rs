//! The peripherals, one module each.

pub mod adc;
pub mod dac;
pub mod dma;
pub mod tim;
#[cfg(test)]
mod together;
mod width;
