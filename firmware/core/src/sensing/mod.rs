//! Sensor evaluation: from levels, counts, codes and echoes to positions, speeds, volts and distances.

pub mod analog;
pub mod angle;
pub mod echo;
pub mod encoder;
pub mod filter;
pub mod index;
pub mod observer;
pub mod on_bus;
pub mod potentiometer;
pub mod pulse;
pub mod quadrature;
pub mod range;
pub mod storm;
pub mod switch;

/// Smallest number of samples, `period_s` apart, that spans `time_s`; tolerates rounding of the two.
fn periods(time_s: f32, period_s: f32) -> u32 {
    (libm::ceilf(time_s / period_s - 1e-3) as u32).max(1)
}
