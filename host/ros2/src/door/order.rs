//! What comes from ROS.

use futures::channel::oneshot;

use crate::{
    lifecycle::Change,
    message::{JointState, JointTrajectory, TriggerResponse, Twist},
    parameters::ParameterCall,
    time::Stamp,
};

/// What a service does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// `~/arm`: lets outputs move.
    Arm,
    /// `~/disarm`: makes outputs safe.
    Disarm,
    /// `~/clear`: leaves a trip behind.
    Clear,
    /// `~/estop`: trips.
    Stop,
}

/// Something from ROS.
#[derive(Debug)]
pub enum Order {
    /// A velocity over the ground.
    Velocity {
        /// When it was decided; `None` for a stamp that is no time.
        stamp: Option<Stamp>,
        /// The velocity.
        twist: Twist,
    },
    /// Set points of joints.
    Joints {
        /// When they were decided; `None` for a stamp that is no time.
        stamp: Option<Stamp>,
        /// The set points.
        joints: JointState,
    },
    /// Paths of joints.
    Trajectory {
        /// When it begins, 0 for at once; `None` for a stamp that is no time.
        stamp: Option<Stamp>,
        /// The paths.
        trajectory: JointTrajectory,
    },
    /// The e-stop topic: engaged or released.
    Estop(bool),
    /// A message that cannot be read. Whatever it was, the commands before it end.
    Unreadable {
        /// Name of the topic.
        topic: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// A service call.
    Call {
        /// Of which.
        request: Request,
        /// Where its answer goes.
        answer: oneshot::Sender<TriggerResponse>,
    },
    /// A call of a parameter service.
    Parameters(ParameterCall),
    /// A transition of a managed node that has a session.
    Change(Change),
}
