//! A board as a ROS 2 node.
//!
//! A [`Door`] is a session's side: it takes [`Order`]s, which are messages and service calls from ROS, and gives [`Report`]s, which are
//! messages for ROS. It decides only what may go through ([`Gate`]); velocities to wheels, odometry and stopping are those of
//! [`r4_rig`] and of the board. The other side is `dds`, with the feature of that name: topics, services and discovery by RustDDS,
//! without a ROS installation. A log becomes a [`bag`] by the same conversions, without that feature.
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
//! | [`frames`] | telemetry frames as the messages of all topics |
//! | [`bag`] | a log as a bag of rosbag2 |
//! | [`diagnose`] | `/diagnostics` |
//! | [`leased`] | set points that end by themselves unless they are repeated |
//! | [`trajectory`] | trajectories of joints as paths |
//! | [`parameters`] | the board's configuration as parameters |
//! | [`lifecycle`] | states and transitions of a managed node |
//! | [`door`] | the node in a session |
//! | [`names`] | names of topics and services |

pub mod bag;
pub mod convert;
#[cfg(feature = "dds")]
pub mod dds;
pub mod diagnose;
pub mod door;
pub mod environment;
pub mod frames;
pub mod gate;
pub mod leased;
pub mod lifecycle;
pub mod message;
pub mod names;
pub mod parameters;
pub mod time;
pub mod trajectory;

pub use door::{Door, Ended, Order, Report, Request};
pub use environment::{Discovery, EnvironmentError, Reach, Services};
pub use gate::{Gate, Refused};
pub use names::Namespace;
pub use time::{RosClock, Stamp};

/// Frame in which odometry counts (REP-105).
pub const ODOM_FRAME: &str = "odom";
/// Frame of the robot's body (REP-105).
pub const BASE_FRAME: &str = "base_link";
