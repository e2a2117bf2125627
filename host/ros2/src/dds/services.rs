//! Creation of service servers by name, and answers to their calls.

use futures::{
    StreamExt,
    channel::{mpsc::UnboundedSender, oneshot},
};
use ros2_client::{Message, Node as RosNode, Server, ServiceTypeName};

use super::{NodeError, mapping, name, steady};
use crate::{environment::Services, names::Namespace};

/// Creates the service servers of a node.
pub(super) struct Maker<'n> {
    pub(super) node: &'n mut RosNode,
    pub(super) namespace: &'n Namespace,
    pub(super) services: Services,
}

impl Maker<'_> {
    /// Creates a server for the service `service` with the type `package/kind`.
    pub(super) fn server<Q: Message + Clone + 'static, A: Message + 'static>(
        &mut self,
        service: &str,
        package: &str,
        kind: &str,
    ) -> Result<Server<Q, A>, NodeError> {
        let absolute = self.namespace.resolve(service);
        let kind = ServiceTypeName::new(package, kind);
        let made = self.node.create_server(mapping(self.services), &name(&absolute)?, &kind, steady(), steady());
        made.map_err(|source| NodeError::Create { name: absolute, source })
    }
}

/// Passes calls on as orders and answers them one after the other. `ended` creates the answer after the end of the session, when orders
/// have no receiver.
pub(super) async fn answer<Q: Message + Clone + 'static, A: Message + 'static, O>(
    server: &Server<Q, A>,
    orders: &UnboundedSender<O>,
    order: impl Fn(Q, oneshot::Sender<A>) -> O,
    ended: impl Fn() -> A,
) {
    let mut calls = server.receive_request_stream();
    while let Some(call) = calls.next().await {
        // A call that cannot be decoded has no sender to answer.
        let Ok((id, request)) = call else { continue };
        let (answer, answered) = oneshot::channel();
        let response = match orders.unbounded_send(order(request, answer)) {
            Ok(()) => answered.await.ok(),
            Err(_) => None,
        };
        // The caller may be gone by now.
        let _ = server.async_send_response(id, response.unwrap_or_else(&ended)).await;
    }
}
