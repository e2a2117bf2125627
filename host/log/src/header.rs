//! What a file says about the run it holds, as a metadata record.

use std::collections::BTreeMap;

use r4_protocol::{ChannelInfo, Mode, ModeInfo, Range, Unit};
use serde::{Deserialize, Serialize};

/// Name of the metadata record.
pub(crate) const RECORD_NAME: &str = "r4.run";

/// Version of the topics, fields and metadata keys; a reader refuses those it does not know.
pub(crate) const FORMAT: &str = "1";

const UNITS: [Unit; 7] = [Unit::Rad, Unit::RadPerS, Unit::M, Unit::MPerS, Unit::Duty, Unit::V, Unit::Bool];
/// Every mode there is.
pub(crate) const MODES: [Mode; 7] =
    [Mode::Position, Mode::Speed, Mode::Duty, Mode::Switch, Mode::Voltage, Mode::Brake, Mode::Home];

/// Which board was recorded, and what its channels are.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// The robot's name.
    pub robot: String,
    /// How the board was reached, such as `sim:osmc-bench`.
    pub board: String,
    /// Version of the board's firmware.
    pub firmware: String,
    /// [`r4_protocol::VERSION`] of the recording program.
    pub protocol_version: u16,
    /// The board's description of itself; only channels listed here can be recorded.
    pub channels: Vec<ChannelInfo>,
    /// Seed of a virtual board's noise; `None` for a real board, and in the first logs of this format.
    pub seed: Option<u64>,
}

/// Why a metadata record is no [`Header`].
#[derive(Debug, PartialEq)]
pub(crate) enum BadHeader {
    Format { found: String },
    Field { key: &'static str },
}

impl Header {
    pub(crate) fn to_metadata(&self) -> Result<BTreeMap<String, String>, serde_json::Error> {
        let channels: Vec<ChannelRecord> = self.channels.iter().map(ChannelRecord::from).collect();
        let mut metadata = BTreeMap::from([
            ("format".to_owned(), FORMAT.to_owned()),
            ("robot".to_owned(), self.robot.clone()),
            ("board".to_owned(), self.board.clone()),
            ("firmware".to_owned(), self.firmware.clone()),
            ("protocol_version".to_owned(), self.protocol_version.to_string()),
            ("channels".to_owned(), serde_json::to_string(&channels)?),
        ]);
        metadata.extend(self.seed.map(|seed| ("seed".to_owned(), seed.to_string())));
        Ok(metadata)
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Result<Self, BadHeader> {
        let field = |key: &'static str| metadata.get(key).ok_or(BadHeader::Field { key });
        let format = field("format")?;
        if format != FORMAT {
            return Err(BadHeader::Format { found: format.clone() });
        }
        let protocol_version =
            field("protocol_version")?.parse().map_err(|_| BadHeader::Field { key: "protocol_version" })?;
        let records: Vec<ChannelRecord> =
            serde_json::from_str(field("channels")?).map_err(|_| BadHeader::Field { key: "channels" })?;
        let channels = records.iter().map(ChannelRecord::info).collect::<Option<_>>();
        Ok(Self {
            robot: field("robot")?.clone(),
            board: field("board")?.clone(),
            firmware: field("firmware")?.clone(),
            protocol_version,
            channels: channels.ok_or(BadHeader::Field { key: "channels" })?,
            seed: metadata
                .get("seed")
                .map(|seed| seed.parse())
                .transpose()
                .map_err(|_| BadHeader::Field { key: "seed" })?,
        })
    }
}

/// The name of `mode` in a file.
pub(crate) fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Position => "position",
        Mode::Speed => "speed",
        Mode::Duty => "duty",
        Mode::Switch => "switch",
        Mode::Voltage => "voltage",
        Mode::Brake => "brake",
        Mode::Home => "home",
    }
}

/// The mode of that name.
pub(crate) fn mode_from(name: &str) -> Option<Mode> {
    MODES.into_iter().find(|mode| mode_name(*mode) == name)
}

fn unit_from(name: &str) -> Option<Unit> {
    UNITS.into_iter().find(|unit| unit.to_string() == name)
}

/// [`ChannelInfo`] in the words of the command line. JSON has no infinity: a missing limit is an open one.
#[derive(Serialize, Deserialize)]
struct ChannelRecord {
    id: String,
    unit: String,
    min: Option<f32>,
    max: Option<f32>,
    rate_hz: Option<f32>,
    resolution: Option<f32>,
    modes: Vec<ModeRecord>,
}

#[derive(Serialize, Deserialize)]
struct ModeRecord {
    mode: String,
    unit: String,
    min: Option<f32>,
    max: Option<f32>,
}

fn finite(value: f32) -> Option<f32> {
    value.is_finite().then_some(value)
}

fn range(min: Option<f32>, max: Option<f32>) -> Range {
    Range::new(min.unwrap_or(f32::NEG_INFINITY), max.unwrap_or(f32::INFINITY))
}

impl From<&ChannelInfo> for ChannelRecord {
    fn from(info: &ChannelInfo) -> Self {
        let modes = info.modes.iter().map(|mode| ModeRecord {
            mode: mode_name(mode.mode).to_owned(),
            unit: mode.unit.to_string(),
            min: finite(mode.range.min),
            max: finite(mode.range.max),
        });
        Self {
            id: info.id.to_string(),
            unit: info.unit.to_string(),
            min: finite(info.range.min),
            max: finite(info.range.max),
            rate_hz: finite(info.rate_hz),
            resolution: finite(info.resolution),
            modes: modes.collect(),
        }
    }
}

impl ChannelRecord {
    fn info(&self) -> Option<ChannelInfo> {
        let modes = self.modes.iter().map(|mode| {
            Some(ModeInfo {
                mode: mode_from(&mode.mode)?,
                unit: unit_from(&mode.unit)?,
                range: range(mode.min, mode.max),
            })
        });
        let mut info = ChannelInfo {
            id: self.id.parse().ok()?,
            unit: unit_from(&self.unit)?,
            range: range(self.min, self.max),
            rate_hz: self.rate_hz.unwrap_or(f32::NAN),
            resolution: self.resolution.unwrap_or(f32::NAN),
            modes: Default::default(),
        };
        for mode in modes {
            info.modes.push(mode?).ok()?;
        }
        Some(info)
    }
}
