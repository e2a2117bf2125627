//! Node on DDS: topics, services and discovery by `ros2-client` on RustDDS.

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

/// Error of creating the node, or of its session.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// The node cannot join the DDS domain.
    #[error("cannot join {discovery}: {why}; check that a network interface is up")]
    Join {
        /// Settings with which the node tried to join.
        discovery: Discovery,
        /// Error of RustDDS or `ros2-client`, as text.
        why: String,
    },
    /// The node could not be created.
    #[error("cannot create the ROS node")]
    Node(#[source] NodeCreateError),
    /// A topic or a service could not be created.
    #[error("cannot create {name}")]
    Create {
        /// Name of the topic or service.
        name: String,
        /// Error that `ros2-client` reported.
        source: CreateError,
    },
    /// The operating system cannot start the thread that reads topics and services.
    #[error("cannot start a thread for the ROS node: {0}")]
    Thread(#[source] std::io::Error),
    /// The session with the board ended with an error.
    #[error(transparent)]
    Board(#[from] r4_rig::Error),
}

/// Node in the ROS graph, which other nodes can discover, without topics and services yet.
pub struct Graph {
    node: RosNode,
    namespace: Namespace,
    services: Services,
}

impl Graph {
    /// Joins a domain as the node `r4` in a namespace.
    ///
    /// # Errors
    /// [`NodeError::Join`] without a usable network interface or for an invalid name, [`NodeError::Node`] when the node cannot be created.
    pub fn join(discovery: Discovery, namespace: &Namespace) -> Result<Self, NodeError> {
        let join = |why: String| NodeError::Join { discovery, why };
        let mut participant = DomainParticipantBuilder::new(discovery.domain);
        if let Some(networks) = discovery.only_networks() {
            participant = participant.with_only_networks(networks);
        }
        let participant = participant.build().map_err(|error| join(error.to_string()))?;
        let context = Context::from_domain_participant(participant).map_err(|error| join(error.to_string()))?;
        let name = NodeName::new(&namespace.absolute(), NODE).map_err(|error| join(error.to_string()))?;
        // The parameters are the board's, with servers of this crate, and diagnostics take the place of `/rosout`.
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let node = context.new_node(name, options).map_err(NodeError::Node)?;
        Ok(Self { node, namespace: namespace.clone(), services: discovery.services })
    }
}

/// Topics and services of a board for one session. They must be dropped before their [`Graph`].
pub struct Node {
    outputs: Outputs,
    sender: UnboundedSender<Order>,
    orders: Option<UnboundedReceiver<Order>>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Node {
    /// Creates the topics and services for the board of a session.
    ///
    /// # Errors
    /// [`NodeError::Create`] for a topic or service, [`NodeError::Thread`] for the thread.
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

    /// Serves the board until its session ends.
    ///
    /// # Errors
    /// [`NodeError::Board`] when the link ends or the board refuses a subscription.
    pub async fn serve<'b>(mut self, session: &'b Session<'b>, door: Door) -> Result<(), NodeError> {
        let Some(orders) = self.orders.take() else { return Ok(()) };
        let outputs = &self.outputs;
        door.serve(session, orders, |report| outputs.publish(report)).await?;
        Ok(())
    }

    /// Serves the board of a managed node until the node is cleaned up or shut down.
    ///
    /// # Errors
    /// [`NodeError::Board`] when the link ends or the board refuses a subscription.
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

/// Passes requested transitions on as orders; never ends.
async fn hand_over(lifecycle: &mut Lifecycle, sender: &UnboundedSender<Order>) -> Infallible {
    loop {
        let change = lifecycle.change().await;
        // The receiver exists: it is served concurrently with this future.
        let _ = sender.unbounded_send(Order::Change(change));
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            // The thread may have ended by itself.
            let _ = end.send(());
        }
        // The thread owns the readers and servers, which must be gone before the graph is dropped.
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Converts an absolute name to a name of `ros2-client`.
fn name(absolute: &str) -> Result<Name, NodeError> {
    let bad = |error: ros2_client::names::NameError| CreateError::BadParameter { reason: error.to_string() };
    Name::parse(absolute).map_err(|error| NodeError::Create { name: absolute.to_owned(), source: bad(error) })
}

/// Number of messages that are kept for slow readers.
const DEPTH: usize = 10;

/// Returns the quality of service of most topics: reliable, which matches reliable and best-effort readers, and without waiting, since a
/// dead reader must not block the board.
fn steady() -> QosProfile {
    QosProfile::publisher_default()
        .reliability(Reliability::Reliable { when_full: WhenFull::Fail })
        .history(History::KeepLast { depth: DEPTH })
}

/// Returns the quality of service of latched topics: as [`steady`], with the last message for readers that subscribe later.
fn latched() -> QosProfile {
    steady().durability(Durability::TransientLocal).history(History::KeepLast { depth: 1 })
}

/// Returns the quality of service of readers that also match best-effort publishers.
fn best_effort() -> QosProfile {
    QosProfile::subscription_default().history(History::KeepLast { depth: DEPTH })
}

/// Converts a type in the form `package/Name`, such as `std_msgs/Bool`.
fn type_name(text: &str) -> MessageTypeName {
    let (package, name) = text.split_once('/').unwrap_or(("", text));
    MessageTypeName::new(package, name)
}

/// Returns the mapping of services to DDS in terms of `ros2-client`.
fn mapping(services: Services) -> ros2_client::ServiceMapping {
    match services {
        Services::Enhanced => ros2_client::ServiceMapping::Enhanced,
        Services::Cyclone => ros2_client::ServiceMapping::Cyclone,
    }
}
