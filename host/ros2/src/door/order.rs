//! Messages and calls from ROS.

use futures::channel::oneshot;

use crate::{
    lifecycle::Change,
    message::{JointState, JointTrajectory, TriggerResponse, Twist},
    parameters::ParameterCall,
    time::Stamp,
};

/// Request of a service of the type `std_srvs/Trigger`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// Service `~/arm`: permits outputs to move.
    Arm,
    /// Service `~/disarm`: takes outputs to their safe state.
    Disarm,
    /// Service `~/clear`: clears a trip.
    Clear,
    /// Service `~/estop`: trips the board.
    Stop,
}

/// Message or call from ROS.
#[derive(Debug)]
pub enum Order {
    /// Velocity over the ground.
    Velocity {
        /// Time of the decision; `None` for an invalid stamp.
        stamp: Option<Stamp>,
        /// Velocity of `base_link`, m/s and rad/s.
        twist: Twist,
    },
    /// Set points of joints.
    Joints {
        /// Time of the decision; `None` for an invalid stamp.
        stamp: Option<Stamp>,
        /// Positions or speeds by joint.
        joints: JointState,
    },
    /// Paths of joints over time.
    Trajectory {
        /// Start time, 0 for at once; `None` for an invalid stamp.
        stamp: Option<Stamp>,
        /// Points of the paths.
        trajectory: JointTrajectory,
    },
    /// State of the e-stop topic: true for engaged, false for released.
    Estop(bool),
    /// Message that cannot be decoded. It ends the commands before it, since it may have been meant to replace them.
    Unreadable {
        /// Name of the topic.
        topic: &'static str,
        /// Error of the decoder.
        why: String,
    },
    /// Call of a service of the type `std_srvs/Trigger`.
    Call {
        /// Request of the service.
        request: Request,
        /// Sender of the answer.
        answer: oneshot::Sender<TriggerResponse>,
    },
    /// Call of a parameter service.
    Parameters(ParameterCall),
    /// Transition of a managed node that has a session.
    Change(Change),
}
