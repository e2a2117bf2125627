//! Topics that the node publishes.

use std::collections::BTreeMap;

use r4_protocol::{ChannelId, ChannelKind};
use r4_rig::Session;
use ros2_client::{Node as RosNode, Publisher};
use serde::Serialize;

use super::{NodeError, latched, name, steady, type_name};
use crate::{
    Report,
    message::{BatteryState, Clock, DiagnosticArray, Imu, JointState, Odometry, Range, TFMessage, Text, TwistStamped},
    names::{self, Namespace, Topic},
};

/// Publishers of a node.
pub(super) struct Outputs {
    odometry: Publisher<Odometry>,
    transform: Publisher<TFMessage>,
    joints: Publisher<JointState>,
    imus: BTreeMap<ChannelId, Publisher<Imu>>,
    ranges: BTreeMap<ChannelId, Publisher<Range>>,
    batteries: BTreeMap<ChannelId, Publisher<BatteryState>>,
    diagnostics: Publisher<DiagnosticArray>,
    state: Publisher<Text>,
    commanded: Publisher<TwistStamped>,
    /// Publisher of simulated time; `None` for a real board, since nodes on simulated time follow every publisher of `/clock`.
    clock: Option<Publisher<Clock>>,
}

impl Outputs {
    pub(super) fn new(node: &mut RosNode, namespace: &Namespace, session: &Session<'_>) -> Result<Self, NodeError> {
        let mut make = Maker { node, namespace };
        let (mut imus, mut ranges, mut batteries) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        for channel in session.board.channels().iter().map(|info| info.id) {
            let Some(topic) = names::topic(channel) else { continue };
            match channel.kind {
                ChannelKind::Imu => drop(imus.insert(channel, make.topic(&topic)?)),
                ChannelKind::Supply => drop(batteries.insert(channel, make.topic(&topic)?)),
                _ => drop(ranges.insert(channel, make.topic(&topic)?)),
            }
        }
        let is_virtual = session.target().is_virtual();
        Ok(Self {
            odometry: make.topic(&names::ODOMETRY)?,
            transform: make.topic(&names::TRANSFORM)?,
            joints: make.topic(&names::JOINTS)?,
            imus,
            ranges,
            batteries,
            diagnostics: make.topic(&names::DIAGNOSTICS)?,
            state: make.topic(&names::STATE)?,
            commanded: make.topic(&names::COMMANDED)?,
            clock: is_virtual.then(|| make.topic(&names::CLOCK)).transpose()?,
        })
    }

    /// Publishes a message, and returns false when it could not.
    pub(super) fn publish(&self, report: Report) -> bool {
        match report {
            Report::Odometry(message) => self.odometry.publish(message).is_ok(),
            Report::Transform(message) => self.transform.publish(message).is_ok(),
            Report::Joints(message) => self.joints.publish(message).is_ok(),
            Report::Imu(channel, message) => of(&self.imus, channel, message),
            Report::Range(channel, message) => of(&self.ranges, channel, message),
            Report::Battery(channel, message) => of(&self.batteries, channel, message),
            Report::Diagnostics(message) => self.diagnostics.publish(message).is_ok(),
            Report::State(message) => self.state.publish(message).is_ok(),
            Report::Commanded(message) => self.commanded.publish(message).is_ok(),
            Report::Clock(message) => self.clock.as_ref().is_none_or(|clock| clock.publish(message).is_ok()),
            // A notice for the lifecycle, which has no topic.
            Report::Deactivated => true,
        }
    }
}

fn of<M: Serialize>(publishers: &BTreeMap<ChannelId, Publisher<M>>, channel: ChannelId, message: M) -> bool {
    publishers.get(&channel).is_some_and(|publisher| publisher.publish(message).is_ok())
}

/// Creates the publishers of a node.
struct Maker<'n> {
    node: &'n mut RosNode,
    namespace: &'n Namespace,
}

impl Maker<'_> {
    fn topic<M: Serialize>(&mut self, topic: &Topic) -> Result<Publisher<M>, NodeError> {
        let Topic { name: relative, kind, is_latched } = topic;
        let (absolute, qos) = (self.namespace.resolve(relative), if *is_latched { latched() } else { steady() });
        let topic = name(&absolute)?;
        let made = self.node.create_topic(&topic, type_name(kind), &qos);
        let made = made.and_then(|topic| self.node.create_publisher(&topic, Some(qos)));
        made.map_err(|source| NodeError::Create { name: absolute, source })
    }
}
