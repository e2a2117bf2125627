//! Benewake TFmini-S: time-of-flight lidar with one beam, at a UART.
//!
//! # Source
//! Benewake *TFmini-S Product Manual*, SJ-PM-TFmini-S A01: 8N1 at 115 200 baud (5.2), frames of nine bytes with the distance in cm (5.3,
//! table 7), -1 for a signal strength below 100, the temperature (5.4, table 8). 100 frames a second, 0.1 to 12 m and an accuracy of 6 cm up
//! to 6 m and 1 % beyond are from memory, not checked.

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use super::normal;

/// Time between two frames, ns.
pub(crate) const PERIOD_NS: u64 = 10_000_000;
/// Farthest distance at which it detects an obstacle, m.
pub(crate) const FARTHEST_M: f64 = 12.0;
const NEAREST_M: f64 = 0.1;
/// First two bytes of a frame.
const HEADER: [u8; 2] = [0x59, 0x59];
/// Distance value of a frame without a target.
const NOTHING: u16 = 0xFFFF;
/// Standard deviation: a third of the accuracy, our choice. In m up to 6 m, and as a share of the distance beyond.
const DEVIATION_M: f64 = 0.02;
const DEVIATION_SHARE: f64 = 0.01 / 3.0;
/// Signal strength with and without an echo: the manual calls less than 100 unreliable; the numbers are our choice.
const STRONG: u16 = 1000;
const WEAK: u16 = 50;
/// Temperature value, eighths of a degree above -256 °C: 40 °C, our choice.
const TEMPERATURE: u16 = (40 + 256) * 8;

/// A sensor with its noise generator.
#[derive(Clone, Debug)]
pub(crate) struct TfminiS {
    noise: Pcg64,
}

impl TfminiS {
    pub(crate) fn new(seed: u64) -> Self {
        Self { noise: Pcg64::seed_from_u64(seed) }
    }

    /// Next frame, for a target at a distance, or none within range.
    pub(crate) fn frame(&mut self, distance_m: Option<f64>) -> [u8; 9] {
        let noise = normal(&mut self.noise);
        let seen = distance_m.filter(|distance_m| (NEAREST_M..=FARTHEST_M).contains(distance_m));
        let (centimetres, strength) = match seen {
            Some(distance_m) => {
                let measured_m = distance_m + noise * DEVIATION_M.max(DEVIATION_SHARE * distance_m);
                ((measured_m.clamp(NEAREST_M, FARTHEST_M) * 100.0).round() as u16, STRONG)
            }
            None => (NOTHING, WEAK),
        };
        let mut frame = [0; 9];
        frame[..2].copy_from_slice(&HEADER);
        for (place, number) in [(2, centimetres), (4, strength), (6, TEMPERATURE)] {
            frame[place..place + 2].copy_from_slice(&number.to_le_bytes());
        }
        frame[8] = frame[..8].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
        frame
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_has_header_distance_and_checksum() {
        let frame = TfminiS::new(1).frame(None);
        // 0x59 + 0x59 + 0xFF + 0xFF + 50 + 0x40 + 0x09 = 0x32B
        assert_eq!(frame, [0x59, 0x59, 0xFF, 0xFF, 50, 0, 0x40, 0x09, 0x2B]);
        assert_eq!(TfminiS::new(1).frame(Some(0.05))[2..4], [0xFF, 0xFF], "too near");
        assert_eq!(TfminiS::new(1).frame(Some(12.5))[2..4], [0xFF, 0xFF], "too far");
    }

    /// The mean of 4000 frames is within 4 standard errors, the deviation within 5 %.
    #[test]
    fn distances_scatter_around_the_truth() {
        for (distance_m, deviation_m) in [(2.0, 0.02), (9.0, 0.03)] {
            let mut sensor = TfminiS::new(3);
            let mut measured = || {
                let frame = sensor.frame(Some(distance_m));
                f64::from(u16::from_le_bytes([frame[2], frame[3]])) / 100.0 - distance_m
            };
            let errors: Vec<f64> = (0..4000).map(|_| measured()).collect();
            let mean = errors.iter().sum::<f64>() / 4000.0;
            let variance = errors.iter().map(|error| (error - mean) * (error - mean)).sum::<f64>() / 4000.0;
            assert!(mean.abs() < 4.0 * deviation_m / 4000f64.sqrt(), "{mean}");
            // steps of 1 cm add 2.9 mm
            assert!((variance.sqrt() / deviation_m.hypot(0.0029) - 1.0).abs() < 0.05, "{}", variance.sqrt());
        }
    }
}
