//! Messages for trajectories of joints.

use serde::{Deserialize, Serialize};

use super::Header;

/// Message `builtin_interfaces/msg/Duration`: time span, which may be negative.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Duration {
    /// Whole seconds, rounded downwards, s.
    pub sec: i32,
    /// Remainder above the whole seconds, ns: below 10⁹.
    pub nanosec: u32,
}

/// Message `trajectory_msgs/msg/JointTrajectoryPoint`: state of all joints at one time. Each list has one number for each joint, or none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// Positions, rad or m; required.
    pub positions: Vec<f64>,
    /// Velocities, rad/s or m/s; optional.
    pub velocities: Vec<f64>,
    /// Accelerations, rad/s² or m/s²; ignored.
    pub accelerations: Vec<f64>,
    /// Efforts, N m or N; refused, must be empty.
    pub effort: Vec<f64>,
    /// Time from the start of the trajectory to this point.
    pub time_from_start: Duration,
}

/// Message `trajectory_msgs/msg/JointTrajectory`: paths of several joints over a common time.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// Start time of the trajectory; a stamp of 0 starts it at once.
    pub header: Header,
    /// Names of the joints.
    pub joint_names: Vec<String>,
    /// Points in the order of time; an empty list cancels the current trajectory.
    pub points: Vec<JointTrajectoryPoint>,
}
