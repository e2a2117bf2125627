//! Reading of a recorded run.

use std::{
    collections::BTreeMap,
    fs, io,
    path::{Path, PathBuf},
};

use mcap::{
    MAGIC,
    records::{Channel, MessageHeader, Metadata, Record, SchemaHeader, op},
};
use r4_protocol::{Causes, ChannelId, ChannelInfo, Mode, Quality, Request, SafetyState, Setpoint};

use crate::{
    container::{self, Chunk, RawRecord, Records},
    header::{self, BadHeader, Header, mode_from},
    message::{
        COMMAND_TOPIC, CommandMessage, ENCODER, EncoderMessage, GAP_TOPIC, GapMessage, LINEAR_MOTOR, MotorMessage,
        READING, REFUSAL_TOPIC, REQUEST_TOPIC, ROTARY_MOTOR, SENSOR, STATE_TOPIC, ScalarMessage, SensorMessage,
        StateMessage, is_linear, quality_from, state_from,
    },
    request::{Described, RefusalMessage, RequestMessage},
};

/// Error of reading a file as a recorded run.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file has no content.
    #[error("the file is empty: the recording never began, or the copy failed; record or copy it again")]
    Empty,
    /// Not an MCAP file, or its beginning is damaged.
    #[error("this is not an MCAP file: give a log that `r4` recorded")]
    NotMcap,
    /// The file ends before its header, which says which board was recorded.
    #[error("the file ends after {length} bytes, before it says what was recorded: copy it again, or record again")]
    CutShort {
        /// Length of the file in bytes.
        length: usize,
    },
    /// MCAP file of another program.
    #[error("this MCAP file was written by \"{library}\", not by `r4`: open it with the program that made it")]
    Foreign {
        /// Library that wrote it, as the file says.
        library: String,
    },
    /// Log of a format that this version of the crate does not read.
    #[error("the log has format {found}, this program reads {}: use the version of `r4` that recorded it", known.join(" and "))]
    Format {
        /// Format of the file.
        found: String,
        /// Formats that this crate reads.
        known: [&'static str; 2],
    },
    /// The metadata record lacks a field, or its value is unknown to this version.
    #[error("the log's header has no usable \"{key}\": use the version of `r4` that recorded it, or record again")]
    BadHeader {
        /// Name of the field.
        key: &'static str,
    },
}

/// Part of a file that is missing from the [`Log`] made from it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Warning {
    /// Recording was interrupted, or the file was copied incompletely; everything before is read.
    #[error("the file ends early: the recording was interrupted or the copy is incomplete; all before it is shown")]
    CutShort,
    /// Part of the file is damaged and was skipped.
    #[error("the file is damaged from byte {offset} on: that part is left out")]
    Damaged {
        /// Offset of that part's first byte in the file.
        offset: usize,
    },
    /// Part of the file was compressed by another program in a way that this crate does not read, and was skipped.
    #[error("part of the file is compressed ({compression}) and left out: decompress it first, with `mcap decompress`")]
    Compressed {
        /// Name of the compression in the file.
        compression: String,
    },
    /// Messages of a topic without the fields they should have, which were skipped.
    #[error("{messages} messages of {topic} cannot be read and are left out")]
    Unreadable {
        /// Name of the topic.
        topic: String,
        /// Number of such messages.
        messages: usize,
    },
}

/// Set point as it was recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Logged {
    /// Mode in which the number is meant.
    pub mode: Mode,
    /// Set point: rad or m; rad/s or m/s; share of the supply; V; N; 0 or 1. NaN if none was recorded.
    pub value: f64,
}

/// Sample of a motor channel. NaN stands for a number that was not finite, or that the channel does not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSample {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Set point in force.
    pub setpoint: Logged,
    /// Position as measured, in counts of [`ChannelInfo::resolution`].
    pub position_counts: i32,
    /// Position, rad or m.
    pub position: f64,
    /// Speed, rad/s or m/s.
    pub speed: f64,
    /// Duty at the bridge, share of the supply, -1 to 1.
    pub duty: f64,
    /// Whether, in position mode, the channel is at the set point and at rest.
    pub settled: bool,
    /// True if the position is absolute, not only counted since power-up.
    pub homed: bool,
    /// Heat of the winding, share of what it withstands.
    pub winding_heat: f64,
}

/// Samples of a motor channel over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorSeries {
    /// Description of the channel.
    pub info: ChannelInfo,
    /// Samples in order of time; at least one.
    pub samples: Vec<MotorSample>,
}

impl MotorSeries {
    /// Returns whether the channel moves linearly (m, m/s); otherwise it turns (rad, rad/s).
    #[must_use]
    pub fn is_linear(&self) -> bool {
        is_linear(&self.info)
    }
}

/// Samples of a channel with one number over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct ScalarSeries {
    /// Description of the channel.
    pub info: ChannelInfo,
    /// Time (s) and value (in the channel's unit; NaN if it was not finite), in order of time; at least one.
    pub samples: Vec<(f64, f64)>,
}

/// Sample of an input that can fail.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingSample {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Value in the channel's unit: the last good one unless `quality` is [`Quality::Good`]. NaN if it was not
    /// finite.
    pub value: f64,
    /// Age of the value when it was sent, ms.
    pub age_ms: u16,
    /// Reliability of the value, or the reason against it.
    pub quality: Quality,
}

/// Samples of an input that can fail, over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadingSeries {
    /// Description of the channel.
    pub info: ChannelInfo,
    /// Samples in order of time; at least one.
    pub samples: Vec<ReadingSample>,
}

/// Sample of an encoder. NaN stands for a number that was not finite, or that the channel does not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderSample {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Position in counts of [`ChannelInfo::resolution`].
    pub position_counts: i32,
    /// Angle of the shaft, rad.
    pub position: f64,
    /// Speed of the shaft, rad/s.
    pub speed: f64,
    /// Number of transitions since power-up that no shaft makes.
    pub illegal: u32,
}

/// Samples of an encoder over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderSeries {
    /// Description of the channel.
    pub info: ChannelInfo,
    /// Samples in order of time; at least one.
    pub samples: Vec<EncoderSample>,
}

/// Sample of a sensor that measures several numbers together.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSample {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Values in the order and units of [`ChannelKind::quantities`](r4_protocol::ChannelKind::quantities): the last
    /// good ones unless `quality` is [`Quality::Good`]. NaN for one that was not finite.
    pub values: Vec<f64>,
    /// Age of the values when they were sent, ms.
    pub age_ms: u16,
    /// Reliability of the values, or the reason against it.
    pub quality: Quality,
}

/// Samples of a sensor that measures several numbers together, over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSeries {
    /// Description of the channel.
    pub info: ChannelInfo,
    /// Samples in order of time; at least one.
    pub samples: Vec<SensorSample>,
}

/// State of the safety supervisor from one time on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateChange {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// State after the change.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
}

/// Set point that the host sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoggedCommand {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Channel that was commanded.
    pub channel: ChannelId,
    /// Set point for the channel.
    pub setpoint: Logged,
}

/// Request that the host sent: a set point, or any other that is more than a question.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedRequest {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Time on the host's clock since its hello, µs; `None` in the first logs of format 1.
    pub sent_us: Option<u64>,
    /// The request itself; a set point's `sent_us` is `time_s`.
    pub request: Request,
}

impl std::fmt::Display for LoggedRequest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        Described(&self.request).fmt(f)
    }
}

/// Request that the board refused.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedRefusal {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Description of the request, as in `set osmc0 position 1.5`.
    pub request: String,
    /// Reason of the refusal.
    pub reason: String,
}

/// Time without a link, after which the recording continued.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// End of the gap, when the board was heard again, s.
    pub time_s: f64,
    /// Time without a sign of the board, on the host's clock, s.
    pub without_link_s: f64,
    /// Restart of the board within the gap, after which its clock began at 0 again.
    pub restarted: bool,
    /// Times of the log minus the board's clock from here on, µs. Only a restart changes it, so that times go on.
    pub clock_shift_us: i64,
}

impl std::fmt::Display for Gap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.restarted { "the board restarted" } else { "the board ran on" };
        write!(f, "{:.3} s without a link; {what}", self.without_link_s)
    }
}

/// A recorded run, read into typed series.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// Description of the recorded board and program.
    pub header: Header,
    /// Motor channels with samples, in the header's order.
    pub motors: Vec<MotorSeries>,
    /// Encoders with samples, in the header's order.
    pub encoders: Vec<EncoderSeries>,
    /// Inputs that can fail, with samples, in the header's order.
    pub readings: Vec<ReadingSeries>,
    /// Sensors that measure several numbers together, with samples, in the header's order.
    pub sensors: Vec<SensorSeries>,
    /// Other channels with samples, in the header's order.
    pub scalars: Vec<ScalarSeries>,
    /// Changes of the safety state, in order of time.
    pub states: Vec<StateChange>,
    /// Commands sent, in order of time.
    pub commands: Vec<LoggedCommand>,
    /// All requests that the host sent, commands included, in the order of sending. The first logs of format 1 hold
    /// only the commands.
    pub requests: Vec<LoggedRequest>,
    /// Refused requests, in order of time.
    pub refusals: Vec<LoggedRefusal>,
    /// Times without a link, in order of time.
    pub gaps: Vec<Gap>,
    /// Parts that could not be read; empty for an intact file.
    pub warnings: Vec<Warning>,
}

impl Log {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// [`LogError::Io`] if the file cannot be read, and the errors of [`from_bytes`](Self::from_bytes).
    pub fn read(path: impl AsRef<Path>) -> Result<Self, LogError> {
        let path = path.as_ref();
        let bytes = fs::read(path).map_err(|source| LogError::Io { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes)
    }

    /// Reads a log from memory.
    ///
    /// A file that is cut or damaged after its header yields what can be read, and [`warnings`](Self::warnings).
    ///
    /// # Errors
    /// A [`LogError`] if the file is no log, or ends before its header.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LogError> {
        if bytes.is_empty() {
            return Err(LogError::Empty);
        }
        if !bytes.starts_with(MAGIC) {
            return Err(if MAGIC.starts_with(bytes) {
                LogError::CutShort { length: bytes.len() }
            } else {
                LogError::NotMcap
            });
        }
        let mut reader = Reader::default();
        // Topics are declared before the messages: the summary at the file's end repeats those that a damaged chunk
        // declared.
        let declared = |record: &RawRecord| !record.cut && matches!(record.opcode, op::SCHEMA | op::CHANNEL);
        for record in Records::new(bytes, MAGIC.len()).filter(declared) {
            reader.record(&record)?;
        }
        for record in Records::new(bytes, MAGIC.len()) {
            match (record.opcode, record.cut) {
                (op::CHUNK, _) => reader.chunk(&record),
                (_, true) => reader.cut_short = true,
                (op::DATA_END, false) => {
                    reader.data_ended = true;
                    break;
                }
                (_, false) => reader.record(&record)?,
            }
        }
        // A complete file ends with the magic bytes.
        reader.cut_short |= !reader.data_ended || !bytes.ends_with(MAGIC);
        reader.finish(bytes.len())
    }

    /// Returns the samples of motor channel `id`; `None` if it has none.
    #[must_use]
    pub fn motor(&self, id: ChannelId) -> Option<&MotorSeries> {
        self.motors.iter().find(|series| series.info.id == id)
    }

    /// Returns the samples of encoder `id`; `None` if it has none.
    #[must_use]
    pub fn encoder(&self, id: ChannelId) -> Option<&EncoderSeries> {
        self.encoders.iter().find(|series| series.info.id == id)
    }

    /// Returns the samples of `id`, an input that can fail; `None` if it has none.
    #[must_use]
    pub fn reading(&self, id: ChannelId) -> Option<&ReadingSeries> {
        self.readings.iter().find(|series| series.info.id == id)
    }

    /// Returns the samples of `id`, a sensor that measures several numbers together; `None` if it has none.
    #[must_use]
    pub fn sensor(&self, id: ChannelId) -> Option<&SensorSeries> {
        self.sensors.iter().find(|series| series.info.id == id)
    }

    /// Returns the samples of `id`, a channel that has one number; `None` if it has none.
    #[must_use]
    pub fn scalar(&self, id: ChannelId) -> Option<&ScalarSeries> {
        self.scalars.iter().find(|series| series.info.id == id)
    }

    /// Returns the times of the first and the last recorded sample, state or request on the board's clock, s; `None`
    /// for an empty log.
    #[must_use]
    pub fn time_span_s(&self) -> Option<(f64, f64)> {
        let motors = self.motors.iter().flat_map(|series| series.samples.iter().map(|sample| sample.time_s));
        let encoders = self.encoders.iter().flat_map(|series| series.samples.iter().map(|sample| sample.time_s));
        let readings = self.readings.iter().flat_map(|series| series.samples.iter().map(|sample| sample.time_s));
        let sensors = self.sensors.iter().flat_map(|series| series.samples.iter().map(|sample| sample.time_s));
        let scalars = self.scalars.iter().flat_map(|series| series.samples.iter().map(|(time_s, _)| *time_s));
        let states = self.states.iter().map(|change| change.time_s);
        let commands = self.commands.iter().map(|command| command.time_s);
        let requests = self.requests.iter().map(|request| request.time_s);
        let times = motors
            .chain(encoders)
            .chain(readings)
            .chain(sensors)
            .chain(scalars)
            .chain(states)
            .chain(commands)
            .chain(requests);
        times.fold(None, |span, time_s| match span {
            None => Some((time_s, time_s)),
            Some((first, last)) => Some((time_s.min(first), time_s.max(last))),
        })
    }

    /// Returns the duration of the run, s; 0 for an empty log.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.time_span_s().map_or(0.0, |(first, last)| last - first)
    }
}

/// Kind of the messages of a topic, with the channel they belong to.
#[derive(Clone, PartialEq)]
enum Content {
    Motor(ChannelId),
    Encoder(ChannelId),
    Reading(ChannelId),
    Sensor(ChannelId),
    Scalar(ChannelId),
    State,
    Command,
    Request,
    Refusal,
    Gap,
}

struct Topic {
    name: String,
    /// Kind of the messages; `None` for topics of other programs, with whose log this one may have been merged.
    content: Option<Content>,
    unreadable: usize,
}

#[derive(Default)]
struct Reader {
    library: String,
    header: Option<Header>,
    schemas: BTreeMap<u16, String>,
    topics: BTreeMap<u16, Topic>,
    motors: BTreeMap<ChannelId, Vec<MotorSample>>,
    encoders: BTreeMap<ChannelId, Vec<EncoderSample>>,
    readings: BTreeMap<ChannelId, Vec<ReadingSample>>,
    sensors: BTreeMap<ChannelId, Vec<SensorSample>>,
    scalars: BTreeMap<ChannelId, Vec<(f64, f64)>>,
    states: Vec<StateChange>,
    commands: Vec<LoggedCommand>,
    requests: Vec<LoggedRequest>,
    refusals: Vec<LoggedRefusal>,
    gaps: Vec<Gap>,
    warnings: Vec<Warning>,
    data_ended: bool,
    cut_short: bool,
}

impl Reader {
    fn warn(&mut self, warning: Warning) {
        if !self.warnings.contains(&warning) {
            self.warnings.push(warning);
        }
    }

    fn chunk(&mut self, record: &RawRecord) {
        self.cut_short |= record.cut;
        let mut decompressed = Vec::new();
        match container::chunk(record, &mut decompressed) {
            Chunk::Records(records) => {
                for record in &records {
                    // Headers are not in chunks, so there is no error to pass on.
                    let _ = self.record(record);
                }
            }
            Chunk::Compressed(compression) => self.warn(Warning::Compressed { compression }),
            Chunk::Damaged => self.warn(Warning::Damaged { offset: record.offset }),
        }
    }

    fn record(&mut self, record: &RawRecord) -> Result<(), LogError> {
        if !matches!(record.opcode, op::HEADER | op::SCHEMA | op::CHANNEL | op::MESSAGE | op::METADATA) {
            return Ok(());
        }
        match mcap::parse_record(record.opcode, record.body) {
            Ok(Record::Header(header)) => self.library = header.library,
            Ok(Record::Schema { header: SchemaHeader { id, name, .. }, .. }) => {
                self.schemas.insert(id, name);
            }
            Ok(Record::Channel(channel)) => self.topic(channel),
            Ok(Record::Message { header, data }) => self.message(&header, &data),
            Ok(Record::Metadata(Metadata { name, metadata })) if name == header::RECORD_NAME => {
                if self.header.is_none() {
                    self.header = Some(Header::from_metadata(&metadata).map_err(|bad| match bad {
                        BadHeader::Format { found } => LogError::Format { found, known: header::READABLE },
                        BadHeader::Field { key } => LogError::BadHeader { key },
                    })?);
                }
            }
            Ok(_) => {}
            Err(_) => self.warn(Warning::Damaged { offset: record.offset }),
        }
        Ok(())
    }

    fn topic(&mut self, channel: Channel) {
        let Channel { id, schema_id, topic: name, .. } = channel;
        let of_channel = match self.schemas.get(&schema_id).map_or("", String::as_str) {
            ROTARY_MOTOR | LINEAR_MOTOR => Content::Motor,
            ENCODER => Content::Encoder,
            reading if reading.ends_with(READING) => Content::Reading,
            sensor if sensor.ends_with(SENSOR) => Content::Sensor,
            _ => Content::Scalar,
        };
        let content = match name.as_str() {
            STATE_TOPIC => Some(Content::State),
            COMMAND_TOPIC => Some(Content::Command),
            REQUEST_TOPIC => Some(Content::Request),
            REFUSAL_TOPIC => Some(Content::Refusal),
            GAP_TOPIC => Some(Content::Gap),
            _ => name.strip_prefix('/').and_then(|name| name.parse().ok()).map(of_channel),
        };
        // A channel's record is repeated in the summary, and may be in every chunk: the first one counts.
        self.topics.entry(id).or_insert(Topic { name, content, unreadable: 0 });
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) {
        // A message of an unknown topic was declared in a damaged chunk.
        let Some(topic) = self.topics.get(&header.channel_id) else { return };
        let Some(content) = topic.content.clone() else { return };
        // Exact up to 2^53 ns (104 days), rounded to the nearest double beyond.
        let time_s = header.publish_time as f64 / 1e9;
        let taken = match content {
            Content::Motor(id) => self.motor(id, time_s, data),
            Content::Encoder(id) => self.encoder(id, time_s, data),
            Content::Reading(id) => self.reading(id, time_s, data),
            Content::Sensor(id) => self.sensor(id, time_s, data),
            Content::Scalar(id) => self.scalar(id, time_s, data),
            Content::State => self.state(time_s, data),
            Content::Command => self.command(time_s, header.publish_time / 1000, data),
            Content::Request => self.request(time_s, data),
            Content::Refusal => self.refusal(time_s, data),
            Content::Gap => self.gap(time_s, data),
        };
        if taken.is_none()
            && let Some(topic) = self.topics.get_mut(&header.channel_id)
        {
            topic.unreadable += 1;
        }
    }

    fn info(&self, id: ChannelId) -> Option<&ChannelInfo> {
        self.header.as_ref()?.channels.iter().find(|info| info.id == id)
    }

    fn motor(&mut self, id: ChannelId, time_s: f64, data: &[u8]) -> Option<()> {
        let message: MotorMessage = serde_json::from_slice(data).ok()?;
        let (position, speed) = if is_linear(self.info(id)?) {
            (message.position_m, message.speed_m_s)
        } else {
            (message.position_rad, message.speed_rad_s)
        };
        let sample = MotorSample {
            time_s,
            setpoint: Logged { mode: mode_from(message.setpoint_mode)?, value: number(message.setpoint()) },
            position_counts: message.position_counts,
            position: position.unwrap_or(f64::NAN),
            speed: number(speed),
            duty: number(message.duty),
            settled: message.settled,
            homed: message.homed,
            winding_heat: number(message.winding_heat),
        };
        self.motors.entry(id).or_default().push(sample);
        Some(())
    }

    fn encoder(&mut self, id: ChannelId, time_s: f64, data: &[u8]) -> Option<()> {
        let message: EncoderMessage = serde_json::from_slice(data).ok()?;
        let sample = EncoderSample {
            time_s,
            position_counts: message.position_counts,
            position: message.position_rad.unwrap_or(f64::NAN),
            speed: number(message.speed_rad_s),
            illegal: message.illegal,
        };
        self.encoders.entry(id).or_default().push(sample);
        Some(())
    }

    fn reading(&mut self, id: ChannelId, time_s: f64, data: &[u8]) -> Option<()> {
        let message: ScalarMessage = serde_json::from_slice(data).ok()?;
        let value = number(message.value(self.info(id)?.unit));
        let (age_ms, quality) = (message.age_ms?, quality_from(message.quality?)?);
        self.readings.entry(id).or_default().push(ReadingSample { time_s, value, age_ms, quality });
        Some(())
    }

    fn sensor(&mut self, id: ChannelId, time_s: f64, data: &[u8]) -> Option<()> {
        let message: SensorMessage = serde_json::from_slice(data).ok()?;
        let values = id.kind.quantities().iter().map(|quantity| message.value(quantity.field)).collect();
        let (age_ms, quality) = (message.age_ms, quality_from(&message.quality)?);
        self.sensors.entry(id).or_default().push(SensorSample { time_s, values, age_ms, quality });
        Some(())
    }

    fn scalar(&mut self, id: ChannelId, time_s: f64, data: &[u8]) -> Option<()> {
        let message: ScalarMessage = serde_json::from_slice(data).ok()?;
        let value = number(message.value(self.info(id)?.unit));
        self.scalars.entry(id).or_default().push((time_s, value));
        Some(())
    }

    fn state(&mut self, time_s: f64, data: &[u8]) -> Option<()> {
        let message: StateMessage = serde_json::from_slice(data).ok()?;
        let state = state_from(message.state)?;
        self.states.push(StateChange { time_s, state, causes: Causes::from_bits(message.causes_bits) });
        Some(())
    }

    fn command(&mut self, time_s: f64, device_us: u64, data: &[u8]) -> Option<()> {
        let message: CommandMessage = serde_json::from_slice(data).ok()?;
        let (channel, mode) = (message.channel.parse().ok()?, mode_from(message.setpoint_mode)?);
        self.commands.push(LoggedCommand {
            time_s,
            channel,
            setpoint: Logged { mode, value: number(message.setpoint()) },
        });
        let setpoint = Setpoint { mode, value: message.setpoint().unwrap_or(f32::NAN) };
        // The time to live is not recorded.
        let request = Request::Set { channel, setpoint, sent_us: device_us, ttl_ms: 0 };
        self.requests.push(LoggedRequest { time_s, sent_us: message.sent_us, request });
        Some(())
    }

    fn request(&mut self, time_s: f64, data: &[u8]) -> Option<()> {
        let message: RequestMessage = serde_json::from_slice(data).ok()?;
        self.requests.push(LoggedRequest { time_s, sent_us: message.sent_us, request: message.request()? });
        Some(())
    }

    fn refusal(&mut self, time_s: f64, data: &[u8]) -> Option<()> {
        let RefusalMessage { request, reason } = serde_json::from_slice(data).ok()?;
        self.refusals.push(LoggedRefusal { time_s, request, reason });
        Some(())
    }

    fn gap(&mut self, time_s: f64, data: &[u8]) -> Option<()> {
        let GapMessage { without_link_s, restarted, clock_shift_us } = serde_json::from_slice(data).ok()?;
        self.gaps.push(Gap { time_s, without_link_s, restarted, clock_shift_us });
        Some(())
    }

    fn finish(mut self, length: usize) -> Result<Log, LogError> {
        let Some(header) = self.header else {
            let library = self.library;
            return Err(if self.cut_short { LogError::CutShort { length } } else { LogError::Foreign { library } });
        };
        for Topic { name, unreadable, .. } in self.topics.into_values().filter(|topic| topic.unreadable > 0) {
            self.warnings.push(Warning::Unreadable { topic: name, messages: unreadable });
        }
        if self.cut_short {
            self.warnings.push(Warning::CutShort);
        }
        let (mut motors, mut encoders, mut readings) = (Vec::new(), Vec::new(), Vec::new());
        let (mut sensors, mut scalars) = (Vec::new(), Vec::new());
        for info in &header.channels {
            if let Some(mut samples) = self.motors.remove(&info.id) {
                samples.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
                motors.push(MotorSeries { info: info.clone(), samples });
            }
            if let Some(mut samples) = self.encoders.remove(&info.id) {
                samples.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
                encoders.push(EncoderSeries { info: info.clone(), samples });
            }
            if let Some(mut samples) = self.readings.remove(&info.id) {
                samples.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
                readings.push(ReadingSeries { info: info.clone(), samples });
            }
            if let Some(mut samples) = self.sensors.remove(&info.id) {
                samples.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
                sensors.push(SensorSeries { info: info.clone(), samples });
            }
            if let Some(mut samples) = self.scalars.remove(&info.id) {
                samples.sort_by(|a, b| a.0.total_cmp(&b.0));
                scalars.push(ScalarSeries { info: info.clone(), samples });
            }
        }
        self.states.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        self.commands.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        // The host's clock gives the order of sending. Logs without it are sorted by the board's clock. The sort is
        // stable: the file's order decides between equal times.
        if self.requests.iter().all(|request| request.sent_us.is_some()) {
            self.requests.sort_by_key(|request| request.sent_us);
        } else {
            self.requests.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        }
        self.refusals.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        self.gaps.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let Self { states, commands, requests, refusals, gaps, warnings, .. } = self;
        Ok(Log {
            header,
            motors,
            encoders,
            readings,
            sensors,
            scalars,
            states,
            commands,
            requests,
            refusals,
            gaps,
            warnings,
        })
    }
}

/// Returns the recorded number; NaN if there is none.
fn number(value: Option<f32>) -> f64 {
    value.map_or(f64::NAN, f64::from)
}
