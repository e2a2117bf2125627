//! Tables `[[imu]]`, `[[current]]`, `[[angle]]`, `[[force]]`, `[[distance]]` of sensors on the bus with the output
//! chips, and their tables `[[simulation.imu]]` and so on.

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{As5600Config, Icm20948Config, Ina226Config, Nau7802Config, SensorChip, SensorConfig, Vl6180xConfig},
};
use serde::Deserialize;

use super::{
    BodyReading,
    read::{Place, Table},
};
use crate::{
    error::BoardError,
    number::{channel, finite, optional_channel, optional_positive, positive},
};

/// Inertial sensor, an ICM-20948.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Imu {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    address: u8,
    rate_hz: u16,
    acceleration_max_g: u8,
    rate_max_deg_s: u16,
}

impl Table for Imu {
    type Config = SensorConfig;
    const KIND: ChannelKind = ChannelKind::Imu;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<SensorConfig, BoardError> {
        let &Self { channel: id, address, rate_hz, acceleration_max_g, rate_max_deg_s } = self;
        place.take_address(address)?;
        let chip = SensorChip::Icm20948(Icm20948Config { acceleration_max_g, rate_max_deg_s });
        Ok(SensorConfig { id, address, rate_hz, chip })
    }
}

/// Current monitor, an INA226.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Current {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    address: u8,
    rate_hz: u16,
    #[serde(deserialize_with = "positive")]
    shunt_ohm: f32,
}

impl Table for Current {
    type Config = SensorConfig;
    const KIND: ChannelKind = ChannelKind::Current;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<SensorConfig, BoardError> {
        let &Self { channel: id, address, rate_hz, shunt_ohm } = self;
        place.take_address(address)?;
        Ok(SensorConfig { id, address, rate_hz, chip: SensorChip::Ina226(Ina226Config { shunt_ohm }) })
    }
}

/// Absolute angle sensor, an AS5600.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Angle {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default = "as5600_address")]
    address: u8,
    rate_hz: u16,
    #[serde(default = "fewest_averages")]
    averages: u8,
}

/// Returns the only address of an AS5600.
fn as5600_address() -> u8 {
    0x36
}

/// Returns the setting of the slow filter with the least lag.
fn fewest_averages() -> u8 {
    2
}

impl Table for Angle {
    type Config = SensorConfig;
    const KIND: ChannelKind = ChannelKind::Angle;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<SensorConfig, BoardError> {
        let &Self { channel: id, address, rate_hz, averages } = self;
        place.take_address(address)?;
        Ok(SensorConfig { id, address, rate_hz, chip: SensorChip::As5600(As5600Config { averages }) })
    }
}

/// Load cell on an NAU7802.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Force {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default = "nau7802_address")]
    address: u8,
    rate_hz: u16,
    #[serde(default = "greatest_gain")]
    gain: u8,
    #[serde(deserialize_with = "finite")]
    newtons_per_mv_v: f32,
    #[serde(default, deserialize_with = "finite")]
    zero_mv_v: f32,
}

/// Returns the only address of an NAU7802.
fn nau7802_address() -> u8 {
    0x2A
}

/// Returns the gain that load cells need: its range is 3.9 mV/V, and most cells put out 1 to 3.
fn greatest_gain() -> u8 {
    128
}

impl Table for Force {
    type Config = SensorConfig;
    const KIND: ChannelKind = ChannelKind::Force;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<SensorConfig, BoardError> {
        let &Self { channel: id, address, rate_hz, gain, newtons_per_mv_v, zero_mv_v } = self;
        place.take_address(address)?;
        let chip = SensorChip::Nau7802(Nau7802Config { gain, newtons_per_mv_v, zero_mv_v });
        Ok(SensorConfig { id, address, rate_hz, chip })
    }
}

/// Optical distance sensor, a VL6180X.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Distance {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default = "vl6180x_address")]
    address: u8,
    rate_hz: u16,
}

/// Returns the address of a VL6180X after power-up.
fn vl6180x_address() -> u8 {
    0x29
}

impl Table for Distance {
    type Config = SensorConfig;
    const KIND: ChannelKind = ChannelKind::Distance;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<SensorConfig, BoardError> {
        let &Self { channel: id, address, rate_hz } = self;
        place.take_address(address)?;
        Ok(SensorConfig { id, address, rate_hz, chip: SensorChip::Vl6180x(Vl6180xConfig {}) })
    }
}

/// Optical distance sensor with what is in front of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedDistance {
    /// Channel of the sensor.
    pub channel: ChannelId,
    /// Distance of an object, in place of the body's, m; `None` for no object.
    pub distance_m: Option<f64>,
    /// Quantity of the body that is the distance, m.
    pub reads: Option<BodyReading>,
    /// Reflectance of the object, a share of the light.
    pub reflectance: f64,
    /// Error of the sensor, m: positive ranges too far.
    pub offset_m: f64,
}

/// Load cell with its load and its true properties.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedForce {
    /// Channel of the sensor.
    pub channel: ChannelId,
    /// Load in place of the body's, N.
    pub force_n: f64,
    /// Quantity of the body that is the load, N.
    pub reads: Option<BodyReading>,
    /// True force per mV/V, N.
    pub newtons_per_mv_v: f64,
    /// True output of the bridge without a force, mV/V.
    pub zero_mv_v: f64,
    /// Noise of a conversion from outside the chip, such as vibration, N rms.
    pub noise_n: f64,
}

/// Angle sensor with its place.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedAngle {
    /// Channel of the sensor.
    #[serde(deserialize_with = "channel")]
    pub channel: ChannelId,
    /// Motor whose output shaft it is on; `None` for a magnet that stands still.
    #[serde(default, deserialize_with = "optional_channel")]
    pub of: Option<ChannelId>,
    /// Angle that the sensor shows at position 0, rad.
    #[serde(default, deserialize_with = "finite")]
    pub zero_rad: f64,
}

/// Angle sensor that sends pulses to a range connector.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedPulses {
    /// Number of the range connector.
    pub connector: u8,
    /// Motor whose output shaft it is on; `None` for a magnet that stands still.
    #[serde(default, deserialize_with = "optional_channel")]
    pub of: Option<ChannelId>,
    /// Angle that the sensor shows at position 0, rad.
    #[serde(default, deserialize_with = "finite")]
    pub zero_rad: f64,
    /// True PWM frames per second, Hz.
    #[serde(deserialize_with = "positive")]
    pub frames_hz: f64,
}

/// Current monitor with its place.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedCurrent {
    /// Channel of the sensor.
    #[serde(deserialize_with = "channel")]
    pub channel: ChannelId,
    /// Supply, or motor on a bridge, whose current it measures; positive is drawn from the supply.
    #[serde(deserialize_with = "channel")]
    pub of: ChannelId,
    /// True resistance of the shunt, Ω; `None` for that of the configuration.
    #[serde(default, deserialize_with = "optional_positive")]
    pub shunt_ohm: Option<f64>,
}

/// Inertial sensor with its place on the body and its errors. Its axes are the body's: x forwards, y to the left, z
/// upwards.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedImu {
    /// Channel of the sensor.
    #[serde(deserialize_with = "channel")]
    pub channel: ChannelId,
    /// Place from the origin of the body, m.
    #[serde(default)]
    pub place_m: [f64; 3],
    /// Reading of each acceleration when there is none, m/s².
    #[serde(default)]
    pub acceleration_bias_m_s2: [f64; 3],
    /// Reading of each rate at rest, rad/s.
    #[serde(default)]
    pub rate_bias_rad_s: [f64; 3],
    /// Reading for a rate of 1 rad/s about each axis, without bias, rad/s.
    #[serde(default = "exact")]
    pub rate_scale: [f64; 3],
}

fn exact() -> [f64; 3] {
    [1.0; 3]
}

impl SimulatedImu {
    /// Makes the sensor for a file that says nothing: at the origin of the body, without bias, of exact scale.
    pub(super) fn new(channel: ChannelId) -> Self {
        let [place_m, acceleration_bias_m_s2, rate_bias_rad_s] = [[0.0; 3]; 3];
        Self { channel, place_m, acceleration_bias_m_s2, rate_bias_rad_s, rate_scale: exact() }
    }

    /// Returns whether all numbers are finite.
    pub(super) fn is_finite(&self) -> bool {
        let Self { channel: _, place_m, acceleration_bias_m_s2, rate_bias_rad_s, rate_scale } = self;
        [place_m, acceleration_bias_m_s2, rate_bias_rad_s, rate_scale]
            .into_iter()
            .flatten()
            .all(|value| value.is_finite())
    }
}
