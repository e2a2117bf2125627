//! Emulated R4 board: the firmware's ELF file on an emulated STM32H747, in the same simulated environment as `r4-sim`'s
//! board.

mod board;
pub mod fault;
mod flash;
pub mod gdb;
pub mod log;
pub mod measure;
mod roles;
pub mod tracing;
mod vectors;
mod watch;
mod wiring;

pub use board::{BoardSoc, EmuBoard, EmuError};
pub use flash::Cells;
pub use r4_image::{FileError, Image};
pub use r4_mcu::Settings;
pub use watch::{Go, SharedMachine, Watcher};
pub use wiring::Wiring;
