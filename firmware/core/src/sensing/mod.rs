//! From counts and codes to position and speed.

pub mod encoder;
pub mod filter;
pub mod potentiometer;
pub mod quadrature;
