//! A drive round waypoints: a skid-steer robot follows them by its odometry, slows down and stops before obstacles that
//! its range sensors detect, and continues when they are gone.
//!
//! The robot uses only what the board measures. The observer passed to [`drive`] may record, and compare with the true
//! state of a simulation.

mod error;
mod senses;

use std::fmt;

use r4_boards::{Drive, SkidSteer};
use r4_driver::Error as DriverError;
use r4_protocol::{Causes, ChannelId, ChannelKind, SafetyState};

pub use error::RoundError;
use senses::Senses;

use crate::{Error, Follower, GroundDrive, Limits, Odometry, Place, Session, Velocity};

/// Waypoints and parameters of a drive.
#[derive(Clone, Debug)]
pub struct Round {
    /// Waypoints, m, in the frame of the robot's start.
    pub waypoints_m: Vec<[f64; 2]>,
    /// Speeds and distances of the follower.
    pub limits: Limits,
    /// Telemetry period of wheels and range sensors, ms.
    pub telemetry_ms: u16,
    /// Period of the attempts to clear a trip, s.
    pub clear_every_s: f64,
    /// Time limit of the drive, s; it ends then before its last waypoint.
    pub timeout_s: f64,
}

/// Measurements of one telemetry frame, and the resulting velocity.
#[derive(Clone, Copy, Debug)]
pub struct Measured {
    /// Time since the drive began, s.
    pub time_s: f64,
    /// Mean positions of the left and the right wheels, rad.
    pub sides_rad: [f64; 2],
    /// Pose by the odometry.
    pub place: Place,
    /// Free distance in front, m; infinite without an obstacle in range.
    pub free_m: f64,
    /// Requested velocity; zero while the board is tripped.
    pub velocity: Velocity,
}

/// Change of the robot's behaviour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The board tripped, with these causes.
    Tripped(Causes),
    /// The trip's causes are gone; it was cleared and the board armed again.
    ArmedAgain,
    /// The robot stands because of an obstacle in front.
    Stands,
    /// The obstacle is gone.
    GoesOn,
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tripped(causes) => write!(f, "tripped: {causes}"),
            Self::ArmedAgain => f.write_str("cleared and armed again"),
            Self::Stands => f.write_str("stops for an obstacle"),
            Self::GoesOn => f.write_str("continues"),
        }
    }
}

/// Record of a drive, passed to an observer.
#[derive(Clone, Copy, Debug)]
pub enum Observation {
    /// Measurements of one telemetry frame.
    Measured(Measured),
    /// Event, with its time since the drive began, s.
    Event(f64, Event),
}

/// Arms, drives `round` and disarms. Passes each [`Observation`] to `observe`, and returns the number of waypoints
/// reached.
///
/// After a trip it clears and arms again as soon as the causes are gone. The caller takes the responsibility of the
/// person who would otherwise have checked the robot.
///
/// # Errors
/// The error of `observe`; [`RoundError::NoRangeSensor`]; the error of a board that fails otherwise than by a trip.
pub async fn drive<E: From<Error>>(
    session: &Session<'_>,
    robot: &SkidSteer,
    round: &Round,
    mut observe: impl FnMut(Observation) -> Result<(), E>,
) -> Result<usize, E> {
    let board = session.board;
    let ground = GroundDrive::new(Drive::SkidSteer(robot.clone()));
    let mut odometry = Odometry::new(robot);
    let mut follower = Follower::new(round.limits, round.waypoints_m.iter().copied());
    let ranges: Vec<ChannelId> =
        board.channels().iter().map(|info| info.id).filter(|id| id.kind == ChannelKind::Range).collect();
    if ranges.is_empty() {
        return Err(Error::from(RoundError::NoRangeSensor).into());
    }
    let mut senses = Senses::new(robot, &ranges);
    let mut telemetry = board.telemetry();
    for channel in ranges.iter().chain(&robot.left).chain(&robot.right).copied() {
        board.subscribe(channel, round.telemetry_ms).await.map_err(Error::from)?;
    }
    let begin_s = board.now_s();
    let work = async || {
        // Time of the next attempt to clear, once the board has tripped.
        let mut clear_s: Option<f64> = None;
        let mut stood = false;
        loop {
            let frame = telemetry.next().await.map_err(Error::from)?;
            senses.update(board, &frame.samples);
            let Some(sides_rad) = senses.sides_rad() else { continue };
            odometry.look(sides_rad[0], sides_rad[1]);
            let time_s = board.now_s() - begin_s;
            let mut velocity = Velocity::default();
            if frame.state == SafetyState::Tripped {
                if clear_s.is_none() {
                    observe(Observation::Event(time_s, Event::Tripped(frame.causes)))?;
                }
                let at_s = *clear_s.get_or_insert(time_s + round.clear_every_s);
                if time_s >= at_s {
                    clear_s = Some(time_s + round.clear_every_s);
                    if arm_again(session).await? {
                        observe(Observation::Event(board.now_s() - begin_s, Event::ArmedAgain))?;
                        // Frames that were queued meanwhile still report the trip.
                        (clear_s, telemetry) = (None, board.telemetry());
                    }
                }
            } else {
                match follower.velocity(odometry.place(), senses.free_m()) {
                    Some(next) => velocity = next,
                    None => break,
                }
                // Sent one after the other, so that a replay of the log sends them at the same times.
                for (channel, setpoint) in ground.setpoints(velocity) {
                    board.set(channel, setpoint).await.or_else(unless_refused).map_err(Error::from)?;
                }
                let stands = velocity == Velocity::default();
                if stands != stood {
                    let event = if stands { Event::Stands } else { Event::GoesOn };
                    observe(Observation::Event(time_s, event))?;
                    stood = stands;
                }
            }
            let (place, free_m) = (odometry.place(), senses.free_m());
            observe(Observation::Measured(Measured { time_s, sides_rad, place, free_m, velocity }))?;
            if time_s > round.timeout_s {
                break;
            }
        }
        Ok(round.waypoints_m.len() - follower.places_left())
    };
    session.armed(work).await
}

/// Ignores the refusal of a set point: the board has tripped meanwhile, and the next frame has the cause.
fn unless_refused(error: DriverError) -> Result<(), DriverError> {
    if matches!(error, DriverError::Refused { .. }) { Ok(()) } else { Err(error) }
}

/// Clears a trip and arms. Returns true when the causes were gone.
///
/// # Errors
/// The error of the board; [`RoundError::NotArmedAgain`] when it stays disarmed after the trip was cleared.
pub async fn arm_again(session: &Session<'_>) -> Result<bool, Error> {
    match session.board.clear().await {
        Ok(()) => {}
        Err(DriverError::Refused { .. }) => return Ok(false),
        Err(error) => return Err(error.into()),
    }
    session.board.arm().await.map_err(RoundError::NotArmedAgain)?;
    Ok(true)
}
