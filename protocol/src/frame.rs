//! Frames on a byte link: `COBS(postcard message | checksum, little-endian) 0x00`.
//!
//! A frame contains no 0x00 but its delimiter. A receiver that joins in the middle, or has lost bytes, is therefore in
//! step again after one delimiter. The checksum covers the message before COBS, and there are two of them ([`Check`]):
//!
//! | messages | checksum | bytes |
//! | --- | --- | --- |
//! | commands: cycles, and all requests but `Hello`, `Bye` and `Stop` | CRC-32/ISO-HDLC, that of zlib: polynomial 0x04C11DB7 reflected | 4 |
//! | `Hello`, `Bye`, `Stop`, heartbeats, and all messages of a board | CRC-16/IBM-SDLC: polynomial 0x1021 reflected, as a UART sends bits | 2 |
//!
//! A command with the shorter checksum is not taken. The other messages are taken with the longer one, too.
//!
//! The shorter one detects every error of up to three bits, or within 16 bits in a row, that leaves COBS codes and
//! zeros in place. A damaged code turns into many wrong bits: measured with the same polynomial unreflected, of frames
//! with one wrong bit 5 in 187 million passed for another message, and of frames with three 1 in a million. That is too
//! many for messages that arm a board or move a motor. `Stop` has the shorter one because a board takes a stop from
//! hosts of every version, and what it stops may be started again.

use crc::{CRC_16_IBM_SDLC, CRC_32_ISO_HDLC, Crc};
use serde::{Serialize, de::DeserializeOwned};

use crate::{
    cycle::{Cycle, CycleState},
    message::{Request, ToDevice, ToHost},
};

/// Maximum length of a message, bytes, before CRC and COBS. Chosen so that COBS adds exactly one byte.
pub const MAX_MESSAGE: usize = 250;
/// Maximum length of a frame, bytes: message, CRC, COBS overhead, delimiter.
pub const MAX_FRAME: usize = MAX_MESSAGE + LONG_LEN + 2;

const SHORT_LEN: usize = 2;
const SHORT: Crc<u16> = Crc::<u16>::new(&CRC_16_IBM_SDLC);
const LONG_LEN: usize = 4;
const LONG: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Checksum of a frame: the length of its CRC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Check {
    /// CRC-16/IBM-SDLC, 2 bytes, for all other messages.
    Short,
    /// CRC-32/ISO-HDLC, 4 bytes, for commands.
    Long,
}

/// Message that travels in frames.
pub trait Message: Serialize + DeserializeOwned {
    /// Returns the checksum that frames of this message have.
    fn check(&self) -> Check;
}

impl Message for ToDevice {
    fn check(&self) -> Check {
        match self {
            Self::Heartbeat { .. }
            | Self::Request { request: Request::Hello { .. } | Request::Bye | Request::Stop, .. } => Check::Short,
            Self::Request { .. } | Self::Cycle(_) => Check::Long,
        }
    }
}

/// Frames on a link that carries nothing but cycles.
impl Message for Cycle {
    fn check(&self) -> Check {
        Check::Long
    }
}

impl Message for CycleState {
    fn check(&self) -> Check {
        Check::Short
    }
}

impl Message for ToHost {
    fn check(&self) -> Check {
        Check::Short
    }
}

/// Error of a message that does not fit a frame; it is not sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageTooLong;

/// Encodes `message` as one frame, delimiter included, and returns the part of `buffer` that holds it.
///
/// # Errors
/// [`MessageTooLong`] when the message needs more than [`MAX_MESSAGE`] bytes.
pub fn encode_frame<'b, T: Message>(message: &T, buffer: &'b mut [u8; MAX_FRAME]) -> Result<&'b [u8], MessageTooLong> {
    encode_with(message, message.check(), buffer)
}

/// Encodes any serializable value as one frame with the given checksum; otherwise as [`encode_frame`].
///
/// # Errors
/// [`MessageTooLong`] when it needs more than [`MAX_MESSAGE`] bytes.
pub fn encode_with<'b, T: Serialize>(
    message: &T,
    check: Check,
    buffer: &'b mut [u8; MAX_FRAME],
) -> Result<&'b [u8], MessageTooLong> {
    // The message is limited to its own room, so that any checksum fits behind it.
    let mut plain = [0; MAX_MESSAGE + LONG_LEN];
    let len = postcard::to_slice(message, &mut plain[..MAX_MESSAGE]).map_err(|_| MessageTooLong)?.len();
    let (message, after) = plain.split_at_mut(len);
    let end = match check {
        Check::Short => {
            after[..SHORT_LEN].copy_from_slice(&SHORT.checksum(message).to_le_bytes());
            len + SHORT_LEN
        }
        Check::Long => {
            after[..LONG_LEN].copy_from_slice(&LONG.checksum(message).to_le_bytes());
            len + LONG_LEN
        }
    };
    // At most 254 bytes: COBS adds one, and the delimiter is the last that `buffer` has room for.
    let end = cobs::encode(&plain[..end], buffer);
    buffer[end] = 0;
    Ok(&buffer[..=end])
}

/// Reason why a frame was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameError {
    /// The frame is longer than any frame of this protocol.
    TooLong,
    /// The frame is not COBS, or too short to hold a CRC.
    Malformed,
    /// The checksum does not match the message.
    Checksum {
        /// Checksum in the frame.
        received: u16,
        /// Checksum of the message as received.
        calculated: u16,
    },
    /// The frame is undamaged, but holds no message of this version, or a command with the shorter checksum.
    NotAMessage {
        /// Sequence number of a request or response, with which both begin in all versions; `None` for other messages.
        /// With it a board refuses an unknown request, and a host ends the request that an unknown response answers.
        seq: Option<u16>,
    },
}

/// Decoder that takes bytes as they come and returns messages.
///
/// It accepts any byte sequence: a bad frame gives one [`FrameError`], and the next good one is decoded.
pub struct FrameDecoder {
    /// Bytes of a frame without its delimiter.
    buffer: [u8; MAX_FRAME - 1],
    len: usize,
    overflow: bool,
}

impl Default for FrameDecoder {
    fn default() -> Self {
        Self::new()
    }
}

impl FrameDecoder {
    /// Makes a decoder that has received nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self { buffer: [0; MAX_FRAME - 1], len: 0, overflow: false }
    }

    /// Takes one byte. Returns `Some` when it ended a frame.
    pub fn push<T: Message>(&mut self, byte: u8) -> Option<Result<T, FrameError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.len) {
                Some(slot) => {
                    *slot = byte;
                    self.len += 1;
                }
                // The rest of an overlong frame is skipped up to its delimiter.
                None => self.overflow = true,
            }
            return None;
        }
        let (len, overflow) = (self.len, self.overflow);
        self.len = 0;
        self.overflow = false;
        match len {
            // Repeated delimiters fill idle time and are no frames.
            0 => None,
            _ if overflow => Some(Err(FrameError::TooLong)),
            _ => Some(Self::decode(&mut self.buffer[..len])),
        }
    }

    fn decode<T: Message>(frame: &mut [u8]) -> Result<T, FrameError> {
        let len = cobs::decode_in_place(frame).map_err(|_| FrameError::Malformed)?;
        let (message, check) = checked(&frame[..len])?;
        // `take_from_bytes` and not `from_bytes`: excess bytes mark a longer message of another version, which must be
        // an error.
        match postcard::take_from_bytes::<T>(message) {
            // The longer checksum detects more errors: any message may have it, a stop above all.
            Ok((message, [])) if check == Check::Long || message.check() == check => Ok(message),
            _ => Err(FrameError::NotAMessage { seq: seq(message) }),
        }
    }
}

/// Returns the message of a frame without COBS, and the checksum that matches. Tries the longer one first: for a
/// command the shorter one matches by chance once in 65 536 times, and two bytes would then be left over.
fn checked(frame: &[u8]) -> Result<(&[u8], Check), FrameError> {
    if let Some((message, received)) = frame.split_last_chunk::<LONG_LEN>()
        && u32::from_le_bytes(*received) == LONG.checksum(message)
    {
        return Ok((message, Check::Long));
    }
    let (message, received) = frame.split_last_chunk::<SHORT_LEN>().ok_or(FrameError::Malformed)?;
    let (received, calculated) = (u16::from_le_bytes(*received), SHORT.checksum(message));
    if received == calculated {
        Ok((message, Check::Short))
    } else {
        Err(FrameError::Checksum { received, calculated })
    }
}

/// Reads the sequence number of a request or response of any version: both are variant 0 of their direction and begin
/// with it.
fn seq(message: &[u8]) -> Option<u16> {
    let (&first, rest) = message.split_first()?;
    (first == 0).then(|| postcard::take_from_bytes(rest).ok())?.map(|(seq, _)| seq)
}
