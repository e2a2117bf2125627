//! Errors of a drive round waypoints.

use r4_driver::Error as DriverError;

/// Error of a robot that cannot drive round waypoints.
#[derive(Debug, thiserror::Error)]
pub enum RoundError {
    /// The robot has no range sensor, so that it could not detect a person in front.
    #[error("the robot has no range sensors, so it would not see people: add [[range]] tables to its file")]
    NoRangeSensor,
    /// The board stays disarmed after a trip that was cleared.
    #[error("cannot arm again")]
    NotArmedAgain(#[source] DriverError),
}
