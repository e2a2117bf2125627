//! The peripherals, one module each.

pub mod dma;
pub mod tim;
mod width;
