//! Lifecycle services of a managed node, on a thread of their own: they are there without a session, too.

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

/// Side of the node of its lifecycle.
pub struct Lifecycle {
    changes: UnboundedReceiver<Change>,
    unasked: UnboundedSender<Unasked>,
    end: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Lifecycle {
    /// Offers the services of a managed node, which is unconfigured.
    ///
    /// # Errors
    /// [`NodeError`]
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

    /// The next transition that somebody asks for and that can be made; never ready where the services have ended.
    pub async fn change(&mut self) -> Change {
        match self.changes.next().await {
            Some(change) => change,
            None => std::future::pending().await,
        }
    }

    /// Where transitions that nobody asked for are noted.
    pub(super) fn notes(&self) -> UnboundedSender<Unasked> {
        self.unasked.clone()
    }

    /// Makes a transition that nobody asked for.
    pub fn note(&self, unasked: Unasked) {
        // The services end with the node only.
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

/// Answers a service that only asks.
async fn ask<A: Message + 'static>(server: &Server<EmptyRequest, A>, now: impl Fn() -> A) {
    let mut calls = server.receive_request_stream();
    while let Some(call) = calls.next().await {
        let Ok((id, _)) = call else { continue };
        // The caller may be gone by now.
        let _ = server.async_send_response(id, now()).await;
    }
}

struct Machine<'e> {
    state: Cell<State>,
    events: &'e Publisher<TransitionEvent>,
}

impl Machine<'_> {
    /// Carries transitions out, one after the other, and those that nobody asked for between them.
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
        let (answer, answered) = oneshot::channel();
        let is_sent = to_node.unbounded_send(Change { transition, answer }).is_ok();
        let is_made = is_sent && answered.await.unwrap_or(false);
        let to = if is_made { transition.goal() } else { from };
        self.state.set(to);
        self.tell(transition.ended(is_made), transition.under_way(), to.message());
        is_made
    }

    fn make(&self, unasked: Unasked) {
        // What was asked for meanwhile may have led away from there.
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
        // Whoever wants to know asks for the state, too.
        let _ = self.events.publish(TransitionEvent { timestamp, transition, start_state, goal_state });
    }
}
