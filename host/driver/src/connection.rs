//! The running side of a connection: bytes in, bytes out, heartbeats.

use std::{
    collections::HashMap,
    pin::pin,
    sync::{Arc, Mutex},
};

use embedded_io_async::{Read, Write};
use futures::{
    StreamExt,
    channel::{mpsc, oneshot},
    future::{Either, select},
};
use r4_protocol::{
    Causes, DeviceInfo, FrameDecoder, Refusal, Reply, SafetyState, ToDevice, ToHost, encode_frame, frame::MAX_FRAME,
};

use crate::{
    Board, Clock, Error,
    board::Wire,
    telemetry::{Streams, lock},
};

/// A heartbeat is sent this many times within the board's link timeout.
const HEARTBEATS_PER_TIMEOUT: u64 = 4;
/// The link counts as lost after this many link timeouts without an answer: the board has tripped long before.
const SILENT_TIMEOUTS: u64 = 5;

/// What a [`Board`] and its connection share.
#[derive(Default)]
pub(crate) struct State {
    pub(crate) pending: HashMap<u16, oneshot::Sender<Result<Reply, Refusal>>>,
    pub(crate) streams: Streams,
    pub(crate) safety: Option<(SafetyState, Causes)>,
    pub(crate) end: Option<Error>,
    pub(crate) bad_frames: u64,
    session: Option<Session>,
    offset: Option<Offset>,
}

/// Board clock minus host clock, as one round trip showed it.
#[derive(Clone, Copy)]
struct Offset {
    us: i64,
    round_trip_us: u64,
    seen_us: u64,
}

/// Two crystals drift apart by no more than this share, of which an old offset is worth less.
const DRIFT: f64 = 200e-6;

impl Offset {
    /// How wrong it may be by now, µs.
    fn uncertainty_us(&self, now_us: u64) -> f64 {
        self.round_trip_us as f64 / 2.0 + now_us.saturating_sub(self.seen_us) as f64 * DRIFT
    }
}

#[derive(Clone, Copy)]
struct Session {
    id: u16,
    timeout_us: u64,
    last_heard_us: u64,
}

impl State {
    /// The board's clock when the host's shows `host_us`.
    pub(crate) fn device_us(&self, host_us: u64) -> u64 {
        host_us.saturating_add_signed(self.offset.map_or(0, |offset| offset.us))
    }

    /// Takes the board's clock as read between `sent_us` and `now_us` of ours.
    fn clock_seen(&mut self, sent_us: u64, device_us: u64, now_us: u64) {
        let round_trip_us = now_us.saturating_sub(sent_us);
        let middle_us = sent_us + round_trip_us / 2;
        let new = Offset { us: device_us.wrapping_sub(middle_us).cast_signed(), round_trip_us, seen_us: now_us };
        if self.offset.is_none_or(|old| new.uncertainty_us(now_us) <= old.uncertainty_us(now_us)) {
            self.offset = Some(new);
        }
    }

    /// Takes the session that the board opened, and returns the heartbeat that keeps it.
    pub(crate) fn open(&mut self, info: &DeviceInfo, sent_us: u64, now_us: u64) -> ToDevice {
        self.clock_seen(sent_us, info.device_us, now_us);
        self.safety = Some((info.state, info.causes));
        self.session = Some(Session {
            id: info.session,
            timeout_us: u64::from(info.link_timeout_ms) * 1000,
            last_heard_us: now_us,
        });
        ToDevice::Heartbeat { session: info.session, host_us: now_us }
    }

    fn receive(&mut self, message: ToHost, now_us: u64) {
        match message {
            ToHost::Response { seq, result } => {
                // An answer that nobody waits for any more came after its time-out.
                if let Some(waiting) = self.pending.remove(&seq) {
                    let _ = waiting.send(result);
                }
            }
            ToHost::Heartbeat { host_us, device_us, state, causes } => {
                self.clock_seen(host_us, device_us, now_us);
                self.safety = Some((state, causes));
                if let Some(session) = &mut self.session {
                    session.last_heard_us = now_us;
                }
            }
            ToHost::Telemetry(telemetry) => {
                self.safety = Some((telemetry.state, telemetry.causes));
                self.streams.push(&telemetry);
            }
            // Nobody asks for one yet.
            ToHost::Cycle(_) => {}
        }
    }

    /// Ends everything that waits, with the first reason there was.
    fn end(&mut self, error: Error) -> Error {
        let error = self.end.get_or_insert(error).clone();
        // Dropping the senders wakes the requests, which then look at `end`.
        self.pending.clear();
        self.streams.end(&error);
        error
    }
}

/// Opens a session with the board at the other end of `rx` and `tx`, runs `work`, and closes the session.
///
/// The heartbeat is kept while `work` runs; when `work` returns or its future is dropped, so does the heartbeat, and the
/// board makes its outputs safe.
///
/// # Errors
/// When no session can be opened. What becomes of the link later is told by the operations in `work`.
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
        // The session ends by itself now: whatever it waits for has failed.
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
            Err(error) => return Error::LinkFailed { reason: format!("{:?}", error) },
        };
        let now_us = clock.now_us();
        let mut state = lock(state);
        for byte in &buffer[..len] {
            match decoder.push(*byte) {
                Some(Ok(message)) => state.receive(message, now_us),
                Some(Err(_)) => state.bad_frames += 1,
                None => {}
            }
        }
    }
}

/// Ends when the board has been silent for too long. Its own future: a stuck transmitter must not stop it.
async fn listen<C: Clock>(state: &Mutex<State>, clock: &C) -> Error {
    /// How often a session is looked for before there is one, µs.
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
    let failed = |error: W::Error| Error::LinkFailed { reason: format!("{error:?}") };
    // Ends whatever half a frame the board may still hold from a host before us.
    if let Err(error) = tx.write_all(&[0]).await {
        return failed(error);
    }
    let mut buffer = [0; MAX_FRAME];
    let mut next_heartbeat_us = 0;
    loop {
        let session = lock(state).session;
        let message = match session {
            // Before all else, so that no amount of requests can starve it.
            Some(session) if clock.now_us() >= next_heartbeat_us => {
                let host_us = clock.now_us();
                next_heartbeat_us = host_us + session.timeout_us / HEARTBEATS_PER_TIMEOUT;
                Some(ToDevice::Heartbeat { session: session.id, host_us })
            }
            Some(_) => match select(messages.next(), pin!(clock.sleep_until(next_heartbeat_us))).await {
                Either::Left((message, _)) => message,
                Either::Right(((), _)) => continue,
            },
            None => messages.next().await,
        };
        let Some(message) = message else {
            // The board's handle is gone, and with it all who could ask for something.
            return std::future::pending().await;
        };
        let Ok(frame) = encode_frame(&message, &mut buffer) else { continue };
        if let Err(error) = tx.write_all(frame).await {
            return failed(error);
        }
        if let Err(error) = tx.flush().await {
            return failed(error);
        }
    }
}
