//! Actuators.
pub mod dhb;
