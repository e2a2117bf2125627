//! Scripts: an input as a list of actions, so that a fuzzer gets past the checksum of frames.
//!
//! A byte below [`WAIT`] is the length of a message, whose bytes follow and are put into a valid frame. A byte from
//! there on is a pause of 1 ms, 2 ms, 4 ms and so on. Every sequence of bytes is a script.

use r4_protocol::frame::{Check, MAX_FRAME, MAX_MESSAGE, Message, encode_with};
use serde::{Serialize, Serializer, ser::SerializeTuple};

/// First byte that is a pause, above all lengths of messages.
pub const WAIT: u8 = 0xFB;

/// One action of a script.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Step {
    /// A valid frame, to be sent.
    Frame(Vec<u8>),
    /// A pause of this many ms.
    Wait(u64),
}

/// Iterates over the steps of a script. `framed` makes a frame of each message, given its number.
pub fn steps(script: &[u8], framed: impl Fn(usize, &[u8]) -> Vec<u8>) -> impl Iterator<Item = Step> {
    let mut rest = script;
    let mut number = 0..;
    std::iter::from_fn(move || {
        let (first, after) = rest.split_first()?;
        let number = number.next()?;
        if *first >= WAIT {
            rest = after;
            return Some(Step::Wait(1 << (first - WAIT)));
        }
        let (message, after) = after.split_at(usize::from(*first).min(after.len()));
        rest = after;
        Some(Step::Frame(framed(number, message)))
    })
}

/// Makes the script that sends these messages as they are encoded, without pauses.
///
/// # Panics
/// A message is longer than a frame can carry.
#[must_use]
pub fn of_messages<'m>(messages: impl IntoIterator<Item = &'m [u8]>) -> Vec<u8> {
    let mut script = Vec::new();
    for message in messages {
        assert!(message.len() <= MAX_MESSAGE, "{} bytes", message.len());
        script.push(message.len() as u8);
        script.extend_from_slice(message);
    }
    script
}

/// Makes a valid frame of any bytes, with the checksum that they need if they are a message.
///
/// # Panics
/// There are more than [`MAX_MESSAGE`] bytes.
#[must_use]
pub fn frame<T: Message>(message: &[u8]) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    let check = postcard::from_bytes::<T>(message).map_or(Check::Short, |message| message.check());
    encode_with(&Raw(message), check, &mut buffer).expect("no longer than a message").to_vec()
}

/// Bytes without a length before them.
struct Raw<'a>(&'a [u8]);

impl Serialize for Raw<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut tuple = serializer.serialize_tuple(self.0.len())?;
        self.0.iter().try_for_each(|byte| tuple.serialize_element(byte))?;
        tuple.end()
    }
}
