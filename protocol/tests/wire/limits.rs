//! Tests that every message fits a frame, and that the buffers end where they should.

use proptest::{prop_assert, proptest};
use r4_protocol::{
    ChannelId, ChannelInfo, ChannelKind, FrameError, Mode, ModeInfo, Range, Reply, Request, Sample, ToDevice, ToHost,
    Unit,
    channel::MAX_MODES,
    cycle::{CYCLE_FRAME, CYCLE_STATE_FRAME},
    encode_frame,
    frame::{Check, MAX_FRAME, MAX_MESSAGE, Message, MessageTooLong},
    message::MAX_SAMPLES,
};

use serde::{Deserialize, Serialize};

use crate::{frame, gives_back, payload, raw, receive, samples, strategies};

/// Length of the longest message to a board, bytes: a `Follow` of as many points as it takes.
const LONGEST_TO_DEVICE: usize = 110;
/// Length of the longest message to a host, bytes: a full `Telemetry`.
const LONGEST_TO_HOST: usize = 246;

/// Pins the lengths, because the schema does not contain the capacity of a `Vec` or a `String`.
#[test]
fn the_longest_message_of_each_kind_fits_a_frame() {
    let request = |request| ToDevice::Request { seq: u16::MAX, request };
    let uart = Request::UartWrite { port: u8::MAX, bytes: samples::largest_raw() };
    let heartbeat = ToDevice::Heartbeat { session: u16::MAX, host_us: u64::MAX };
    let reply = |reply| ToHost::Response { seq: u16::MAX, result: Ok(reply) };
    let telemetry = ToHost::Telemetry(samples::largest_telemetry());
    for (what, len, expected) in [
        ("follow", payload(&request(samples::largest_request())).len(), LONGEST_TO_DEVICE),
        ("i2c", payload(&request(samples::largest_transfer())).len(), 73),
        ("uart", payload(&request(uart)).len(), 71),
        ("set", payload(&request(samples::largest_set())).len(), 25),
        ("bind", payload(&request(samples::largest_bind())).len(), 53),
        ("heartbeat", payload(&heartbeat).len(), 14),
        ("hello", payload(&reply(samples::largest_welcome())).len(), 79),
        ("channel", payload(&reply(Reply::Channel(largest_channel()))).len(), 86),
        ("fault snapshot", payload(&reply(samples::largest_reply())).len(), 131),
        ("bytes", payload(&reply(Reply::Bytes(samples::largest_raw()))).len(), 71),
        ("log", payload(&ToHost::Log(samples::largest_log())).len(), 71),
        ("telemetry", payload(&telemetry).len(), LONGEST_TO_HOST),
    ] {
        assert_eq!(len, expected, "{what}");
        assert!(len <= MAX_MESSAGE, "{what}");
    }
}

proptest! {
    /// Checks that no message is longer than the longest ones above.
    #[test]
    fn no_message_is_longer_than_the_longest(to_device in strategies::to_device(), to_host in strategies::to_host()) {
        prop_assert!(payload(&to_device).len() <= LONGEST_TO_DEVICE);
        prop_assert!(payload(&to_host).len() <= LONGEST_TO_HOST);
    }
}

/// Checks the guaranteed length of a cycle of four motors: 66 bytes for both frames, checksums, COBS and delimiters
/// included. There is no byte to spare: one more field, or one that takes more bytes for some values, breaks it.
#[test]
fn both_frames_of_a_cycle_are_66_bytes_whatever_is_in_them() {
    for (name, cycle) in samples::cycles() {
        assert_eq!(frame(&ToDevice::Cycle(cycle)).len(), CYCLE_FRAME, "{name}");
    }
    for (name, state) in samples::cycle_states() {
        assert_eq!(frame(&ToHost::Cycle(state)).len(), CYCLE_STATE_FRAME, "{name}");
    }
    const { assert!(CYCLE_FRAME + CYCLE_STATE_FRAME <= 66) };
}

proptest! {
    #[test]
    fn no_cycle_is_longer_than_another(cycle in strategies::cycle(), state in strategies::cycle_state()) {
        prop_assert!(frame(&ToDevice::Cycle(cycle)).len() == CYCLE_FRAME);
        prop_assert!(frame(&ToHost::Cycle(state)).len() == CYCLE_STATE_FRAME);
    }
}

/// Message in place of a command, as long as its test needs it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Bytes(heapless::Vec<u8, 400>);

impl Message for Bytes {
    fn check(&self) -> Check {
        Check::Long
    }
}

/// Makes a message of `len` encoded bytes, its own length included.
fn bytes_of_encoded_length(len: usize, value: u8) -> Bytes {
    let bytes = Bytes(core::iter::repeat_n(value, len - 2).collect());
    assert_eq!(payload(&bytes).len(), len, "a length of 128 or more takes two bytes");
    bytes
}

#[test]
fn the_longest_frame_goes_through_and_a_longer_message_is_not_sent() {
    for value in [0x00, 0x55, 0xFF] {
        let longest = bytes_of_encoded_length(MAX_MESSAGE, value);
        assert_eq!(frame(&longest).len(), MAX_FRAME, "COBS adds one byte, whatever the message holds");
        assert_eq!(receive::<Bytes>(&frame(&longest)), [Ok(longest)]);
        let longer = bytes_of_encoded_length(MAX_MESSAGE + 1, value);
        assert_eq!(encode_frame(&longer, &mut [0; MAX_FRAME]), Err(MessageTooLong));
    }
}

/// Checks that a frame with 16 bits of checksum is no command, whatever a bad link does to it.
#[test]
fn a_command_with_the_shorter_checksum_is_not_taken_and_all_else_with_either() {
    for (name, message) in samples::to_device() {
        let short = raw(&message, Check::Short);
        match message.check() {
            Check::Short => assert!(gives_back(&short, &message), "{name}"),
            Check::Long => {
                let seq = if let ToDevice::Request { seq, .. } = message { Some(seq) } else { None };
                assert_eq!(receive::<ToDevice>(&short), [Err(FrameError::NotAMessage { seq })], "{name}");
            }
        }
        assert!(gives_back(&raw(&message, Check::Long), &message), "{name}");
    }
}

/// Sends a frame that is too long. Without its delimiter a frame has at most `MAX_FRAME` - 1 bytes.
#[test]
fn a_frame_that_is_too_long_is_one_error_and_the_next_frame_is_taken() {
    let next = ToDevice::Heartbeat { session: 7, host_us: 1 };
    // Around one and two lengths of the buffer, where an overflow that is forgotten would show.
    for len in [MAX_FRAME, MAX_FRAME + 1, MAX_FRAME + 2, 2 * MAX_FRAME, 2 * MAX_FRAME + 1, 100_000] {
        for value in [0x01, 0x55, 0xFF] {
            let mut bytes = vec![value; len];
            bytes.push(0);
            bytes.extend(frame(&next));
            assert_eq!(receive(&bytes), [Err(FrameError::TooLong), Ok(next.clone())], "{len} bytes of {value:#04x}");
        }
    }
}

/// Checks that a good frame at the end of an endless one is not decoded.
#[test]
fn a_frame_inside_a_too_long_one_is_not_taken() {
    let message = ToDevice::Heartbeat { session: 7, host_us: 1 };
    let mut bytes = vec![0x01; MAX_FRAME + 1];
    bytes.extend(frame(&message));
    assert_eq!(receive::<ToDevice>(&bytes), [Err(FrameError::TooLong)]);
}

#[test]
fn delimiters_alone_are_not_frames() {
    let message = ToDevice::Heartbeat { session: 7, host_us: 1 };
    let mut bytes = vec![0; 1000];
    bytes.extend(frame(&message));
    bytes.extend([0; 1000]);
    assert_eq!(receive(&bytes), [Ok(message)]);
}

#[test]
fn a_frame_too_short_for_a_checksum_is_malformed() {
    for bytes in [&[0x01, 0][..], &[0x02, 0x55, 0], &[0x01, 0x01, 0], &[0x03, 0x55, 0], &[0xFF, 0]] {
        assert_eq!(receive::<ToDevice>(bytes), [Err(FrameError::Malformed)], "{bytes:02x?}");
    }
}

/// Tries undamaged messages that are longer, shorter or other than this version's.
#[test]
fn a_message_of_another_version_is_not_a_message() {
    // `ToDevice` has variants 0 to 2.
    let unknown_variant = 3u8;
    let nameless = FrameError::NotAMessage { seq: None };
    assert_eq!(receive::<ToDevice>(&raw(&unknown_variant, Check::Short)), [Err(nameless)]);
    let heartbeat = ToDevice::Heartbeat { session: 7, host_us: 1 };
    assert_eq!(receive::<ToDevice>(&raw(&(heartbeat, 0u8), Check::Short)), [Err(nameless)], "a field more");
    assert_eq!(receive::<ToDevice>(&raw(&(1u8, 7u8), Check::Short)), [Err(nameless)], "a field less");
    assert_eq!(receive::<ToDevice>(&raw(&(), Check::Short)), [Err(nameless)], "nothing");
    // A request or a response keeps its number: a board refuses it by that, and a host ends the request.
    for seq in [0, 127, 128, u16::MAX] {
        let numbered = FrameError::NotAMessage { seq: Some(seq) };
        assert_eq!(receive::<ToDevice>(&raw(&(0u8, seq, 200u8), Check::Short)), [Err(numbered)], "an unknown request");
        assert_eq!(
            receive::<ToHost>(&raw(&(0u8, seq, 1u8, 200u8), Check::Short)),
            [Err(numbered)],
            "an unknown refusal"
        );
    }
    assert_eq!(receive::<ToDevice>(&raw(&0u8, Check::Short)), [Err(nameless)], "a request without a number");
}

/// Checks that more samples or longer names than this version's are an error and not a cut-off list.
#[test]
fn lists_longer_than_this_versions_are_not_a_message() {
    let sample = Sample::Scalar { channel: ChannelId::new(ChannelKind::Supply, 0), value: 24.5 };
    let one_more: heapless::Vec<_, { MAX_SAMPLES + 1 }> = [sample; MAX_SAMPLES + 1].into_iter().collect();
    let telemetry = (2u8, 1u8, 0u8, 0u8, one_more);
    assert_eq!(receive::<ToHost>(&raw(&telemetry, Check::Short)), [Err(FrameError::NotAMessage { seq: None })]);
}

fn largest_channel() -> ChannelInfo {
    let mode = ModeInfo { mode: Mode::Home, unit: Unit::Bool, range: Range::symmetric(f32::MAX) };
    ChannelInfo {
        id: ChannelId::new(ChannelKind::DeadMan, u8::MAX),
        unit: Unit::Bool,
        range: Range::symmetric(f32::MAX),
        rate_hz: f32::MAX,
        resolution: f32::MAX,
        modes: [mode; MAX_MODES].into_iter().collect(),
    }
}
