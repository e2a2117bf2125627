//! Recorded runs of an R4 board: MCAP files that Foxglove and PlotJuggler open as they are.
//!
//! [`Tap`] writes what goes over a link, in both directions; [`Recorder`] writes what it is given. [`Log`] reads either
//! back into typed series; [`Log::write_csv`] makes a table of it, [`compare()`] tells two runs apart. Messages are JSON with a JSON Schema:
//!
//! | topic | fields |
//! | --- | --- |
//! | `/osmc0` … (rotary) | `setpoint_mode`, `setpoint`, `position_counts`, `position_rad`, `speed_rad_s`, `duty`, `settled`, `homed` |
//! | `/actuator1` … (linear) | the same with `position_m`, `speed_m_s` |
//! | `/encoder0` … | `position_counts`, `position_rad`, `speed_rad_s`, `illegal` |
//! | `/supply0` … | one of `voltage_v`, `angle_rad`, `speed_rad_s`, `distance_m`, `speed_m_s`, `duty`, `on` |
//! | `/range0` … (can fail) | the same with `age_ms`, and `quality`: `good`, `none`, `out-of-range`, `no-answer`, `stuck`, `low`, `high` |
//! | `/state` | `state`, `causes`, `causes_bits`; a message when it changes |
//! | `/command` | `channel`, `setpoint_mode`, `setpoint`, `sent_us`; a message per command sent |
//! | `/request` | `request`, such as `arm`, and what it is about (`channel`, `period_ms`, `kp` …), `sent_us`; a message per request sent |
//! | `/refusal` | `request`, `reason`; a message per request refused |
//!
//! `setpoint` is in rad or m, rad/s or m/s, V, a share of the supply, or 0 or 1, by `setpoint_mode`. A number that is not finite is
//! left out of its message. Who was recorded is in the metadata record `r4.run`.
//!
//! `sent_us` is the host's clock since it said hello: what is needed to send the same again at the same moments.
//!
//! Publish times are the board's clock. Log times are the same for a virtual board, and wall-clock times for a board in real
//! time. The metadata record also says when the run was recorded, by which program and command. Two identical runs of a virtual
//! board have identical messages, to the last bit.
//!
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
mod header;
mod message;
mod read;
mod record;
mod request;
mod signal;
mod tap;

pub use compare::{Difference, compare};
pub use coverage::Coverage;
pub use header::{Header, Recorded};
pub use read::{
    EncoderSample, EncoderSeries, Log, LogError, Logged, LoggedCommand, LoggedRefusal, LoggedRequest, MotorSample,
    MotorSeries, ReadingSample, ReadingSeries, ScalarSeries, StateChange, Warning,
};
pub use record::{RecordError, Recorder};
pub use request::request_name;
pub use signal::{Kind, Signal, Value};
pub use tap::{About, Tap, Wall};
