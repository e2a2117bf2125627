//! Where things are and how they move.

use serde::{Deserialize, Serialize};

use super::Header;

/// `geometry_msgs/msg/Vector3`, and `geometry_msgs/msg/Point`, which has the same fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Vector3 {
    /// Forwards.
    pub x: f64,
    /// To the left.
    pub y: f64,
    /// Upwards.
    pub z: f64,
}

/// `geometry_msgs/msg/Quaternion`
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Of the vector part.
    pub x: f64,
    /// Of the vector part.
    pub y: f64,
    /// Of the vector part.
    pub z: f64,
    /// Scalar part.
    pub w: f64,
}

impl Default for Quaternion {
    /// No rotation.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}

impl Quaternion {
    /// Rotation about z, counterclockwise, rad.
    #[must_use]
    pub fn of_yaw(yaw_rad: f64) -> Self {
        let (sin, cos) = (yaw_rad / 2.0).sin_cos();
        Self { x: 0.0, y: 0.0, z: sin, w: cos }
    }
}

/// `geometry_msgs/msg/Twist`: m/s and rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Twist {
    /// m/s
    pub linear: Vector3,
    /// rad/s
    pub angular: Vector3,
}

/// `geometry_msgs/msg/TwistStamped`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TwistStamped {
    /// When it was decided.
    pub header: Header,
    /// The velocity.
    pub twist: Twist,
}

/// `geometry_msgs/msg/Pose`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// m
    pub position: Vector3,
    /// Rotation of the body.
    pub orientation: Quaternion,
}

/// `geometry_msgs/msg/PoseWithCovariance`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PoseWithCovariance {
    /// The pose.
    pub pose: Pose,
    /// Row by row over x, y, z, and rotations about x, y, z: m², m rad, rad².
    #[serde(with = "super::array")]
    pub covariance: [f64; 36],
}

/// `geometry_msgs/msg/TwistWithCovariance`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TwistWithCovariance {
    /// The velocity.
    pub twist: Twist,
    /// Row by row over x, y, z, and rates about x, y, z: m²/s², m rad/s², rad²/s².
    #[serde(with = "super::array")]
    pub covariance: [f64; 36],
}

/// `nav_msgs/msg/Odometry`
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Odometry {
    /// Frame of the pose.
    pub header: Header,
    /// Frame of the velocity.
    pub child_frame_id: String,
    /// Where it is.
    pub pose: PoseWithCovariance,
    /// How it moves.
    pub twist: TwistWithCovariance,
}

/// `geometry_msgs/msg/Transform`
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// m
    pub translation: Vector3,
    /// Rotation of the child frame.
    pub rotation: Quaternion,
}

/// `geometry_msgs/msg/TransformStamped`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TransformStamped {
    /// Parent frame.
    pub header: Header,
    /// Child frame.
    pub child_frame_id: String,
    /// The child frame in its parent.
    pub transform: Transform,
}

/// `tf2_msgs/msg/TFMessage`
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TFMessage {
    /// All that is known anew.
    pub transforms: Vec<TransformStamped>,
}
