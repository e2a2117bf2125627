//! Recorded runs of an R4 board: MCAP files that Foxglove and PlotJuggler open as they are.
//!
//! [`Tap`] records what goes over a link, in both directions; [`Recorder`] writes what it is given. [`Log`] reads a
//! file back into typed series, [`Log::write_csv`] makes a table of it, and [`compare()`] lists the differences of
//! two runs. Messages are JSON with a JSON Schema:
//!
//! | topic | fields |
//! | --- | --- |
//! | `/osmc0` … (rotary) | `setpoint_mode`, the set point in a field of that mode such as `setpoint_position_rad`, `position_counts`, `position_rad`, `speed_rad_s`, `duty`, `settled`, `homed`, `winding_heat` |
//! | `/actuator1` … (linear) | the same with `setpoint_position_m`, `position_m`, `speed_m_s` |
//! | `/encoder0` … | `position_counts`, `position_rad`, `speed_rad_s`, `illegal` |
//! | `/supply0` … | one of `voltage_v`, `angle_rad`, `speed_rad_s`, `distance_m`, `speed_m_s`, `duty`, `on` |
//! | `/range0` … (can fail) | the same with `age_ms`, and `quality`: `good`, `none`, `out-of-range`, `no-answer`, `stuck`, `low`, `high` |
//! | `/state` | `state`, `causes`, `causes_bits`; a message when it changes |
//! | `/command` | `channel`, `setpoint_mode`, the set point as above, `sent_us`; a message per command sent |
//! | `/request` | `request`, such as `arm`, and what it is about (`channel`, `period_ms`, `kp` …), `sent_us`; a message per request sent |
//! | `/refusal` | `request`, `reason`; a message per request refused |
//! | `/gap` | `without_link_s`, `restarted`, `clock_shift_us`; a message when a lost link is back |
//!
//! Every numeric field has one unit, which ends its name. Set points: `setpoint_position_rad`, `_m`;
//! `setpoint_speed_rad_s`, `_m_s`; `setpoint_home_rad_s`, `_m_s`; `setpoint_duty` (share of the supply);
//! `setpoint_voltage_v`; `setpoint_force_n`; `setpoint_switch`, `setpoint_brake` (0 or 1). A number that is not finite
//! is left out of its message. The metadata record `r4.run` describes the board that was recorded.
//!
//! Chunks are LZ4 frames, which stock MCAP readers open; each is at most a second long. This is format 2. Format 1
//! can also be read; it has uncompressed chunks and one field `setpoint` for all modes.
//!
//! `sent_us` is the host's clock since its hello: a replay sends the same requests at the same moments.
//!
//! Publish times are the board's clock; if a board restarts while it is recorded, times continue by the host's clock,
//! and `clock_shift_us` leads back to the board's. Log times are publish times for a virtual board, and wall-clock
//! times for a board in real time, which drift with the board's crystal from the beginning on. The metadata record
//! also says when the run was recorded, by which program and command. Two identical runs of a virtual board have
//! bit-identical messages.
//! ```
//! # use std::io::Cursor;
//! # use r4_log::{Header, Log, Recorder};
//! # use r4_protocol::{Causes, SafetyState};
//! let header = Header { robot: "osmc-bench".into(), board: "sim:osmc-bench".into(), firmware: "0.1.0".into(),
//!     protocol_version: r4_protocol::VERSION, channels: Vec::new(), seed: Some(1), recorded: None };
//! let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header)?;
//! recorder.state(1_000, SafetyState::Armed, Causes::NONE)?;
//! let file = recorder.finish()?.into_inner();
//!
//! let log = Log::from_bytes(&file)?;
//! assert_eq!(log.header, header);
//! assert_eq!(log.states[0].time_s, 0.001);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod compare;
mod container;
mod coverage;
mod csv;
mod derive;
mod header;
mod live;
mod message;
mod read;
mod record;
mod request;
mod signal;
mod tap;
mod write;

pub use compare::{Difference, compare};
pub use coverage::Coverage;
pub use derive::{Derive, DerivedTopic};
pub use header::{Header, Recorded};
pub use live::{Live, LiveTopic};
pub use mcap::records::MessageHeader as McapMessage;
pub use message::quality_name;
pub use read::{
    EncoderSample, EncoderSeries, Gap, Log, LogError, Logged, LoggedCommand, LoggedRefusal, LoggedRequest, MotorSample,
    MotorSeries, ReadingSample, ReadingSeries, ScalarSeries, SensorSample, SensorSeries, StateChange, Warning,
};
pub use record::{RecordError, Recorder};
pub use request::request_name;
pub use signal::{Kind, Signal, Value};
pub use tap::{About, Tap, Wall};
pub use write::{McapTopic, McapWriter};
