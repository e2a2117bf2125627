//! ROS messages, field by field as the `.msg` files of ROS 2 Jazzy have them: serialised in that order they are CDR.
//!
//! # Source
//! The interface files of `common_interfaces` 5.3.6, `rcl_interfaces` 2.0.3 and `geometry2`, Apache-2.0 and BSD: names, order and types.

mod diagnostic;
mod geometry;
mod lifecycle;
mod parameter;
mod sensor;
mod service;
mod trajectory;

pub use diagnostic::{DiagnosticArray, DiagnosticStatus, KeyValue, Level};
pub use geometry::{
    Odometry, Pose, PoseWithCovariance, Quaternion, TFMessage, Transform, TransformStamped, Twist, TwistStamped,
    TwistWithCovariance, Vector3,
};
pub use lifecycle::{
    ChangeStateRequest, ChangeStateResponse, EmptyRequest, GetAvailableStatesResponse, GetAvailableTransitionsResponse,
    GetStateResponse, LifecycleState, LifecycleTransition, TransitionDescription, TransitionEvent,
};
pub use parameter::{
    DescribeParametersResponse, FloatingPointRange, GetParameterTypesResponse, GetParametersResponse, IntegerRange,
    ListParametersRequest, ListParametersResponse, ListParametersResult, NamesRequest, Parameter, ParameterDescriptor,
    ParameterValue, SetParametersAtomicallyResponse, SetParametersRequest, SetParametersResponse, SetParametersResult,
    parameter_type,
};
pub use sensor::{BatteryState, Imu, JointState, Range};
pub use service::{TriggerRequest, TriggerResponse};
pub use trajectory::{Duration, JointTrajectory, JointTrajectoryPoint};

use serde::{Deserialize, Serialize};

/// `builtin_interfaces/msg/Time`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds, downwards, s.
    pub sec: i32,
    /// What is above them, ns: below 10⁹.
    pub nanosec: u32,
}

/// `std_msgs/msg/Header`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// When it was measured or decided.
    pub stamp: Time,
    /// Frame of the numbers.
    pub frame_id: String,
}

impl Header {
    /// Header of a message.
    #[must_use]
    pub fn new(stamp: Time, frame: &str) -> Self {
        Self { stamp, frame_id: frame.to_owned() }
    }
}

/// `std_msgs/msg/String`
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Text {
    /// The text.
    pub data: String,
}

/// `std_msgs/msg/Bool`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bool {
    /// The value.
    pub data: bool,
}

/// `rosgraph_msgs/msg/Clock`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// Simulated time.
    pub clock: Time,
}

/// Arrays of more than 32 numbers, which serde does not have: a fixed array is its elements without a length.
pub(crate) mod array {
    use std::fmt;

    use serde::{
        Deserializer, Serializer,
        de::{Error, SeqAccess, Visitor},
        ser::SerializeTuple,
    };

    pub(crate) fn serialize<const N: usize, S: Serializer>(values: &[f64; N], to: S) -> Result<S::Ok, S::Error> {
        let mut tuple = to.serialize_tuple(N)?;
        values.iter().try_for_each(|value| tuple.serialize_element(value))?;
        tuple.end()
    }

    pub(crate) fn deserialize<'de, const N: usize, D: Deserializer<'de>>(from: D) -> Result<[f64; N], D::Error> {
        struct Numbers<const N: usize>;
        impl<'de, const N: usize> Visitor<'de> for Numbers<N> {
            type Value = [f64; N];

            fn expecting(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(to, "{N} numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut from: A) -> Result<[f64; N], A::Error> {
                let mut values = [0.0; N];
                for (index, value) in values.iter_mut().enumerate() {
                    *value = from.next_element()?.ok_or_else(|| A::Error::invalid_length(index, &self))?;
                }
                Ok(values)
            }
        }
        from.deserialize_tuple(N, Numbers)
    }
}
