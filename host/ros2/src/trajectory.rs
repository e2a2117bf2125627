//! Conversion of joint trajectories to paths of motors, as pure functions.

use r4_protocol::{ChannelInfo, Mode};
use r4_rig::path::{BeyondLimit, Waypoint, thinned};

use crate::message::{Duration, JointTrajectory};

/// Reason for the refusal of a trajectory.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadTrajectory {
    /// The message has points but no names of joints.
    #[error("it has points but no joint_names: name the joints, or send neither to cancel the current trajectory")]
    NoNames,
    /// The board has no joint of this name.
    #[error("this board has no joint {name:?}: joint_states lists the names")]
    UnknownJoint {
        /// Name in the message.
        name: String,
    },
    /// A joint has two paths.
    #[error("{name} is named twice: give each joint one path")]
    Twice {
        /// Name of the joint.
        name: String,
    },
    /// A point has a different number of values and joints.
    #[error("point {index} has {numbers} {what} for {names} joints: give one for each")]
    Lengths {
        /// Index of the point, from 0.
        index: usize,
        /// Field of the values: `positions` or `velocities`.
        what: &'static str,
        /// Number of joints in the message.
        names: usize,
        /// Number of values in the point.
        numbers: usize,
    },
    /// A number is NaN or infinite.
    #[error("point {index} has a number for {name} that is not finite: check the publisher")]
    NotFinite {
        /// Index of the point, from 0.
        index: usize,
        /// Name of the joint.
        name: String,
    },
    /// The times of the points do not increase, or one is invalid.
    #[error("time_from_start of point {index} is negative, invalid, or not later than that of the point before")]
    Time {
        /// Index of the point, from 0.
        index: usize,
    },
    /// A point has efforts, which a board cannot follow.
    #[error("point {index} has efforts: boards follow positions and velocities; leave effort empty")]
    Effort {
        /// Index of the point, from 0.
        index: usize,
    },
    /// The joint has not sent a position yet.
    #[error("{name} has not sent its position yet: wait for it in joint_states")]
    Unseen {
        /// Name of the joint.
        name: String,
    },
    /// The start of the trajectory lies too far in the past.
    #[error(
        "its start is {late_s:.3} s ago and at most {limit_s} s are allowed: set its stamp to 0, or synchronise the clocks of both \
         machines; for a simulated board, set use_sim_time of the publisher"
    )]
    Begun {
        /// Time since the start, s.
        late_s: f64,
        /// Maximum time since the start, s.
        limit_s: f64,
    },
    /// The start of the trajectory lies too far in the future.
    #[error("it starts in {ahead_s:.3} s and at most {limit_s} s are allowed: send it later")]
    FarAhead {
        /// Time until the start, s.
        ahead_s: f64,
        /// Maximum time until the start, s.
        limit_s: f64,
    },
    /// The path of a joint exceeds its limits.
    #[error("{name}: {source}")]
    Beyond {
        /// Name of the joint.
        name: String,
        /// Exceeded limit, with the requested value.
        source: BeyondLimit,
    },
}

/// Converts a trajectory to one path for each joint, in the order of its names. Times count from the start of the trajectory. Points
/// closer than [`THIN_S`](r4_rig::path::THIN_S) to the one before are omitted. Without velocities, the last point is at rest.
/// Accelerations are ignored, since those of the board's cubic follow from positions and speeds.
///
/// # Errors
/// [`BadTrajectory`] for the first error in the message.
pub fn paths(
    message: &JointTrajectory,
    channels: &[ChannelInfo],
) -> Result<Vec<(ChannelInfo, Vec<Waypoint>)>, BadTrajectory> {
    if message.joint_names.is_empty() {
        return Err(BadTrajectory::NoNames);
    }
    let mut joints: Vec<(ChannelInfo, Vec<Waypoint>)> = Vec::new();
    for name in &message.joint_names {
        let known = channels.iter().find(|info| info.id.to_string() == *name);
        let info = known.ok_or_else(|| BadTrajectory::UnknownJoint { name: name.clone() })?;
        if info.mode(Mode::Follow).is_none() {
            return Err(BadTrajectory::Beyond { name: name.clone(), source: BeyondLimit::FollowsNone });
        }
        if joints.iter().any(|(other, _)| other.id == info.id) {
            return Err(BadTrajectory::Twice { name: name.clone() });
        }
        joints.push((info.clone(), Vec::new()));
    }
    let mut before_s = f64::NEG_INFINITY;
    for (index, point) in message.points.iter().enumerate() {
        let names = joints.len();
        let lengths = [("positions", &point.positions, true), ("velocities", &point.velocities, false)];
        for (what, numbers, is_needed) in lengths {
            if numbers.len() != names && (is_needed || !numbers.is_empty()) {
                return Err(BadTrajectory::Lengths { index, what, names, numbers: numbers.len() });
            }
        }
        if !point.effort.is_empty() {
            // Efforts cannot be ignored like accelerations: a publisher that gives them expects a force.
            return Err(BadTrajectory::Effort { index });
        }
        let time_s = seconds(point.time_from_start).filter(|time_s| *time_s >= 0.0 && *time_s > before_s);
        let time_s = time_s.ok_or(BadTrajectory::Time { index })?;
        before_s = time_s;
        let is_last = index + 1 == message.points.len();
        for (at, (info, points)) in joints.iter_mut().enumerate() {
            let (position, speed) = (point.positions[at], point.velocities.get(at).copied());
            if !position.is_finite() || speed.is_some_and(|speed| !speed.is_finite()) {
                return Err(BadTrajectory::NotFinite { index, name: info.id.to_string() });
            }
            let speed = if is_last { Some(speed.unwrap_or(0.0)) } else { speed };
            points.push(Waypoint { speed, ..Waypoint::at(time_s, position) });
        }
    }
    Ok(joints.into_iter().map(|(info, points)| (info, thinned(points))).collect())
}

/// Returns a duration, s; `None` when its nanoseconds are a second or more, which is invalid.
fn seconds(duration: Duration) -> Option<f64> {
    (duration.nanosec < 1_000_000_000).then(|| f64::from(duration.sec) + f64::from(duration.nanosec) * 1e-9)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelId, ChannelKind, ModeInfo, Range, Unit};

    use super::*;
    use crate::message::JointTrajectoryPoint;

    fn channels() -> Vec<ChannelInfo> {
        let range = Range::new(-1.0, 1.0);
        let channel = |index, modes: &[Mode]| ChannelInfo {
            id: ChannelId::new(ChannelKind::Osmc, index),
            unit: Unit::Rad,
            range,
            rate_hz: 1000.0,
            resolution: 0.001,
            modes: modes.iter().map(|mode| ModeInfo { mode: *mode, unit: Unit::Rad, range }).collect(),
        };
        vec![channel(0, &[Mode::Follow]), channel(1, &[Mode::Follow]), channel(2, &[Mode::Duty])]
    }

    fn point(ms: u32, positions: &[f64], velocities: &[f64]) -> JointTrajectoryPoint {
        let time_from_start = Duration { sec: (ms / 1000) as i32, nanosec: ms % 1000 * 1_000_000 };
        let (positions, velocities) = (positions.to_vec(), velocities.to_vec());
        JointTrajectoryPoint { positions, velocities, time_from_start, ..JointTrajectoryPoint::default() }
    }

    fn trajectory(names: &[&str], points: &[JointTrajectoryPoint]) -> JointTrajectory {
        let joint_names = names.iter().map(|name| (*name).to_owned()).collect();
        JointTrajectory { joint_names, points: points.to_vec(), ..JointTrajectory::default() }
    }

    #[test]
    fn each_joint_gets_its_points_and_rests_at_the_last() {
        let message = trajectory(&["osmc1", "osmc0"], &[point(500, &[0.1, 0.2], &[]), point(1500, &[0.3, 0.4], &[])]);
        let [(first, of_first), (second, of_second)] = &paths(&message, &channels()).expect("paths")[..] else {
            panic!("two")
        };
        assert_eq!((first.id.to_string(), second.id.to_string()), ("osmc1".into(), "osmc0".into()));
        let rest = |time_s, position| Waypoint { speed: Some(0.0), ..Waypoint::at(time_s, position) };
        assert_eq!(of_first[..], [Waypoint::at(0.5, 0.1), rest(1.5, 0.3)]);
        assert_eq!(of_second[..], [Waypoint::at(0.5, 0.2), rest(1.5, 0.4)]);
        let moving = trajectory(&["osmc0"], &[point(500, &[0.1], &[0.2])]);
        assert_eq!(paths(&moving, &channels()).expect("paths")[0].1[0].speed, Some(0.2));
    }

    #[test]
    fn each_thing_that_is_wrong_has_its_reason() {
        let good = point(500, &[0.1], &[]);
        let effort = JointTrajectoryPoint { effort: vec![1.0], ..good.clone() };
        let no_time =
            JointTrajectoryPoint { time_from_start: Duration { sec: 0, nanosec: 1_000_000_000 }, ..good.clone() };
        let early = JointTrajectoryPoint { time_from_start: Duration { sec: -1, nanosec: 0 }, ..good.clone() };
        for (names, points, says) in [
            (&[][..], vec![good.clone()], "no joint_names"),
            (&["elbow"], vec![good.clone()], "no joint \"elbow\""),
            (&["osmc2"], vec![good.clone()], "osmc2: it cannot follow a path"),
            (&["osmc0", "osmc0"], vec![point(500, &[0.1, 0.1], &[])], "named twice"),
            (&["osmc0"], vec![point(500, &[], &[])], "point 0 has 0 positions for 1 joints"),
            (&["osmc0"], vec![good.clone(), point(600, &[0.1], &[0.1, 0.2])], "point 1 has 2 velocities"),
            (&["osmc0"], vec![good.clone(), point(500, &[0.1], &[])], "time_from_start of point 1"),
            (&["osmc0"], vec![no_time], "time_from_start of point 0"),
            (&["osmc0"], vec![early], "time_from_start of point 0"),
            (&["osmc0"], vec![effort], "point 0 has efforts"),
            (&["osmc0"], vec![point(500, &[f64::NAN], &[])], "point 0 has a number for osmc0"),
            (&["osmc0"], vec![point(500, &[0.1], &[f64::INFINITY])], "not finite"),
        ] {
            let refused = paths(&trajectory(names, &points), &channels()).expect_err(says).to_string();
            assert!(refused.contains(says), "{refused}");
        }
    }

    proptest! {
        /// Any message either gives paths with increasing times and finite numbers, or is refused.
        #[test]
        fn any_message_is_followed_or_refused(
            points in prop::collection::vec((any::<i32>(), any::<u32>(), prop::collection::vec(any::<f64>(), 0..3)), 1..20),
            speeds in prop::collection::vec(any::<f64>(), 0..3),
        ) {
            let points: Vec<_> = points.into_iter().map(|(sec, nanosec, positions)| JointTrajectoryPoint {
                positions,
                velocities: speeds.clone(),
                time_from_start: Duration { sec, nanosec },
                ..JointTrajectoryPoint::default()
            }).collect();
            if let Ok(joints) = paths(&trajectory(&["osmc0", "osmc1"], &points), &channels()) {
                for (_, points) in joints {
                    prop_assert!(!points.is_empty());
                    prop_assert!(points.windows(2).all(|pair| pair[0].time_s < pair[1].time_s));
                    prop_assert!(points.iter().all(|point| point.position.is_finite() && point.time_s >= 0.0));
                }
            }
        }
    }
}
