//! What programs above a board's channels share.
//!
//! Pure: no link, no clock, no simulation. A program gives what it has measured, and gets set points for channels.
//!
//! Frames are those of REP-103: x forwards, y to the left, angles counterclockwise; SI units.

mod ground;
mod odometry;
mod route;

pub use ground::{GroundDrive, Velocity};
pub use odometry::{Odometry, Place, WHEEL_VARIANCE_M};
pub use route::{Follower, Limits};
