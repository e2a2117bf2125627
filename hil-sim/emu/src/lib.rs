//! An emulated R4 board: the firmware's ELF on an emulated STM32H747, in the same simulated surroundings as `r4-sim`'s board.

mod board;
mod flash;
mod image;
pub mod measure;
mod roles;
mod wiring;

pub use board::{BoardSoc, EmuBoard, EmuError};
pub use flash::Cells;
pub use image::{Image, ImageError};
pub use r4_mcu::Settings;
pub use wiring::Wiring;
