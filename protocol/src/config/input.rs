//! Inputs: encoders, switches, range sensors, analog inputs, supply rails.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{
    ANALOG_INPUTS, ConfigError, ENCODERS, MAX_EXACT, RANGE_SENSORS, SWITCHES, check, finite, finite_range, positive,
};
use crate::channel::{ChannelId, ChannelKind, Range};

/// Quadrature encoder that is a channel of its own, whether or not a motor uses it too.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct EncoderConfig {
    /// [`ChannelKind::Encoder`] and its number, which is the counter's.
    pub id: ChannelId,
    /// Counts in one turn, four to a line.
    pub counts_per_turn: u32,
    /// True where the encoder counts down forwards.
    pub inverted: bool,
}

/// Switch input, as beside an encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct SwitchConfig {
    /// [`ChannelKind::Switch`] and its number, which is the connector's.
    pub id: ChannelId,
    /// True where a low level is a closed switch.
    pub active_low: bool,
}

/// Ultrasonic range sensor, with trigger and echo.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RangeConfig {
    /// [`ChannelKind::Range`] and its number, which is the connector's.
    pub id: ChannelId,
    /// Range of distances that the sensor can measure, m.
    pub range_m: Range,
    /// Distance below which the board trips, m. It also trips when a sensor with this limit does not measure.
    pub stop_below_m: Option<f32>,
}

/// Analog input behind a voltage divider.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct AnalogConfig {
    /// [`ChannelKind::Analog`] and its number, which is the input's.
    pub id: ChannelId,
    /// Volts at the input for one count of the 16-bit converter.
    pub volts_per_code: f32,
    /// Voltage at the input at code 0, V.
    pub offset_v: f32,
    /// Range of voltages that a connected source can have, V: below is a short, above is open or clamped.
    pub plausible_v: Range,
}

/// Supply rail on an analog input behind a voltage divider.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct SupplyConfig {
    /// [`ChannelKind::Supply`] and its number.
    pub id: ChannelId,
    /// Number of the analog input.
    pub analog: u8,
    /// Volts at the rail for one count of the 16-bit converter.
    pub volts_per_code: f32,
    /// Range of voltages outside of which the board trips, V.
    pub range_v: Range,
    /// Voltage above which the motors on this rail feed less and less energy back, V; nothing at the end of `range_v`.
    /// `None` sets no such limit.
    pub regeneration_v: Option<f32>,
}

impl EncoderConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Encoder, "an encoder needs an encoder channel name")?;
        rule(usize::from(self.id.index) < ENCODERS, "encoders are numbered 0 to 3")?;
        rule((1..=MAX_EXACT).contains(&self.counts_per_turn), "counts_per_turn must be 1 to 16777216")
    }
}

impl SwitchConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Switch, "a switch needs a switch channel name")?;
        rule(usize::from(self.id.index) < SWITCHES, "switches are numbered 0 to 3")
    }
}

impl RangeConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Range, "a range sensor needs a range channel name")?;
        rule(usize::from(self.id.index) < RANGE_SENSORS, "range sensors are numbered 0 to 3")?;
        let widest = Range::new(0.02, 4.0);
        let Range { min, max } = self.range_m;
        rule(widest.contains(min) && widest.contains(max) && min < max, "range_m must lie between 0.02 and 4 m")?;
        rule(
            self.stop_below_m.is_none_or(|stop| stop > min && stop <= max),
            "stop_below_m must lie within range_m and above its min, or nothing is ever nearer",
        )
    }
}

impl AnalogConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Analog, "an analog input needs an analog channel name")?;
        rule(usize::from(self.id.index) < ANALOG_INPUTS, "analog inputs are numbered 0 to 5")?;
        rule(positive(self.volts_per_code), "volts_per_code must be positive")?;
        rule(finite(self.offset_v), "offset_v must be finite")?;
        rule(finite_range(self.plausible_v), "plausible_v must have a finite min below a finite max")
    }
}

impl SupplyConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.kind == ChannelKind::Supply, "a supply needs a supply channel name")?;
        rule(usize::from(self.analog) < ANALOG_INPUTS, "the analog input must exist and be used once")?;
        rule(positive(self.volts_per_code), "volts_per_code must be positive")?;
        rule(finite_range(self.range_v), "range_v must have a finite min below a finite max")?;
        rule(
            self.range_v.max < f32::from(u16::MAX) * self.volts_per_code,
            "range_v must end below the converter's highest voltage, or a higher one is never seen",
        )?;
        rule(
            self.regeneration_v
                .is_none_or(|volts| positive(volts) && self.range_v.contains(volts) && volts < self.range_v.max),
            "regeneration_v must lie within range_v and below its max",
        )
    }
}
