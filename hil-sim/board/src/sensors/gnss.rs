//! GNSS receiver that sends NMEA 0183 at a UART: one GGA and one RMC sentence per position.
//!
//! The error is a first-order Gauss-Markov process, independent for east and north. A position is available from the
//! start, and time starts at noon of 1 January 2026.
//!
//! # Source
//! NMEA 0183, 4.11: sentences GGA and RMC, the checksum. WGS 84: NIMA TR8350.2, 3rd edition, semi-major axis and flattening.

use std::fmt::Write as _;

use r4_boards::SimulatedGnss;
use rand_pcg::{Pcg64, rand_core::SeedableRng};

use super::normal;

/// WGS 84 ellipsoid: semi-major axis, m, and first eccentricity squared.
const SEMI_MAJOR_M: f64 = 6_378_137.0;
const ECCENTRICITY_SQUARED: f64 = 6.694_379_990_14e-3;
/// Conversion from m/s to knots.
const KNOTS: f64 = 3600.0 / 1852.0;
/// Speed below which the course is omitted, m/s: four standard deviations of the speed's noise.
const MOVES_M_S: f64 = 0.2;
/// Noise of the speed, m/s: our choice, as makers of receivers specify it.
const SPEED_DEVIATION_M_S: f64 = 0.05;
/// Time of day at the start, s.
const NOON_S: u64 = 12 * 3600;
const DAY_S: u64 = 24 * 3600;

/// A receiver with the state of its error.
#[derive(Clone, Debug)]
pub(crate) struct Gnss {
    pub(crate) spec: SimulatedGnss,
    noise: Pcg64,
    /// Present error, east and north, m.
    error_m: [f64; 2],
}

impl Gnss {
    pub(crate) fn new(spec: SimulatedGnss, seed: u64) -> Self {
        let mut noise = Pcg64::seed_from_u64(seed);
        let error_m = [0; 2].map(|_| spec.deviation_m * normal(&mut noise));
        Self { spec, noise, error_m }
    }

    /// Time between two positions, ns.
    pub(crate) fn period_ns(&self) -> u64 {
        1_000_000_000 / u64::from(self.spec.rate_hz)
    }

    /// Sentences for a time, at a place east and north of the origin, m, with a velocity in the same directions, m/s.
    pub(crate) fn sentences(&mut self, at_ns: u64, place_m: [f64; 2], speed_m_s: [f64; 2]) -> String {
        let kept = libm::exp(-(self.period_ns() as f64) * 1e-9 / self.spec.correlation_s);
        let fresh = (1.0 - kept * kept).sqrt() * self.spec.deviation_m;
        for error_m in &mut self.error_m {
            *error_m = kept * *error_m + fresh * normal(&mut self.noise);
        }
        let speed_m_s = speed_m_s.map(|speed| speed + SPEED_DEVIATION_M_S * normal(&mut self.noise));
        let (latitude_deg, longitude_deg) = self.on_earth([0, 1].map(|axis| place_m[axis] + self.error_m[axis]));
        let place = format!("{},{}", degrees(latitude_deg, 2, ["N", "S"]), degrees(longitude_deg, 3, ["E", "W"]));
        let hundredths = at_ns / 10_000_000;
        let since_midnight_s = NOON_S + hundredths / 100;
        let (hours, minutes, seconds) =
            (since_midnight_s / 3600 % 24, since_midnight_s / 60 % 60, since_midnight_s % 60);
        let time = format!("{hours:02}{minutes:02}{seconds:02}.{:02}", hundredths % 100);
        // no simulation lasts a month
        let day = 1 + since_midnight_s / DAY_S;
        let [east_m_s, north_m_s] = speed_m_s;
        let speed = libm::hypot(east_m_s, north_m_s);
        let course = if speed < MOVES_M_S {
            String::new()
        } else {
            format!("{:.1}", libm::atan2(east_m_s, north_m_s).to_degrees().rem_euclid(360.0))
        };
        let height_m = self.spec.origin.height_m;
        let mut text = sentence(&format!("GPGGA,{time},{place},1,12,0.8,{height_m:.1},M,0.0,M,,"));
        text += &sentence(&format!("GPRMC,{time},A,{place},{:.2},{course},{day:02}0126,,,A", speed * KNOTS));
        text
    }

    /// Latitude and longitude, degrees, of a place near the origin, by the radii of curvature there.
    fn on_earth(&self, [east_m, north_m]: [f64; 2]) -> (f64, f64) {
        let origin = &self.spec.origin;
        let (sin, cos) = libm::sincos(origin.latitude_deg.to_radians());
        let root = (1.0 - ECCENTRICITY_SQUARED * sin * sin).sqrt();
        let across_m = SEMI_MAJOR_M / root;
        let along_m = SEMI_MAJOR_M * (1.0 - ECCENTRICITY_SQUARED) / (root * root * root);
        let latitude_deg = origin.latitude_deg + (north_m / along_m).to_degrees();
        let longitude_deg = origin.longitude_deg + (east_m / (across_m * cos)).to_degrees();
        (latitude_deg, (longitude_deg + 180.0).rem_euclid(360.0) - 180.0)
    }
}

/// Degrees and minutes in NMEA format, with `digits` for whole degrees and the direction letter: 1e-5 minutes are 2 cm.
fn degrees(angle_deg: f64, digits: usize, [positive, negative]: [&str; 2]) -> String {
    let all = (angle_deg.abs() * 60.0 * 1e5).round() as u64;
    let (whole, minutes) = (all / 6_000_000, all % 6_000_000);
    let direction = if angle_deg < 0.0 { negative } else { positive };
    format!("{whole:0digits$}{:02}.{:05},{direction}", minutes / 100_000, minutes % 100_000)
}

/// A sentence with its checksum.
fn sentence(content: &str) -> String {
    let checksum = content.bytes().fold(0, |sum, byte| sum ^ byte);
    let mut text = String::new();
    // writing to a String cannot fail
    let _ = write!(text, "${content}*{checksum:02X}\r\n");
    text
}

#[cfg(test)]
mod tests {
    use r4_boards::GnssOrigin;

    use super::*;

    fn gnss(deviation_m: f64, latitude_deg: f64, longitude_deg: f64) -> Gnss {
        let origin = GnssOrigin { latitude_deg, longitude_deg, height_m: 40.0 };
        Gnss::new(SimulatedGnss { origin, rate_hz: 5, deviation_m, correlation_s: 60.0, place_m: [0.0; 2] }, 1)
    }

    fn fields(text: &str) -> Vec<Vec<&str>> {
        text.lines().map(|line| line.split(['$', ',', '*']).skip(1).collect()).collect()
    }

    /// Checksum of a published sentence, as printed in receivers' manuals.
    #[test]
    fn checksums_are_those_of_published_sentences() {
        assert!(sentence("GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,").ends_with("*47\r\n"));
        assert!(sentence("GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W").ends_with("*6A\r\n"));
    }

    /// A plane at the origin has an error of 1 cm at this distance.
    #[test]
    fn a_place_has_the_latitude_and_longitude_of_its_distance() {
        let mut gnss = gnss(0.0, 53.2, -0.5);
        let (latitude_deg, longitude_deg) = gnss.on_earth([100.0, -200.0]);
        // earth-centred coordinates give 53.198 202 884, -0.498 503 652; a nanodegree is 0.1 mm
        let off = [latitude_deg - 53.198_202_884, longitude_deg + 0.498_503_652];
        assert!(off.iter().all(|off| off.abs() < 1e-7), "{latitude_deg} {longitude_deg}");
        let text = gnss.sentences(1_230_000_000, [0.0; 2], [3.0, 0.0]);
        let [gga, rmc] = &fields(&text)[..] else { panic!("{text}") };
        assert_eq!(gga[..6], ["GPGGA", "120001.23", "5312.00000", "N", "00030.00000", "W"]);
        assert_eq!((gga[6], gga[9]), ("1", "40.0"));
        let speed_m_s = rmc[7].parse::<f64>().expect("a number") / KNOTS;
        let course_deg = rmc[8].parse::<f64>().expect("a number");
        // five standard deviations; 0.05 of 3 m/s are one degree
        assert!((speed_m_s - 3.0).abs() < 0.25 && (course_deg - 90.0).abs() < 5.0, "{text}");
        assert_eq!(rmc[9], "010126");
    }

    #[test]
    fn a_receiver_at_rest_has_no_course() {
        let mut gnss = gnss(0.0, -33.0, 151.0);
        let text = gnss.sentences(0, [0.0; 2], [0.0; 2]);
        let [gga, rmc] = &fields(&text)[..] else { panic!("{text}") };
        assert_eq!(gga[2..6], ["3300.00000", "S", "15100.00000", "E"]);
        // noise reaches 0.2 m/s once in three thousand positions
        assert_eq!(rmc[8], "", "{text}");
    }

    /// Ten thousand positions, one correlation time apart: their standard deviation within 5 %, and neighbours
    /// correlated by 1/e.
    #[test]
    fn errors_are_as_large_and_as_slow_as_said() {
        let mut gnss = gnss(2.0, 0.0, 0.0);
        gnss.spec = SimulatedGnss { rate_hz: 1, correlation_s: 1.0, ..gnss.spec };
        let errors: Vec<f64> = (0..10_000u64)
            .map(|second| {
                gnss.sentences(second * 1_000_000_000, [0.0; 2], [0.0; 2]);
                gnss.error_m[0]
            })
            .collect();
        let square = |pairs: &mut dyn Iterator<Item = f64>| pairs.sum::<f64>() / 10_000.0;
        let variance = square(&mut errors.iter().map(|error| error * error));
        let neighbours = square(&mut errors.windows(2).map(|pair| pair[0] * pair[1]));
        assert!((variance.sqrt() / 2.0 - 1.0).abs() < 0.05, "{variance}");
        assert!((neighbours / variance - (-1.0_f64).exp()).abs() < 0.04, "{}", neighbours / variance);
    }
}
