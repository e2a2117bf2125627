//! Numbers that are checked while they are read, so that the error carries their line.

use std::{fmt::Display, str::FromStr};

use r4_protocol::{
    can::{BITRATES_KBIT, DATA_RATES_KBIT, Node},
    channel::{ChannelId, ChannelKind, Range},
    config::{DUTY_HARD_MAX, STOP_BRAKE_MAX_MS},
};
use serde::{Deserialize, Deserializer, de::Error};

pub(crate) fn finite<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Number<'de>,
{
    checked(deserializer, |_| true, "finite")
}

pub(crate) fn positive<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Number<'de>,
{
    checked(deserializer, |value| value > 0.0, "above 0")
}

pub(crate) fn not_negative<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Number<'de>,
{
    checked(deserializer, |value| value >= 0.0, "0 or above")
}

/// Reads a duty above 0, up to the highest that a configuration may have.
pub(crate) fn duty<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    checked(deserializer, |value| value > 0.0 && value <= f64::from(DUTY_HARD_MAX), "above 0 and at most 0.98")
}

/// Makes for each check the same of a field that may be left out.
macro_rules! optional {
    ($($name:ident = $check:ident),*) => {
        $(pub(crate) fn $name<'de, D, T>(deserializer: D) -> Result<Option<T>, D::Error>
        where
            D: Deserializer<'de>,
            T: Number<'de>,
        {
            $check(deserializer).map(Some)
        })*
    };
}

optional!(optional_finite = finite, optional_positive = positive, optional_not_negative = not_negative);
optional!(optional_oscillator_hz = oscillator_hz);

pub(crate) fn optional_duty<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f32>, D::Error> {
    duty(deserializer).map(Some)
}

/// Reads the control period, µs, within the firmware's limits ([`r4_protocol::config::BoardConfig::validate`]). Checked
/// here so that the error has the line; the same holds for the functions below.
pub(crate) fn control_period_us<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u32, D::Error> {
    checked(deserializer, |value| (500.0..=20_000.0).contains(&value), "500 to 20000")
}

/// Reads the longest silence of the host before the board trips, ms.
pub(crate) fn link_timeout_ms<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    checked(deserializer, |value| (20.0..=1000.0).contains(&value), "20 to 1000")
}

/// Reads the time for which a stop brakes before it switches off, ms.
pub(crate) fn stop_brake_ms<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    checked(deserializer, |value| (0.0..=f64::from(STOP_BRAKE_MAX_MS)).contains(&value), "0 to 5000")
}

/// Reads a PWM frequency, Hz: that of prescalers 255 to 3 (PCA9685 datasheet, 7.3.5).
pub(crate) fn pwm_frequency_hz<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    checked(deserializer, |value| (24.0..=1526.0).contains(&value), "24 to 1526, which is what the PCA9685 has")
}

/// Reads the measured frequency of an oscillator, Hz, within the firmware's limits; the part's spread is some percent.
pub(crate) fn oscillator_hz<'de, D, T>(deserializer: D) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Number<'de>,
{
    checked(deserializer, |value| (20e6..=30e6).contains(&value), "20e6 to 30e6: the PCA9685 has 25 MHz")
}

/// Reads an air temperature, °C, within the firmware's limits.
pub(crate) fn air_temperature_c<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    checked(deserializer, |value| (-40.0..=60.0).contains(&value), "-40 to 60")
}

/// Reads the bit rate of the CAN bus, kbit/s.
pub(crate) fn can_kbit_per_s<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    checked(deserializer, |value| BITRATES_KBIT.iter().any(|rate| f64::from(*rate) == value), "125, 250, 500 or 1000")
}

/// Reads the bit rate of the data phase of CAN FD frames, kbit/s.
pub(crate) fn can_data_kbit_per_s<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    checked(
        deserializer,
        |value| DATA_RATES_KBIT.iter().any(|rate| f64::from(*rate) == value),
        "500, 1000 or 2000, or 0 for classic frames only",
    )
}

/// Reads the node number of the board on its CAN bus.
pub(crate) fn can_node<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u16, D::Error> {
    checked(deserializer, |value| (0.0..f64::from(Node::COUNT)).contains(&value), "0 to 127")
}

/// Reads a code of an ideal 10-bit converter, 0 to 1023.
pub(crate) fn code_10bit<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    checked(deserializer, |value| (0.0..=1023.0).contains(&value), "0 to 1023")
}

/// Number type of the files.
pub(crate) trait Number<'de>: Deserialize<'de> + Copy + Display + Into<f64> {}

impl<'de, T: Deserialize<'de> + Copy + Display + Into<f64>> Number<'de> for T {}

fn checked<'de, D, T>(deserializer: D, holds: fn(f64) -> bool, rule: &str) -> Result<T, D::Error>
where
    D: Deserializer<'de>,
    T: Number<'de>,
{
    let value = T::deserialize(deserializer)?;
    let number: f64 = value.into();
    if number.is_finite() && holds(number) {
        Ok(value)
    } else {
        Err(D::Error::custom(format!("{value} is out of range, must be {rule}")))
    }
}

/// Closed interval, written `{ min = ..., max = ... }`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(try_from = "RawInterval")]
pub struct Interval {
    /// Lowest value of the interval.
    pub min: f64,
    /// Highest value of the interval.
    pub max: f64,
}

impl From<Interval> for Range {
    fn from(interval: Interval) -> Self {
        Self::new(interval.min as f32, interval.max as f32)
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawInterval {
    #[serde(deserialize_with = "finite")]
    min: f64,
    #[serde(deserialize_with = "finite")]
    max: f64,
}

impl TryFrom<RawInterval> for Interval {
    type Error = &'static str;

    fn try_from(raw: RawInterval) -> Result<Self, Self::Error> {
        let interval = Self { min: raw.min, max: raw.max };
        let Range { min, max } = interval.into();
        if !(min.is_finite() && max.is_finite()) {
            Err("min and max must fit into 32-bit floats")
        } else if min < max {
            Ok(interval)
        } else {
            Err("min must be below max")
        }
    }
}

/// Reads a channel's name, as in `osmc0`.
pub(crate) fn channel<'de, D: Deserializer<'de>>(deserializer: D) -> Result<ChannelId, D::Error> {
    let text = String::deserialize(deserializer)?;
    ChannelId::from_str(&text).map_err(|why| D::Error::custom(format!("`{text}` is {why}")))
}

pub(crate) fn channels<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<ChannelId>, D::Error> {
    #[derive(Deserialize)]
    struct Named(#[serde(deserialize_with = "channel")] ChannelId);
    Ok(Vec::<Named>::deserialize(deserializer)?.into_iter().map(|Named(id)| id).collect())
}

pub(crate) fn optional_channel<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<ChannelId>, D::Error> {
    channel(deserializer).map(Some)
}

/// Reads the number in the name of a channel of `kind`.
fn number_of<'de, D: Deserializer<'de>>(deserializer: D, kind: ChannelKind) -> Result<u8, D::Error> {
    let id = channel(deserializer)?;
    if id.kind == kind {
        Ok(id.index)
    } else {
        let name = kind.name();
        Err(D::Error::custom(format!("`{id}` is no {name}: write {name} and its number, as in {name}0")))
    }
}

pub(crate) fn optional_supply_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u8>, D::Error> {
    number_of(deserializer, ChannelKind::Supply).map(Some)
}

pub(crate) fn angle_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u8, D::Error> {
    number_of(deserializer, ChannelKind::Angle)
}

pub(crate) fn optional_analog_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u8>, D::Error> {
    number_of(deserializer, ChannelKind::Analog).map(Some)
}

pub(crate) fn optional_force_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<u8>, D::Error> {
    number_of(deserializer, ChannelKind::Force).map(Some)
}

pub(crate) fn analog_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<u8, D::Error> {
    number_of(deserializer, ChannelKind::Analog)
}
