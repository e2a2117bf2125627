//! From levels, counts, codes and echoes to positions, speeds, volts and distances.

pub mod analog;
pub mod encoder;
pub mod filter;
pub mod potentiometer;
pub mod quadrature;
pub mod range;
pub mod switch;
