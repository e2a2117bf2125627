//! Messages for poses, velocities and transforms.

use serde::{Deserialize, Serialize};

use super::Header;

/// `geometry_msgs/msg/Vector3`, and `geometry_msgs/msg/Point`, which has the same fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Component along x, which points forwards in frames of a body (REP-103).
    pub x: f64,
    /// Component along y, which points to the left.
    pub y: f64,
    /// Component along z, which points upwards.
    pub z: f64,
}

/// Message `geometry_msgs/msg/Quaternion`: a rotation, of unit length.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Vector part along x.
    pub x: f64,
    /// Vector part along y.
    pub y: f64,
    /// Vector part along z.
    pub z: f64,
    /// Scalar part of the quaternion.
    pub w: f64,
}

impl Default for Quaternion {
    /// Returns the identity, which is no rotation.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl Quaternion {
    /// Returns the rotation about z by `yaw_rad`, positive counterclockwise seen from above.
    #[must_use]
    pub fn of_yaw(yaw_rad: f64) -> Self {
        let (sin, cos) = (yaw_rad / 2.0).sin_cos();
        Self { x: 0.0, y: 0.0, z: sin, w: cos }
    }
}

/// Message `geometry_msgs/msg/Twist`: velocity of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// Velocity along each axis, m/s.
    pub linear: Vector3,
    /// Angular velocity about each axis, rad/s.
    pub angular: Vector3,
}

/// Message `geometry_msgs/msg/TwistStamped`: velocity with its time and frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// Time at which the publisher decided on the velocity, and the frame that it is in.
    pub header: Header,
    /// Velocity of the body.
    pub twist: Twist,
}

/// Message `geometry_msgs/msg/Pose`: position and orientation of a body.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position of the body, m.
    pub position: Vector3,
    /// Rotation of the body against the frame of the pose.
    pub orientation: Quaternion,
}

/// Message `geometry_msgs/msg/PoseWithCovariance`: pose with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// Estimate of the pose.
    pub pose: Pose,
    /// Covariance of x, y, z and rotations about x, y, z, row by row: m², m rad, rad².
    #[serde(with = "super::array")]
    pub covariance: [f64; 36],
}

/// Message `geometry_msgs/msg/TwistWithCovariance`: velocity with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// Estimate of the velocity.
    pub twist: Twist,
    /// Covariance of velocities along and rates about x, y, z, row by row: m²/s², m rad/s², rad²/s².
    #[serde(with = "super::array")]
    pub covariance: [f64; 36],
}

/// Message `nav_msgs/msg/Odometry`: pose and velocity of a robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Time of the measurement, and the frame of the pose.
    pub header: Header,
    /// Frame of the velocity, which is the robot's body.
    pub child_frame_id: String,
    /// Pose of the body in the header's frame.
    pub pose: PoseWithCovariance,
    /// Velocity of the body in its own frame.
    pub twist: TwistWithCovariance,
}

/// Message `geometry_msgs/msg/Transform`: translation and rotation between two frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Origin of the child frame in its parent, m.
    pub translation: Vector3,
    /// Rotation of the child frame against its parent.
    pub rotation: Quaternion,
}

/// Message `geometry_msgs/msg/TransformStamped`: transform with its time and frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Time of the transform, and the parent frame.
    pub header: Header,
    /// Name of the child frame.
    pub child_frame_id: String,
    /// Pose of the child frame in its parent.
    pub transform: Transform,
}

/// Message `tf2_msgs/msg/TFMessage`: transforms of `/tf`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TFMessage {
    /// Transforms that are published together.
    pub transforms: Vec<TransformStamped>,
}
