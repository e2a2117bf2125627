//! Both ends of a frame as a board has them: a message for the host encoded, one from the host decoded. `cargo xtask
//! size --protocol` links what each of the lists below leads to, and nothing else, and measures its size.

#![no_std]

use r4_protocol::{
    Cycle, CycleState, FrameDecoder, FrameError, ToDevice, ToHost, encode_frame,
    frame::{MAX_FRAME, MessageTooLong},
};

type Encoder<T> = for<'b> fn(&T, &'b mut [u8; MAX_FRAME]) -> Result<&'b [u8], MessageTooLong>;
type Decoder<T> = fn(&mut FrameDecoder, u8) -> Option<Result<T, FrameError>>;

/// Encoder and decoder of cycles only.
pub static CYCLES_ONLY: (Encoder<CycleState>, Decoder<Cycle>) = (encode_frame, FrameDecoder::push);

/// Encoder and decoder of every message.
pub static EVERY_MESSAGE: (Encoder<ToHost>, Decoder<ToDevice>) = (encode_frame, FrameDecoder::push);
