//! Client for R4 boards over any byte link.
//!
//! [`with_board`] opens a session on a link, keeps its heartbeat, runs what you give it and closes the session again:
//!
//! ```no_run
//! # async fn example<R, W, C>(rx: R, tx: W, clock: C) -> Result<(), r4_driver::Error>
//! # where R: embedded_io_async::Read, W: embedded_io_async::Write, C: r4_driver::Clock {
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
//! # }
//! ```
//!
//! What a board keeps over a restart, and what it remembers of its trips:
//!
//! ```no_run
//! # async fn example<C: r4_driver::Clock>(board: &r4_driver::Board<C>) -> Result<(), r4_driver::Error> {
//! let key = "osmc0.position_kp".parse().expect("a parameter");
//! board.set_parameter(key, 4.0).await?;
//! board.save_parameters().await?;
//! for fault in board.faults().await? {
//!     println!("trip {}: {}", fault.number, fault.causes);
//! }
//! # Ok(())
//! # }
//! ```
//!
//! Nothing here knows what the link is or whether time is real: bytes come and go through `embedded-io-async`, time
//! through [`Clock`]. So the same code drives a board and a simulated one.

mod board;
mod connection;
mod error;
mod telemetry;
pub mod tune;

pub use board::{Board, Motion, Until};
pub use connection::with_board;
pub use error::Error;
pub use telemetry::TelemetryStream;

/// Where the driver takes its time from.
pub trait Clock: Clone {
    /// Microseconds since some fixed moment; never goes back.
    fn now_us(&self) -> u64;

    /// Ready once [`Clock::now_us`] is at least `at_us`.
    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()>;
}
