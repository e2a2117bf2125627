//! A small run for the tests.
#![allow(clippy::unwrap_used, reason = "test code")]
#![allow(dead_code, reason = "not every test needs everything")]

use std::{
    collections::BTreeMap,
    io::{Cursor, Read},
};

use mcap::{
    records::{MessageHeader, Record},
    sans_io::{
        LinearReadEvent, LinearReader, LinearReaderOptions,
        decompressor::{DecompressResult, Decompressor},
    },
};
use r4_log::{Header, Recorder};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelInfo, ChannelKind, Mode, ModeInfo, Quality, Range, SafetyState, Sample, Setpoint,
    Telemetry, Unit, Winding,
};

pub(crate) const OSMC: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
pub(crate) const ACTUATOR: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);
pub(crate) const DHB: ChannelId = ChannelId::new(ChannelKind::Dhb, 2);
pub(crate) const SUPPLY: ChannelId = ChannelId::new(ChannelKind::Supply, 0);
pub(crate) const SWITCH: ChannelId = ChannelId::new(ChannelKind::Switch, 3);
pub(crate) const ENCODER: ChannelId = ChannelId::new(ChannelKind::Encoder, 4);
pub(crate) const IMU: ChannelId = ChannelId::new(ChannelKind::Imu, 0);
pub(crate) const RANGE: ChannelId = ChannelId::new(ChannelKind::Range, 5);

pub(crate) fn header() -> Header {
    let channel = |id, unit, range, resolution, modes: &[(Mode, Unit, Range)]| ChannelInfo {
        id,
        unit,
        range,
        rate_hz: 1_000.0,
        resolution,
        modes: modes.iter().map(|&(mode, unit, range)| ModeInfo { mode, unit, range }).collect(),
    };
    let duty = (Mode::Duty, Unit::Duty, Range::symmetric(0.9));
    Header {
        robot: "bench \"A\"".into(),
        board: "sim:osmc-bench".into(),
        firmware: "0.1.0".into(),
        protocol_version: r4_protocol::VERSION,
        channels: vec![
            channel(
                OSMC,
                Unit::Rad,
                Range::symmetric(f32::INFINITY),
                0.001,
                &[(Mode::Position, Unit::Rad, Range::symmetric(f32::INFINITY)), duty],
            ),
            channel(
                ACTUATOR,
                Unit::M,
                Range::new(0.0, 0.1),
                0.000_1,
                &[
                    (Mode::Position, Unit::M, Range::new(0.0, 0.1)),
                    (Mode::Speed, Unit::MPerS, Range::symmetric(0.02)),
                    duty,
                ],
            ),
            channel(DHB, Unit::Duty, Range::symmetric(0.9), 0.0, &[duty]),
            channel(SUPPLY, Unit::V, Range::new(0.0, 30.0), 0.0, &[]),
            channel(SWITCH, Unit::Bool, Range::new(0.0, 1.0), 0.0, &[]),
            channel(ENCODER, Unit::Rad, Range::symmetric(f32::MAX), 0.01, &[]),
            channel(RANGE, Unit::M, Range::new(0.02, 4.0), 0.0, &[]),
            channel(IMU, Unit::MPerS2, Range::symmetric(39.2), 0.0, &[]),
        ],
        seed: Some(7),
        recorded: None,
    }
}

/// Records twenty frames of every channel, an arming, a trip and two commands.
pub(crate) fn run() -> Vec<u8> {
    run_every(1)
}

/// Records the same run with `period_us` between the frames, µs.
pub(crate) fn run_every(period_us: u64) -> Vec<u8> {
    let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header()).unwrap();
    recorder.state(500, SafetyState::Disarmed, Causes::NONE).unwrap();
    recorder.command(900, OSMC, Setpoint { mode: Mode::Position, value: 1.5 }).unwrap();
    recorder.command(950, ACTUATOR, Setpoint { mode: Mode::Speed, value: -0.01 }).unwrap();
    for tick in 1..=20_i16 {
        let motor = |channel, mode, value| Sample::Motor {
            channel,
            setpoint: Setpoint { mode, value },
            position: i32::from(tick) * 7,
            speed: 0.25,
            duty: f32::from(tick) / 30.0,
            settled: tick > 15,
            homed: tick > 10,
            winding: (channel == OSMC).then_some(Winding { heat_percent: 80 + tick as u8, hot: true }),
        };
        let (state, causes) = match tick {
            ..18 => (SafetyState::Armed, Causes::NONE),
            18.. => (SafetyState::Tripped, Causes::only(Cause::DeadMan)),
        };
        let samples = [
            motor(OSMC, Mode::Position, 1.5),
            motor(ACTUATOR, Mode::Speed, -0.01),
            motor(DHB, Mode::Duty, 0.5),
            Sample::Scalar { channel: SUPPLY, value: 24.5 },
            Sample::Scalar { channel: SWITCH, value: f32::from(tick % 2) },
            Sample::Encoder { channel: ENCODER, position: -i32::from(tick), speed: -1.5, illegal: 3 },
            Sample::Reading {
                channel: RANGE,
                value: 0.75,
                age_ms: tick.unsigned_abs(),
                quality: if tick > 10 { Quality::NoAnswer } else { Quality::Good },
            },
        ];
        let device_us = u64::from(tick.unsigned_abs()) * period_us;
        recorder.telemetry(&Telemetry { device_us, state, causes, samples: samples.into_iter().collect() }).unwrap();
    }
    recorder.finish().unwrap().into_inner()
}

/// Message as read by the reader of the `mcap` crate.
pub(crate) struct Message {
    pub(crate) topic: String,
    pub(crate) encoding: String,
    /// Encoding and content of the schema.
    pub(crate) schema: (String, Vec<u8>),
    pub(crate) header: MessageHeader,
    pub(crate) data: Vec<u8>,
}

/// Reads the messages of `file` with the reader of the `mcap` crate, which checks every length and checksum.
pub(crate) fn messages(file: &[u8]) -> Vec<Message> {
    let options = LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true)
        .with_check_finishes_after_end_magic(true);
    let mut reader = LinearReader::new_with_options(options);
    reader.add_decompressor(Lz4::default()).unwrap();
    let (mut rest, mut schemas, mut channels) = (file, BTreeMap::new(), BTreeMap::new());
    let mut messages = Vec::new();
    while let Some(event) = reader.next_event() {
        match event.unwrap() {
            LinearReadEvent::ReadRequest(need) => {
                let len = need.min(rest.len());
                reader.insert(len).copy_from_slice(&rest[..len]);
                reader.notify_read(len);
                rest = &rest[len..];
            }
            LinearReadEvent::Record { data, opcode } => match mcap::parse_record(opcode, data).unwrap() {
                Record::Schema { header, data } => {
                    schemas.insert(header.id, (header.encoding, data.into_owned()));
                }
                Record::Channel(channel) => {
                    channels.insert(channel.id, channel);
                }
                Record::Message { header, data } => {
                    let channel = &channels[&header.channel_id];
                    messages.push(Message {
                        topic: channel.topic.clone(),
                        encoding: channel.message_encoding.clone(),
                        schema: schemas[&channel.schema_id].clone(),
                        header,
                        data: data.into_owned(),
                    });
                }
                _ => {}
            },
        }
    }
    messages
}

/// LZ4 decompressor for that reader, which has none without a C library.
#[derive(Default)]
struct Lz4 {
    compressed: Vec<u8>,
    plain: Vec<u8>,
    given: usize,
}

impl Decompressor for Lz4 {
    fn next_read_size(&self) -> usize {
        0
    }

    fn decompress(&mut self, src: &[u8], dst: &mut [u8]) -> mcap::McapResult<DecompressResult> {
        if !src.is_empty() {
            self.compressed.extend(src);
            self.plain.clear();
            // Input without the end of the frame yields what is there so far.
            let _ = lz4_flex::frame::FrameDecoder::new(&self.compressed[..]).read_to_end(&mut self.plain);
        }
        let new = &self.plain[self.given..];
        let wrote = new.len().min(dst.len());
        dst[..wrote].copy_from_slice(&new[..wrote]);
        self.given += wrote;
        Ok(DecompressResult { consumed: src.len(), wrote })
    }

    fn reset(&mut self) -> mcap::McapResult<()> {
        *self = Self::default();
        Ok(())
    }

    fn name(&self) -> &'static str {
        "lz4"
    }
}
