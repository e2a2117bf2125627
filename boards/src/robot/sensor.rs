//! `[[imu]]`, `[[current]]`, `[[angle]]`, `[[force]]`, `[[distance]]`, and `[[simulation.imu]]` and so on: sensors on the bus with the output chips, and what they
//! measure in simulation.

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

/// An inertial sensor, ICM-20948.
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

/// A current monitor, INA226.
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

/// An absolute angle sensor, AS5600.
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

/// The only one that it has.
fn as5600_address() -> u8 {
    0x36
}

/// What lags least.
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

/// A load cell, on an NAU7802.
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

/// The only one that it has.
fn nau7802_address() -> u8 {
    0x2A
}

/// What load cells need: 3.9 mV/V, where most put out 1 to 3.
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

/// An optical distance sensor, VL6180X.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Distance {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default = "vl6180x_address")]
    address: u8,
    rate_hz: u16,
}

/// The one that it has after power-up.
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

/// What is in front of an optical distance sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedDistance {
    /// Channel of the sensor.
    pub channel: ChannelId,
    /// How far away it is, in place of the body's, m; `None` where there is nothing.
    pub distance_m: Option<f64>,
    /// The quantity of the body that is the distance, as m.
    pub reads: Option<BodyReading>,
    /// Share of the light that it gives back.
    pub reflectance: f64,
    /// How much too far the sensor ranges, m.
    pub offset_m: f64,
}

/// What is on a load cell, and what the cell truly is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedForce {
    /// Channel of the sensor.
    pub channel: ChannelId,
    /// What presses on it in place of the body, N.
    pub force_n: f64,
    /// The quantity of the body that presses on it, as N.
    pub reads: Option<BodyReading>,
    /// True force for each mV/V, N.
    pub newtons_per_mv_v: f64,
    /// What its bridge truly puts out without a force, mV/V.
    pub zero_mv_v: f64,
    /// Noise of a conversion from outside the chip, such as shaking, N rms.
    pub noise_n: f64,
}

/// Where an angle sensor is.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedAngle {
    /// Channel of the sensor.
    #[serde(deserialize_with = "channel")]
    pub channel: ChannelId,
    /// The motor whose output shaft it is on; `None` for a magnet that stands still.
    #[serde(default, deserialize_with = "optional_channel")]
    pub of: Option<ChannelId>,
    /// The angle that it shows at position 0, rad.
    #[serde(default, deserialize_with = "finite")]
    pub zero_rad: f64,
}

/// An angle sensor that sends pulses to a range connector.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedPulses {
    /// Number of the range connector.
    pub connector: u8,
    /// The motor whose output shaft it is on; `None` for a magnet that stands still.
    #[serde(default, deserialize_with = "optional_channel")]
    pub of: Option<ChannelId>,
    /// The angle that it shows at position 0, rad.
    #[serde(default, deserialize_with = "finite")]
    pub zero_rad: f64,
    /// True frames a second.
    #[serde(deserialize_with = "positive")]
    pub frames_hz: f64,
}

/// Where a current monitor is.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedCurrent {
    /// Channel of the sensor.
    #[serde(deserialize_with = "channel")]
    pub channel: ChannelId,
    /// The supply, or the motor on a bridge, whose current it sees: what is drawn counts as positive.
    #[serde(deserialize_with = "channel")]
    pub of: ChannelId,
    /// True resistance of the shunt, Ω; `None` for that of the configuration.
    #[serde(default, deserialize_with = "optional_positive")]
    pub shunt_ohm: Option<f64>,
}

/// How an inertial sensor sits on the body, and how far it is off. Its axes are the body's: x forwards, y to the left, z upwards.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulatedImu {
    /// Channel of the sensor.
    #[serde(deserialize_with = "channel")]
    pub channel: ChannelId,
    /// Where it sits, from the origin of the body, m.
    #[serde(default)]
    pub place_m: [f64; 3],
    /// What it shows of each acceleration when there is none, m/s².
    #[serde(default)]
    pub acceleration_bias_m_s2: [f64; 3],
    /// What it shows of each rate at rest, rad/s.
    #[serde(default)]
    pub rate_bias_rad_s: [f64; 3],
    /// What it shows of a rate of 1 rad/s about each axis, without bias, rad/s.
    #[serde(default = "exact")]
    pub rate_scale: [f64; 3],
}

fn exact() -> [f64; 3] {
    [1.0; 3]
}

impl SimulatedImu {
    /// What is true where a file says nothing: at the origin of the body, without bias, of exact scale.
    pub(super) fn new(channel: ChannelId) -> Self {
        let [place_m, acceleration_bias_m_s2, rate_bias_rad_s] = [[0.0; 3]; 3];
        Self { channel, place_m, acceleration_bias_m_s2, rate_bias_rad_s, rate_scale: exact() }
    }

    /// Whether all its numbers are finite.
    pub(super) fn is_finite(&self) -> bool {
        let Self { channel: _, place_m, acceleration_bias_m_s2, rate_bias_rad_s, rate_scale } = self;
        [place_m, acceleration_bias_m_s2, rate_bias_rad_s, rate_scale]
            .into_iter()
            .flatten()
            .all(|value| value.is_finite())
    }
}
