//! What travels between an R4 board and its hosts: message types, frames and their version.
//!
//! | module | subject |
//! | --- | --- |
//! | [`channel`] | names, units and abilities of a board's channels |
//! | [`message`] | requests, replies, refusals, telemetry, heartbeats |
//! | [`cycle`] | set points for four channels and what these do, in 64 bytes |
//! | [`state`] | safety states and trip causes |
//! | [`config`] | what a board is told about itself: wiring, limits, gains, calibration |
//! | [`parameter`] | the numbers of the configuration that hosts may change |
//! | [`log`] | the log of a board's firmware |
//! | [`image`] | the image of a board's firmware, and how it is known to be whole |
//! | [`frame`] | COBS + CRC-16 frames on a byte link |
//! | [`can`] | a byte link on a CAN bus |
//!
//! Every wire change bumps [`VERSION`], most change [`SCHEMA_HASH`] by themselves, and each gets a line in `CHANGELOG.md`.
//! All values are SI: radians, metres, seconds, volts; duty is a share of the supply in -1..=1; angles are at the output
//! shaft.
#![no_std]

pub mod can;
pub mod channel;
pub mod config;
pub mod cycle;
pub mod frame;
pub mod image;
pub mod log;
pub mod message;
pub mod parameter;
pub mod state;

pub use channel::{ChannelId, ChannelInfo, ChannelKind, Mode, ModeInfo, Quantity, Range, Unit};
pub use cycle::{Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState, Unscaled};
pub use frame::{FrameDecoder, FrameError, encode_frame};
pub use image::ImageInfo;
pub use log::{LogChunk, LogInfo};
pub use message::{
    DeviceInfo, DeviceStats, FaultInfo, FaultSnapshot, HotWinding, MotorSnapshot, ParameterInfo, PathPoint, Quality,
    Refusal, Reply, Request, Sample, Setpoint, Telemetry, ToDevice, ToHost, Winding,
};
pub use parameter::{NotAParameter, Parameter, ParameterKey, SetError};
pub use state::{Cause, Causes, SafetyState};

/// Version of the messages in this crate. A board and a host talk only when theirs are equal.
pub const VERSION: u16 = 11;

/// Hash over the shape of every message type; two builds of the same [`VERSION`] that still differ are caught by it.
///
/// It sees names, types and variants, how much each list and text holds, and how many causes there are; not units and
/// meanings.
pub const SCHEMA_HASH: u64 = {
    use postcard_schema::key::hash::fnv1a64::hash_ty_path;
    // `from_le_bytes` of two FNV-1a hashes; the paths keep the two directions apart.
    let mut hash = u64::from_le_bytes(hash_ty_path::<ToDevice>("r4/to-device"))
        ^ u64::from_le_bytes(hash_ty_path::<ToHost>("r4/to-host")).rotate_left(1);
    // What a schema does not tell of a type, hashed on by FNV-1a's step.
    let capacities = [
        message::MAX_SAMPLES,
        message::MAX_RAW,
        message::MAX_FIRMWARE,
        channel::MAX_MODES,
        config::MAX_NAME,
        config::MAX_MOTORS,
        config::MAX_SUPPLIES,
        Cause::ALL.len(),
        cycle::CYCLE_CHANNELS,
        log::MAX_LOG,
        message::MAX_POINTS,
    ];
    let mut place = 0;
    while place < capacities.len() {
        hash = (hash ^ capacities[place] as u64).wrapping_mul(0x0100_0000_01B3);
        place += 1;
    }
    hash
};
