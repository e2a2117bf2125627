//! The control loop: each period it reads sensors, closes the loops and writes the outputs.

mod axis;
mod drive_curve;
mod follower;
mod force;
mod inputs;
mod landing;
mod model;
pub mod motor;
mod motor_side;
pub mod overload;
pub mod pid;
pub mod profile;
pub mod regeneration;
mod task;
#[cfg(test)]
mod tests;
mod watch;

pub use task::{BoardIo, run};
