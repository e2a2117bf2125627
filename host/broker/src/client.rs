//! One client of a shared board: what it asks, and what it is answered.

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
use r4_driver::{Clock, Error};
use r4_protocol::{
    ChannelId, Cycle, CycleOutcome, CycleState, DeviceInfo, FrameDecoder, FrameError, Refusal, Reply, Request, Spoken,
    ToDevice, ToHost,
    cycle::{CYCLE_CHANNELS, CycleMotor},
    version::{REPEATS, SPOKEN, accept},
};

use crate::{
    Broker,
    command::{Role, role},
    log::LogReader,
    outbox::Outbox,
    subscriptions::{Subscriptions, common_ms},
};

/// A client without a session, or whose heartbeats do not come, is dropped after this time, µs: ten times as long as a board waits.
const SILENT_US: u64 = 2_000_000;
/// Most requests of one client that wait for the board's answer. Further ones are refused.
const UNDER_WAY: usize = 64;

/// How a client left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Left {
    /// It closed its end, or its link failed.
    Gone,
    /// It opened no session, or sent no heartbeats.
    Silent,
    /// It did not read what it was sent.
    Slow,
}

/// State of a client that others see, too.
pub(crate) struct ClientState {
    /// Number of the open session; `None` before hello and after bye.
    pub(crate) session: Option<u16>,
    /// When its last heartbeat or hello came, by the host's clock, µs.
    pub(crate) heard_us: u64,
    /// The heartbeat that was sent to the board for one of the client's, and that one: clocks of the broker's host and of the client, µs.
    pub(crate) relayed: Option<(u64, u64)>,
    pub(crate) subscriptions: Subscriptions,
    /// Where it is in the firmware's log, if it asked for that.
    pub(crate) log: Option<LogReader>,
    pub(crate) outbox: Outbox,
}

/// An answer that comes later; `None` where there will be none.
type Later<'s> = LocalBoxFuture<'s, Option<ToHost>>;

/// A client that is served. Dropping it takes back what it had asked for.
struct Served<'s, 'b, C: Clock> {
    broker: &'s Broker<'b, C>,
    number: u64,
    /// Requests that wait for the board's answer.
    under_way: Cell<usize>,
    /// Version of the protocol in which the session was opened, 0 before there is one.
    version: Cell<u16>,
    /// Requests that are done once, newest last, with their answers where these have come.
    once: RefCell<VecDeque<Once>>,
}

/// A request that is done once, however often the client sends it.
struct Once {
    seq: u16,
    request: Request,
    answer: Option<ToHost>,
}

/// What the first of two futures ends with.
async fn first<T>(one: impl Future<Output = T>, other: impl Future<Output = T>) -> T {
    select(pin!(one), pin!(other)).await.factor_first().0
}

impl<C: Clock> Broker<'_, C> {
    /// Serves a client on a link until it leaves. Dropping the future is a client that is gone.
    pub async fn client<R: Read, W: Write>(&self, rx: R, tx: W) -> Left {
        let served = Served {
            broker: self,
            number: self.register(),
            under_way: Cell::new(0),
            version: Cell::new(0),
            once: RefCell::default(),
        };
        let (later, answers) = unbounded();
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

    /// Subscribes to a channel at the board as the clients want it now. Returns the period if that is another than before, ms.
    pub(crate) fn common_period(&self, channel: ChannelId) -> Option<u16> {
        let shared = &mut *self.shared.borrow_mut();
        let of_clients = shared.clients.values().map(|client| client.subscriptions.period_ms(channel));
        let wanted = common_ms(of_clients.chain(shared.watched.get(&channel).copied()));
        let before = if wanted > 0 { shared.periods.insert(channel, wanted) } else { shared.periods.remove(&channel) };
        (before.unwrap_or(0) != wanted).then_some(wanted)
    }
}

impl<'s, C: Clock> Served<'s, '_, C> {
    /// Gives the client's state to `with`; `None` never happens while it is served.
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

    /// Handles all that the client sends, until its link ends.
    async fn receive(&self, mut rx: impl Read, later: &UnboundedSender<Later<'s>>) -> Left {
        let mut decoder = FrameDecoder::new();
        let mut buffer = [0; 4096];
        while let Ok(len @ 1..) = rx.read(&mut buffer).await {
            for byte in &buffer[..len] {
                match decoder.push(*byte) {
                    Some(Ok(message)) => self.message(message, later),
                    Some(Err(FrameError::NotAMessage { seq: Some(seq) })) => self.unknown(seq, later),
                    // Damaged: as on a link to the board, it is not there.
                    Some(Err(_)) | None => {}
                }
            }
        }
        Left::Gone
    }

    /// Whether the client has sent this before, as a board does it ([`REPEATS`]): if it was answered, it is again. A repeat is never passed
    /// on: the driver repeats by itself, and to the board this would be another request.
    fn is_repeat(&self, seq: u16, request: &Request) -> bool {
        let mut once = self.once.borrow_mut();
        let known = once.iter().find(|known| known.seq == seq && known.request == *request);
        if let Some(known) = known {
            if let Some(answer) = &known.answer {
                self.tell(answer);
            }
            return true;
        }
        // A number is only that of the last request that had it.
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
        // Received for as long as the client is served.
        let _ = later.unbounded_send(answer);
    }

    fn commands(&self) -> bool {
        self.broker.shared.borrow().command.holder() == Some(self.number)
    }

    /// A heartbeat of the client that commands is one for the board, whose answer is the answer. One of another client is
    /// answered by what is known of the board.
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
        if self.commands() {
            let relayed = Some((board.send_heartbeat(), host_us));
            self.state(|client| client.relayed = relayed);
            return;
        }
        let (state, causes) = board.safety();
        let hot = board.hot_windings().into_iter().collect();
        self.tell(&ToHost::Heartbeat { host_us, device_us: board.device_us(), state, causes, hot });
    }

    fn cycle(&self, cycle: Cycle) {
        let board = self.broker.board;
        if self.commands() {
            board.pass_on_cycle(cycle);
        } else {
            let motors = [CycleMotor::NONE; CYCLE_CHANNELS];
            let outcome = CycleOutcome::Unbound;
            self.tell(&ToHost::Cycle(CycleState::new(cycle.seq, outcome, board.device_us(), board.safety(), motors)));
        }
    }

    /// Refuses an undamaged request that neither this program nor, perhaps, the board knows. It may be a set point: a board would end
    /// those in force, and here it is disarmed.
    fn unknown(&self, seq: u16, later: &UnboundedSender<Later<'s>>) {
        let refused = ToHost::Response { seq, result: Err(Refusal::UnknownMessage) };
        if !self.commands() {
            self.tell(&refused);
            return;
        }
        let board = self.broker.board;
        let answer = async move {
            // A board that does not answer has no heartbeats soon, and trips.
            let _ = board.disarm().await;
            Some(refused)
        };
        self.later(later, answer.boxed_local());
    }

    /// Answers a request at once, or by what this returns.
    fn request(&self, seq: u16, request: Request) -> Option<Later<'s>> {
        let (broker, board) = (self.broker, self.broker.board);
        let has_session = self.state(|client| client.session.is_some()) == Some(true);
        let role = role(&request);
        let refusal = match role {
            // A stop is never too much.
            Role::Watch | Role::Command | Role::Session if self.under_way.get() >= UNDER_WAY => Some(Refusal::Busy),
            Role::Watch | Role::Command if !has_session => Some(Refusal::NoSession),
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
                // For each that begins the board begins anew.
                return Some(self.pass_on(seq, Request::Log { on: *on || is_read }));
            }
            (None, Request::Arm) => {
                broker.shared.borrow_mut().command.arming(board.host_now_us());
                // From now on it depends on the client's.
                board.keep_heartbeat(false);
                return Some(self.pass_on(seq, request));
            }
            (None, Request::Stop) => {
                let answer = self.pass_on(seq, request);
                // So that all clients hear of it. Nothing is kept moving by it.
                board.send_heartbeat();
                return Some(answer);
            }
            (None, _) => return Some(self.pass_on(seq, request)),
        };
        self.answered(ToHost::Response { seq, result: told });
        None
    }

    /// Passes a request on to the board, whose answer is the answer.
    fn pass_on(&self, seq: u16, request: Request) -> Later<'s> {
        let answer = self.broker.board.pass_on(request);
        async move {
            let result = match answer.await {
                Ok(reply) => Ok(reply),
                Err(Error::Refused(refusal)) => Err(refusal),
                // Nothing is known of it: the client's own time-out says so.
                Err(_) => return None,
            };
            Some(ToHost::Response { seq, result })
        }
        .boxed_local()
    }

    /// Opens a session of a version. What an earlier one of this client commanded ends first.
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

    /// Closes the session. What this returns is ready when the board is disarmed, if the client commanded it.
    fn close(&self) -> impl Future<Output = ()> + use<C> {
        self.state(|client| (client.session, client.log) = (None, None));
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
            // Nothing is known of it: the next that subscribes asks again.
            shared.periods.remove(&channel);
            if let Some(client) = shared.clients.get_mut(&number) {
                client.subscriptions.set(channel, before_ms);
            }
            let Error::Refused(refusal) = why else { return None };
            Some(response(Err(refusal)))
        };
        Some(answer.boxed_local())
    }

    /// Ends the client's subscriptions, at the board where nobody else has one.
    fn unsubscribe(&self) {
        let channels = self.state(|client| std::mem::take(&mut client.subscriptions)).unwrap_or_default();
        for channel in channels.channels() {
            if let Some(period_ms) = self.broker.common_period(channel) {
                // One that is lost leaves samples that nobody gets.
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
        self.broker.wake();
    }
}
