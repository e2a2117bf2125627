//! A board as a ROS 2 node.
//!
//! A [`Door`] is a session's side: it takes [`Order`]s, which are messages and service calls from ROS, and gives [`Report`]s, which are
//! messages for ROS. It decides only what may go through ([`Gate`]); velocities to wheels, odometry and stopping are those of
//! [`r4_rig`] and of the board. The other side is `dds`, with the feature of that name: topics, services and discovery by RustDDS,
//! without a ROS installation.
//!
//! Frames are those of REP-103 and REP-105, units SI.
//!
//! | module | subject |
//! | --- | --- |
//! | [`message`] | the ROS messages that cross, as their `.msg` files have them |
//! | [`environment`] | `ROS_DOMAIN_ID` and the discovery variables, and what of them can be kept |
//! | [`time`] | stamps |
//! | [`gate`] | which commands go through |
//! | [`convert`] | readings of a board as ROS messages |
//! | [`diagnose`] | `/diagnostics` |
//! | [`leased`] | set points that end by themselves unless they are repeated |
//! | [`door`] | the node in a session |
//! | [`names`] | names of topics and services |

pub mod convert;
#[cfg(feature = "dds")]
pub mod dds;
pub mod diagnose;
pub mod door;
pub mod environment;
pub mod gate;
pub mod leased;
pub mod message;
pub mod names;
pub mod time;

pub use door::{Door, Order, Report, Request};
pub use environment::{Discovery, EnvironmentError, Reach, Services};
pub use gate::{Gate, Refused};
pub use names::Namespace;
pub use time::{RosClock, Stamp};

/// Frame in which odometry counts (REP-105).
pub const ODOM_FRAME: &str = "odom";
/// Frame of the robot's body (REP-105).
pub const BASE_FRAME: &str = "base_link";
