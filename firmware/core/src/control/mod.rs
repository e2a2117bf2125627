//! The control loop: each period sense, close the loops, write the outputs.

mod axis;
mod inputs;
pub mod motor;
pub mod pid;
pub mod profile;
mod task;
#[cfg(test)]
mod tests;
mod watch;

pub use task::{BoardIo, run};
