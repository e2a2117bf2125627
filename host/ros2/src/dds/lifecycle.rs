//! Lifecycle services of a managed node. They run on their own thread, because they exist without a session, too.

use std::{
    cell::Cell,
    pin::pin,
    thread::{self, JoinHandle},
};

use futures::{
    FutureExt, StreamExt,
    channel::{
        mpsc::{UnboundedReceiver, UnboundedSender, unbounded},
        oneshot,
    },
    future::{join_all, select},
};
use ros2_client::{Message, Publisher, Server};

use super::{Graph, NodeError, name, services::Maker, steady, type_name};
use crate::{
    Stamp,
    lifecycle::{Change, State, Unasked},
    message::{
        ChangeStateRequest, ChangeStateResponse, EmptyRequest, GetAvailableStatesResponse,
        GetAvailableTransitionsResponse, GetStateResponse, LifecycleState, LifecycleTransition, TransitionEvent,
    },
};

impl Message for EmptyRequest {}
impl Message for GetStateResponse {}
impl Message for ChangeStateRequest {}
impl Message for ChangeStateResponse {}
impl Message for GetAvailableStatesResponse {}
impl Message for GetAvailableTransitionsResponse {}

/// Handle of the node to its lifecycle services.
pub struct Lifecycle {
    changes: UnboundedReceiver<Change>,
    unasked: UnboundedSender<Unasked>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Lifecycle {
    /// Offers the lifecycle services of a node, which starts unconfigured.
    ///
    /// # Errors
    /// [`NodeError::Create`] for a topic or service, [`NodeError::Thread`] for the thread.
    pub fn open(graph: &mut Graph) -> Result<Self, NodeError> {
        let servers = Servers::new(graph)?;
        let (to_node, changes) = unbounded();
        let (unasked, of_node) = unbounded();
        let (end, ended) = oneshot::channel();
        let thread = thread::Builder::new()
            .name("r4-lifecycle".into())
            .spawn(move || r4_links::block_on(servers.run(&to_node, of_node, ended)))
            .map_err(NodeError::Thread)?;
        Ok(Self { changes, unasked, end: Some(end), thread: Some(thread) })
    }

    /// Waits for the next requested transition that is possible in the current state. Never ready after the services have ended.
    pub async fn change(&mut self) -> Change {
        match self.changes.next().await {
            Some(change) => change,
            None => std::future::pending().await,
        }
    }

    /// Returns a sender for transitions that the node makes by itself.
    pub(super) fn notes(&self) -> UnboundedSender<Unasked> {
        self.unasked.clone()
    }

    /// Makes a transition without a request.
    pub fn note(&self, unasked: Unasked) {
        // The receiver exists until the node is dropped.
        let _ = self.unasked.unbounded_send(unasked);
    }
}

impl Drop for Lifecycle {
    fn drop(&mut self) {
        if let Some(end) = self.end.take() {
            let _ = end.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Servers of the lifecycle services, with the publisher of transitions.
struct Servers {
    get: Server<EmptyRequest, GetStateResponse>,
    change: Server<ChangeStateRequest, ChangeStateResponse>,
    states: Server<EmptyRequest, GetAvailableStatesResponse>,
    transitions: Server<EmptyRequest, GetAvailableTransitionsResponse>,
    events: Publisher<TransitionEvent>,
}

impl Servers {
    fn new(graph: &mut Graph) -> Result<Self, NodeError> {
        const PACKAGE: &str = "lifecycle_msgs";
        let Graph { node, namespace, services } = graph;
        let absolute = namespace.resolve("~/transition_event");
        let topic = name(&absolute)?;
        let made = node.create_topic(&topic, type_name("lifecycle_msgs/TransitionEvent"), &steady());
        let made = made.and_then(|topic| node.create_publisher(&topic, Some(steady())));
        let events = made.map_err(|source| NodeError::Create { name: absolute, source })?;
        let mut make = Maker { node, namespace, services: *services };
        Ok(Self {
            get: make.server("~/get_state", PACKAGE, "GetState")?,
            change: make.server("~/change_state", PACKAGE, "ChangeState")?,
            states: make.server("~/get_available_states", PACKAGE, "GetAvailableStates")?,
            transitions: make.server("~/get_available_transitions", PACKAGE, "GetAvailableTransitions")?,
            events,
        })
    }

    async fn run(
        self,
        to_node: &UnboundedSender<Change>,
        unasked: UnboundedReceiver<Unasked>,
        ended: oneshot::Receiver<()>,
    ) {
        let Self { get, change, states, transitions, events } = &self;
        let machine = Machine { state: Cell::default(), events };
        let all = join_all([
            ask(get, || GetStateResponse { current_state: machine.state.get().message() }).boxed_local(),
            ask(states, || GetAvailableStatesResponse { available_states: State::ALL.map(State::message).to_vec() })
                .boxed_local(),
            ask(transitions, || GetAvailableTransitionsResponse {
                available_transitions: machine.state.get().descriptions(),
            })
            .boxed_local(),
            machine.serve(change, to_node, unasked).boxed_local(),
        ]);
        select(pin!(all), ended).await;
    }
}

/// Answers the calls of a service that only queries.
async fn ask<A: Message + 'static>(server: &Server<EmptyRequest, A>, now: impl Fn() -> A) {
    let mut calls = server.receive_request_stream();
    while let Some(call) = calls.next().await {
        let Ok((id, _)) = call else { continue };
        // The caller may be gone by now.
        let _ = server.async_send_response(id, now()).await;
    }
}

/// State machine of a managed node.
struct Machine<'e> {
    state: Cell<State>,
    events: &'e Publisher<TransitionEvent>,
}

impl Machine<'_> {
    /// Carries out requested transitions one after the other, and the node's own transitions between them.
    async fn serve(
        &self,
        server: &Server<ChangeStateRequest, ChangeStateResponse>,
        to_node: &UnboundedSender<Change>,
        mut unasked: UnboundedReceiver<Unasked>,
    ) {
        let mut calls = pin!(server.receive_request_stream().fuse());
        loop {
            futures::select_biased! {
                unasked = unasked.next() => match unasked {
                    Some(unasked) => self.make(unasked),
                    None => return,
                },
                call = calls.next() => match call {
                    Some(Ok((id, request))) => {
                        let success = self.change(&request, to_node).await;
                        // The caller may be gone by now.
                        let _ = server.async_send_response(id, ChangeStateResponse { success }).await;
                    }
                    Some(Err(_)) => {}
                    None => return,
                },
            }
        }
    }

    async fn change(&self, request: &ChangeStateRequest, to_node: &UnboundedSender<Change>) -> bool {
        let from = self.state.get();
        let Some(transition) = from.asked(&request.transition) else { return false };
        self.tell(transition.message(from), from.message(), transition.under_way());
        // The node carries the transition out; without a node to answer, the transition fails.
        let (answer, answered) = oneshot::channel();
        let is_sent = to_node.unbounded_send(Change { transition, answer }).is_ok();
        let is_made = is_sent && answered.await.unwrap_or(false);
        let to = if is_made { transition.goal() } else { from };
        self.state.set(to);
        self.tell(transition.ended(is_made), transition.under_way(), to.message());
        is_made
    }

    fn make(&self, unasked: Unasked) {
        // A requested transition may have changed the state since the note was sent.
        let from = self.state.get();
        if unasked == Unasked::Disarmed && from != State::Active
            || matches!(from, State::Unconfigured | State::Finalized)
        {
            return;
        }
        let (steps, to) = unasked.steps(from);
        self.state.set(to);
        for (transition, start, goal) in steps {
            self.tell(transition, start, goal);
        }
    }

    fn tell(&self, transition: LifecycleTransition, start_state: LifecycleState, goal_state: LifecycleState) {
        let timestamp = u64::try_from(Stamp::of_machine().as_ns()).unwrap_or_default();
        // A lost event is harmless: clients can query the state.
        let _ = self.events.publish(TransitionEvent { timestamp, transition, start_state, goal_state });
    }
}
