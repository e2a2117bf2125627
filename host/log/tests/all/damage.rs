//! Tests of files that are cut, damaged or of another program.
#![allow(clippy::unwrap_used, reason = "test code")]

use std::{cell::RefCell, collections::BTreeMap, io::Cursor};

use crate::common::{OSMC, header, messages, run, run_every};
use mcap::records::{MessageHeader, Metadata};
use proptest::prelude::*;
use r4_log::{Log, LogError, Recorder, Warning};
use r4_protocol::{Causes, SafetyState};

#[test]
fn a_file_cut_anywhere_gives_an_error_or_what_was_before() {
    // Frames are 120 ms apart: three chunks of a second.
    let file = run_every(120_000);
    let whole = Log::from_bytes(&file).unwrap();
    let (mut samples, mut steps) = (0, 0);
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
                steps += usize::from(read.len() > samples);
                samples = read.len();
            }
        }
    }
    assert_eq!((samples, steps), (20, 3));
}

/// A recording program that is killed leaves everything on disk but the last second.
#[test]
fn an_unfinished_recording_is_read() {
    struct Disk<'a>(&'a RefCell<Vec<u8>>);
    impl std::io::Write for Disk<'_> {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            if self.0.borrow().len() > 5_000 {
                return Err(std::io::ErrorKind::StorageFull.into());
            }
            self.0.borrow_mut().extend(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let disk = RefCell::new(Vec::new());
    // Buffered bytes are lost, as when a process is killed.
    let mut recorder = Recorder::new(std::io::BufWriter::new(Disk(&disk)), &header()).unwrap();
    let mut states = 0;
    // Ten states per second, with causes in no pattern that would compress.
    while recorder
        .state(states * 100_000, SafetyState::Armed, Causes::from_bits((states * 40_503) as u32 & 0xffff))
        .is_ok()
    {
        let log = Log::from_bytes(&disk.borrow()).unwrap();
        assert_eq!(log.warnings, [Warning::CutShort]);
        assert!(log.states.len() as u64 + 10 >= states, "{} of {states}", log.states.len());
        states += 1;
    }
    let full = recorder.finish().err().map(|error| error.to_string()).unwrap_or_default();
    assert!(full.contains("free space"), "{full}");
    let log = Log::from_bytes(&disk.borrow()).unwrap();
    assert!(log.states.len() as u64 + 10 >= states && states > 20, "{} of {states}", log.states.len());
}

#[test]
fn a_flipped_bit_is_found_and_its_chunk_left_out() {
    let (file, mut found) = (run_every(120_000), 0);
    let (whole, data) = (Log::from_bytes(&file).unwrap(), data_of_chunks(&file));
    for at in data.iter().cloned().flatten() {
        // Each byte gets another bit flipped.
        let mut damaged = file.clone();
        damaged[at] ^= 1 << (at % 8);
        let log = Log::from_bytes(&damaged).unwrap();
        let samples = log.motor(OSMC).map_or(&[][..], |series| &series.samples);
        if !log.warnings.is_empty() {
            assert!(matches!(log.warnings[..], [Warning::Damaged { .. }]), "{:?}", log.warnings);
            assert!((1..20).contains(&samples.len()), "the other chunks are read");
            found += 1;
        }
        // A flipped bit of the LZ4 frame's header may have no effect, but no number may change.
        assert!(samples.iter().all(|sample| whole.motor(OSMC).unwrap().samples.contains(sample)), "{at}");
    }
    let bits: usize = data.iter().map(|chunk| chunk.len()).sum();
    assert!(found > bits * 98 / 100, "{found} of {bits}");
}

/// Returns the range of the compressed data of each chunk in the file.
fn data_of_chunks(file: &[u8]) -> Vec<std::ops::Range<usize>> {
    let summary = mcap::Summary::read(file).unwrap().unwrap();
    let data = summary.chunk_indexes.iter().map(|index| {
        let from = index.compressed_data_offset().unwrap() as usize;
        from..from + index.compressed_size as usize
    });
    data.collect()
}

/// Chunks whose header declares a wrong size, or an unknown compression.
#[test]
fn a_chunk_with_a_wrong_head_is_left_out() {
    let file = run();
    let data = data_of_chunks(&file)[0].start;
    // Fields before the data, backwards: compressed size (8), name (3) and its length (4), checksum (4), uncompressed
    // size (8).
    let (name, uncompressed) = (data - 11, data - 27);
    assert_eq!(&file[name..data - 8], b"lz4");
    let with = |at: usize, bytes: &[u8]| {
        let mut file = file.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        Log::from_bytes(&file).unwrap()
    };
    let size = u64::from_le_bytes(file[uncompressed..uncompressed + 8].try_into().unwrap());
    for size in [0, size - 1, size + 1, u64::MAX] {
        let log = with(uncompressed, &size.to_le_bytes());
        assert!(matches!(log.warnings[..], [Warning::Damaged { .. }]) && log.motors.is_empty(), "{size}");
    }
    let log = with(name, b"lz5");
    assert_eq!(log.warnings, [Warning::Compressed { compression: "lz5".into() }]);
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
    let newer = Log::from_bytes(&foreign(Some(record(&[("format", "3")]))));
    assert!(matches!(newer, Err(LogError::Format { found, .. }) if found == "3"));
    let partial = Log::from_bytes(&foreign(Some(record(&[("format", "1"), ("protocol_version", "one")]))));
    assert!(matches!(partial, Err(LogError::BadHeader { key: "protocol_version" })));
}

/// Messages of a known topic with wrong fields between good ones: they are counted, and the good ones are kept.
#[test]
fn a_message_with_wrong_fields_is_counted() {
    let file = run();
    let original = mcap::Summary::read(&file).unwrap().unwrap();
    let mut writer = mcap::WriteOptions::new().compression(None).create(Cursor::new(Vec::new())).unwrap();
    let index = &original.metadata_indexes[0];
    writer.write_metadata(&mcap::read::metadata(&file, index).unwrap()).unwrap();
    for message in messages(&file).into_iter().filter(|message| ["/osmc0", "/state"].contains(&&*message.topic)) {
        let wrong = message.topic == "/osmc0" && message.header.sequence == 3;
        let (encoding, schema) = message.schema;
        let name = if message.topic == "/state" { "r4.SafetyState" } else { "r4.RotaryMotor" };
        let schema = writer.add_schema(name, &encoding, &schema).unwrap();
        let channel_id = writer.add_channel(schema, &message.topic, &message.encoding, &BTreeMap::new()).unwrap();
        let data = if wrong { br#"{"setpoint_mode":"torque"}"# } else { &message.data[..] };
        writer.write_to_known_channel(&MessageHeader { channel_id, ..message.header }, data).unwrap();
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
