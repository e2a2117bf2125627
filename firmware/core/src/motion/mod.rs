//! Steppers: paths, pulse times, axes, and the enable they share.

pub mod axis;
mod bank;
pub mod generator;
pub mod scurve;
pub mod steps;

#[cfg(test)]
mod tests;

pub use bank::{Bank, MAX_STEPPERS, NotTaken};
pub use r4_protocol::config::{HomingConfig as Homing, StepperConfig};

/// The nearest number to `whole`, as `as` gives it. A Cortex-M7 converts halves by itself, and calls a function of 30 instructions
/// for the whole.
fn to_f64(whole: u64) -> f64 {
    f64::from((whole >> 32) as u32) * 4_294_967_296.0 + f64::from(whole as u32)
}
