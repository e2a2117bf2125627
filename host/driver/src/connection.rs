//! Running side of a connection: receives bytes, sends messages, keeps the heartbeat.

use std::{
    collections::HashMap,
    pin::pin,
    sync::{Arc, Mutex},
    task::Poll,
};

use embedded_io_async::{Read, Write};
use futures::{
    StreamExt,
    channel::{mpsc, oneshot},
    future::{Either, select},
};
use r4_protocol::{
    Causes, ChannelId, CycleChannel, CycleState, DeviceInfo, FrameDecoder, FrameError, HotWinding, LogChunk, Refusal,
    Reply, Request, SafetyState, Telemetry, ToDevice, ToHost, cycle::CYCLE_CHANNELS, encode_frame, frame::MAX_FRAME,
};

use crate::{
    Board, Clock, Error, HeartbeatAnswer,
    board::Wire,
    clock_map::ClockMap,
    cycles::{self, CycleQueue},
    streams::{SampleStreams, Sent, Streams, lock},
};

/// Number of heartbeats within the board's link time-out.
const HEARTBEATS_PER_TIMEOUT: u64 = 4;
/// Number of link time-outs without an answer after which the link counts as lost; the board has tripped long before.
const SILENT_TIMEOUTS: u64 = 5;

/// Outcome of a request that the board answered.
pub(crate) enum Answer {
    Told(Result<Reply, Refusal>),
    /// The answer has a form from a later version of the protocol.
    Unknown,
}

/// Request that was sent and waits for its answer.
pub(crate) struct Pending {
    pub(crate) answer: oneshot::Sender<Answer>,
    /// The request arms the board.
    pub(crate) arms: bool,
}

/// State that a [`Board`] and its connection share.
#[derive(Default)]
pub(crate) struct State {
    pub(crate) pending: HashMap<u16, Pending>,
    pub(crate) telemetry: Streams<Telemetry>,
    /// Safety state and causes from the last message that had them.
    pub(crate) safety: Option<(SafetyState, Causes)>,
    /// Hot windings in the last heartbeat.
    pub(crate) hot: Vec<HotWinding>,
    pub(crate) end: Option<Error>,
    pub(crate) bad_frames: u64,
    pub(crate) clock: ClockMap,
    pub(crate) cycles: CycleQueue,
    pub(crate) samples: SampleStreams,
    pub(crate) sent: Streams<Sent>,
    pub(crate) log: Streams<LogChunk>,
    pub(crate) heartbeats: Streams<HeartbeatAnswer>,
    pub(crate) cycle_answers: Streams<CycleState>,
    /// [`Board::send_heartbeat`] alone sends heartbeats, and the connection none.
    pub(crate) relays_heartbeats: bool,
    /// Subscribed channels, each with its period in ms.
    pub(crate) subscriptions: Vec<(ChannelId, u16)>,
    /// Channels of the cycles, from the last bind request that was sent.
    bound: heapless::Vec<CycleChannel, CYCLE_CHANNELS>,
    /// Date of the newest set point, on the board's clock, µs.
    dated_us: u64,
    session: Option<Session>,
}

#[derive(Clone, Copy)]
struct Session {
    id: u16,
    timeout_us: u64,
    last_heard_us: u64,
}

impl Session {
    fn heartbeat(self, now_us: u64) -> ToDevice {
        ToDevice::Heartbeat { session: self.id, host_us: now_us }
    }
}

impl State {
    /// Returns the date of a set point made now, on the board's clock, µs. Dates always increase, also when the
    /// estimate of that clock is corrected backwards: the board compares them to see if a refused set point is newer
    /// than the one in force.
    pub(crate) fn date_us(&mut self, now_us: u64) -> u64 {
        self.dated_us = self.clock.device_us(now_us).max(self.dated_us + 1);
        self.dated_us
    }

    /// Stores the session that the board opened, and returns its first heartbeat.
    pub(crate) fn open(&mut self, info: &DeviceInfo, sent_us: u64, now_us: u64) -> ToDevice {
        self.clock.seen(sent_us, info.device_us, now_us);
        self.safety = Some((info.state, info.causes));
        let timeout_us = u64::from(info.link_timeout_ms) * 1000;
        let session = Session { id: info.session, timeout_us, last_heard_us: now_us };
        self.session = Some(session);
        session.heartbeat(now_us)
    }

    /// Makes a heartbeat of the session; `None` before a session is open.
    pub(crate) fn heartbeat(&self, now_us: u64) -> Option<ToDevice> {
        self.session.map(|session| session.heartbeat(now_us))
    }

    fn answered(&mut self, seq: u16, answer: Answer) {
        // An answer without a waiting request came after its time-out.
        if let Some(pending) = self.pending.remove(&seq) {
            // The last report is older than this answer: with it, a caller who has just armed the board would read that
            // it is disarmed, and could not distinguish that from a board disarmed since.
            if pending.arms && matches!(answer, Answer::Told(Ok(_))) {
                self.safety = Some((SafetyState::Armed, Causes::NONE));
            }
            let _ = pending.answer.send(answer);
        }
    }

    fn receive(&mut self, message: ToHost, now_us: u64) {
        match message {
            ToHost::Response { seq, result } => self.answered(seq, Answer::Told(result)),
            ToHost::Heartbeat { host_us, device_us, state, causes, hot } => {
                self.hot.clear();
                self.hot.extend_from_slice(&hot);
                self.clock.seen(host_us, device_us, now_us);
                self.safety = Some((state, causes));
                if let Some(session) = &mut self.session {
                    session.last_heard_us = now_us;
                }
                let hot = self.hot.clone();
                self.heartbeats.push(&HeartbeatAnswer { host_us, device_us, state, causes, hot });
            }
            ToHost::Telemetry(telemetry) => {
                self.safety = Some((telemetry.state, telemetry.causes));
                self.telemetry.push(&telemetry);
                self.samples.push(&telemetry, self.clock.host_us(telemetry.device_us));
            }
            ToHost::Log(chunk) => self.log.push(&chunk),
            ToHost::Cycle(told) => {
                if let Ok(state) = told.state() {
                    self.safety = Some((state, told.causes()));
                }
                self.cycles.answered(told, now_us, self.clock.device_us(now_us));
                self.cycle_answers.push(&told);
            }
        }
    }

    /// Passes a message that leaves now to the streams of sent messages.
    fn sent(&mut self, message: &ToDevice, now_us: u64) {
        if let ToDevice::Request { request: Request::Bind { channels, .. }, .. } = message {
            self.bound.clone_from(channels);
        }
        if !self.sent.is_open() {
            return;
        }
        let setpoints = match message {
            ToDevice::Request { request: Request::Set { channel, setpoint, .. }, .. } => vec![(*channel, *setpoint)],
            ToDevice::Cycle(cycle) => cycles::setpoints(cycle, &self.bound),
            ToDevice::Heartbeat { .. } => return,
            ToDevice::Request { .. } => Vec::new(),
        };
        self.sent.push(&Sent { device_us: self.clock.device_us(now_us), message: message.clone(), setpoints });
    }

    /// Ends all requests and streams with the first error of the connection, and returns that error.
    fn end(&mut self, error: Error) -> Error {
        let error = self.end.get_or_insert(error).clone();
        // Dropping the senders wakes the requests, which then read `end`.
        self.pending.clear();
        self.telemetry.end(&error);
        self.samples.end(&error);
        self.sent.end(&error);
        self.log.end(&error);
        self.heartbeats.end(&error);
        self.cycle_answers.end(&error);
        self.cycles.wake_user();
        error
    }
}

/// Opens a session with the board at the other end of `rx` and `tx`, runs `work`, and closes the session.
///
/// The heartbeat is kept while `work` runs; when `work` returns or its future is dropped, so does the heartbeat, and the
/// board makes its outputs safe.
///
/// # Errors
/// When no session can be opened. Later errors of the link are returned by the operations in `work`.
pub async fn with_board<C, R, W, T>(rx: R, tx: W, clock: C, work: impl AsyncFnOnce(&Board<C>) -> T) -> Result<T, Error>
where
    C: Clock,
    R: Read,
    W: Write,
{
    let state = Arc::new(Mutex::new(State::default()));
    let (outgoing, messages) = mpsc::unbounded();
    let session = async {
        let board = Board::open(Wire::new(clock.clone(), state.clone(), outgoing)).await?;
        let result = work(&board).await;
        board.close().await;
        Ok(result)
    };
    let receive = receive(&state, &clock, rx);
    let transmit = transmit(&state, &clock, tx, messages);
    let listen = listen(&state, &clock);
    let link = async {
        let error = match select(pin!(listen), select(pin!(receive), pin!(transmit))).await {
            Either::Left((error, _)) => error,
            Either::Right((Either::Left((error, _)) | Either::Right((error, _)), _)) => error,
        };
        lock(&state).end(error);
        // All waiting requests have failed, so the session ends by itself.
        std::future::pending::<T>().await
    };
    match select(pin!(session), pin!(link)).await {
        Either::Left((result, _)) => result,
        Either::Right((never, _)) => Ok(never),
    }
}

async fn receive<C: Clock, R: Read>(state: &Mutex<State>, clock: &C, mut rx: R) -> Error {
    let mut decoder = FrameDecoder::new();
    let mut buffer = [0; 512];
    loop {
        let len = match rx.read(&mut buffer).await {
            Ok(0) => return Error::LinkFailed { reason: "closed by the other end".into() },
            Ok(len) => len,
            Err(error) => return Error::LinkFailed { reason: error.to_string() },
        };
        let now_us = clock.now_us();
        let mut state = lock(state);
        for byte in &buffer[..len] {
            match decoder.push(*byte) {
                Some(Ok(message)) => state.receive(message, now_us),
                Some(Err(FrameError::NotAMessage { seq: Some(seq) })) => state.answered(seq, Answer::Unknown),
                Some(Err(_)) => state.bad_frames += 1,
                None => {}
            }
        }
    }
}

/// Returns when the board has been silent for too long. A future of its own, because a stuck transmitter must not delay
/// it.
async fn listen<C: Clock>(state: &Mutex<State>, clock: &C) -> Error {
    /// Poll interval before a session is open, µs.
    const LOOK_EVERY_US: u64 = 50_000;
    loop {
        let session = lock(state).session;
        let now_us = clock.now_us();
        let until_us = match session {
            None => now_us + LOOK_EVERY_US,
            Some(session) => {
                let silent_us = now_us.saturating_sub(session.last_heard_us);
                let allowed_us = session.timeout_us * SILENT_TIMEOUTS;
                if silent_us > allowed_us {
                    return Error::LinkLost { silent_ms: (silent_us / 1000) as u32 };
                }
                now_us + (allowed_us - silent_us) + 1
            }
        };
        clock.sleep_until(until_us).await;
    }
}

async fn transmit<C: Clock, W: Write>(
    state: &Mutex<State>,
    clock: &C,
    mut tx: W,
    mut messages: mpsc::UnboundedReceiver<ToDevice>,
) -> Error {
    let failed = |error: W::Error| Error::LinkFailed { reason: error.to_string() };
    // The zero byte ends a partial frame that the board may still hold from the previous host.
    if let Err(error) = tx.write_all(&[0]).await {
        return failed(error);
    }
    let mut buffer = [0; MAX_FRAME];
    let mut next_heartbeat_us = 0;
    // Requests and cycles alternate in priority, so that neither can starve the other.
    let mut cycles_first = false;
    loop {
        let (session, relays) = {
            let state = lock(state);
            (state.session, state.relays_heartbeats)
        };
        let message = match session {
            // The heartbeat comes before all other messages, so that no number of requests can starve it.
            Some(session) if clock.now_us() >= next_heartbeat_us => {
                let host_us = clock.now_us();
                next_heartbeat_us = host_us + session.timeout_us / HEARTBEATS_PER_TIMEOUT;
                if relays {
                    continue;
                }
                Some(session.heartbeat(host_us))
            }
            Some(_) => {
                cycles_first = !cycles_first;
                let next = std::future::poll_fn(|context| {
                    let cycle = |context: &mut _| {
                        let now_us = clock.now_us();
                        lock(state).cycles.poll_send(context, now_us).map(Some)
                    };
                    if cycles_first && let Poll::Ready(cycle) = cycle(context) {
                        return Poll::Ready(cycle);
                    }
                    match messages.poll_next_unpin(context) {
                        Poll::Ready(message) => Poll::Ready(message),
                        Poll::Pending if cycles_first => Poll::Pending,
                        Poll::Pending => cycle(context),
                    }
                });
                match select(pin!(next), pin!(clock.sleep_until(next_heartbeat_us))).await {
                    Either::Left((message, _)) => message,
                    Either::Right(((), _)) => continue,
                }
            }
            None => messages.next().await,
        };
        let Some(message) = message else {
            // The board's handle was dropped, so no further message can come.
            return std::future::pending().await;
        };
        let Ok(frame) = encode_frame(&message, &mut buffer) else { continue };
        let now_us = clock.now_us();
        lock(state).sent(&message, now_us);
        if let Err(error) = tx.write_all(frame).await {
            return failed(error);
        }
        if let Err(error) = tx.flush().await {
            return failed(error);
        }
    }
}
