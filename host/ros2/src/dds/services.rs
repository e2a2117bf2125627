//! Services: made by name, and their calls handed over and answered.

use futures::{
    StreamExt,
    channel::{mpsc::UnboundedSender, oneshot},
};
use ros2_client::{Message, Node as RosNode, Server, ServiceTypeName};

use super::{NodeError, mapping, name, steady};
use crate::{environment::Services, names::Namespace};

/// Maker of the services of a node.
pub(super) struct Maker<'n> {
    pub(super) node: &'n mut RosNode,
    pub(super) namespace: &'n Namespace,
    pub(super) services: Services,
}

impl Maker<'_> {
    /// A service of a type of `package`.
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

/// Hands calls over as orders and answers them, one after the other; `ended` is the answer where nobody takes orders any more.
pub(super) async fn answer<Q: Message + Clone + 'static, A: Message + 'static, O>(
    server: &Server<Q, A>,
    orders: &UnboundedSender<O>,
    order: impl Fn(Q, oneshot::Sender<A>) -> O,
    ended: impl Fn() -> A,
) {
    let mut calls = server.receive_request_stream();
    while let Some(call) = calls.next().await {
        // A call that cannot be read has nobody to be answered to.
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
