//! Files that are cut, damaged or of another program.
#![allow(clippy::unwrap_used, reason = "test code")]

use std::{collections::BTreeMap, io::Cursor};

use crate::common::{OSMC, header, run};
use mcap::records::{MessageHeader, Metadata};
use proptest::prelude::*;
use r4_log::{Log, LogError, Recorder, Warning};
use r4_protocol::{Causes, SafetyState};

#[test]
fn a_file_cut_anywhere_gives_an_error_or_what_was_before() {
    let file = run();
    let whole = Log::from_bytes(&file).unwrap();
    let mut samples = 0;
    for length in 0..file.len() {
        match Log::from_bytes(&file[..length]) {
            Err(LogError::Empty) => assert_eq!(length, 0),
            Err(LogError::CutShort { length: said }) => assert!(said == length && samples == 0),
            Err(other) => panic!("{length}: {other}"),
            Ok(log) => {
                assert_eq!(log.warnings, [Warning::CutShort], "{length}");
                let read = log.motor(OSMC).map_or(&[][..], |series| &series.samples);
                assert!(read.len() >= samples, "a longer file gives no less");
                assert_eq!(read, &whole.motor(OSMC).unwrap().samples[..read.len()]);
                samples = read.len();
            }
        }
    }
    assert_eq!(samples, 20);
}

/// What is on disk when the recording program is killed: the chunk's lengths are not filled in yet.
#[test]
fn an_unfinished_chunk_is_read() {
    struct Killed<'a>(&'a mut Cursor<Vec<u8>>, usize);
    impl std::io::Write for Killed<'_> {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            if self.0.get_ref().len() > self.1 {
                Err(std::io::ErrorKind::StorageFull.into())
            } else {
                self.0.write(bytes)
            }
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    impl std::io::Seek for Killed<'_> {
        fn seek(&mut self, to: std::io::SeekFrom) -> std::io::Result<u64> {
            self.0.seek(to)
        }
    }
    let mut disk = Cursor::new(Vec::new());
    let mut recorder = Recorder::new(Killed(&mut disk, 5_000), &header()).unwrap();
    let mut written = 0;
    while recorder.state(written, SafetyState::Armed, Causes::from_bits(written as u16)).is_ok() {
        written += 1;
    }
    let full = recorder.finish().err().map(|error| error.to_string()).unwrap_or_default();
    assert!(full.contains("free space"), "{full}");
    let log = Log::from_bytes(disk.get_ref()).unwrap();
    assert_eq!(log.warnings, [Warning::CutShort]);
    assert!(log.states.len() as u64 >= written - 1 && written > 20, "{} of {written}", log.states.len());
}

#[test]
fn a_flipped_bit_is_found_and_its_chunk_left_out() {
    let mut file = run();
    let at = file.windows(8).position(|bytes| bytes == b"position").unwrap();
    let number = at + file[at..].windows(4).position(|bytes| bytes == b":1.5").unwrap() + 1;
    file[number] = b'7';
    let log = Log::from_bytes(&file).unwrap();
    assert!(matches!(log.warnings[..], [Warning::Damaged { .. }]), "{:?}", log.warnings);
    assert!(log.motors.is_empty() && log.states.is_empty(), "no number from a damaged chunk");
}

#[test]
fn what_is_not_a_log_is_named() {
    assert!(matches!(Log::from_bytes(b""), Err(LogError::Empty)));
    for bytes in [&b"time_s,duty\n0.0,0.5\n"[..], &run()[1..]] {
        assert!(matches!(Log::from_bytes(bytes), Err(LogError::NotMcap)));
    }
    let foreign = |metadata: Option<Metadata>| {
        let mut writer = mcap::WriteOptions::new().library("rosbag2").create(Cursor::new(Vec::new())).unwrap();
        let channel = writer.add_channel(0, "/osmc0", "cdr", &BTreeMap::new()).unwrap();
        let header = MessageHeader { channel_id: channel, sequence: 0, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, b"\x00\x01\x02").unwrap();
        metadata.iter().for_each(|metadata| writer.write_metadata(metadata).unwrap());
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    };
    let error = Log::from_bytes(&foreign(None)).unwrap_err();
    assert!(matches!(&error, LogError::Foreign { library } if library == "rosbag2"), "{error}");

    let record = |pairs: &[(&str, &str)]| Metadata {
        name: "r4.run".into(),
        metadata: pairs.iter().map(|(key, value)| ((*key).into(), (*value).into())).collect(),
    };
    let newer = Log::from_bytes(&foreign(Some(record(&[("format", "2")]))));
    assert!(matches!(newer, Err(LogError::Format { found, .. }) if found == "2"));
    let partial = Log::from_bytes(&foreign(Some(record(&[("format", "1"), ("protocol_version", "one")]))));
    assert!(matches!(partial, Err(LogError::BadHeader { key: "protocol_version" })));
}

/// Messages of a known topic with the wrong fields, beside good ones: counted, and the good ones kept.
#[test]
fn a_message_with_wrong_fields_is_counted() {
    let file = run();
    let original = mcap::Summary::read(&file).unwrap().unwrap();
    let mut writer = mcap::WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    let index = &original.metadata_indexes[0];
    writer.write_metadata(&mcap::read::metadata(&file, index).unwrap()).unwrap();
    for message in mcap::MessageStream::new(&file).unwrap() {
        let mut message = message.unwrap();
        if message.channel.topic == "/osmc0" && message.sequence == 3 {
            message.data = br#"{"setpoint_mode":"torque"}"#[..].into();
        }
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    let log = Log::from_bytes(&writer.into_inner().into_inner()).unwrap();
    assert_eq!(log.warnings, [Warning::Unreadable { topic: "/osmc0".into(), messages: 1 }]);
    assert_eq!(log.motor(OSMC).unwrap().samples.len(), 19);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2_000))]
    #[test]
    fn damaged_bytes_never_panic(damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8)) {
        let mut file = run();
        for (index, byte) in damage {
            let at = index.index(file.len());
            file[at] = byte;
        }
        let _ = Log::from_bytes(&file);
    }

    #[test]
    fn any_bytes_after_the_magic_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = Log::from_bytes(&[mcap::MAGIC, &bytes].concat());
    }
}
