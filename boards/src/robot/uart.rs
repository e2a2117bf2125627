//! Tables `[[simulation.lidar]]` and `[[simulation.gnss]]`: sensors at the UART connectors. The board passes their
//! bytes on without decoding them, so that a robot's file has nothing else about them.

use serde::Deserialize;

use super::{Mount, body::MountTable, read::Reader};
use crate::{
    error::BoardError,
    number::{finite, not_negative, positive},
    source::Claims,
};

/// Number of UART connectors of the board.
const CONNECTORS: u8 = 2;
/// Range of position rates, Hz: ten messages of 150 bytes take an eighth of a line of 115 200 baud.
const RATES_HZ: std::ops::RangeInclusive<u16> = 1..=10;
/// Largest latitude of a world, degrees; the world is flat.
const LATITUDE_MAX_DEG: f64 = 85.0;
/// Standard deviation of a receiver without corrections, m: our choice.
const DEVIATION_M: f64 = 1.5;
/// Time in which the correlation of its error falls to 1/e, s: our choice.
const CORRELATION_S: f64 = 60.0;

/// Device at a UART connector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedUart {
    /// Number of the UART connector, 0 or 1.
    pub port: u8,
    /// Device that sends there.
    pub device: UartDevice,
}

/// Sensor that sends by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UartDevice {
    /// TFmini-S, which measures the distance in one direction 100 times a second.
    Lidar(Mount),
    /// Receiver that sends NMEA 0183.
    Gnss(SimulatedGnss),
}

/// GNSS receiver, and the place of the world on Earth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedGnss {
    /// Place of the world's origin; the x axis points east, the y axis north.
    pub origin: GnssOrigin,
    /// Positions per second, Hz.
    pub rate_hz: u16,
    /// Standard deviation of the error, east and north, m.
    pub deviation_m: f64,
    /// Time in which the error's correlation falls to 1/e, s.
    pub correlation_s: f64,
    /// Place of the aerial on the body, m.
    pub place_m: [f64; 2],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GnssTable {
    uart: u8,
    origin: GnssOrigin,
    #[serde(default = "rate_hz")]
    rate_hz: u16,
    #[serde(default = "deviation_m", deserialize_with = "not_negative")]
    deviation_m: f64,
    #[serde(default = "correlation_s", deserialize_with = "positive")]
    correlation_s: f64,
    #[serde(default)]
    place_m: [f64; 2],
}

impl From<&GnssTable> for SimulatedGnss {
    fn from(table: &GnssTable) -> Self {
        let &GnssTable { uart: _, origin, rate_hz, deviation_m, correlation_s, place_m } = table;
        Self { origin, rate_hz, deviation_m, correlation_s, place_m }
    }
}

/// Place on the ellipsoid WGS 84.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GnssOrigin {
    /// Latitude, positive to the north, degrees.
    #[serde(deserialize_with = "finite")]
    pub latitude_deg: f64,
    /// Longitude, positive to the east, degrees.
    #[serde(deserialize_with = "finite")]
    pub longitude_deg: f64,
    /// Height above mean sea level, m.
    #[serde(default, deserialize_with = "finite")]
    pub height_m: f64,
}

fn rate_hz() -> u16 {
    5
}

fn deviation_m() -> f64 {
    DEVIATION_M
}

fn correlation_s() -> f64 {
    CORRELATION_S
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LidarTable {
    uart: u8,
    mount: MountTable,
}

/// Checks the tables of all such sensors of a robot.
pub(super) fn check(
    reader: &Reader<'_>,
    claims: &mut Claims<'_>,
    has_body: bool,
    (lidars, receivers): (&[LidarTable], &[GnssTable]),
) -> Result<Vec<SimulatedUart>, BoardError> {
    let lidars = lidars.iter().map(|lidar| (lidar.uart, UartDevice::Lidar(lidar.mount.into())));
    let receivers = receivers.iter().map(|gnss| (gnss.uart, UartDevice::Gnss(gnss.into())));
    let paths = |name: &'static str| (0..).map(move |index: usize| format!("simulation.{name}[{index}]"));
    let mut uarts = Vec::new();
    for ((port, device), path) in lidars.zip(paths("lidar")).chain(receivers.zip(paths("gnss"))) {
        if port >= CONNECTORS {
            return Err(reader.rule(format!("{path}.uart"), "must be 0 or 1: the board has two UART connectors"));
        }
        // Both kinds of sensors measure from a place on a body.
        if !has_body {
            return Err(reader.rule(path, "the robot has no [body] to mount it on"));
        }
        if let UartDevice::Gnss(gnss) = &device {
            if !RATES_HZ.contains(&gnss.rate_hz) {
                return Err(reader.rule(format!("{path}.rate_hz"), "must be 1 to 10"));
            }
            if gnss.origin.latitude_deg.abs() > LATITUDE_MAX_DEG {
                return Err(reader.rule(format!("{path}.origin.latitude_deg"), "must be -85 to 85"));
            }
            if gnss.origin.longitude_deg.abs() > 180.0 {
                return Err(reader.rule(format!("{path}.origin.longitude_deg"), "must be -180 to 180"));
            }
            if !gnss.place_m.into_iter().all(f64::is_finite) {
                return Err(reader.rule(format!("{path}.place_m"), "numbers must be finite"));
            }
        }
        claims.take("UART connector", port, format!("{path}.uart"))?;
        uarts.push(SimulatedUart { port, device });
    }
    Ok(uarts)
}
