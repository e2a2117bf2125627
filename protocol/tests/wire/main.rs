//! Tests of the wire format, from outside the crate: golden bytes, limits, and the effect of damage on a link.
//!
//! | module | subject |
//! | --- | --- |
//! | `samples` | hand-written messages, the source of the golden tables |
//! | `golden` | those bytes, the schema hash, and the encodings that are frozen |
//! | `coverage` | which enum variants a message holds, read off its bytes and the schema |
//! | `strategies` | any message, for property tests |
//! | `limits` | every message fits a frame; the decoder's buffer ends where it should |
//! | `damage` | cut, flipped, random bytes |
//! | `many` | ten million damaged frames |
//! | `words` | what refusals, states and readings say to users |

mod coverage;
mod damage;
mod golden;
mod limits;
mod many;
mod samples;
mod strategies;
mod words;

use r4_protocol::{
    FrameDecoder, FrameError, encode_frame,
    frame::{Check, MAX_FRAME, Message, encode_with},
};
use serde::Serialize;

/// Encodes one frame, delimiter included.
fn frame<T: Message>(message: &T) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    encode_frame(message, &mut buffer).expect("the message fits").to_vec()
}

/// Encodes any value as a frame, with the given checksum.
fn raw<T: Serialize>(message: &T, check: Check) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    encode_with(message, check, &mut buffer).expect("it fits").to_vec()
}

/// Encodes a message as in its frame, before CRC and COBS.
fn payload<T: Serialize>(message: &T) -> Vec<u8> {
    let mut buffer = [0; 1024];
    postcard::to_slice(message, &mut buffer).expect("the message fits").to_vec()
}

/// Decodes `bytes` with a fresh decoder.
fn receive<T: Message>(bytes: &[u8]) -> Vec<Result<T, FrameError>> {
    let mut decoder = FrameDecoder::new();
    bytes.iter().filter_map(|byte| decoder.push(*byte)).collect()
}

/// Returns whether a fresh decoder takes exactly one message from `frame`, and it is `message`. Compares bytes: a NaN
/// comes back with every bit, but is not equal to itself.
fn gives_back<T: Message>(frame: &[u8], message: &T) -> bool {
    matches!(&receive::<T>(frame)[..], [Ok(received)] if payload(received) == payload(message))
}
