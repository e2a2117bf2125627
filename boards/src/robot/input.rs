//! Tables `[[encoder]]`, `[[switch]]`, `[[range]]`, `[[analog]]`, `[[supply]]`: inputs.

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{AnalogConfig, EncoderConfig, RangeConfig, SupplyConfig, SwitchConfig},
};
use serde::Deserialize;

use super::read::{Place, Table};
use crate::{
    error::BoardError,
    number::{Interval, channel, finite, optional_positive, positive},
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Encoder {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "positive")]
    counts_per_turn: u32,
    #[serde(default)]
    inverted: bool,
}

impl Table for Encoder {
    type Config = EncoderConfig;
    const KIND: ChannelKind = ChannelKind::Encoder;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, _: &mut Place<'_, '_>) -> Result<EncoderConfig, BoardError> {
        let &Self { channel, counts_per_turn, inverted } = self;
        Ok(EncoderConfig { id: channel, counts_per_turn, inverted })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Switch {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    active_low: bool,
}

impl Table for Switch {
    type Config = SwitchConfig;
    const KIND: ChannelKind = ChannelKind::Switch;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, _: &mut Place<'_, '_>) -> Result<SwitchConfig, BoardError> {
        Ok(SwitchConfig { id: self.channel, active_low: self.active_low })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RangeSensor {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    range_m: Option<Interval>,
    #[serde(default, deserialize_with = "optional_positive")]
    stop_below_m: Option<f32>,
}

impl Table for RangeSensor {
    type Config = RangeConfig;
    const KIND: ChannelKind = ChannelKind::Range;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<RangeConfig, BoardError> {
        let range_m = self.range_m.unwrap_or(place.carrier.range.range_m);
        Ok(RangeConfig { id: self.channel, range_m: range_m.into(), stop_below_m: self.stop_below_m })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Analog {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default, deserialize_with = "optional_positive")]
    volts_per_code: Option<f32>,
    #[serde(default, deserialize_with = "finite")]
    offset_v: f32,
    plausible_v: Interval,
}

impl Table for Analog {
    type Config = AnalogConfig;
    const KIND: ChannelKind = ChannelKind::Analog;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<AnalogConfig, BoardError> {
        Ok(AnalogConfig {
            id: self.channel,
            volts_per_code: self.volts_per_code.unwrap_or(place.carrier.analog.volts_per_code() as f32),
            offset_v: self.offset_v,
            plausible_v: self.plausible_v.into(),
        })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Supply {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    analog: u8,
    #[serde(default, deserialize_with = "optional_positive")]
    volts_per_code: Option<f32>,
    range_v: Interval,
    #[serde(default, deserialize_with = "optional_positive")]
    regeneration_v: Option<f32>,
}

impl Table for Supply {
    type Config = SupplyConfig;
    const KIND: ChannelKind = ChannelKind::Supply;

    fn channel(&self) -> ChannelId {
        self.channel
    }

    fn config(&self, place: &mut Place<'_, '_>) -> Result<SupplyConfig, BoardError> {
        place.take_analog(self.analog, "analog")?;
        Ok(SupplyConfig {
            id: self.channel,
            analog: self.analog,
            volts_per_code: self.volts_per_code.unwrap_or(place.carrier.analog.volts_per_code() as f32),
            range_v: self.range_v.into(),
            regeneration_v: self.regeneration_v,
        })
    }
}
