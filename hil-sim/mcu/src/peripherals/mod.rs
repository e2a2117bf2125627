//! The peripherals, one module each.

pub mod dma;
mod width;
