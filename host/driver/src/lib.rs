//! Client for R4 boards over any byte link.
//!
//! [`with_board`] opens a session on a link, keeps its heartbeat, runs what you give it and closes the session again:
//!
//! ```
//! # mod bench { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/simulated/mod.rs")); }
//! # bench::simulated_link(async |rx, tx, clock| {
//! use r4_driver::with_board;
//!
//! let osmc0 = "osmc0".parse().expect("a channel name");
//! with_board(rx, tx, clock, async |board| {
//!     board.arm().await?;
//!     let reached = board.move_to(osmc0, 1.57, 30.0).await?;
//!     println!("{} rad after {} s", reached.position, reached.after_s);
//!     board.disarm().await
//! })
//! .await?
//! # }).unwrap();
//! ```
//!
//! Parameters that survive a restart, and the trips that the board remembers:
//!
//! ```
//! # mod bench { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/simulated/mod.rs")); }
//! # bench::simulated(async |board| {
//! let key = "osmc0.position_kp".parse().expect("a parameter");
//! board.set_parameter(key, 4.0).await?;
//! board.save_parameters().await?;
//! for fault in board.faults().await? {
//!     println!("trip {}: {}", fault.number, fault.causes);
//! }
//! # Ok(())
//! # }).unwrap();
//! ```
//!
//! Telemetry of one channel, and an error that names the refusal:
//!
//! ```
//! # mod bench { include!(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/simulated/mod.rs")); }
//! # bench::simulated(async |board| {
//! use r4_driver::Error;
//! use r4_protocol::{Mode, Refusal, Setpoint};
//!
//! let osmc0 = "osmc0".parse().expect("a channel name");
//! let mut samples = board.samples(osmc0, 10).await?;
//! let first = samples.next().await?;
//! let second = samples.next().await?;
//! assert_eq!(second.device_us - first.device_us, 10_000);
//! assert_eq!(second.position(board.channel(osmc0)?), Some(0.0));
//!
//! let refused = board.set(osmc0, Setpoint { mode: Mode::Speed, value: 1.0 }).await;
//! assert!(matches!(refused, Err(Error::Refused(Refusal::NotArmed { .. }))));
//! # Ok(())
//! # }).unwrap();
//! ```
//!
//! Set points at a high rate go through [`Board::stream`].
//!
//! The crate knows neither the kind of link nor whether time is real: bytes pass through `embedded-io-async`, time
//! through [`Clock`]. So the same code drives a real and a simulated board.

mod board;
mod clock_map;
mod connection;
mod cycles;
mod error;
mod relay;
mod streams;
pub mod tune;

pub use board::{Board, Motion, Until};
pub use connection::with_board;
pub use cycles::{CycleCounters, CycleMotion, CycleReport, Cycles};
pub use error::Error;
pub use relay::HeartbeatAnswer;
pub use streams::{ChannelSample, LogStream, SampleStream, Sent, SentStream, Stream, TelemetryStream};

/// Time source of the driver.
pub trait Clock: Clone {
    /// Returns the time since a fixed moment, µs; never decreases.
    fn now_us(&self) -> u64;

    /// Waits until [`Clock::now_us`] is at least `at_us`.
    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()>;
}
