//! Stepper motion: paths, pulse times, axes, and the enable they share.

pub mod axis;
mod bank;
pub mod generator;
mod numbers;
pub mod scurve;
pub mod steps;

#[cfg(test)]
mod tests;

pub use bank::{Bank, MAX_STEPPERS, NotTaken};
