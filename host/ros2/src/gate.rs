//! Acceptance of commands, as pure functions with the time as an argument.
//!
//! A refused command ends the set points before it, and a command older than an accepted one changes nothing: an outdated command never
//! replaces a newer one.

use r4_driver::Error as DriverError;
use r4_protocol::{ChannelId, ChannelInfo, Mode, Setpoint};
use r4_rig::Velocity;

use crate::{
    message::{JointState, Twist},
    time::Stamp,
    trajectory::BadTrajectory,
};

/// Reason for the refusal of a command.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refused {
    /// A number is NaN or infinite.
    #[error("{what} is not a finite number: check the publisher")]
    NotFinite {
        /// Field of the number, or name of its joint.
        what: String,
    },
    /// A message cannot be decoded as its topic's type.
    #[error("a message on {topic} cannot be decoded ({why}): check its type")]
    Unreadable {
        /// Name of the topic.
        topic: &'static str,
        /// Error of the decoder.
        why: String,
    },
    /// The stamp is invalid: its nanoseconds are a second or more.
    #[error("the nanoseconds of the stamp are a second or more: check the publisher")]
    BadStamp,
    /// The command is too old.
    #[error(
        "its stamp is {age_s:.3} s old and at most {limit_s} s are allowed: synchronise the clocks of both machines; for a simulated \
         board, set use_sim_time of the publisher"
    )]
    Stale {
        /// Age of the stamp, s.
        age_s: f64,
        /// Maximum age of a stamp, s.
        limit_s: f64,
    },
    /// The stamp lies too far in the future.
    #[error(
        "its stamp is {ahead_s:.3} s ahead and at most {limit_s} s are allowed: synchronise the clocks of both machines; for a \
         simulated board, set use_sim_time of the publisher"
    )]
    Ahead {
        /// Time until the stamp, s.
        ahead_s: f64,
        /// Maximum time until a stamp, s.
        limit_s: f64,
    },
    /// The robot cannot drive, or its geometry is unknown.
    #[error("velocities need a robot whose file has [drive] (boards/README.md): use joint_commands")]
    NoDrive,
    /// A message has a different number of names and values.
    #[error("{names} names but {numbers} values of {what}: give one value for each name, or none")]
    Lengths {
        /// Field of the values: `position` or `velocity`.
        what: &'static str,
        /// Number of names in the message.
        names: usize,
        /// Number of values in the field.
        numbers: usize,
    },
    /// The board has no joint of this name.
    #[error("this board has no joint {name:?}: joint_states lists the names")]
    UnknownJoint {
        /// Name in the message.
        name: String,
    },
    /// A joint has two set points.
    #[error("{name} is named twice: give each joint one set point")]
    Twice {
        /// Name of the joint.
        name: String,
    },
    /// A joint has both a position and a speed.
    #[error("{name} has a position and a velocity: give one, and NaN or nothing for the other")]
    Both {
        /// Name of the joint.
        name: String,
    },
    /// A joint does not accept set points of this mode.
    #[error("{name} cannot be commanded by {mode}: `r4 info` lists what it can take")]
    NoMode {
        /// Name of the joint.
        name: String,
        /// Mode of the set point.
        mode: Mode,
    },
    /// The command has more joints than a stream.
    #[error("{asked} joints in one command: at most {most} can be commanded together")]
    TooMany {
        /// Number of joints in the command.
        asked: usize,
        /// Maximum number of joints in a command.
        most: usize,
    },
    /// A trajectory cannot be followed.
    #[error("the trajectory was refused: {0}")]
    Trajectory(#[from] BadTrajectory),
    /// The board or the driver refused the command.
    #[error(transparent)]
    Board(DriverError),
}

/// Check of commands' stamps, with the newest accepted one.
#[derive(Clone, Debug)]
pub struct Gate {
    /// Maximum age of a command, and maximum time by which its stamp may lie ahead, s.
    limit_s: f64,
    newest: Option<Stamp>,
}

impl Gate {
    /// Creates a check with a maximum age of `limit_s`, which is the board's link time-out.
    #[must_use]
    pub fn new(limit_s: f64) -> Self {
        Self { limit_s, newest: None }
    }

    /// Returns the maximum age of a command, which is also the maximum time by which its stamp may lie ahead, s.
    #[must_use]
    pub fn limit_s(&self) -> f64 {
        self.limit_s
    }

    /// Returns true when a command with this stamp is accepted at `now`, and false when it is to be ignored because it is older than an
    /// accepted one. A stamp of 0 counts as now, as in other controllers of ROS. `None` is an invalid stamp.
    ///
    /// # Errors
    /// [`Refused::BadStamp`] for an invalid stamp, [`Refused::Stale`] and [`Refused::Ahead`] beyond the limit.
    pub fn pass(&mut self, stamp: Option<Stamp>, now: Stamp) -> Result<bool, Refused> {
        let stamp = stamp.ok_or(Refused::BadStamp)?;
        let stamp = if stamp.is_none() { now } else { stamp };
        let (age_s, limit_s) = (now.since_s(stamp), self.limit_s);
        if age_s > limit_s {
            return Err(Refused::Stale { age_s, limit_s });
        }
        if -age_s > limit_s {
            return Err(Refused::Ahead { ahead_s: -age_s, limit_s });
        }
        // After a clock was set back by more than the limit, for example by a new simulation, the newest stamp no longer counts.
        let before = self.newest.filter(|newest| newest.since_s(now) <= limit_s);
        if before.is_some_and(|before| stamp < before) {
            return Ok(false);
        }
        self.newest = Some(stamp);
        Ok(true)
    }
}

/// Returns the velocity over the ground of a twist. A wheeled robot ignores its other components, which must be finite.
///
/// # Errors
/// [`Refused::NotFinite`] for the first component that is NaN or infinite.
pub fn velocity(twist: &Twist) -> Result<Velocity, Refused> {
    let parts = [("linear", twist.linear), ("angular", twist.angular)];
    let numbers = parts.iter().flat_map(|(part, of)| [(part, "x", of.x), (part, "y", of.y), (part, "z", of.z)]);
    for (part, axis, value) in numbers {
        if !value.is_finite() {
            return Err(Refused::NotFinite { what: format!("{part}.{axis}") });
        }
    }
    Ok(Velocity { forward_m_s: twist.linear.x, yaw_rad_s: twist.angular.z })
}

/// Returns the set points of a message about joints. NaN means no set point of this mode, as ros2_control publishes it.
///
/// # Errors
/// [`Refused`] for the first joint that is not accepted; then the whole command is refused.
pub fn joints(
    message: &JointState,
    channels: &[ChannelInfo],
    most: usize,
) -> Result<Vec<(ChannelId, Setpoint)>, Refused> {
    let names = message.name.len();
    for (what, numbers) in [("position", message.position.len()), ("velocity", message.velocity.len())] {
        if numbers != 0 && numbers != names {
            return Err(Refused::Lengths { what, names, numbers });
        }
    }
    let mut setpoints: Vec<(ChannelId, Setpoint)> = Vec::new();
    for (index, name) in message.name.iter().enumerate() {
        let given = |values: &[f64]| values.get(index).copied().filter(|value| !value.is_nan());
        let (mode, value) = match (given(&message.position), given(&message.velocity)) {
            (Some(_), Some(_)) => return Err(Refused::Both { name: name.clone() }),
            (Some(position), None) => (Mode::Position, position),
            (None, Some(speed)) => (Mode::Speed, speed),
            (None, None) => continue,
        };
        if !value.is_finite() {
            return Err(Refused::NotFinite { what: name.clone() });
        }
        let known = channels.iter().find(|info| info.id.to_string() == *name);
        let info = known.ok_or_else(|| Refused::UnknownJoint { name: name.clone() })?;
        if info.mode(mode).is_none() {
            return Err(Refused::NoMode { name: name.clone(), mode });
        }
        if setpoints.iter().any(|(channel, _)| *channel == info.id) {
            return Err(Refused::Twice { name: name.clone() });
        }
        setpoints.push((info.id, Setpoint { mode, value: value as f32 }));
    }
    // Counted without NaN entries: ros2_control names all joints in each message.
    if setpoints.len() > most {
        return Err(Refused::TooMany { asked: setpoints.len(), most });
    }
    Ok(setpoints)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelKind, ModeInfo, Range, Unit};

    use super::*;
    use crate::message::Vector3;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_ns((seconds * 1e9) as i64)
    }

    #[test]
    fn stale_and_early_stamps_are_refused() {
        let mut gate = Gate::new(0.2);
        assert_eq!(gate.pass(Some(at(9.9)), at(10.0)), Ok(true));
        assert_eq!(gate.pass(Some(at(10.1)), at(10.0)), Ok(true));
        assert!(matches!(gate.pass(Some(at(9.75)), at(10.0)), Err(Refused::Stale { .. })));
        assert!(matches!(gate.pass(Some(at(10.25)), at(10.0)), Err(Refused::Ahead { .. })));
        assert_eq!(gate.pass(None, at(10.0)), Err(Refused::BadStamp));
        let said = gate.pass(Some(at(7.0)), at(10.0)).expect_err("stale").to_string();
        assert!(said.starts_with("its stamp is 3.000 s old and at most 0.2 s are allowed"), "{said}");
    }

    #[test]
    fn an_older_command_changes_nothing_and_none_counts_as_now() {
        let mut gate = Gate::new(0.2);
        assert_eq!(gate.pass(Some(at(10.0)), at(10.0)), Ok(true));
        assert_eq!(gate.pass(Some(at(9.99)), at(10.01)), Ok(false));
        assert_eq!(gate.pass(Some(Stamp::default()), at(10.02)), Ok(true));
        assert_eq!(gate.pass(Some(at(10.01)), at(10.03)), Ok(false));
        // A simulation that starts again.
        assert_eq!(gate.pass(Some(at(1.0)), at(1.0)), Ok(true));
    }

    proptest! {
        /// In any sequence, an accepted stamp is within the limit and not older than the accepted one before it.
        #[test]
        fn what_goes_through_is_fresh_and_in_order(steps in prop::collection::vec((0.0..0.05f64, -0.5..0.5f64), 1..200)) {
            let (mut gate, mut now_s, mut newest_s) = (Gate::new(0.2), 100.0, f64::NEG_INFINITY);
            for (step_s, offset_s) in steps {
                now_s += step_s;
                let stamp_s = now_s + offset_s;
                if gate.pass(Some(at(stamp_s)), at(now_s)) == Ok(true) {
                    // Stamps are rounded to 1 ns, twice in each difference.
                    prop_assert!((stamp_s - now_s).abs() <= 0.2 + 2e-9);
                    prop_assert!(stamp_s >= newest_s - 2e-9);
                    newest_s = stamp_s;
                }
            }
        }
    }

    /// Access to one component of a twist.
    type Number = fn(&mut Twist) -> &mut f64;

    #[test]
    fn a_twist_is_refused_for_each_number_that_is_none() {
        let whole = Twist { linear: Vector3 { x: 0.3, y: 0.0, z: 0.0 }, angular: Vector3 { x: 0.0, y: 0.0, z: -0.7 } };
        assert_eq!(velocity(&whole), Ok(Velocity { forward_m_s: 0.3, yaw_rad_s: -0.7 }));
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            let spoiled: [(&str, Number); 6] = [
                ("linear.x", |twist| &mut twist.linear.x),
                ("linear.y", |twist| &mut twist.linear.y),
                ("linear.z", |twist| &mut twist.linear.z),
                ("angular.x", |twist| &mut twist.angular.x),
                ("angular.y", |twist| &mut twist.angular.y),
                ("angular.z", |twist| &mut twist.angular.z),
            ];
            for (what, number) in spoiled {
                let mut twist = whole;
                *number(&mut twist) = bad;
                assert_eq!(velocity(&twist), Err(Refused::NotFinite { what: what.to_owned() }));
            }
        }
    }

    fn channels() -> Vec<ChannelInfo> {
        let range = Range::new(-1.0, 1.0);
        let channel = |number, modes: &[(Mode, Unit)]| ChannelInfo {
            id: ChannelId::new(ChannelKind::Osmc, number),
            unit: Unit::Rad,
            range,
            rate_hz: 1000.0,
            resolution: 0.001,
            modes: modes.iter().map(|(mode, unit)| ModeInfo { mode: *mode, unit: *unit, range }).collect(),
        };
        let both = [(Mode::Position, Unit::Rad), (Mode::Speed, Unit::RadPerS)];
        vec![channel(0, &both), channel(1, &both), channel(2, &[])]
    }

    fn message(name: &[&str], position: &[f64], velocity: &[f64]) -> JointState {
        let name = name.iter().map(|name| (*name).to_owned()).collect();
        JointState { name, position: position.to_vec(), velocity: velocity.to_vec(), ..JointState::default() }
    }

    #[test]
    fn joints_take_one_number_each() {
        let nan = f64::NAN;
        let through = joints(&message(&["osmc0", "osmc1"], &[0.5, nan], &[nan, -0.25]), &channels(), 4);
        let [position, speed] = through.expect("it goes through")[..] else { panic!("two set points") };
        assert_eq!(
            (position.0.to_string(), position.1),
            ("osmc0".into(), Setpoint { mode: Mode::Position, value: 0.5 })
        );
        assert_eq!((speed.0.to_string(), speed.1), ("osmc1".into(), Setpoint { mode: Mode::Speed, value: -0.25 }));
        assert_eq!(joints(&message(&["osmc0"], &[nan], &[]), &channels(), 4), Ok(Vec::new()));
    }

    #[test]
    fn one_bad_joint_refuses_the_whole_command() {
        let refused = |name: &[&str], position: &[f64], velocity: &[f64]| {
            joints(&message(name, position, velocity), &channels(), 1).expect_err("refused").to_string()
        };
        assert!(refused(&["osmc0", "osmc1"], &[0.1], &[]).starts_with("2 names but 1 values of position"));
        assert!(refused(&["osmc0"], &[0.1], &[0.1]).contains("a position and a velocity"));
        assert!(refused(&["osmc0", "elbow"], &[0.1, 0.1], &[]).contains("no joint \"elbow\""));
        assert!(refused(&["osmc2"], &[0.1], &[]).contains("cannot be commanded by position"));
        assert!(refused(&["osmc0", "osmc0"], &[0.1, 0.1], &[]).contains("named twice"));
        assert!(refused(&["osmc0"], &[f64::INFINITY], &[]).contains("not a finite number"));
        assert!(refused(&["osmc0", "osmc1"], &[0.1, 0.1], &[]).contains("at most 1"));
    }
}
