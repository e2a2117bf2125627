//! Positions of a GNSS receiver: decodes NMEA 0183 sentences to metres east and north of the plot's corner, which
//! correct the pose.
//!
//! # Source
//! NMEA 0183, sentence GGA and checksum. Geodetic to earth-centred coordinates and to the local plane: Farrell, *Aided Navigation*, McGraw-Hill 2008,
//! 2.3 (WGS 84).

use nalgebra::RowVector4;
use r4_boards::{Robot, UartDevice};
use r4_maps::pose::Point;

use crate::rover::{Fix, PoseFilter};

/// WGS 84: semi-major axis, m, and flattening.
const AXIS_M: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Number of the program's periods (20 ms) between reads of the connector; the robot moves 16 mm meanwhile.
const TURNS: usize = 2;
/// Standard deviation of a position in the filter, m. The receiver's error of 0.02 m is correlated over a minute, which
/// a filter of white noise cannot represent. Our choice; other values were not compared.
const DEVIATION_M: f64 = 0.05;
/// Gate in standard deviations, beyond which positions are rejected.
const GATE: f64 = 5.0;
/// Longest sentence of the standard, in bytes.
const SENTENCE_MAX: usize = 82;

/// Position on the WGS 84 ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geodetic {
    /// Latitude, positive to the north, rad.
    pub latitude_rad: f64,
    /// Longitude, positive to the east, rad.
    pub longitude_rad: f64,
    /// Height above the ellipsoid, m.
    pub height_m: f64,
}

impl Geodetic {
    /// Position in earth-centred, earth-fixed coordinates, m.
    fn earth_centred_m(self) -> [f64; 3] {
        let squared = FLATTENING * (2.0 - FLATTENING);
        let ((sin, cos), (sin_east, cos_east)) = (self.latitude_rad.sin_cos(), self.longitude_rad.sin_cos());
        let normal_m = AXIS_M / (1.0 - squared * sin * sin).sqrt();
        let across_m = (normal_m + self.height_m) * cos;
        [across_m * cos_east, across_m * sin_east, (normal_m * (1.0 - squared) + self.height_m) * sin]
    }

    /// Position east and north of `origin`, in its tangent plane, m.
    #[must_use]
    pub fn east_north_m(self, origin: Self) -> Point {
        let (here, there) = (self.earth_centred_m(), origin.earth_centred_m());
        let [x, y, z] = [0, 1, 2].map(|axis| here[axis] - there[axis]);
        let ((sin, cos), (sin_east, cos_east)) = (origin.latitude_rad.sin_cos(), origin.longitude_rad.sin_cos());
        [-sin_east * x + cos_east * y, -sin * cos_east * x - sin * sin_east * y + cos * z]
    }
}

/// Decoder of a receiver's byte stream.
#[derive(Clone, Debug, Default)]
pub struct Sentences {
    line: Vec<u8>,
}

impl Sentences {
    /// Takes bytes and returns the positions that they complete. Sentences with a wrong checksum, of another kind or
    /// without a position give none.
    pub fn take(&mut self, bytes: &[u8]) -> Vec<Geodetic> {
        let mut positions = Vec::new();
        for byte in bytes {
            match byte {
                b'$' => self.line.clear(),
                b'\n' => positions.extend(std::str::from_utf8(&self.line).ok().and_then(position)),
                // The rest of a longer line is dropped; its checksum fails then.
                _ if self.line.len() < SENTENCE_MAX => self.line.push(*byte),
                _ => {}
            }
        }
        positions
    }
}

/// Position of a GGA sentence, without its `$`; `None` for other or damaged sentences.
fn position(line: &str) -> Option<Geodetic> {
    let (content, checksum) = line.trim_end().split_once('*')?;
    if u8::from_str_radix(checksum, 16).ok()? != content.bytes().fold(0, |sum, byte| sum ^ byte) {
        return None;
    }
    let fields: Vec<&str> = content.split(',').collect();
    let [kind, _, north, south, east, west, quality, _, _, height, ..] = *fields else { return None };
    if !kind.ends_with("GGA") || quality == "0" {
        return None;
    }
    Some(Geodetic {
        latitude_rad: angle_rad(north, 2)? * if south == "S" { -1.0 } else { 1.0 },
        longitude_rad: angle_rad(east, 3)? * if west == "W" { -1.0 } else { 1.0 },
        height_m: height.parse().ok()?,
    })
}

/// Parses an angle in degrees and minutes, of which the first `digits` are whole degrees; the result is in rad.
fn angle_rad(text: &str, digits: usize) -> Option<f64> {
    let (whole, minutes) = text.split_at_checked(digits)?;
    Some((whole.parse::<f64>().ok()? + minutes.parse::<f64>().ok()? / 60.0).to_radians())
}

/// A GNSS receiver on the robot.
#[derive(Clone, Debug)]
pub struct Receiver {
    port: u8,
    /// Corner of the plot, the origin of positions.
    origin: Geodetic,
    /// Position of the aerial on the robot: forwards and to the left of its middle, m.
    aerial_m: Point,
    sentences: Sentences,
    counts: [u64; 2],
}

impl Receiver {
    /// Creates the receiver of a robot's file.
    ///
    /// # Errors
    /// A robot without a receiver, in words.
    pub fn of(robot: &Robot) -> Result<Self, String> {
        let receiver = robot.simulation.uarts.iter().find_map(|uart| match uart.device {
            UartDevice::Gnss(gnss) => Some((uart.port, gnss)),
            UartDevice::Lidar(_) => None,
        });
        let (port, gnss) = receiver.ok_or("it has no [[simulation.gnss]]")?;
        let origin = Geodetic {
            latitude_rad: gnss.origin.latitude_deg.to_radians(),
            longitude_rad: gnss.origin.longitude_deg.to_radians(),
            height_m: gnss.origin.height_m,
        };
        Ok(Self { port, origin, aerial_m: gnss.place_m, sentences: Sentences::default(), counts: [0; 2] })
    }
}

impl Fix for Receiver {
    fn port(&self, turn: usize) -> Option<u8> {
        turn.is_multiple_of(TURNS).then_some(self.port)
    }

    fn correct(&mut self, _: u8, bytes: &[u8], pose: &mut PoseFilter) {
        for position in self.sentences.take(bytes) {
            let seen_m = position.east_north_m(self.origin);
            let mut is_good = true;
            for axis in 0..2 {
                let (sin, cos) = pose.state()[2].sin_cos();
                let [ahead_m, aside_m] = self.aerial_m;
                let from_middle_m = [cos * ahead_m - sin * aside_m, sin * ahead_m + cos * aside_m];
                let mut row = RowVector4::zeros();
                row[axis] = 1.0;
                // The aerial is not above the middle, so that its position also depends on the yaw.
                row[2] = [-from_middle_m[1], from_middle_m[0]][axis];
                let off_m = seen_m[axis] - (pose.state()[axis] + from_middle_m[axis]);
                is_good &= pose.correct(&row, off_m, DEVIATION_M, GATE);
            }
            self.counts[usize::from(!is_good)] += 1;
        }
    }

    fn counts(&self) -> [u64; 2] {
        self.counts
    }
}
