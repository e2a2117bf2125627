//! Tests of the board's image on the emulated processor. The images are built by `cargo xtask firmware`.

mod boot;
mod boot_safety;
mod can;
mod crystal;
mod cycles;
mod debugging;
mod determinism;
mod emulated;
mod faults;
mod feedback;
mod flash;
mod gdb;
mod hung;
mod image;
mod log;
mod stops;
mod storms;
mod windings;
