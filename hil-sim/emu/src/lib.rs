//! An emulated R4 board: the firmware's ELF on an emulated STM32H747, in the same simulated surroundings as `r4-sim`'s board.

mod roles;
mod wiring;
