//! Messages between an R4 board and its hosts: types, frames and versions.
//!
//! | module | subject |
//! | --- | --- |
//! | [`channel`] | names, units and abilities of a board's channels |
//! | [`message`] | requests, replies, refusals, telemetry, heartbeats |
//! | [`cycle`] | set points for four channels and what these do, in 66 bytes |
//! | [`state`] | safety states and trip causes |
//! | [`config`] | configuration of a board: wiring, limits, gains, calibration |
//! | [`parameter`] | the numbers of the configuration that hosts may change |
//! | [`log`] | the log of a board's firmware |
//! | [`image`] | the image of a board's firmware, and how it is known to be whole |
//! | [`frame`] | frames on a byte link: COBS, and a checksum of 16 bits or, for commands, 32 |
//! | [`can`] | a byte link on a CAN bus |
//! | [`version`] | versions of all this, and how a board and a host agree on one |
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
pub mod version;

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
pub use version::{SCHEMA_HASH, Spoken, VERSION};
