//! Actuators.
pub mod dhb;
pub mod rc_servo;
