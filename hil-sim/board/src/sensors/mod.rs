//! Sensors, switches and loopback devices that are wired to the processor's own pins.
//!
//! All are lazy: nothing is scheduled, the caller passes the time. An earlier time than one already seen counts as that
//! one. Randomness is seeded and sampled at events, not at queries, so the frequency of queries does not change the
//! result.
//!
//! | module | modelled | not modelled |
//! | --- | --- | --- |
//! | [`hc_sr04`] | echo width from distance and air temperature, range, time-out, refused and too frequent triggers, dead, stuck-high, noise, sound of other modules | angle and size of the target, own late echoes of the ping before, supply, loudness |
//! | [`quadrature`] | edges in order with their time, glitches, chatter, lost edges; timer in encoder mode 3 with input filter | phase error of the disc, limits of an interrupt-driven decoder (they are the firmware's) |
//! | [`interference`] | a square wave coupled into a track or an echo | coupling into analog lines, levels between low and high |
//! | [`switch`] | contact bounce, normally open or closed, pull resistor, cut and shorted wire | wetting current, wear, RC filters |
//! | [`analog_input`] | divider tolerance, bend below the clamp, reference error, offset, noise, oversampling, open and short | settling of the sampling capacitor, non-linearity of the converter, cross-talk of channels |
//! | [`loopback`] | UART bytes at their time, bounded receive FIFO, unplugged cable, noise; 24C02 EEPROM with page writes and write time | parity errors, baud mismatch; write-protect pin, wear, loss of power during a write |
//! | `tfmini_s` | frames of a lidar with one beam at a UART: distance in centimetres with noise, nothing within reach, checksum | commands, width of the beam, reflectivity, sunlight |
//! | `gnss` | NMEA sentences at a UART: place on the ellipsoid, an error that changes slowly, speed and course | commands, time to the first position, satellites, multipath, loss of reception |
//! | [`dac_output`] | code to volts with gain and offset error, swing of the output buffer | settling, load, non-linearity |

pub mod analog_input;
pub mod as5600_pwm;
pub mod dac_output;
pub(crate) mod gnss;
pub mod hc_sr04;
pub mod interference;
pub mod loopback;
pub mod quadrature;
pub mod switch;
pub(crate) mod tfmini_s;

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::{Pcg64, rand_core::Rng};

/// Uniform random number from 0 up to, not including, 1.
pub(crate) fn uniform(generator: &mut Pcg64) -> f64 {
    // the 53 bits that a double can hold
    (generator.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
}

/// Standard normal random number, with mean 0 and standard deviation 1.
pub(crate) fn normal(generator: &mut Pcg64) -> f64 {
    StandardNormal.sample(generator)
}
