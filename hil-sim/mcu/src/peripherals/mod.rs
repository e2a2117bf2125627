//! The peripherals, one module each.

pub mod adc;
pub mod dma;
pub mod tim;
mod width;
