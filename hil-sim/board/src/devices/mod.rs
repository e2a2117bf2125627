//! Actuators.
pub mod bldc_drive;
pub mod dhb;
pub mod rc_servo;
pub mod stepper_driver;
