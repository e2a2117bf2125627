//! A board as a ROS 2 node.
//!
//! A [`Door`] is the node's side towards the board's session: it receives [`Order`]s, which are messages and service calls from ROS, and
//! returns [`Report`]s, which are messages for ROS. It decides only which commands are accepted ([`Gate`]); the kinematics of the wheels,
//! odometry and stopping belong to [`r4_rig`] and to the board. The side towards ROS is `dds`, with the feature of that name: topics,
//! services and discovery by RustDDS, without a ROS installation. [`bag`] converts a log with the same conversions, without that feature.
//!
//! Frames follow REP-103 and REP-105; units are SI.
//!
//! | module | subject |
//! | --- | --- |
//! | [`message`] | ROS messages with the fields of their `.msg` files |
//! | [`environment`] | `ROS_DOMAIN_ID` and the discovery variables: supported values, errors for others |
//! | [`time`] | stamps |
//! | [`gate`] | acceptance of commands |
//! | [`convert`] | readings of a board as ROS messages |
//! | [`frames`] | conversion of telemetry frames to the messages of all topics |
//! | [`bag`] | conversion of a log to a bag of rosbag2 |
//! | [`diagnose`] | `/diagnostics` |
//! | [`leased`] | set points that expire unless they are repeated |
//! | [`trajectory`] | conversion of joint trajectories to paths of motors |
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

/// Frame of odometry, fixed to the floor where it started (REP-105).
pub const ODOM_FRAME: &str = "odom";
/// Frame of the robot's body (REP-105).
pub const BASE_FRAME: &str = "base_link";
