//! What can go wrong between a host and a board.

use r4_protocol::{Causes, ChannelId, Refusal, Unit};

/// Why an operation on a board did not succeed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// The board got the request and said no.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// No answer in time, though the link is alive. What was asked may or may not have been done.
    #[error("the board did not answer `{request}` within {after_ms} ms: {}", silence(request))]
    TimedOut {
        /// What was asked.
        request: &'static str,
        /// How long was waited.
        after_ms: u32,
    },
    /// The board stopped answering heartbeats.
    #[error("link lost: no heartbeat from the board for {silent_ms} ms; check cable and power, then connect again")]
    LinkLost {
        /// How long it has been silent.
        silent_ms: u32,
    },
    /// The link itself failed.
    #[error("the link failed ({reason}); check cable and power, then connect again")]
    LinkFailed {
        /// As the link told it.
        reason: String,
    },
    /// The board answered something else than the protocol says.
    #[error("the board gave the wrong kind of answer to `{request}`: its firmware is faulty, flash it again")]
    WrongReply {
        /// What was asked.
        request: &'static str,
    },
    /// The board tripped or was disarmed while something was waited for.
    #[error("the board stopped: {causes}{}", advice(*causes))]
    Stopped {
        /// The latched causes; none when it was disarmed.
        causes: Causes,
    },
    /// The board's answer came with a later version of the protocol than this program speaks.
    #[error(
        "this program does not know the board's answer to `{request}`: use the program of the firmware's release, or a later one"
    )]
    UnknownAnswer {
        /// What was asked.
        request: &'static str,
    },
    /// The motor follows another set point, or its telemetry has stopped.
    #[error("{channel} no longer follows this set point: somebody else commands it too, or ended its telemetry")]
    NotFollowed {
        /// Which.
        channel: ChannelId,
    },
    /// A motor did not find its home in time.
    #[error(
        "{channel} has not found its home switch after {after_s:.1} s: check the switch and the direction of the speed, \
         or allow more time"
    )]
    NotHomed {
        /// Which.
        channel: ChannelId,
        /// How long was waited.
        after_s: f64,
    },
    /// The name of a robot has more bytes than a board keeps.
    #[error("the name is too long: a board keeps {most_bytes} bytes")]
    NameTooLong {
        /// How many it keeps.
        most_bytes: usize,
    },
    /// A stream of cycles is open, and a board has one.
    #[error("another stream of set points is open: drop that first")]
    StreamOpen,
    /// Set points for another number of channels than the stream has, or channels for more than a stream can have.
    #[error("{asked} channels, where a stream of set points has {expected}")]
    CycleLength {
        /// As asked.
        asked: usize,
        /// What the stream has, or most that one can have.
        expected: usize,
    },
    /// A motor did not reach its set point in time.
    #[error("{channel} was not settled after {after_s:.1} s: at {position:.4} {unit}, asked for {target:.4} {unit}")]
    NotSettled {
        /// Which.
        channel: ChannelId,
        /// rad or m
        target: f64,
        /// rad or m
        position: f64,
        /// Of both.
        unit: Unit,
        /// How long was waited.
        after_s: f64,
    },
}

/// What keeps a board from answering.
fn silence(request: &str) -> &'static str {
    // A served board lets the next host wait; the board itself refuses it.
    match request {
        "hello" => "another program may be connected to it, which has to end first, or this is no R4 board",
        _ => "it is busy, or frames are being lost",
    }
}

fn advice(causes: Causes) -> String {
    causes.iter().map(|cause| format!("; {}", cause.advice())).collect()
}
