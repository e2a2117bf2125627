//! The node on DDS: topics, services and discovery by `ros2-client` on RustDDS.

mod inputs;
mod lifecycle;
mod outputs;
mod parameters;
mod services;

use std::{
    convert::Infallible,
    pin::pin,
    thread::{self, JoinHandle},
};

use futures::{
    channel::{
        mpsc::{UnboundedReceiver, UnboundedSender, unbounded},
        oneshot,
    },
    future::{Either, select},
};
use r4_rig::Session;
use ros2_client::{
    Context, CreateError, MessageTypeName, Name, Node as RosNode, NodeCreateError, NodeName, NodeOptions, QosProfile,
    dds::rustdds::DomainParticipantBuilder,
    qos::{Durability, History, Reliability, WhenFull},
};

use crate::{
    Discovery, Door, Ended, Order, Report,
    environment::Services,
    lifecycle::Unasked,
    names::{NODE, Namespace},
};
use inputs::Inputs;
pub use lifecycle::Lifecycle;
use outputs::Outputs;

/// The node could not be made, or its session ended.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// There is no DDS.
    #[error("cannot join {discovery}: {why}; is there a network interface that is up?")]
    Join {
        /// What was to be joined.
        discovery: Discovery,
        /// What RustDDS says.
        why: String,
    },
    /// The node could not be made.
    #[error("cannot make the ROS node")]
    Node(#[source] NodeCreateError),
    /// A topic or a service could not be made.
    #[error("cannot make {name}")]
    Create {
        /// Name of the topic or service.
        name: String,
        /// Why not.
        source: CreateError,
    },
    /// The operating system gives no thread for what comes in.
    #[error("cannot start a thread for the ROS node: {0}")]
    Thread(#[source] std::io::Error),
    /// The session with the board ended.
    #[error(transparent)]
    Board(#[from] r4_rig::Error),
}

/// A name in ROS's graph that can be found, without topics and services yet.
pub struct Graph {
    node: RosNode,
    namespace: Namespace,
    services: Services,
}

impl Graph {
    /// Joins a domain as the node `r4` of a namespace.
    ///
    /// # Errors
    /// [`NodeError`]
    pub fn join(discovery: Discovery, namespace: &Namespace) -> Result<Self, NodeError> {
        let join = |why: String| NodeError::Join { discovery, why };
        let mut participant = DomainParticipantBuilder::new(discovery.domain);
        if let Some(networks) = discovery.only_networks() {
            participant = participant.with_only_networks(networks);
        }
        let participant = participant.build().map_err(|error| join(error.to_string()))?;
        let context = Context::from_domain_participant(participant).map_err(|error| join(error.to_string()))?;
        let name = NodeName::new(&namespace.absolute(), NODE).map_err(|error| join(error.to_string()))?;
        // Parameters are the board's, with services of our own, and `/rosout` has its place in diagnostics.
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(name, options).map_err(NodeError::Node)?;
        Ok(Self { node, namespace: namespace.clone(), services: discovery.services })
    }
}

/// Topics and services of a board, for one session with it. Dropped before its [`Graph`].
pub struct Node {
    outputs: Outputs,
    sender: UnboundedSender<Order>,
    orders: Option<UnboundedReceiver<Order>>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Node {
    /// Makes the topics and services for the board of a session.
    ///
    /// # Errors
    /// [`NodeError`]
    pub fn open(session: &Session<'_>, graph: &mut Graph) -> Result<Self, NodeError> {
        let Graph { node, namespace, services } = graph;
        let outputs = Outputs::new(node, namespace, session)?;
        let inputs = Inputs::new(node, namespace, *services)?;
        let (sender, orders) = unbounded();
        let (end, ended) = oneshot::channel();
        let to_board = sender.clone();
        let thread = thread::Builder::new()
            .name("r4-ros2".into())
            .spawn(move || r4_links::block_on(inputs.run(&to_board, ended)))
            .map_err(NodeError::Thread)?;
        Ok(Self { outputs, sender, orders: Some(orders), end: Some(end), thread: Some(thread) })
    }

    /// Serves until the session ends.
    ///
    /// # Errors
    /// Why it ended.
    pub async fn serve<'b>(mut self, session: &'b Session<'b>, door: Door) -> Result<(), NodeError> {
        let Some(orders) = self.orders.take() else { return Ok(()) };
        let outputs = &self.outputs;
        door.serve(session, orders, |report| outputs.publish(report)).await?;
        Ok(())
    }

    /// Serves a managed node until it is cleaned up or shut down.
    ///
    /// # Errors
    /// Why it ended otherwise.
    pub async fn serve_managed<'b>(
        mut self,
        session: &'b Session<'b>,
        door: Door,
        lifecycle: &mut Lifecycle,
    ) -> Result<Ended, NodeError> {
        let Some(orders) = self.orders.take() else { return Ok(Ended::Orders) };
        let (outputs, sender) = (&self.outputs, &self.sender);
        let unasked = lifecycle.notes();
        let serve = door.serve(session, orders, |report| match report {
            Report::Deactivated => unasked.unbounded_send(Unasked::Disarmed).is_ok(),
            report => outputs.publish(report),
        });
        match select(pin!(serve), pin!(hand_over(lifecycle, sender))).await {
            Either::Left((ended, _)) => Ok(ended?),
            Either::Right((never, _)) => match never {},
        }
    }
}

/// Hands over transitions that are asked for.
async fn hand_over(lifecycle: &mut Lifecycle, sender: &UnboundedSender<Order>) -> Infallible {
    loop {
        let change = lifecycle.change().await;
        // The other end is served beside this.
        let _ = sender.unbounded_send(Order::Change(change));
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // It may have ended by itself.
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// A name that has been resolved.
fn name(absolute: &str) -> Result<Name, NodeError> {
    let bad = |error: ros2_client::names::NameError| CreateError::BadParameter { reason: error.to_string() };
    Name::parse(absolute).map_err(|error| NodeError::Create { name: absolute.to_owned(), source: bad(error) })
}

/// Kept for readers that are a little behind.
const DEPTH: usize = 10;

/// Reliable, which readers of both kinds can have, and never waiting: a reader that is gone must not hold up the board.
fn steady() -> QosProfile {
    QosProfile::publisher_default()
        .reliability(Reliability::Reliable { when_full: WhenFull::Fail })
        .history(History::KeepLast { depth: DEPTH })
}

/// The same, and the last one for readers that come later.
fn latched() -> QosProfile {
    steady().durability(Durability::TransientLocal).history(History::KeepLast { depth: 1 })
}

/// For readers of publishers that are not reliable, too.
fn best_effort() -> QosProfile {
    QosProfile::subscription_default().history(History::KeepLast { depth: DEPTH })
}

/// `std_msgs/Bool` in `package/Name`.
fn type_name(text: &str) -> MessageTypeName {
    let (package, name) = text.split_once('/').unwrap_or(("", text));
    MessageTypeName::new(package, name)
}

/// Which mapping of services to DDS `services` stands for.
fn mapping(services: Services) -> ros2_client::ServiceMapping {
    match services {
        Services::Enhanced => ros2_client::ServiceMapping::Enhanced,
        Services::Cyclone => ros2_client::ServiceMapping::Cyclone,
    }
}
