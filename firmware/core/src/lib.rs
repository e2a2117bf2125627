//! Application of an R4 board: chip drivers, control loops, sensing, safety supervisor, dispatch of messages.
//!
//! It runs unchanged on the board, in the emulator and in the simulator: all hardware is accessed through the traits of
//! [`platform`], `embedded-hal-async`, `embedded-io-async`, `embedded-storage-async` and `embassy-time`. No heap, no
//! `std`, and nothing here may depend on where it runs.
//!
//! Tasks share one [`Shared`]; a binary runs them at descending priority:
//!
//! | task | does |
//! | --- | --- |
//! | [`supervisor::supervise`] | watches every trip cause, owns the state machine and the hardware stop lines |
//! | [`control::run`] | each period: sense, close the loops, queue step pulses, write the outputs; owns the board's I2C bus |
//! | [`ranging::run`] | pings the range sensors in turn, where there are any |
//! | [`link::serve`] | one per link: frames in, requests dispatched, telemetry and log out |
//! | [`passthrough::Passthrough::run`] | raw access to the external I2C and UART connectors |
//! | [`storage::run`] | owns the flash: saved parameters, the history of trips |
//! | [`screen::run`] | draws the optional screen; blocks, so it is alone on the lowest priority |
//!
//! Before the tasks, [`storage::parameters::load`] creates the configuration to start with.
#![no_std]

mod bus;
mod channel;
pub mod chips;
pub mod control;
mod cycle;
mod dispatch;
pub mod link;
pub mod log;
pub mod motion;
pub mod outputs;
pub mod passthrough;
mod path;
pub mod platform;
pub mod ranging;
mod root;
pub mod safety;
pub mod screen;
pub mod sensing;
mod shared;
pub mod storage;
pub mod supervisor;
mod telemetry;
#[cfg(test)]
mod testing;
mod within;

pub use shared::{MotorStatus, ResetCause, Restart, Shared};

/// Version of this firmware, as reported to hosts.
pub const FIRMWARE_VERSION: &str = env!("CARGO_PKG_VERSION");
