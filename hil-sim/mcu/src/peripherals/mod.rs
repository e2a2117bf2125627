//! The peripherals, one module each.

pub(crate) mod access;
pub mod backup;
pub mod crs;
pub mod dbgmcu;
pub mod adc;
pub mod dac;
pub mod dma;
pub mod exti;
pub mod fdcan;
pub mod flash;
pub mod fmc;
pub mod gpio;
pub mod i2c;
pub mod identity;
pub mod iwdg;
pub mod pwr;
pub mod rcc;
pub mod tim;
pub mod rng;
pub mod spi;
pub mod usart;
#[cfg(test)]
mod together;
mod width;

#[cfg(test)]
mod bench;
pub mod syscfg;
pub mod usb;
pub mod wiring;
