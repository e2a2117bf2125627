//! Tests that a log reads back as it was recorded.
#![allow(clippy::unwrap_used, reason = "test code")]

use std::{fs, io::Cursor};

use crate::common::{ACTUATOR, DHB, ENCODER, IMU, OSMC, RANGE, SUPPLY, SWITCH, header, messages, run};
use mcap::records::op;
use proptest::{collection::vec, prelude::*};
use r4_log::{Log, McapTopic, McapWriter, RecordError, Recorder};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, Mode, Quality, SafetyState, Sample, Setpoint, Telemetry, Winding,
};

#[test]
fn every_kind_of_message_comes_back() {
    let log = Log::from_bytes(&run()).unwrap();
    assert_eq!(log.header, header());
    assert_eq!(log.warnings, []);

    let motors: Vec<_> = log.motors.iter().map(|series| series.info.id).collect();
    assert_eq!(motors, [OSMC, ACTUATOR, DHB]);
    let last = log.motor(OSMC).unwrap().samples[19];
    assert_eq!((last.position_counts, last.setpoint.mode), (140, Mode::Position));
    assert!(last.settled && last.homed && !log.motor(OSMC).unwrap().samples[0].homed);
    assert_eq!((last.time_s, last.setpoint.value, last.speed), (20e-6, 1.5, 0.25));
    // The resolution is an `f32` on the wire, hence not exactly 0.001.
    assert_eq!(last.position, 140.0 * f64::from(0.001_f32));
    assert!(log.motor(ACTUATOR).unwrap().is_linear());
    assert_eq!(log.motor(ACTUATOR).unwrap().samples[0].position, 7.0 * f64::from(0.000_1_f32));
    assert!(log.motor(DHB).unwrap().samples[0].position.is_nan(), "a channel without resolution has no position");

    assert_eq!(log.scalar(SUPPLY).unwrap().samples[0], (1e-6, 24.5));
    assert_eq!(log.scalar(SWITCH).unwrap().samples[..2], [(1e-6, 1.0), (2e-6, 0.0)]);

    let encoder = log.encoder(ENCODER).unwrap().samples[19];
    assert_eq!((encoder.position_counts, encoder.speed, encoder.illegal), (-20, -1.5, 3));
    assert_eq!((encoder.time_s, encoder.position), (20e-6, -20.0 * f64::from(0.01_f32)));
    let range = &log.reading(RANGE).unwrap().samples;
    assert_eq!((range[9].time_s, range[9].value, range[9].age_ms, range[9].quality), (10e-6, 0.75, 10, Quality::Good));
    assert_eq!((range[10].value, range[10].quality), (0.75, Quality::NoAnswer));

    let states: Vec<_> = log.states.iter().map(|change| change.state).collect();
    assert_eq!(states, [SafetyState::Armed, SafetyState::Tripped, SafetyState::Disarmed], "in order of time");
    assert!(log.states[1].causes.contains(Cause::DeadMan));
    assert_eq!(log.states[1].causes.bits(), 0x0001);

    assert_eq!(log.commands.len(), 2);
    assert_eq!((log.commands[1].channel, log.commands[1].setpoint.mode), (ACTUATOR, Mode::Speed));
    assert_eq!(log.time_span_s(), Some((1e-6, 950e-6)));
}

/// The field names are a contract with the layouts that people keep in their viewers.
#[test]
fn messages_have_units_in_their_names_and_follow_their_schema() {
    let file = run();
    let summary = mcap::Summary::read(&file).unwrap().unwrap();
    let mut first = std::collections::BTreeMap::new();
    for message in messages(&file) {
        assert_eq!(message.header.log_time, message.header.publish_time);
        let fields: serde_json::Value = serde_json::from_slice(&message.data).unwrap();
        assert_eq!((message.schema.0.as_str(), message.encoding.as_str()), ("jsonschema", "json"));
        let schema: serde_json::Value = serde_json::from_slice(&message.schema.1).unwrap();
        for (name, value) in fields.as_object().unwrap() {
            let fits = match schema["properties"][name]["type"].as_str().unwrap() {
                "string" => value.is_string(),
                "number" => value.is_number(),
                "integer" => value.is_i64(),
                "boolean" => value.is_boolean(),
                "array" => value.is_array(),
                other => panic!("{other}"),
            };
            assert!(fits, "{name}: {value}");
        }
        first.entry(message.topic).or_insert_with(|| String::from_utf8(message.data).unwrap());
    }
    assert_eq!(summary.stats.unwrap().message_count, 3 + 2 + 20 * 7);
    let expected = [
        (
            "/actuator1",
            r#"{"setpoint_mode":"speed","setpoint_speed_m_s":-0.01,"position_counts":7,"position_m":0.0006999999823165126,"speed_m_s":0.25,"duty":0.033333335,"settled":false,"homed":false}"#,
        ),
        ("/command", r#"{"channel":"osmc0","setpoint_mode":"position","setpoint_position_rad":1.5}"#),
        (
            "/dhb2",
            r#"{"setpoint_mode":"duty","setpoint_duty":0.5,"position_counts":7,"speed_rad_s":0.25,"duty":0.033333335,"settled":false,"homed":false}"#,
        ),
        ("/encoder4", r#"{"position_counts":-1,"position_rad":-0.009999999776482582,"speed_rad_s":-1.5,"illegal":3}"#),
        (
            "/osmc0",
            r#"{"setpoint_mode":"position","setpoint_position_rad":1.5,"position_counts":7,"position_rad":0.007000000332482159,"speed_rad_s":0.25,"duty":0.033333335,"settled":false,"homed":false,"winding_heat":0.81}"#,
        ),
        ("/range5", r#"{"distance_m":0.75,"age_ms":1,"quality":"good"}"#),
        ("/state", r#"{"state":"disarmed","causes":[],"causes_bits":0}"#),
        ("/supply0", r#"{"voltage_v":24.5}"#),
        ("/switch3", r#"{"on":true}"#),
    ];
    assert!(first.iter().map(|(topic, json)| (topic.as_str(), json.as_str())).eq(expected), "{first:#?}");
}

#[test]
fn two_identical_runs_make_identical_bytes() {
    assert_eq!(run(), run());
}

#[test]
fn a_file_is_read_from_its_path() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    fs::write(&path, run()).unwrap();
    let log = Log::read(&path).unwrap();
    assert_eq!((log.header, log.warnings, log.commands.len()), (header(), vec![], 2));
    let missing = Log::read(folder.path().join("none.mcap")).unwrap_err();
    assert!(missing.to_string().contains("none.mcap"), "{missing}");
}

#[test]
fn a_channel_that_the_header_does_not_describe_is_refused() {
    let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header()).unwrap();
    let channel = ChannelId::new(ChannelKind::Servo, 3);
    let samples = [Sample::Scalar { channel, value: 0.0 }].into_iter().collect();
    let frame = Telemetry { device_us: 0, state: SafetyState::Armed, causes: Causes::NONE, samples };
    assert!(matches!(recorder.telemetry(&frame), Err(RecordError::UnknownChannel { channel: c }) if c == channel));
    assert!(matches!(
        recorder.state(u64::MAX, SafetyState::Disarmed, Causes::NONE),
        Err(RecordError::TimeOutOfRange { device_us: u64::MAX })
    ));
}

/// Chunks are closed when they are full or a second long; every chunk must be found by its index.
#[test]
fn a_long_run_has_several_chunks() {
    // Each sample is about 50 bytes: 5243 per chunk by size, 1000 by time.
    for (period_us, chunks) in [(1, 4), (1_000, 20)] {
        let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header()).unwrap();
        for sample in 0..20_000 {
            let (device_us, state, causes) = (sample * period_us, SafetyState::Armed, Causes::NONE);
            let samples = [Sample::Scalar { channel: SUPPLY, value: sample as f32 }].into_iter().collect();
            recorder.telemetry(&Telemetry { device_us, state, causes, samples }).unwrap();
        }
        let file = recorder.finish().unwrap().into_inner();
        let summary = mcap::Summary::read(&file).unwrap().unwrap();
        assert_eq!(summary.chunk_indexes.len(), chunks);
        assert_eq!((summary.stats.unwrap().message_count, messages(&file).len()), (20_001, 20_001));
        // Each index must point to a record of the declared kind.
        for index in &summary.chunk_indexes {
            assert_eq!(file[index.chunk_start_offset as usize], op::CHUNK);
            for (channel, offset) in &index.message_index_offsets {
                let at = *offset as usize;
                assert_eq!((file[at], &file[at + 9..at + 11]), (op::MESSAGE_INDEX, &channel.to_le_bytes()[..]));
            }
        }
        let log = Log::from_bytes(&file).unwrap();
        assert_eq!(log.warnings, []);
        assert!(log.scalar(SUPPLY).unwrap().samples.iter().enumerate().all(|(i, sample)| sample.1 == i as f64));
    }
}

fn modes() -> impl Strategy<Value = Mode> {
    prop_oneof![
        Just(Mode::Position),
        Just(Mode::Speed),
        Just(Mode::Duty),
        Just(Mode::Switch),
        Just(Mode::Voltage),
        Just(Mode::Brake),
        Just(Mode::Home),
    ]
}

fn qualities() -> impl Strategy<Value = Quality> {
    prop_oneof![
        Just(Quality::Good),
        Just(Quality::None),
        Just(Quality::OutOfRange),
        Just(Quality::NoAnswer),
        Just(Quality::Stuck),
        Just(Quality::Low),
        Just(Quality::High),
        Just(Quality::Stale),
        Just(Quality::WrongChip),
        Just(Quality::Saturated),
    ]
}

/// Floats of any bit pattern, NaN and the infinities included.
fn floats() -> impl Strategy<Value = f32> {
    any::<u32>().prop_map(f32::from_bits)
}

fn motors() -> impl Strategy<Value = Sample> {
    (any::<bool>(), modes(), floats(), any::<i32>(), floats(), floats(), any::<[bool; 2]>(), any::<Option<u8>>())
        .prop_map(|(linear, mode, value, position, speed, duty, [settled, homed], heat)| {
            let channel = if linear { ACTUATOR } else { OSMC };
            let winding = heat.map(|heat_percent| Winding { heat_percent, hot: heat_percent > 80 });
            Sample::Motor {
                channel,
                setpoint: Setpoint { mode, value },
                position,
                speed,
                duty,
                settled,
                homed,
                winding,
            }
        })
}

fn samples() -> impl Strategy<Value = Sample> {
    prop_oneof![
        motors(),
        floats().prop_map(|value| Sample::Scalar { channel: SUPPLY, value }),
        (floats(), any::<u16>(), qualities()).prop_map(|(value, age_ms, quality)| Sample::Reading {
            channel: RANGE,
            value,
            age_ms,
            quality
        }),
        (proptest::array::uniform6(floats()), any::<u16>(), qualities())
            .prop_map(|(values, age_ms, quality)| { Sample::Sensor { channel: IMU, values, age_ms, quality } }),
        (any::<i32>(), floats(), any::<u32>()).prop_map(|(position, speed, illegal)| Sample::Encoder {
            channel: ENCODER,
            position,
            speed,
            illegal
        }),
    ]
}

/// Returns the number as a log holds it: NaN for what JSON cannot hold.
fn logged(value: f32) -> f64 {
    if value.is_finite() { f64::from(value) } else { f64::NAN }
}

fn same(a: f64, b: f64) -> bool {
    a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
}

proptest! {
    #[test]
    fn any_telemetry_comes_back_to_the_last_bit(
        frames in vec((0..10_000_000_u64, vec(samples(), 0..8), any::<u16>()), 0..40)
    ) {
        let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header()).unwrap();
        let mut device_us = 0;
        let (mut written, mut states) = (Vec::new(), Vec::new());
        for (pause_us, samples, bits) in &frames {
            device_us += pause_us;
            let time_s = (device_us * 1_000) as f64 / 1e9;
            let (state, causes) = (SafetyState::Armed, Causes::from_bits((*bits).into()));
            recorder.telemetry(&Telemetry { device_us, state, causes, samples: samples.iter().copied().collect() })
                .unwrap();
            written.extend(samples.iter().map(|sample| (time_s, *sample)));
            if states.last().is_none_or(|(_, last)| *last != causes) {
                states.push((time_s, causes));
            }
        }
        let log = Log::from_bytes(&recorder.finish().unwrap().into_inner()).unwrap();
        prop_assert!(log.warnings.is_empty(), "{:?}", log.warnings);
        prop_assert!(log.states.iter().map(|change| (change.time_s, change.causes)).eq(states));
        let of = |id| written.iter().filter(move |(_, sample)| sample.channel() == id);
        for (id, resolution) in [(OSMC, 0.001_f32), (ACTUATOR, 0.000_1)] {
            let read = log.motor(id).map_or(&[][..], |series| &series.samples);
            prop_assert_eq!(read.len(), of(id).count());
            for (read, (time_s, written)) in read.iter().zip(of(id)) {
                let Sample::Motor { setpoint, position, speed, duty, settled, homed, winding, .. } = *written else {
                    unreachable!()
                };
                prop_assert_eq!((read.time_s, read.position_counts), (*time_s, position));
                prop_assert_eq!((read.settled, read.homed), (settled, homed));
                prop_assert_eq!(read.position, f64::from(position) * f64::from(resolution));
                prop_assert_eq!(read.setpoint.mode, setpoint.mode);
                prop_assert!(same(read.setpoint.value, logged(setpoint.value)));
                let heat = winding.map_or(f64::NAN, |winding| f64::from(f32::from(winding.heat_percent) / 100.0));
                prop_assert!(same(read.winding_heat, heat));
                prop_assert!(same(read.speed, logged(speed)) && same(read.duty, logged(duty)));
            }
        }
        let read = log.scalar(SUPPLY).map_or(&[][..], |series| &series.samples);
        prop_assert_eq!(read.len(), of(SUPPLY).count());
        for (read, (time_s, written)) in read.iter().zip(of(SUPPLY)) {
            let Sample::Scalar { value, .. } = *written else { unreachable!() };
            prop_assert!(read.0 == *time_s && same(read.1, logged(value)));
        }
        let read = log.reading(RANGE).map_or(&[][..], |series| &series.samples);
        prop_assert_eq!(read.len(), of(RANGE).count());
        for (read, (time_s, written)) in read.iter().zip(of(RANGE)) {
            let Sample::Reading { value, age_ms, quality, .. } = *written else { unreachable!() };
            prop_assert_eq!((read.time_s, read.age_ms, read.quality), (*time_s, age_ms, quality));
            prop_assert!(same(read.value, logged(value)));
        }
        let read = log.sensor(IMU).map_or(&[][..], |series| &series.samples);
        prop_assert_eq!(read.len(), of(IMU).count());
        for (read, (time_s, written)) in read.iter().zip(of(IMU)) {
            let Sample::Sensor { values, age_ms, quality, .. } = *written else { unreachable!() };
            prop_assert_eq!((read.time_s, read.age_ms, read.quality), (*time_s, age_ms, quality));
            prop_assert!(read.values.iter().zip(values).all(|(read, value)| same(*read, logged(value))));
            prop_assert_eq!(read.values.len(), values.len());
        }
        let read = log.encoder(ENCODER).map_or(&[][..], |series| &series.samples);
        prop_assert_eq!(read.len(), of(ENCODER).count());
        for (read, (time_s, written)) in read.iter().zip(of(ENCODER)) {
            let Sample::Encoder { position, speed, illegal, .. } = *written else { unreachable!() };
            prop_assert_eq!((read.time_s, read.position_counts, read.illegal), (*time_s, position, illegal));
            prop_assert_eq!(read.position, f64::from(position) * f64::from(0.01_f32));
            prop_assert!(same(read.speed, logged(speed)));
        }
    }
}

/// Numbers of topics have 16 bits and begin at 0; those of schemas begin at 1, because 0 means "no schema" (MCAP
/// specification, Channel).
#[test]
fn a_log_takes_as_many_topics_and_schemas_as_their_numbers_allow() {
    let declared = |is_schema_each: bool| {
        let mut log = McapWriter::new(std::io::sink(), "", "", None).unwrap();
        let mut declare = |number: u32| {
            let name = number.to_string();
            let schema: &str = if is_schema_each { &name } else { "one" };
            log.topic(&McapTopic {
                name: &name,
                schema,
                schema_encoding: "jsonschema",
                schema_text: "{}",
                encoding: "json",
                metadata: &[],
            })
        };
        let taken = (0..=70_000).map_while(|number| declare(number).ok()).count();
        (taken, declare(70_000).unwrap_err().to_string())
    };
    assert_eq!(declared(false), (65_536, "a log holds at most 65536 topics".to_owned()));
    assert_eq!(declared(true), (65_535, "a log holds at most 65535 schemas".to_owned()));
}
