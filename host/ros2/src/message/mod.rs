//! ROS messages with the fields of the `.msg` files of ROS 2 Jazzy, in their order: serialised in that order, they are CDR.
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

/// Message `builtin_interfaces/msg/Time`: ROS time since 1970 or since the start of a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Time {
    /// Whole seconds, rounded downwards, s.
    pub sec: i32,
    /// Remainder above the whole seconds, ns: below 10⁹.
    pub nanosec: u32,
}

/// Message `std_msgs/msg/Header`: time and frame of a message.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// Time of the measurement, or of the decision on a command; 0 for no stamp.
    pub stamp: Time,
    /// Name of the frame of the message's numbers; empty for none.
    pub frame_id: String,
}

impl Header {
    /// Creates the header of a message.
    #[must_use]
    pub fn new(stamp: Time, frame: &str) -> Self {
        Self { stamp, frame_id: frame.to_owned() }
    }
}

/// Message `std_msgs/msg/String`: a text.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Text {
    /// Text of the message.
    pub data: String,
}

/// Message `std_msgs/msg/Bool`: a switch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bool {
    /// State of the switch.
    pub data: bool,
}

/// Message `rosgraph_msgs/msg/Clock`: time of a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clock {
    /// Simulated time of the board.
    pub clock: Time,
}

/// Serde implementation for arrays of more than 32 numbers, which serde lacks. CDR writes the elements of a fixed array without a length.
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
