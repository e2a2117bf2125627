//! Trajectories that a board follows: points are sent as the board has room for them.
//!
//! A trajectory is not leased: once accepted it continues to its end, even without its publisher. `docs/ros2.md` lists what ends it
//! earlier; when this node or its link ends, the board trips.

use std::{
    cell::Cell,
    collections::{BTreeMap, BTreeSet},
    rc::Rc,
};

use futures::FutureExt;
use r4_driver::Error as DriverError;
use r4_protocol::{ChannelId, Mode, SafetyState, Sample, Setpoint, message::MAX_POINTS};
use r4_rig::path::{Feed, Waypoint, check};

use super::{Done, Report, Serving};
use crate::{
    gate::Refused,
    message::JointTrajectory,
    time::Stamp,
    trajectory::{self, BadTrajectory},
};

/// Least time from the arrival of a trajectory to its start, s: its first points must reach the board before their dates, or the board
/// refuses them as late. Our choice: the link time-out of the built-in robots, within which a link that works answers.
const LEAD_S: f64 = 0.2;
/// Longest time from the arrival of a trajectory to its start, s: until then its points wait in this node.
const AHEAD_S: f64 = 60.0;

/// Trajectory that the board is following.
pub(super) struct Following {
    joints: BTreeMap<ChannelId, Feed>,
    /// True while sent points await the board's answer.
    is_sending: bool,
    /// True once the board has accepted points.
    is_taken: bool,
    /// Set when the trajectory is ended early: no further points are sent.
    has_ended: Rc<Cell<bool>>,
}

/// Last measured position of each motor, rad or m.
pub(super) type Positions = BTreeMap<ChannelId, f64>;

impl<R: FnMut(Report) -> bool> Serving<'_, R> {
    /// Stores the motors' measured positions.
    pub(super) fn note_positions(&mut self, samples: &[Sample]) {
        for sample in samples {
            if let Sample::Motor { channel, position, .. } = *sample
                && let Ok(info) = self.session.board.channel(channel)
            {
                self.positions.insert(channel, f64::from(position) * f64::from(info.resolution));
            }
        }
    }

    /// Starts a trajectory in place of earlier commands. A trajectory without points cancels the current one.
    pub(super) fn trajectory(&mut self, stamp: Option<Stamp>, message: &JointTrajectory) -> Result<(), Refused> {
        if message.points.is_empty() {
            self.end_trajectory(&BTreeSet::new());
            return Ok(());
        }
        let board = self.session.board;
        let joints = trajectory::paths(message, board.channels())?;
        let now_us = board.device_us();
        let earliest_us = now_us + (LEAD_S * 1e6) as u64;
        let begin_us = self.begin_us(stamp, now_us)?.max(earliest_us);
        let time_s = |at_us: u64| (at_us as f64 - begin_us as f64) * 1e-6;
        let mut feeds = BTreeMap::new();
        for (info, mut points) in joints {
            let name = info.id.to_string();
            let here = self.positions.get(&info.id).copied();
            let here = here.ok_or_else(|| BadTrajectory::Unseen { name: name.clone() })?;
            let before = self.following.as_ref().and_then(|following| following.joints.get(&info.id));
            // The new path branches off the current one at the earliest time at which its points can be on the board. If the current one
            // has not started or is over, it branches off the measured position, at rest.
            let left = before.map(|feed| feed.at(earliest_us).unwrap_or((here, 0.0)));
            let checked = match left {
                Some((position, speed)) => {
                    let left = Waypoint { speed: Some(speed), ..Waypoint::at(time_s(earliest_us), position) };
                    // A point at time 0 is the planner's idea of the start; the joint is already moving elsewhere, so it is dropped.
                    if points.len() > 1 && points[0].time_s <= left.time_s {
                        points.remove(0);
                    }
                    points.insert(0, left);
                    check(&info, left, &points[1..])
                }
                None => {
                    // The joint stays at its measured position until the start.
                    if points[0].time_s > 0.0 {
                        points.insert(0, Waypoint { speed: Some(0.0), ..Waypoint::at(0.0, here) });
                    }
                    check(&info, Waypoint::at(time_s(now_us), here), &points)
                }
            };
            checked.map_err(|source| BadTrajectory::Beyond { name, source })?;
            feeds.insert(info.id, Feed::new(&points, 0.0, begin_us));
        }
        // After all checks, so that a trajectory that is refused starts no joint.
        self.leased.rest();
        self.end_trajectory(&feeds.keys().copied().collect());
        let has_ended = Rc::default();
        self.following = Some(Following { joints: feeds, is_sending: false, is_taken: false, has_ended });
        self.feed();
        Ok(())
    }

    /// Returns the start of a trajectory with this stamp on the board's clock, µs; 0 for at once. `now_us` is the board's clock now.
    fn begin_us(&self, stamp: Option<Stamp>, now_us: u64) -> Result<u64, Refused> {
        let stamp = stamp.ok_or(Refused::BadStamp)?;
        if stamp.is_none() {
            return Ok(0);
        }
        let ahead_s = stamp.since_s(self.now());
        let limit_s = self.gate.limit_s();
        if -ahead_s > limit_s {
            return Err(BadTrajectory::Begun { late_s: -ahead_s, limit_s }.into());
        }
        if ahead_s > AHEAD_S {
            return Err(BadTrajectory::FarAhead { ahead_s, limit_s: AHEAD_S }.into());
        }
        Ok(now_us.saturating_add_signed((ahead_s * 1e6) as i64))
    }

    /// Sends the points for which the board has room, one message for each joint, and detects the end of the trajectory.
    pub(super) fn feed(&mut self) {
        let board = self.session.board;
        let Some(following) = self.following.as_mut().filter(|following| !following.is_sending) else { return };
        let now_us = board.device_us();
        let batch: Vec<_> = following
            .joints
            .iter_mut()
            .map(|(channel, feed)| (*channel, feed.next(now_us, MAX_POINTS)))
            .filter(|(_, points)| !points.is_empty())
            .collect();
        if batch.is_empty() {
            // Nothing to send means no room, points too far ahead, or the end.
            let is_over = |feed: &Feed| feed.is_sent() && feed.end_us().is_none_or(|end_us| end_us < now_us);
            if following.joints.values().all(is_over) {
                self.following = None;
            }
            return;
        }
        following.is_sending = true;
        let has_ended = following.has_ended.clone();
        let work = async move {
            for (channel, points) in batch {
                // A command may end the trajectory between two messages.
                if has_ended.get() {
                    break;
                }
                if let Err(error) = board.follow(channel, &points).await {
                    return Done::Fed { has_ended, result: Err(error) };
                }
            }
            Done::Fed { has_ended, result: Ok(()) }
        };
        self.work.push(work.boxed_local());
    }

    /// Handles the board's answer to points of a trajectory.
    pub(super) fn fed(&mut self, has_ended: &Cell<bool>, result: Result<(), DriverError>) {
        let Some(following) = self.following.as_mut().filter(|_| !has_ended.get()) else { return };
        following.is_sending = false;
        match result {
            Ok(()) => {
                if !std::mem::replace(&mut following.is_taken, true) {
                    self.note_taken();
                }
                self.feed();
            }
            Err(error) => {
                self.end_trajectory(&BTreeSet::new());
                match self.session.board.safety().0 {
                    SafetyState::Armed => self.refuse(format!("the trajectory was ended: {error}")),
                    state => self.refuse(format!("the trajectory was ended, the board is {state}: call ~/arm first")),
                }
            }
        }
    }

    /// Ends the current trajectory. Its joints come to rest, except those in `anew`, which a new command takes over.
    pub(super) fn end_trajectory(&mut self, anew: &BTreeSet<ChannelId>) {
        let Some(following) = self.drop_trajectory() else { return };
        let board = self.session.board;
        let channels: Vec<_> = following.joints.into_keys().filter(|channel| !anew.contains(channel)).collect();
        let work = async move {
            for channel in channels {
                // A speed of 0 stops a motor by its profile, as the board does itself. A board that is not armed has nothing to stop.
                match board.set(channel, Setpoint { mode: Mode::Speed, value: 0.0 }).await {
                    Err(error) if board.safety().0 == SafetyState::Armed => return Done::Rested(Err(error)),
                    _ => {}
                }
            }
            Done::Rested(Ok(()))
        };
        self.work.push(work.boxed_local());
    }

    /// Discards the current trajectory without stopping its joints: for a board that stops them itself.
    pub(super) fn drop_trajectory(&mut self) -> Option<Following> {
        let following = self.following.take()?;
        following.has_ended.set(true);
        Some(following)
    }
}
