//! Models of the peripherals, one module each.

pub(crate) mod access;
pub mod adc;
pub mod backup;
pub mod crc;
pub mod crs;
pub mod dac;
pub mod dbgmcu;
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
pub mod rng;
pub mod spi;
pub mod tim;
#[cfg(test)]
mod together;
pub mod usart;

#[cfg(test)]
mod bench;
pub mod syscfg;
pub mod usb;
pub mod wiring;
