//! The peripherals, one module each.

pub mod usart;

#[cfg(test)]
mod bench;
