//! Topics and services by which the node is commanded. They run on their own thread.

use std::pin::pin;

use futures::{
    FutureExt, StreamExt,
    channel::{mpsc::UnboundedSender, oneshot},
    future::{join_all, join3, select},
};
use ros2_client::{Message, Node as RosNode, QosProfile, Server, Subscription};
use serde::de::DeserializeOwned;

use super::{
    NodeError, best_effort, latched, name,
    parameters::ParameterServers,
    services::{Maker, answer},
    steady, type_name,
};
use crate::{
    Order, Request, Stamp,
    environment::Services,
    message::{Bool, JointState, JointTrajectory, TriggerRequest, TriggerResponse, Twist, TwistStamped},
    names::Namespace,
};

impl Message for TriggerRequest {}
impl Message for TriggerResponse {}

/// Services of the type `std_srvs/Trigger` with their requests.
const SERVICES: [(&str, Request); 4] =
    [("~/arm", Request::Arm), ("~/disarm", Request::Disarm), ("~/clear", Request::Clear), ("~/estop", Request::Stop)];

/// Readers and servers of a node.
pub(super) struct Inputs {
    stamped: Subscription<TwistStamped>,
    unstamped: Subscription<Twist>,
    joints: Subscription<JointState>,
    trajectories: Subscription<JointTrajectory>,
    /// Readers of the e-stop topic: one for publishers that latch and one for others. DDS does not match a reader that requests the last
    /// value with a publisher that does not keep it.
    estop: [Subscription<Bool>; 2],
    services: Vec<(Request, Server<TriggerRequest, TriggerResponse>)>,
    parameters: ParameterServers,
}

impl Inputs {
    pub(super) fn new(node: &mut RosNode, namespace: &Namespace, services: Services) -> Result<Self, NodeError> {
        let stamped = topic(node, namespace, "cmd_vel", "geometry_msgs/TwistStamped", steady())?;
        let unstamped = topic(node, namespace, "cmd_vel_unstamped", "geometry_msgs/Twist", steady())?;
        let joints = topic(node, namespace, "joint_commands", "sensor_msgs/JointState", steady())?;
        let trajectories = topic(node, namespace, "joint_trajectory", "trajectory_msgs/JointTrajectory", steady())?;
        let estop = [latched(), best_effort()].map(|qos| topic(node, namespace, "estop", "std_msgs/Bool", qos));
        let [of_latching, of_others] = estop;
        let mut make = Maker { node, namespace, services };
        let services = SERVICES.map(|(service, request)| Ok((request, make.server(service, "std_srvs", "Trigger")?)));
        let services = services.into_iter().collect::<Result<_, NodeError>>()?;
        let parameters = ParameterServers::new(&mut make)?;
        Ok(Self { stamped, unstamped, joints, trajectories, estop: [of_latching?, of_others?], services, parameters })
    }

    /// Passes messages and calls on as orders until `ended` is signalled.
    pub(super) async fn run(self, orders: &UnboundedSender<Order>, ended: oneshot::Receiver<()>) {
        let Self { stamped, unstamped, joints, trajectories, estop: [of_latching, of_others], services, parameters } =
            &self;
        let topics = vec![
            hand_over(stamped, orders, "cmd_vel", |TwistStamped { header, twist }| Order::Velocity {
                stamp: Stamp::from_time(header.stamp),
                twist,
            })
            .boxed_local(),
            // A velocity without a stamp counts as decided now.
            hand_over(unstamped, orders, "cmd_vel_unstamped", |twist| Order::Velocity {
                stamp: Some(Stamp::default()),
                twist,
            })
            .boxed_local(),
            hand_over(joints, orders, "joint_commands", |joints| Order::Joints {
                stamp: Stamp::from_time(joints.header.stamp),
                joints,
            })
            .boxed_local(),
            hand_over(trajectories, orders, "joint_trajectory", |trajectory| Order::Trajectory {
                stamp: Stamp::from_time(trajectory.header.stamp),
                trajectory,
            })
            .boxed_local(),
            hand_over(of_latching, orders, "estop", |Bool { data }| Order::Estop(data)).boxed_local(),
            hand_over(of_others, orders, "estop", |Bool { data }| Order::Estop(data)).boxed_local(),
        ];
        let services = services.iter().map(|(request, server)| {
            let order = |_: TriggerRequest, answer| Order::Call { request: *request, answer };
            answer(server, orders, order, || TriggerResponse {
                success: false,
                message: "the session with the board has ended".into(),
            })
        });
        let all = join3(join_all(topics), join_all(services), parameters.run(orders));
        select(pin!(all), ended).await;
    }
}

fn topic<M: 'static>(
    node: &mut RosNode,
    namespace: &Namespace,
    topic: &str,
    of: &str,
    qos: QosProfile,
) -> Result<Subscription<M>, NodeError> {
    let absolute = namespace.resolve(topic);
    let topic = name(&absolute)?;
    let made = node.create_topic(&topic, type_name(of), &qos);
    let made = made.and_then(|topic| node.create_subscription(&topic, Some(qos)));
    made.map_err(|source| NodeError::Create { name: absolute, source })
}

async fn hand_over<M: DeserializeOwned + 'static>(
    subscription: &Subscription<M>,
    orders: &UnboundedSender<Order>,
    topic: &'static str,
    order: impl Fn(M) -> Order,
) {
    let mut messages = pin!(subscription.async_stream());
    while let Some(message) = messages.next().await {
        let order = match message {
            Ok((message, _)) => order(message),
            Err(error) => Order::Unreadable { topic, why: error.to_string() },
        };
        // After the end of the session, orders have no receiver.
        if orders.unbounded_send(order).is_err() {
            return;
        }
    }
}
