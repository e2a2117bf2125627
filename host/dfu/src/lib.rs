//! Update of a board's image over USB: DFU 1.1 with ST's extensions (DfuSe 1.1a), as the Arduino bootloader of the Giga
//! implements it.
//!
//! The crate `dfu-core` has the steps of a download (erase, set the address, blocks, their status). This crate has the
//! steps before and after it (an interrupted try, reading back, leaving). All of it goes through [`Usb`], control
//! transfers and waiting, which is a device of this machine (feature `usb`) or a test's model of a bootloader.
//!
//! | module | subject |
//! | --- | --- |
//! | `flash` | flashing, from a board that runs to one that runs another image |
//! | `update` | from any state of the bootloader to an image that is written, read back and started |
//! | `io` | control transfers as `dfu-core` wants them |
//! | `device` | bootloaders on this machine's USB |
//!
//! Sources: USB Device Class Specification for Device Firmware Upgrade, version 1.1; ST UM0424 and AN3156 (DfuSe).

#[cfg(feature = "usb")]
pub mod device;
mod flash;
mod io;
mod update;

pub use dfu_core::{State, Status};
pub use flash::{Asked, FlashError, Flashed, Machine, Note, Running, flash};
pub use io::{Descriptor, Usb, UsbError};
pub use update::{Progress, Step, UpdateError, Updated, leave, update};
