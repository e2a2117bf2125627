//! One client of a shared board: its session, its requests and their answers.

use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    future::poll_fn,
    pin::pin,
};

use embedded_io_async::{Read, Write};
use futures::{
    FutureExt, StreamExt,
    channel::mpsc::{UnboundedSender, unbounded},
    future::{LocalBoxFuture, select},
};
use r4_access::{Piece, Splitter};
use r4_driver::{Clock, Error};
use r4_protocol::{
    ChannelId, Cycle, CycleOutcome, CycleState, DeviceInfo, FrameDecoder, FrameError, Refusal, Reply, Request,
    Setpoint, Spoken, ToDevice, ToHost,
    cycle::{CYCLE_CHANNELS, CycleMotor},
    version::{REPEATS, SPOKEN, accept},
};

use crate::{
    Broker,
    command::{Role, role},
    guard::needs,
    log::LogReader,
    outbox::Outbox,
    subscriptions::{Subscriptions, common_ms},
};

/// Longest silence of a client, µs: without a session or a heartbeat for this time it is dropped. Ten times the link
/// time-out of a board.
const SILENT_US: u64 = 2_000_000;
/// Most requests of one client that may wait for the board's answer. Further ones are refused with [`Refusal::Busy`].
const UNDER_WAY: usize = 64;

/// Reason why a client is no longer served.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// The client closed its end, or its link failed.
    Gone,
    /// The client opened no session, or sent no heartbeats, for two seconds.
    Silent,
    /// The client did not read what it was sent until its outbox was full.
    Slow,
}

/// State of a client that the broker and the other clients also use.
pub(crate) struct ClientState {
    /// Number of the open session; `None` before hello and after bye.
    pub(crate) session: Option<u16>,
    /// Time of its last heartbeat or hello, on the host's clock, µs.
    pub(crate) heard_us: u64,
    /// Heartbeat sent to the board on behalf of the client, and the client's own that caused it: times on the clocks
    /// of the broker's host and of the client, µs. `None` when no answer is due.
    pub(crate) relayed: Option<(u64, u64)>,
    pub(crate) subscriptions: Subscriptions,
    /// Position in the firmware's log; `None` unless the client asked for the log.
    pub(crate) log: Option<LogReader>,
    pub(crate) outbox: Outbox,
}

/// Future of an answer that comes later; it yields `None` if there is no answer to send.
type Later<'s> = LocalBoxFuture<'s, Option<ToHost>>;

/// A client while it is served. Dropping it ends its subscriptions and its command.
struct Served<'s, 'b, C: Clock> {
    broker: &'s Broker<'b, C>,
    number: u64,
    /// Number of requests that wait for the board's answer.
    under_way: Cell<usize>,
    /// Protocol version in which the session was opened; 0 before there is one.
    version: Cell<u16>,
    /// Requests that must be executed only once, newest last, with their answers where these have come.
    once: RefCell<VecDeque<Once>>,
    /// Last binding that the guard permitted: each cycle needs the same permissions.
    bind: RefCell<Option<Request>>,
}

/// A request that is executed once, however often the client sends it.
struct Once {
    seq: u16,
    request: Request,
    answer: Option<ToHost>,
}

/// Returns the output of the future that finishes first; the other one is dropped.
async fn first<T>(one: impl Future<Output = T>, other: impl Future<Output = T>) -> T {
    select(pin!(one), pin!(other)).await.factor_first().0
}

impl<C: Clock> Broker<'_, C> {
    /// Serves a client on a link until it leaves, and returns why it left. Dropping the future counts as a lost
    /// client.
    pub async fn client<R: Read, W: Write>(&self, rx: R, tx: W) -> Left {
        let served = Served {
            broker: self,
            number: self.register(),
            under_way: Cell::new(0),
            version: Cell::new(0),
            once: RefCell::default(),
            bind: RefCell::default(),
        };
        let (later, answers) = unbounded();
        // Answers are awaited concurrently: a slow one must not delay a stop.
        let answering = answers.for_each_concurrent(None, |answer: Later<'_>| async {
            let answer = answer.await;
            served.under_way.set(served.under_way.get() - 1);
            if let Some(answer) = answer {
                served.answered(answer);
            }
        });
        let answering = async {
            answering.await;
            Left::Gone
        };
        let link = first(served.receive(rx, &later), served.send(tx));
        first(first(link, served.silence()), answering).await
    }

    fn register(&self) -> u64 {
        let heard_us = self.board.host_now_us();
        let shared = &mut *self.shared.borrow_mut();
        shared.next_client += 1;
        let client = ClientState {
            session: None,
            heard_us,
            relayed: None,
            subscriptions: Subscriptions::default(),
            log: None,
            outbox: Outbox::default(),
        };
        shared.clients.insert(shared.next_client, client);
        shared.next_client
    }

    /// Computes the period at which the board has to be subscribed to a channel, ms (0: not at all), and records it.
    /// Returns it only if it differs from the one before.
    pub(crate) fn common_period(&self, channel: ChannelId) -> Option<u16> {
        let shared = &mut *self.shared.borrow_mut();
        let of_clients = shared.clients.values().map(|client| client.subscriptions.period_ms(channel));
        let wanted = common_ms(of_clients.chain(shared.watched.get(&channel).copied()));
        let before = if wanted > 0 { shared.periods.insert(channel, wanted) } else { shared.periods.remove(&channel) };
        (before.unwrap_or(0) != wanted).then_some(wanted)
    }
}

impl<'s, C: Clock> Served<'s, '_, C> {
    /// Calls `with` on the client's state. Returns `None` only if the client is not registered, which does not happen
    /// while it is served.
    fn state<T>(&self, with: impl FnOnce(&mut ClientState) -> T) -> Option<T> {
        self.broker.shared.borrow_mut().clients.get_mut(&self.number).map(with)
    }

    fn tell(&self, message: &ToHost) {
        self.state(|client| client.outbox.push(message));
    }

    async fn send(&self, mut tx: impl Write) -> Left {
        loop {
            let bytes = poll_fn(|context| {
                let poll = self.state(|client| client.outbox.poll(context));
                poll.unwrap_or(std::task::Poll::Pending)
            });
            let Ok(bytes) = bytes.await else { return Left::Slow };
            if tx.write_all(&bytes).await.is_err() || tx.flush().await.is_err() {
                return Left::Gone;
            }
        }
    }

    async fn silence(&self) -> Left {
        loop {
            let heard_us = self.state(|client| client.heard_us).unwrap_or(0);
            let silent_us = self.broker.board.host_now_us().saturating_sub(heard_us);
            let Some(left_us) = SILENT_US.checked_sub(silent_us).filter(|left_us| *left_us > 0) else {
                return Left::Silent;
            };
            self.broker.board.sleep_s(left_us as f64 * 1e-6).await;
        }
    }

    /// Decodes and handles everything that the client sends, until its link ends.
    async fn receive(&self, mut rx: impl Read, later: &UnboundedSender<Later<'s>>) -> Left {
        let mut decoder = FrameDecoder::new();
        let mut splitter = Splitter::default();
        let mut buffer = [0; 4096];
        while let Ok(len @ 1..) = rx.read(&mut buffer).await {
            let Some(guard) = &self.broker.guard else {
                self.bytes(&buffer[..len], &mut decoder, later);
                continue;
            };
            for piece in splitter.push(&buffer[..len]) {
                match piece {
                    Piece::Bytes(bytes) => self.bytes(&bytes, &mut decoder, later),
                    Piece::Token(token) => guard.present(self.number, &token),
                }
            }
        }
        Left::Gone
    }

    fn bytes(&self, bytes: &[u8], decoder: &mut FrameDecoder, later: &UnboundedSender<Later<'s>>) {
        for byte in bytes {
            match decoder.push(*byte) {
                Some(Ok(message)) => self.message(message, later),
                Some(Err(FrameError::NotAMessage { seq: Some(seq) })) => self.unknown(seq, later),
                // A damaged frame is ignored, as a board ignores it: the client repeats its request.
                Some(Err(_)) | None => {}
            }
        }
    }

    /// Returns whether the client has sent this request before, and repeats the answer if there is one, as a board
    /// does ([`REPEATS`]). A repeat is never passed on: the driver repeats by itself, and the board would take it for
    /// another request.
    fn is_repeat(&self, seq: u16, request: &Request) -> bool {
        let mut once = self.once.borrow_mut();
        let known = once.iter().find(|known| known.seq == seq && known.request == *request);
        if let Some(known) = known {
            if let Some(answer) = &known.answer {
                self.tell(answer);
            }
            return true;
        }
        // Sequence numbers wrap: a number belongs to the last request that used it.
        once.retain(|known| known.seq != seq);
        if request.is_done_once() && self.version.get() >= REPEATS.since {
            if once.len() == REPEATS.remembered {
                once.pop_front();
            }
            once.push_back(Once { seq, request: request.clone(), answer: None });
        }
        false
    }

    fn answered(&self, answer: ToHost) {
        self.tell(&answer);
        if let ToHost::Response { seq, .. } = answer
            && let Some(known) = self.once.borrow_mut().iter_mut().find(|known| known.seq == seq)
        {
            known.answer = Some(answer);
        }
    }

    fn message(&self, message: ToDevice, later: &UnboundedSender<Later<'s>>) {
        match message {
            ToDevice::Heartbeat { session, host_us } => self.heartbeat(session, host_us),
            ToDevice::Cycle(cycle) => self.cycle(cycle),
            ToDevice::Request { seq, request } if self.is_repeat(seq, &request) => {}
            ToDevice::Request { seq, request } => {
                if let Some(answer) = self.request(seq, request) {
                    self.later(later, answer);
                }
            }
        }
    }

    fn later(&self, later: &UnboundedSender<Later<'s>>, answer: Later<'s>) {
        self.under_way.set(self.under_way.get() + 1);
        // The receiver lives as long as the client is served, so sending cannot fail.
        let _ = later.unbounded_send(answer);
    }

    fn commands(&self) -> bool {
        self.broker.shared.borrow().command.holder() == Some(self.number)
    }

    /// Handles a heartbeat. That of the commanding client is passed on to the board, whose answer becomes the answer
    /// (see [`Broker::run`]). That of another client is answered from the last known state of the board.
    fn heartbeat(&self, session: u16, host_us: u64) {
        let board = self.broker.board;
        let now_us = board.host_now_us();
        let is_known = self.state(|client| {
            let is_known = client.session == Some(session);
            if is_known {
                client.heard_us = now_us;
            }
            is_known
        });
        if is_known != Some(true) {
            return;
        }
        if self.commands() && !self.broker.is_welcome(self.number) {
            self.dismiss();
        }
        if self.commands() {
            let relayed = Some((board.send_heartbeat(), host_us));
            self.state(|client| client.relayed = relayed);
            return;
        }
        let (state, causes) = board.safety();
        let hot = board.hot_windings().into_iter().collect();
        self.tell(&ToHost::Heartbeat { host_us, device_us: board.device_us(), state, causes, hot });
    }

    /// Ends the command of a client that may no longer have it, as if it had closed its session: the broker disarms the
    /// board at once, so that it stops in its orderly way instead of tripping, and others may command after that.
    fn dismiss(&self) {
        // The receiver is for clients that wait for the end.
        drop(self.broker.shared.borrow_mut().command.end(self.number));
        self.broker.wake();
    }

    /// Asks the guard about a request; without a guard every client may do everything.
    fn permits(&self, request: &Request) -> bool {
        self.broker.guard.as_ref().is_none_or(|guard| guard.permits(self.number, &needs(request)))
    }

    /// Ends at the board what a denied request was to replace: a refused newer set point never leaves the older one in
    /// force.
    fn withdraw(&self, request: Request) -> Option<impl Future<Output = ()> + use<C>> {
        // The board refuses these and withdraws the channel's set points up to that date, as for any refused one.
        let refused = match request {
            Request::Set { channel, setpoint, sent_us, ttl_ms } => {
                Request::Set { channel, setpoint: Setpoint { value: f32::NAN, ..setpoint }, sent_us, ttl_ms }
            }
            Request::Follow { channel, sent_us, .. } => {
                Request::Follow { channel, sent_us, points: heapless::Vec::new() }
            }
            // An empty binding ends that in force.
            Request::Bind { ttl_ms, .. } => Request::Bind { channels: heapless::Vec::new(), ttl_ms },
            _ => return None,
        };
        let ended = self.commands().then(|| self.broker.board.pass_on(refused))?;
        Some(async move {
            // If the link to the board is lost, heartbeats are lost too, and the board trips by itself.
            let _ = ended.await;
        })
    }

    /// Answers a denied request once the board has ended what it was to replace.
    fn denied(&self, seq: u16, request: Request) -> Option<Later<'s>> {
        let refused = ToHost::Response { seq, result: Err(Refusal::Denied) };
        let Some(ended) = self.withdraw(request) else {
            self.answered(refused);
            return None;
        };
        let answer = async move {
            ended.await;
            Some(refused)
        };
        Some(answer.boxed_local())
    }

    fn cycle(&self, cycle: Cycle) {
        let board = self.broker.board;
        let commands = self.commands();
        let is_denied = commands && self.bind.borrow().as_ref().is_some_and(|bind| !self.permits(bind));
        if is_denied {
            // The board follows the cycle before until its time to live: a newer one that is refused ends it at once.
            self.dismiss();
        }
        if commands && !is_denied {
            board.pass_on_cycle(cycle);
        } else {
            let motors = [CycleMotor::NONE; CYCLE_CHANNELS];
            let outcome = CycleOutcome::Unbound;
            self.tell(&ToHost::Cycle(CycleState::new(cycle.seq, outcome, board.device_us(), board.safety(), motors)));
        }
    }

    /// Refuses an undamaged request which this program does not know. It may be a set point of a newer protocol: a
    /// board would end the set points in force, so the broker disarms it.
    fn unknown(&self, seq: u16, later: &UnboundedSender<Later<'s>>) {
        let refused = ToHost::Response { seq, result: Err(Refusal::UnknownMessage) };
        if !self.commands() {
            self.tell(&refused);
            return;
        }
        let board = self.broker.board;
        let answer = async move {
            // If the link to the board is lost, heartbeats are lost too, and the board trips by itself.
            let _ = board.disarm().await;
            Some(refused)
        };
        self.later(later, answer.boxed_local());
    }

    /// Answers a request at once and returns `None`, or returns the future of its answer.
    fn request(&self, seq: u16, request: Request) -> Option<Later<'s>> {
        let (broker, board) = (self.broker, self.broker.board);
        let has_session = self.state(|client| client.session.is_some()) == Some(true);
        let role = role(&request);
        // Before all that depends on what the board has: a denial does not say whether the resource exists.
        if has_session && !self.permits(&request) {
            return self.denied(seq, request);
        }
        if let Request::Bind { .. } = request {
            *self.bind.borrow_mut() = Some(request.clone());
        }
        // Anybody may disarm, but a client without a valid token does not get the command by that.
        let is_guest = matches!(request, Request::Disarm) && !broker.is_welcome(self.number);
        let refusal = match role {
            // A stop is never refused for load.
            Role::Watch | Role::Command | Role::Session if self.under_way.get() >= UNDER_WAY => Some(Refusal::Busy),
            Role::Watch | Role::Command if !has_session => Some(Refusal::NoSession),
            Role::Command if is_guest && broker.shared.borrow().command.holder().is_none() => None,
            Role::Command if !broker.shared.borrow_mut().command.claim(self.number) => Some(Refusal::InUse),
            _ => None,
        };
        let told = match (refusal, &request) {
            (Some(refusal), _) => Err(refusal),
            (None, Request::Hello { version, schema }) => {
                match accept(&SPOKEN, Spoken { version: *version, schema: *schema }) {
                    Ok(version) => return Some(self.hello(seq, version)),
                    Err(refusal) => Err(refusal),
                }
            }
            (None, Request::Bye) => return Some(self.bye(seq)),
            (None, Request::Describe { index }) => {
                let channel = board.channels().get(usize::from(*index)).cloned();
                channel.map(Reply::Channel).ok_or(Refusal::NoSuchIndex { index: *index })
            }
            (None, Request::Subscribe { channel, period_ms }) => return self.subscribe(seq, *channel, *period_ms),
            (None, Request::Log { on }) => {
                self.state(|client| client.log = on.then(LogReader::default));
                let is_read = broker.shared.borrow().clients.values().any(|client| client.log.is_some());
                // The board restarts its log for each request; [`LogReader::unread`] removes what the others already
                // have.
                return Some(self.pass_on(seq, Request::Log { on: *on || is_read }));
            }
            (None, Request::Arm) => {
                broker.shared.borrow_mut().command.arming(board.host_now_us());
                // From now on the board gets a heartbeat only for each of the client's, so that it trips if the
                // client fails.
                board.keep_heartbeat(false);
                return Some(self.pass_on(seq, request));
            }
            (None, Request::Stop) => {
                let answer = self.pass_on(seq, request);
                // The answer to this heartbeat carries the tripped state to all clients. A single heartbeat keeps
                // nothing moving.
                board.send_heartbeat();
                return Some(answer);
            }
            (None, _) => return Some(self.pass_on(seq, request)),
        };
        self.answered(ToHost::Response { seq, result: told });
        None
    }

    /// Passes a request on to the board. The future yields the board's reply or refusal.
    fn pass_on(&self, seq: u16, request: Request) -> Later<'s> {
        let answer = self.broker.board.pass_on(request);
        async move {
            let result = match answer.await {
                Ok(reply) => Ok(reply),
                Err(Error::Refused(refusal)) => Err(refusal),
                // Lost or timed out: the client's own time-out reports it.
                Err(_) => return None,
            };
            Some(ToHost::Response { seq, result })
        }
        .boxed_local()
    }

    /// Opens a session in a protocol version. An earlier session of this client is closed first, with what it
    /// commanded.
    fn hello(&self, seq: u16, version: u16) -> Later<'s> {
        let (broker, number) = (self.broker, self.number);
        let ended = self.close();
        self.version.set(version);
        async move {
            ended.await;
            let shared = &mut *broker.shared.borrow_mut();
            shared.next_session = shared.next_session.wrapping_add(1);
            let client = shared.clients.get_mut(&number)?;
            (client.session, client.heard_us) = (Some(shared.next_session), broker.board.host_now_us());
            let (state, causes) = broker.board.safety();
            let device_us = broker.board.device_us();
            let info =
                DeviceInfo { session: shared.next_session, device_us, state, causes, ..broker.board.info().clone() };
            Some(ToHost::Response { seq, result: Ok(Reply::Hello(info)) })
        }
        .boxed_local()
    }

    fn bye(&self, seq: u16) -> Later<'s> {
        let ended = self.close();
        async move {
            ended.await;
            Some(ToHost::Response { seq, result: Ok(Reply::Done) })
        }
        .boxed_local()
    }

    /// Closes the session. The returned future is ready once the board is disarmed, at once if the client did not
    /// command.
    fn close(&self) -> impl Future<Output = ()> + use<C> {
        self.state(|client| (client.session, client.log) = (None, None));
        // Sequence numbers start again with the next session.
        self.once.borrow_mut().clear();
        self.unsubscribe();
        let ended = self.broker.shared.borrow_mut().command.end(self.number);
        self.broker.wake();
        async move {
            if let Some(ended) = ended {
                let _ = ended.await;
            }
        }
    }

    fn subscribe(&self, seq: u16, channel: ChannelId, period_ms: u16) -> Option<Later<'s>> {
        let (broker, number) = (self.broker, self.number);
        let response = move |result| ToHost::Response { seq, result };
        if broker.board.channel(channel).is_err() {
            self.tell(&response(Err(Refusal::UnknownChannel { channel })));
            return None;
        }
        let before_ms = self.state(|client| client.subscriptions.set(channel, period_ms)).unwrap_or(0);
        let Some(common_ms) = broker.common_period(channel) else {
            self.tell(&response(Ok(Reply::Done)));
            return None;
        };
        let asked = broker.board.pass_on(Request::Subscribe { channel, period_ms: common_ms });
        let answer = async move {
            let Err(why) = asked.await else { return Some(response(Ok(Reply::Done))) };
            let shared = &mut *broker.shared.borrow_mut();
            // It is unknown whether the board is subscribed: forget the period, so that the next subscriber asks
            // again.
            shared.periods.remove(&channel);
            if let Some(client) = shared.clients.get_mut(&number) {
                client.subscriptions.set(channel, before_ms);
            }
            let Error::Refused(refusal) = why else { return None };
            Some(response(Err(refusal)))
        };
        Some(answer.boxed_local())
    }

    /// Ends the client's subscriptions, also at the board where no other client has one.
    fn unsubscribe(&self) {
        let channels = self.state(|client| std::mem::take(&mut client.subscriptions)).unwrap_or_default();
        for channel in channels.channels() {
            if let Some(period_ms) = self.broker.common_period(channel) {
                // The answer is not awaited: a lost request only leaves samples that no client reads.
                drop(self.broker.board.pass_on(Request::Subscribe { channel, period_ms }));
            }
        }
    }
}

impl<C: Clock> Drop for Served<'_, '_, C> {
    fn drop(&mut self) {
        self.unsubscribe();
        {
            let shared = &mut *self.broker.shared.borrow_mut();
            shared.command.lose(self.number);
            shared.clients.remove(&self.number);
        }
        if let Some(guard) = &self.broker.guard {
            guard.leave(self.number);
        }
        self.broker.wake();
    }
}
