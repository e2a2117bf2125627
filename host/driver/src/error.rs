//! Errors of the operations on a board.

use r4_protocol::{Causes, ChannelId, Refusal, Unit};

/// Reason why an operation on a board failed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The board received the request and refused it.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The board did not answer in time, though the link is alive. It may or may not have carried out the request.
    #[error("the board did not answer `{request}` within {after_ms} ms: {}", silence(request))]
    TimedOut {
        /// Name of the request.
        request: &'static str,
        /// Time waited for the answer, ms.
        after_ms: u32,
    },
    /// The board stopped answering heartbeats.
    #[error("link lost: no heartbeat from the board for {silent_ms} ms; check cable and power, then connect again")]
    LinkLost {
        /// Time since the last answer, ms.
        silent_ms: u32,
    },
    /// The link itself failed.
    #[error("the link failed ({reason}); check cable and power, then connect again")]
    LinkFailed {
        /// Message of the link's own error.
        reason: String,
    },
    /// The board answered with a kind of reply that does not belong to the request.
    #[error("the board gave the wrong kind of answer to `{request}`: its firmware is faulty, flash it again")]
    WrongReply {
        /// Name of the request.
        request: &'static str,
    },
    /// The board tripped or was disarmed during the operation.
    #[error("the board stopped: {causes}{}", advice(*causes))]
    Stopped {
        /// Latched causes; none when it was disarmed.
        causes: Causes,
    },
    /// The answer has a form from a later version of the protocol than this program speaks.
    #[error(
        "this program does not know the board's answer to `{request}`: use the program of the firmware's release, or a later one"
    )]
    UnknownAnswer {
        /// Name of the request.
        request: &'static str,
    },
    /// The motor follows another set point, or its telemetry has stopped.
    #[error("{channel} no longer follows this set point: somebody else commands it too, or ended its telemetry")]
    NotFollowed {
        /// Channel of the set point.
        channel: ChannelId,
    },
    /// The motor did not find its home switch in time.
    #[error(
        "{channel} has not found its home switch after {after_s:.1} s: check the switch and the direction of the speed, \
         or allow more time"
    )]
    NotHomed {
        /// Channel that seeks its switch.
        channel: ChannelId,
        /// Duration of the search, s.
        after_s: f64,
    },
    /// The robot's name has more bytes than a board stores.
    #[error("the name is too long: a board keeps {most_bytes} bytes")]
    NameTooLong {
        /// Largest number of bytes.
        most_bytes: usize,
    },
    /// A stream of cycles is open already, and a board has only one.
    #[error("another stream of set points is open: drop that first")]
    StreamOpen,
    /// The number of set points differs from that of the stream's channels, or the stream would have too many channels.
    #[error("{asked} channels, where a stream of set points has {expected}")]
    CycleLength {
        /// Number of channels in the call.
        asked: usize,
        /// Number of channels of the stream, or the largest possible.
        expected: usize,
    },
    /// The motor did not reach its set point in time.
    #[error("{channel} was not settled after {after_s:.1} s: at {position:.4} {unit}, asked for {target:.4} {unit}")]
    NotSettled {
        /// Channel of the set point.
        channel: ChannelId,
        /// Requested position, rad or m.
        target: f64,
        /// Position in the last sample, rad or m.
        position: f64,
        /// Unit of both positions.
        unit: Unit,
        /// Time since the command, s.
        after_s: f64,
    },
}

/// Likely reason why the board does not answer, for the message.
fn silence(request: &str) -> &'static str {
    // `r4 serve` lets the next host wait for its hello; a board itself refuses it with an answer.
    match request {
        "hello" => "another program may be connected to it, which has to end first, or this is no R4 board",
        _ => "it is busy, or frames are being lost",
    }
}

fn advice(causes: Causes) -> String {
    causes.iter().map(|cause| format!("; {}", cause.advice())).collect()
}
