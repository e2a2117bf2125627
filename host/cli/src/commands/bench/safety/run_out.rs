//! Plants after a stop, followed until they are at rest; plants of one kind and stop category form a group.

use std::fmt;

use r4_boards::Robot;
use r4_protocol::{
    ChannelId, ChannelKind,
    config::{Feedback, MotorConfig},
};
use r4_sim::stop::{Outputs, Ran};

use super::MS;

/// Longest time for which plants are followed, ns; one that still moves then did not come to rest.
pub(super) const RUN_OUT_NS: u64 = 20_000 * MS;
/// Braking time of the channels that this bench lets brake, ms: that of `osmc0` of `osmc-bench`.
const BRAKE_MS: u16 = 500;

/// Adds braking to every second channel of each kind, unless the robot's file already configures it.
pub(super) fn robot(mut robot: Robot) -> Robot {
    let config = &mut robot.config;
    if config.stop_brake_ms() == 0 {
        config.motors.iter_mut().step_by(2).for_each(|motor| motor.stop_brake_ms = BRAKE_MS);
        config.bldcs.iter_mut().step_by(2).for_each(|bldc| bldc.stop_brake_ms = BRAKE_MS);
        config.steppers.iter_mut().step_by(2).for_each(|stepper| stepper.stop_brake_ms = BRAKE_MS);
    }
    robot
}

/// Channels of one kind and one stop category.
pub(super) struct Group {
    pub(super) kind: ChannelKind,
    /// True for category 1 of IEC 60204-1, where a controlled stop brakes; false for category 0.
    pub(super) brakes: bool,
    /// Unit of the motion, rad or m.
    pub(super) unit: &'static str,
    channels: Vec<ChannelId>,
}

impl Group {
    /// Name of the plants' kind.
    pub(super) fn plants(&self) -> String {
        format!("{}{}", self.kind.name(), if self.unit == "m" { " (linear)" } else { "" })
    }

    /// Outputs that must be safe before the plants are off.
    pub(super) const fn outputs(&self) -> Outputs {
        match self.kind {
            ChannelKind::Bldc => Outputs::Bldcs,
            ChannelKind::Stepper => Outputs::Steppers,
            _ => Outputs::Bridges,
        }
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, category {}", self.plants(), u8::from(self.brakes))
    }
}

/// Result of a group: maxima over its plants and all runs, ms and rad or m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct GroupRan {
    pub(super) runs: u32,
    pub(super) off_ms: f64,
    pub(super) rest_ms: f64,
    pub(super) distance: f64,
}

impl GroupRan {
    fn merge(&mut self, other: &Self) {
        self.runs += other.runs;
        self.off_ms = self.off_ms.max(other.off_ms);
        self.rest_ms = self.rest_ms.max(other.rest_ms);
        self.distance = self.distance.max(other.distance);
    }
}

/// Adds the runs of `more`, which has no groups or the same ones.
pub(super) fn merge(groups: &mut Vec<GroupRan>, more: &[GroupRan]) {
    if groups.is_empty() {
        groups.extend_from_slice(more);
    } else {
        groups.iter_mut().zip(more).for_each(|(group, more)| group.merge(more));
    }
}

/// Groups of a robot, in the order of its configuration.
pub(super) fn groups(robot: &Robot) -> Vec<Group> {
    let config = &robot.config;
    let unit = |motor: &MotorConfig| match motor.control.map(|control| control.feedback) {
        Some(Feedback::Potentiometer { .. }) => "m",
        _ => "rad",
    };
    let motors = config.motors.iter().map(|motor| (motor.id, unit(motor), motor.stop_brake_ms));
    let bldcs = config.bldcs.iter().map(|bldc| (bldc.id, "rad", bldc.stop_brake_ms));
    let steppers = config.steppers.iter().map(|stepper| (stepper.id, "rad", stepper.stop_brake_ms));
    let mut groups: Vec<Group> = Vec::new();
    for (id, unit, stop_brake_ms) in motors.chain(bldcs).chain(steppers) {
        let brakes = stop_brake_ms > 0;
        let is_its = |group: &&mut Group| (group.kind, group.brakes, group.unit) == (id.kind, brakes, unit);
        match groups.iter_mut().find(is_its) {
            Some(group) => group.channels.push(id),
            None => groups.push(Group { kind: id.kind, brakes, unit, channels: vec![id] }),
        }
    }
    groups
}

/// Time from `since_ns` to `at_ns`, ms; infinite for `None`.
pub(super) fn ms(at_ns: Option<u64>, since_ns: u64) -> f64 {
    at_ns.map_or(f64::INFINITY, |at_ns| at_ns.saturating_sub(since_ns) as f64 * 1e-6)
}

/// Results of one run by group, with times counted from `since_ns`.
pub(super) fn by_group(robot: &Robot, ran: &[Ran], since_ns: u64) -> Vec<GroupRan> {
    let of_group = |group: Group| {
        let mut all = GroupRan { runs: 1, ..GroupRan::default() };
        for ran in ran.iter().filter(|ran| group.channels.contains(&ran.channel)) {
            let (off_ms, rest_ms) = (ms(ran.off_ns, since_ns), ms(ran.rest_ns, since_ns));
            all.merge(&GroupRan { runs: 0, off_ms, rest_ms, distance: ran.distance });
        }
        all
    };
    groups(robot).into_iter().map(of_group).collect()
}
