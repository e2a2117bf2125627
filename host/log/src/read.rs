//! Reading a run.

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

/// Why a file could not be read as a recorded run.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// There is nothing in the file.
    #[error("the file is empty: the recording never began, or the copy failed; record or copy it again")]
    Empty,
    /// Not an MCAP file, or nothing is left of it.
    #[error("this is not an MCAP file: give a log that `r4` recorded")]
    NotMcap,
    /// The file ends before it says which board it is of.
    #[error("the file ends after {length} bytes, before it says what was recorded: copy it again, or record again")]
    CutShort {
        /// Bytes there are.
        length: usize,
    },
    /// An MCAP file of another program.
    #[error("this MCAP file was written by \"{library}\", not by `r4`: open it with the program that made it")]
    Foreign {
        /// What the file says wrote it.
        library: String,
    },
    /// A log of another version of this crate.
    #[error("the log has format {found}, this program reads {}: use the version of `r4` that recorded it", known.join(" and "))]
    Format {
        /// Of the file.
        found: String,
        /// Of this crate.
        known: [&'static str; 2],
    },
    /// The metadata record lacks a field, or it is none that this version knows.
    #[error("the log's header has no usable \"{key}\": use the version of `r4` that recorded it, or record again")]
    BadHeader {
        /// Which field.
        key: &'static str,
    },
}

/// Something in a file that is not in the [`Log`] made from it.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Warning {
    /// Recording was interrupted, or the file was copied incompletely; all before is read.
    #[error("the file ends early: the recording was interrupted or the copy is incomplete; all before it is shown")]
    CutShort,
    /// Part of the file is damaged and was left out.
    #[error("the file is damaged from byte {offset} on: that part is left out")]
    Damaged {
        /// Byte at which that part starts.
        offset: usize,
    },
    /// Another program has compressed part of the file in a way that this one does not read; that part was left out.
    #[error("part of the file is compressed ({compression}) and left out: decompress it first, with `mcap decompress`")]
    Compressed {
        /// How.
        compression: String,
    },
    /// Messages of a topic that do not have the fields they should, and were left out.
    #[error("{messages} messages of {topic} cannot be read and are left out")]
    Unreadable {
        /// Which topic.
        topic: String,
        /// How many.
        messages: usize,
    },
}

/// A set point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Logged {
    /// How the number is meant.
    pub mode: Mode,
    /// rad or m; rad/s or m/s; share of the supply; V; 0 or 1. NaN where none was recorded.
    pub value: f64,
}

/// A motor channel at one moment. NaN stands for a number that was not finite, or that the channel does not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorSample {
    /// The board's clock, s.
    pub time_s: f64,
    /// What it follows.
    pub setpoint: Logged,
    /// Position as measured, in counts of [`ChannelInfo::resolution`].
    pub position_counts: i32,
    /// rad or m.
    pub position: f64,
    /// rad/s or m/s.
    pub speed: f64,
    /// Share of the supply at the bridge.
    pub duty: f64,
    /// In position mode: at the set point and at rest.
    pub settled: bool,
    /// Whether the position is known, and not only counted from where power came on.
    pub homed: bool,
    /// Heat of its winding, share of what it withstands.
    pub winding_heat: f64,
}

/// A motor channel over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorSeries {
    /// What the channel is.
    pub info: ChannelInfo,
    /// In order of time; at least one.
    pub samples: Vec<MotorSample>,
}

impl MotorSeries {
    /// Whether it moves in a line (m, m/s); otherwise it turns (rad, rad/s).
    #[must_use]
    pub fn is_linear(&self) -> bool {
        is_linear(&self.info)
    }
}

/// A channel that has one number, over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct ScalarSeries {
    /// What the channel is.
    pub info: ChannelInfo,
    /// Time (s) and value (the channel's unit; NaN where it was not finite), in order of time; at least one.
    pub samples: Vec<(f64, f64)>,
}

/// An input that can fail, at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadingSample {
    /// The board's clock, s.
    pub time_s: f64,
    /// The channel's unit; the last good one where `quality` is not [`Quality::Good`]. NaN where it was not finite.
    pub value: f64,
    /// Since it was measured.
    pub age_ms: u16,
    /// Whether it can be relied on.
    pub quality: Quality,
}

/// An input that can fail, over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadingSeries {
    /// What the channel is.
    pub info: ChannelInfo,
    /// In order of time; at least one.
    pub samples: Vec<ReadingSample>,
}

/// An encoder at one moment. NaN stands for a number that was not finite, or that the channel does not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderSample {
    /// The board's clock, s.
    pub time_s: f64,
    /// In counts of [`ChannelInfo::resolution`].
    pub position_counts: i32,
    /// rad
    pub position: f64,
    /// rad/s
    pub speed: f64,
    /// Transitions that no shaft makes, since power-up.
    pub illegal: u32,
}

/// An encoder over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderSeries {
    /// What the channel is.
    pub info: ChannelInfo,
    /// In order of time; at least one.
    pub samples: Vec<EncoderSample>,
}

/// A sensor that measures several numbers together, at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSample {
    /// The board's clock, s.
    pub time_s: f64,
    /// In the order and units of [`ChannelKind::quantities`](r4_protocol::ChannelKind::quantities); the last good ones where `quality` is
    /// not [`Quality::Good`]. NaN where one was not finite.
    pub values: Vec<f64>,
    /// Since they were measured.
    pub age_ms: u16,
    /// Whether they can be relied on.
    pub quality: Quality,
}

/// A sensor that measures several numbers together, over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorSeries {
    /// What the channel is.
    pub info: ChannelInfo,
    /// In order of time; at least one.
    pub samples: Vec<SensorSample>,
}

/// The safety supervisor from one moment on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StateChange {
    /// The board's clock, s.
    pub time_s: f64,
    /// Where it stands.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
}

/// A command that was sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoggedCommand {
    /// The board's clock, s.
    pub time_s: f64,
    /// Which channel.
    pub channel: ChannelId,
    /// To what.
    pub setpoint: Logged,
}

/// A request that the host sent: a set point, or anything else that is not only a question.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedRequest {
    /// The board's clock, s.
    pub time_s: f64,
    /// The host's clock, µs since it said hello; `None` in the first logs of this format.
    pub sent_us: Option<u64>,
    /// What. A set point's `sent_us` is `time_s`.
    pub request: Request,
}

impl std::fmt::Display for LoggedRequest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        Described(&self.request).fmt(f)
    }
}

/// A request that the board refused.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedRefusal {
    /// The board's clock, s.
    pub time_s: f64,
    /// What was asked, as in `set osmc0 position 1.5`.
    pub request: String,
    /// Why it was refused.
    pub reason: String,
}

/// A time without a link, after which the recording went on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Its end: when the board was heard again, s.
    pub time_s: f64,
    /// How long nothing was heard, by the host's clock.
    pub without_link_s: f64,
    /// Whether the board has restarted meanwhile: its clock began again at 0.
    pub restarted: bool,
    /// Times of the log minus the board's clock from here on. Only a restart changes it, so that times go on.
    pub clock_shift_us: i64,
}

impl std::fmt::Display for Gap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.restarted { "the board restarted" } else { "the board ran on" };
        write!(f, "{:.3} s without a link; {what}", self.without_link_s)
    }
}

/// A recorded run.
#[derive(Clone, Debug, PartialEq)]
pub struct Log {
    /// Which board was recorded.
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
    /// Everything the host asked for, those commands included, in the order in which it was sent; the first logs of this
    /// format hold nothing but the commands.
    pub requests: Vec<LoggedRequest>,
    /// What was refused, in order of time.
    pub refusals: Vec<LoggedRefusal>,
    /// Where the link was lost and came back, in order of time.
    pub gaps: Vec<Gap>,
    /// What could not be read; empty for a sound file.
    pub warnings: Vec<Warning>,
}

impl Log {
    /// Reads the file at `path`.
    ///
    /// # Errors
    /// [`LogError::Io`], and those of [`from_bytes`](Self::from_bytes).
    pub fn read(path: impl AsRef<Path>) -> Result<Self, LogError> {
        let path = path.as_ref();
        let bytes = fs::read(path).map_err(|source| LogError::Io { path: path.to_owned(), source })?;
        Self::from_bytes(&bytes)
    }

    /// Reads a file that is in memory.
    ///
    /// A file that is cut or damaged after its header gives what can be read, and [`warnings`](Self::warnings).
    ///
    /// # Errors
    /// A [`LogError`] when the file is no log, or ends before its header.
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
        // The summary repeats the topics, which a damaged chunk may have declared for all after it.
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
        reader.cut_short |= !reader.data_ended || !bytes.ends_with(MAGIC);
        reader.finish(bytes.len())
    }

    /// The samples of motor channel `id`.
    #[must_use]
    pub fn motor(&self, id: ChannelId) -> Option<&MotorSeries> {
        self.motors.iter().find(|series| series.info.id == id)
    }

    /// The samples of encoder `id`.
    #[must_use]
    pub fn encoder(&self, id: ChannelId) -> Option<&EncoderSeries> {
        self.encoders.iter().find(|series| series.info.id == id)
    }

    /// The samples of `id`, an input that can fail.
    #[must_use]
    pub fn reading(&self, id: ChannelId) -> Option<&ReadingSeries> {
        self.readings.iter().find(|series| series.info.id == id)
    }

    /// The samples of `id`, a sensor that measures several numbers together.
    #[must_use]
    pub fn sensor(&self, id: ChannelId) -> Option<&SensorSeries> {
        self.sensors.iter().find(|series| series.info.id == id)
    }

    /// The samples of `id`, a channel that has one number.
    #[must_use]
    pub fn scalar(&self, id: ChannelId) -> Option<&ScalarSeries> {
        self.scalars.iter().find(|series| series.info.id == id)
    }

    /// The board's clock at the first and at the last thing recorded, s; `None` for an empty log.
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

    /// How long the run was, s; 0 for an empty log.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.time_span_s().map_or(0.0, |(first, last)| last - first)
    }
}

/// What a topic's messages are.
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
    /// `None` for topics of other programs: a log may have been merged with them.
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
                    // no headers in chunks, so no error to pass on
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
        // the same channel is repeated in the summary, and may be in every chunk
        self.topics.entry(id).or_insert(Topic { name, content, unreadable: 0 });
    }

    fn message(&mut self, header: &MessageHeader, data: &[u8]) {
        // a message without its channel was in a chunk of its own that is damaged
        let Some(topic) = self.topics.get(&header.channel_id) else { return };
        let Some(content) = topic.content.clone() else { return };
        // exact up to 2^53 ns, 104 days; the nearest nanoseconds beyond
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
        // By the clock that told when each was sent; where that is not known, by the board's. Stable: the file's order
        // decides between equals.
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

/// The number recorded, or NaN where none was.
fn number(value: Option<f32>) -> f64 {
    value.map_or(f64::NAN, f64::from)
}
