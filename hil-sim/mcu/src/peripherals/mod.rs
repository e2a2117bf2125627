//! The peripherals, one module each.

pub mod adc;
pub mod dac;
pub mod dma;
pub mod tim;
mod width;
