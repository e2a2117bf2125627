//! Paths of joints over time.

use serde::{Deserialize, Serialize};

use super::Header;

/// `builtin_interfaces/msg/Duration`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Duration {
    /// Whole seconds, downwards, s.
    pub sec: i32,
    /// Rest above them, ns: below 10⁹.
    pub nanosec: u32,
}

/// `trajectory_msgs/msg/JointTrajectoryPoint`: rad or m, rad/s or m/s, rad/s² or m/s², N m or N; one for each joint, or none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectoryPoint {
    /// Positions.
    pub positions: Vec<f64>,
    /// Velocities.
    pub velocities: Vec<f64>,
    /// Accelerations.
    pub accelerations: Vec<f64>,
    /// Efforts.
    pub effort: Vec<f64>,
    /// Time from the trajectory's beginning to this point.
    pub time_from_start: Duration,
}

/// `trajectory_msgs/msg/JointTrajectory`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTrajectory {
    /// When it begins; 0: at once.
    pub header: Header,
    /// Names of the joints.
    pub joint_names: Vec<String>,
    /// Points in the order of time; none cancels what is followed.
    pub points: Vec<JointTrajectoryPoint>,
}
