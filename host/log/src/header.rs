//! Header of a log: the metadata record that describes the recorded board and the recording.

use std::{
    collections::BTreeMap,
    time::{Duration, UNIX_EPOCH},
};

use r4_protocol::{ChannelInfo, Mode, ModeInfo, Range, Unit};
use serde::{Deserialize, Serialize};

/// Name of the metadata record.
pub(crate) const RECORD_NAME: &str = "r4.run";

/// Version of the topics, fields and metadata keys; a reader refuses versions it does not know.
///
/// In format 1 a set point of any mode was the field `setpoint`, and chunks were not compressed.
pub(crate) const FORMAT: &str = "2";
/// Formats that this crate reads.
pub(crate) const READABLE: [&str; 2] = ["1", FORMAT];

/// Description of the recorded board, its channels and the recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Name of the robot.
    pub robot: String,
    /// Address of the board, such as `sim:osmc-bench`.
    pub board: String,
    /// Version of the board's firmware.
    pub firmware: String,
    /// [`r4_protocol::VERSION`] of the recording program.
    pub protocol_version: u16,
    /// Channels as the board describes them; samples of other channels cannot be recorded.
    pub channels: Vec<ChannelInfo>,
    /// Seed of a virtual board's noise; `None` for a real board, and in the first logs of format 1.
    pub seed: Option<u64>,
    /// Time and program of the recording; `None` in earlier logs.
    pub recorded: Option<Recorded>,
}

/// Time, program and command line of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Recorded {
    /// Wall clock when the session with the board was opened, ns since 1970-01-01T00:00:00Z.
    pub unix_ns: u64,
    /// Name and version of the recording program.
    pub program: String,
    /// Command line of the recording program.
    pub command: String,
    /// Wall clock minus the board's clock, ns, for a board in real time, whose messages have wall-clock log times.
    /// `None` for a virtual board, whose log times are those of its own clock.
    pub clock_offset_ns: Option<i64>,
}

impl Recorded {
    /// Returns `unix_ns` in UTC as in RFC 3339, in whole seconds.
    #[must_use]
    pub fn at(&self) -> String {
        humantime::format_rfc3339_seconds(UNIX_EPOCH + Duration::from_nanos(self.unix_ns)).to_string()
    }
}

/// Reason why a metadata record is no [`Header`].
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
        // Absent fields stay absent, so that readers can tell them from empty ones.
        metadata.extend(self.seed.map(|seed| ("seed".to_owned(), seed.to_string())));
        if let Some(recorded) = &self.recorded {
            metadata.insert("recorded_at".to_owned(), recorded.at());
            metadata.insert("recorded_unix_ns".to_owned(), recorded.unix_ns.to_string());
            metadata.insert("program".to_owned(), recorded.program.clone());
            metadata.insert("command".to_owned(), recorded.command.clone());
            let offset = recorded.clock_offset_ns;
            metadata.extend(offset.map(|offset_ns| ("clock_offset_ns".to_owned(), offset_ns.to_string())));
        }
        Ok(metadata)
    }

    pub(crate) fn from_metadata(metadata: &BTreeMap<String, String>) -> Result<Self, BadHeader> {
        let field = |key: &'static str| metadata.get(key).ok_or(BadHeader::Field { key });
        let format = field("format")?;
        if !READABLE.contains(&format.as_str()) {
            return Err(BadHeader::Format { found: format.clone() });
        }
        let protocol_version =
            field("protocol_version")?.parse().map_err(|_| BadHeader::Field { key: "protocol_version" })?;
        let records: Vec<ChannelRecord> =
            serde_json::from_str(field("channels")?).map_err(|_| BadHeader::Field { key: "channels" })?;
        // One unknown channel makes the header unreadable: samples of it could not be interpreted.
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
            recorded: recorded(metadata)?,
        })
    }
}

fn recorded(metadata: &BTreeMap<String, String>) -> Result<Option<Recorded>, BadHeader> {
    let Some(unix_ns) = metadata.get("recorded_unix_ns") else { return Ok(None) };
    let bad = |key| BadHeader::Field { key };
    let text = |key: &str| metadata.get(key).cloned().unwrap_or_default();
    let offset_ns = metadata.get("clock_offset_ns").map(|offset_ns| offset_ns.parse()).transpose();
    Ok(Some(Recorded {
        unix_ns: unix_ns.parse().map_err(|_| bad("recorded_unix_ns"))?,
        program: text("program"),
        command: text("command"),
        clock_offset_ns: offset_ns.map_err(|_| bad("clock_offset_ns"))?,
    }))
}

/// Returns the name of `mode` in a file.
pub(crate) fn mode_name(mode: Mode) -> &'static str {
    match mode {
        Mode::Position => "position",
        Mode::Speed => "speed",
        Mode::Duty => "duty",
        Mode::Switch => "switch",
        Mode::Voltage => "voltage",
        Mode::Brake => "brake",
        Mode::Home => "home",
        Mode::Follow => "follow",
        Mode::Force => "force",
    }
}

/// Returns the mode with that name; `None` for an unknown one.
pub(crate) fn mode_from(name: &str) -> Option<Mode> {
    Mode::ALL.into_iter().find(|mode| mode_name(*mode) == name)
}

fn unit_from(name: &str) -> Option<Unit> {
    Unit::ALL.into_iter().find(|unit| unit.to_string() == name)
}

/// [`ChannelInfo`] with the names of the command line. JSON has no infinity: a missing limit is an open one.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_are_those_of_the_calendar() {
        let at = |seconds: u64| {
            let unix_ns = seconds * 1_000_000_000;
            Recorded { unix_ns, program: String::new(), command: String::new(), clock_offset_ns: None }.at()
        };
        // Reference dates are from `date -u -d @SECONDS`.
        for (seconds, date) in [
            (0, "1970-01-01T00:00:00Z"),
            (951_782_399, "2000-02-28T23:59:59Z"),
            (951_782_400, "2000-02-29T00:00:00Z"),
            (1_709_251_199, "2024-02-29T23:59:59Z"),
            (4_107_542_400, "2100-03-01T00:00:00Z"),
            (18_446_744_073, "2554-07-21T23:34:33Z"),
        ] {
            assert_eq!(at(seconds), date);
        }
    }
}
