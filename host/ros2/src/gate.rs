//! Which commands go through: pure, with the time given.
//!
//! A command that is refused ends the set points before it, and a command that is older than one that went through changes nothing: what
//! the publisher wanted before is never taken for what it wants.

use r4_driver::Error as DriverError;
use r4_protocol::{ChannelId, ChannelInfo, Mode, Setpoint};
use r4_rig::Velocity;

use crate::{
    message::{JointState, Twist},
    time::Stamp,
    trajectory::BadTrajectory,
};

/// Why a command did not go through.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refused {
    /// A number is NaN or infinite.
    #[error("{what} is not a finite number: check the publisher")]
    NotFinite {
        /// Which number, as the message has it.
        what: String,
    },
    /// A message is none of its topic's type.
    #[error("a message on {topic} cannot be read ({why}): check its type")]
    Unreadable {
        /// Name of the topic.
        topic: &'static str,
        /// What is wrong with it.
        why: String,
    },
    /// The stamp is no time.
    #[error("the stamp has a second or more in its nanoseconds: check the publisher")]
    BadStamp,
    /// It was decided too long ago.
    #[error(
        "its stamp is {age_s:.3} s old and {limit_s} s are allowed: synchronise the clocks of both machines; where the board is \
         simulated, set use_sim_time of the publisher"
    )]
    Stale {
        /// How old it is, s.
        age_s: f64,
        /// How old it may be, s.
        limit_s: f64,
    },
    /// It will be decided.
    #[error(
        "its stamp is {ahead_s:.3} s ahead and {limit_s} s are allowed: synchronise the clocks of both machines; where the board \
         is simulated, set use_sim_time of the publisher"
    )]
    Ahead {
        /// How far, s.
        ahead_s: f64,
        /// How far it may be, s.
        limit_s: f64,
    },
    /// The robot does not drive, or its geometry is unknown.
    #[error("velocities need a robot whose file has [drive] (boards/README.md): use joint_commands")]
    NoDrive,
    /// Names and numbers do not go together.
    #[error("{names} names and {numbers} numbers of {what}: give one for each name, or none at all")]
    Lengths {
        /// Of which.
        what: &'static str,
        /// How many names.
        names: usize,
        /// How many numbers.
        numbers: usize,
    },
    /// The board has no such joint, or it cannot be commanded.
    #[error("{name:?} is no joint of this board: joint_states has their names")]
    UnknownJoint {
        /// The name.
        name: String,
    },
    /// A joint is named twice.
    #[error("{name} is named twice: give each joint one set point")]
    Twice {
        /// The name.
        name: String,
    },
    /// A joint has a position and a speed.
    #[error("{name} has a position and a velocity: give one, and NaN or nothing for the other")]
    Both {
        /// The name.
        name: String,
    },
    /// A joint does not take this.
    #[error("{name} cannot be commanded by {mode}: `r4 info` lists what it can take")]
    NoMode {
        /// The name.
        name: String,
        /// By what it was commanded.
        mode: Mode,
    },
    /// More joints than a stream has.
    #[error("{asked} joints in one command: at most {most} can be commanded together")]
    TooMany {
        /// How many were.
        asked: usize,
        /// How many can be.
        most: usize,
    },
    /// A trajectory cannot be followed.
    #[error("the trajectory is not followed: {0}")]
    Trajectory(#[from] BadTrajectory),
    /// The board or the driver refused it.
    #[error(transparent)]
    Board(DriverError),
}

/// The check of stamps, and the newest one that went through.
#[derive(Clone, Debug)]
pub struct Gate {
    /// How old a command may be, and how far ahead, s.
    limit_s: f64,
    newest: Option<Stamp>,
}

impl Gate {
    /// Commands may be `limit_s` old: the board's time-out of its link.
    #[must_use]
    pub fn new(limit_s: f64) -> Self {
        Self { limit_s, newest: None }
    }

    /// How old a command may be, and how far ahead, s.
    #[must_use]
    pub fn limit_s(&self) -> f64 {
        self.limit_s
    }

    /// Whether a command of this stamp goes through `now`: `false` for one that is older than one that did. A stamp of 0 counts as now,
    /// as it does with other controllers of ROS.
    ///
    /// # Errors
    /// [`Refused::BadStamp`], [`Refused::Stale`], [`Refused::Ahead`].
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
        // A clock that was set back by more than is allowed lets commands through again.
        let before = self.newest.filter(|newest| newest.since_s(now) <= limit_s);
        if before.is_some_and(|before| stamp < before) {
            return Ok(false);
        }
        self.newest = Some(stamp);
        Ok(true)
    }
}

/// The velocity over the ground in a twist. A robot on wheels has no other parts: they are passed over, if they are finite.
///
/// # Errors
/// [`Refused::NotFinite`]
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

/// Set points in a message about joints. NaN is a joint that this message does not command by that, as ros2_control publishes it.
///
/// # Errors
/// [`Refused`], for the first joint that does not go through: then none does.
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
        assert!(said.starts_with("its stamp is 3.000 s old and 0.2 s are allowed"), "{said}");
    }

    #[test]
    fn an_older_command_changes_nothing_and_none_counts_as_now() {
        let mut gate = Gate::new(0.2);
        assert_eq!(gate.pass(Some(at(10.0)), at(10.0)), Ok(true));
        assert_eq!(gate.pass(Some(at(9.99)), at(10.01)), Ok(false));
        assert_eq!(gate.pass(Some(Stamp::default()), at(10.02)), Ok(true));
        assert_eq!(gate.pass(Some(at(10.01)), at(10.03)), Ok(false));
        // A simulation that begins again.
        assert_eq!(gate.pass(Some(at(1.0)), at(1.0)), Ok(true));
    }

    proptest! {
        /// No sequence of stamps lets one through that is older than the limit, or older than one before it.
        #[test]
        fn what_goes_through_is_fresh_and_in_order(steps in prop::collection::vec((0.0..0.05f64, -0.5..0.5f64), 1..200)) {
            let (mut gate, mut now_s, mut newest_s) = (Gate::new(0.2), 100.0, f64::NEG_INFINITY);
            for (step_s, offset_s) in steps {
                now_s += step_s;
                let stamp_s = now_s + offset_s;
                if gate.pass(Some(at(stamp_s)), at(now_s)) == Ok(true) {
                    // 1 ns: what seconds are rounded to.
                    prop_assert!((stamp_s - now_s).abs() <= 0.2 + 2e-9);
                    prop_assert!(stamp_s >= newest_s - 2e-9);
                    newest_s = stamp_s;
                }
            }
        }
    }

    /// One of the numbers of a twist.
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
        assert!(refused(&["osmc0", "osmc1"], &[0.1], &[]).starts_with("2 names and 1 numbers of position"));
        assert!(refused(&["osmc0"], &[0.1], &[0.1]).contains("a position and a velocity"));
        assert!(refused(&["osmc0", "elbow"], &[0.1, 0.1], &[]).contains("\"elbow\" is no joint"));
        assert!(refused(&["osmc2"], &[0.1], &[]).contains("cannot be commanded by position"));
        assert!(refused(&["osmc0", "osmc0"], &[0.1, 0.1], &[]).contains("named twice"));
        assert!(refused(&["osmc0"], &[f64::INFINITY], &[]).contains("not a finite number"));
        assert!(refused(&["osmc0", "osmc1"], &[0.1, 0.1], &[]).contains("at most 1"));
    }
}
