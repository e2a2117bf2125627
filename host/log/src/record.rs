//! Writing of a log.

use std::{
    collections::BTreeMap,
    io::{self, Write},
};

use mcap::records::{MessageHeader, Metadata};
use r4_protocol::{Causes, ChannelId, ChannelInfo, Refusal, Request, SafetyState, Sample, Setpoint, Telemetry};
use serde::Serialize;

use crate::{
    derive::DerivedTopic,
    header::{self, Header},
    live::{Live, LiveTopic},
    message::{
        self, COMMAND_TOPIC, CommandMessage, EncoderMessage, GAP_TOPIC, GapMessage, MotorMessage, REFUSAL_TOPIC,
        REQUEST_TOPIC, STATE_TOPIC, ScalarMessage, Schema, SensorMessage, StateMessage, finite, is_linear,
        quality_name, state_name,
    },
    read::Gap,
    request::{self, RequestMessage},
    write::{McapTopic, McapWriter},
};

/// Error that ends a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A sample belongs to a channel that the header does not list; the rest of the frame was not recorded.
    #[error("the log's header does not describe {channel}: list every channel of the board when the recording starts")]
    UnknownChannel {
        /// Channel that the header lacks.
        channel: ChannelId,
    },
    /// The board's clock is beyond 64 bits of nanoseconds (584 years), which a log cannot hold.
    #[error("the board's clock says {device_us} us, which no log can hold: restart the board")]
    TimeOutOfRange {
        /// Time on the board's clock, µs.
        device_us: u64,
    },
    /// The file could not be written.
    #[error("cannot write the log ({0}): check the free space and the permissions of its folder")]
    Write(#[from] io::Error),
    /// The link now leads to another board, or the same board was given other channels.
    #[error("the board that answers now is not the one this log is of: record it to a log of its own")]
    OtherBoard,
    /// The recording has ended with an earlier error.
    #[error("the recording has ended")]
    Ended,
    /// A message could not be turned into JSON.
    #[error("cannot encode a message of the log ({0}): report this as a defect")]
    Encode(#[from] serde_json::Error),
}

/// Name of this library, which a log states in its header.
const LIBRARY: &str = concat!("r4-log/", env!("CARGO_PKG_VERSION"));

/// Topic of the file, with the number of its messages so far.
#[derive(Clone, Copy)]
struct Topic {
    id: u16,
    messages: u32,
}

/// Writes the messages of a board and of its host to an MCAP file.
///
/// A recorder that is dropped also finishes its file, but cannot report an error: call [`finish`](Self::finish).
pub struct Recorder<W: Write> {
    mcap: McapWriter<W>,
    channels: Vec<ChannelInfo>,
    /// Log time minus publish time, ns.
    offset_ns: i64,
    /// Publish times minus the board's clock, µs; changes when the board restarts.
    shift_us: i64,
    topics: BTreeMap<String, Topic>,
    state: Option<(SafetyState, Causes)>,
    live: Option<Box<dyn Live>>,
}

impl<W: Write> Recorder<W> {
    /// Starts a file with `header`. Give a [`std::io::BufWriter`] rather than a bare file.
    ///
    /// # Errors
    /// [`RecordError::Write`] if `writer` fails.
    pub fn new(writer: W, header: &Header) -> Result<Self, RecordError> {
        let metadata = Metadata { name: header::RECORD_NAME.to_owned(), metadata: header.to_metadata()? };
        let mcap = McapWriter::new(writer, "", LIBRARY, Some(metadata))?;
        let offset_ns = header.recorded.as_ref().and_then(|recorded| recorded.clock_offset_ns).unwrap_or_default();
        let channels = header.channels.clone();
        Ok(Self { mcap, channels, offset_ns, shift_us: 0, topics: BTreeMap::new(), state: None, live: None })
    }

    /// Also sends everything that is recorded from now on to `live`.
    #[must_use]
    pub fn with_live(mut self, live: Option<Box<dyn Live>>) -> Self {
        self.live = live;
        self
    }

    /// Records every sample of a frame, and the safety state if it has changed.
    ///
    /// # Errors
    /// Any [`RecordError`]; the samples before the faulty one are recorded.
    pub fn telemetry(&mut self, telemetry: &Telemetry) -> Result<(), RecordError> {
        let device_us = telemetry.device_us;
        // The state comes first, so that readers see it before the samples it applies to.
        self.state(device_us, telemetry.state, telemetry.causes)?;
        for sample in &telemetry.samples {
            let channel = sample.channel();
            let info = self.channels.iter().find(|info| info.id == channel);
            let info = info.ok_or(RecordError::UnknownChannel { channel })?;
            // Copied out, because `write` borrows the recorder mutably.
            let (unit, resolution, linear) = (info.unit, info.resolution, is_linear(info));
            let topic = format!("/{channel}");
            // Position in rad or m; `None` for a channel without a resolution.
            let measured = |counts: i32| {
                let position = f64::from(counts) * f64::from(resolution);
                (resolution.is_finite() && resolution != 0.0).then_some(position)
            };
            match *sample {
                Sample::Motor { setpoint, position, speed, duty, settled, homed, winding, .. } => {
                    let measured = measured(position);
                    let message = MotorMessage {
                        position_counts: position,
                        position_rad: measured.filter(|_| !linear),
                        position_m: measured.filter(|_| linear),
                        speed_rad_s: finite(speed).filter(|_| !linear),
                        speed_m_s: finite(speed).filter(|_| linear),
                        duty: finite(duty),
                        settled,
                        homed,
                        winding_heat: winding.map(|winding| f32::from(winding.heat_percent) / 100.0),
                        ..MotorMessage::default()
                    };
                    let message = message.with_setpoint(setpoint, linear);
                    self.write(device_us, &topic, || message::motor_schema(linear), &message)?;
                }
                Sample::Scalar { value, .. } => {
                    let message = ScalarMessage::new(unit, value);
                    self.write(device_us, &topic, || message::scalar_schema(unit), &message)?;
                }
                Sample::Reading { value, age_ms, quality, .. } => {
                    let mut message = ScalarMessage::new(unit, value);
                    (message.age_ms, message.quality) = (Some(age_ms), Some(quality_name(quality)));
                    self.write(device_us, &topic, || message::reading_schema(unit), &message)?;
                }
                Sample::Encoder { position, speed, illegal, .. } => {
                    let (position_rad, speed_rad_s) = (measured(position), finite(speed));
                    let message = EncoderMessage { position_counts: position, position_rad, speed_rad_s, illegal };
                    self.write(device_us, &topic, message::encoder_schema, &message)?;
                }
                Sample::Sensor { values, age_ms, quality, .. } => {
                    let message = SensorMessage::new(channel.kind, &values, age_ms, quality);
                    self.write(device_us, &topic, || message::sensor_schema(channel.kind), &message)?;
                }
            }
        }
        Ok(())
    }

    /// Records a set point that was sent to `channel`, without the time on the host's clock.
    ///
    /// # Errors
    /// Any [`RecordError`].
    pub fn command(&mut self, device_us: u64, channel: ChannelId, setpoint: Setpoint) -> Result<(), RecordError> {
        self.set(device_us, None, channel, setpoint)
    }

    /// Records a request that the host sent; `sent_us` is the time on the host's clock since its hello, µs. Requests
    /// that only read the board's identity, parameters or memory of faults are not recorded.
    ///
    /// # Errors
    /// Any [`RecordError`].
    pub fn request(&mut self, device_us: u64, sent_us: Option<u64>, request: &Request) -> Result<(), RecordError> {
        if let Request::Set { channel, setpoint, .. } = *request {
            return self.set(device_us, sent_us, channel, setpoint);
        }
        let Some(mut message) = RequestMessage::new(request) else { return Ok(()) };
        message.sent_us = sent_us;
        self.write(device_us, REQUEST_TOPIC, request::request_schema, &message)
    }

    /// Records that the board refused a request, with the reason.
    ///
    /// # Errors
    /// Any [`RecordError`].
    pub fn refusal(&mut self, device_us: u64, request: &Request, reason: &Refusal) -> Result<(), RecordError> {
        self.write(device_us, REFUSAL_TOPIC, request::refusal_schema, &request::refusal(request, reason))
    }

    fn set(
        &mut self,
        device_us: u64,
        sent_us: Option<u64>,
        channel: ChannelId,
        setpoint: Setpoint,
    ) -> Result<(), RecordError> {
        let linear = self.channels.iter().any(|info| info.id == channel && is_linear(info));
        let channel = channel.to_string();
        let message = CommandMessage { channel: &channel, sent_us, ..CommandMessage::default() };
        let message = message.with_setpoint(setpoint, linear);
        self.write(device_us, COMMAND_TOPIC, message::command_schema, &message)
    }

    /// Records the state of the safety supervisor if it differs from the last one recorded.
    ///
    /// # Errors
    /// Any [`RecordError`].
    pub fn state(&mut self, device_us: u64, state: SafetyState, causes: Causes) -> Result<(), RecordError> {
        if self.state == Some((state, causes)) {
            return Ok(());
        }
        let message = StateMessage {
            state: state_name(state),
            causes: causes.iter().map(|cause| cause.to_string()).collect(),
            causes_bits: causes.bits(),
        };
        self.write(device_us, STATE_TOPIC, message::state_schema, &message)?;
        self.state = Some((state, causes));
        Ok(())
    }

    /// Records that the link was lost and is back, with the board's clock at `device_us`. From here on times are that
    /// clock plus `gap.clock_shift_us`; `gap.time_s` is not used.
    ///
    /// # Errors
    /// Any [`RecordError`].
    pub fn gap(&mut self, device_us: u64, gap: &Gap) -> Result<(), RecordError> {
        self.shift_us = gap.clock_shift_us;
        // The state may have changed without a link, so the next one is recorded even if it is equal.
        self.state = None;
        let Gap { without_link_s, restarted, clock_shift_us, .. } = *gap;
        let message = GapMessage { without_link_s, restarted, clock_shift_us };
        self.write(device_us, GAP_TOPIC, message::gap_schema, &message)
    }

    /// Returns the board's channels as the header lists them.
    pub(crate) fn channels(&self) -> &[ChannelInfo] {
        &self.channels
    }

    /// Writes the index at the end of the file and returns the writer.
    ///
    /// # Errors
    /// [`RecordError::Write`] if the writer fails.
    pub fn finish(self) -> Result<W, RecordError> {
        Ok(self.mcap.finish()?)
    }

    /// Records a message that was derived from the frame of `device_us`.
    ///
    /// # Errors
    /// Any [`RecordError`].
    pub fn derived(&mut self, device_us: u64, topic: DerivedTopic, json: Vec<u8>) -> Result<(), RecordError> {
        let schema = || Schema { name: topic.schema.to_owned(), json: (topic.json_schema)() };
        self.write_json(device_us, topic.name, schema, json)
    }

    fn write(
        &mut self,
        device_us: u64,
        name: &str,
        schema: impl FnOnce() -> Schema,
        message: &impl Serialize,
    ) -> Result<(), RecordError> {
        let data = serde_json::to_vec(message)?;
        self.write_json(device_us, name, schema, data)
    }

    /// Publish and log time of a moment on the board's clock, ns.
    pub(crate) fn times_ns(&self, device_us: u64) -> Result<(u64, u64), RecordError> {
        let out_of_range = RecordError::TimeOutOfRange { device_us };
        // Publish times continue across a restart of the board's clock.
        let publish_us = device_us.checked_add_signed(self.shift_us);
        let Some(publish_time) = publish_us.and_then(|us| us.checked_mul(1_000)) else { return Err(out_of_range) };
        let Some(log_time) = publish_time.checked_add_signed(self.offset_ns) else { return Err(out_of_range) };
        Ok((publish_time, log_time))
    }

    fn write_json(
        &mut self,
        device_us: u64,
        name: &str,
        schema: impl FnOnce() -> Schema,
        data: Vec<u8>,
    ) -> Result<(), RecordError> {
        let (publish_time, log_time) = self.times_ns(device_us)?;
        let topic = match self.topics.get_mut(name) {
            Some(topic) => topic,
            None => {
                let schema = schema();
                let id = self.mcap.topic(&McapTopic {
                    name,
                    schema: &schema.name,
                    schema_encoding: "jsonschema",
                    schema_text: &schema.json,
                    encoding: "json",
                    metadata: &[],
                })?;
                if let Some(live) = &mut self.live {
                    live.topic(&LiveTopic { number: id, name, schema: &schema.name, json_schema: &schema.json });
                }
                self.topics.entry(name.to_owned()).or_insert(Topic { id, messages: 0 })
            }
        };
        let header = MessageHeader { channel_id: topic.id, sequence: topic.messages, log_time, publish_time };
        topic.messages = topic.messages.wrapping_add(1);
        if let Some(live) = &mut self.live {
            live.message(header.channel_id, log_time, &data);
        }
        Ok(self.mcap.message(&header, &data)?)
    }
}
