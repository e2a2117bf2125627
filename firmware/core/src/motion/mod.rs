//! Steppers: paths, pulse times, axes.

pub mod scurve;
pub mod steps;
