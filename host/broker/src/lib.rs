//! Shares one board between several programs: one commands it, all can watch.
//!
//! A [`Broker`] holds the only session with the board. Its clients speak a board's protocol with it, so that every
//! program that can talk to a board can be a client:
//!
//! - Each client has its own session, subscriptions and position in the firmware's log. The board is subscribed to a
//!   channel with the greatest common divisor of the clients' periods, and each client gets samples at its own
//!   period.
//! - The first client that sends a command (arming, set points, parameters, external buses) commands the board until
//!   it closes its session, leaves or falls silent. Commands of others are refused with
//!   [`InUse`](r4_protocol::Refusal::InUse) and change nothing. A stop is accepted from any client.
//! - While the board may be armed, it gets a heartbeat only when the client that commands has sent one. If that
//!   client, its machine or its network fails, the board trips within its link time-out, as if the client were
//!   connected to it directly. Clients that only watch cannot delay that.
//! - A client that commands and closes its session leaves the board disarmed.
//!
//! With a guard ([`Broker::guarded`]) each request of a client is authorised anew by `r4-access`, and a denied one gets
//! [`Denied`](r4_protocol::Refusal::Denied). Stops and disarming never are. A denied set point stops its channel.
//!
//! The broker does not depend on the kind of the links, nor on whether time is real or simulated.

mod client;
mod command;
mod guard;
mod log;
mod outbox;
mod subscriptions;

use std::{
    cell::RefCell,
    collections::BTreeMap,
    future::poll_fn,
    pin::pin,
    rc::Rc,
    task::{Poll, Waker},
};

use client::ClientState;
use command::Command;
use futures::future::{Either, join4, select};
use r4_driver::{Board, Clock, Error, HeartbeatAnswer};
use r4_protocol::{ChannelId, CycleState, LogChunk, Request, Telemetry, ToHost};
use subscriptions::Periods;

pub use client::Left;
pub use guard::Guarded;

/// Number of checks of the commanding client per link time-out of the board.
const LOOKS_PER_TIMEOUT: f64 = 4.0;

/// A shared board. [`Broker::run`] and the clients' futures run side by side on one executor.
pub struct Broker<'b, C> {
    board: &'b Board<C>,
    shared: RefCell<Shared>,
    /// `None` where every client may do everything.
    guard: Option<Rc<Guarded>>,
}

/// State that all clients share.
#[derive(Default)]
struct Shared {
    /// Connected clients by their number.
    clients: BTreeMap<u64, ClientState>,
    next_client: u64,
    next_session: u16,
    command: Command,
    /// Period at which the board is subscribed to each channel, ms.
    periods: Periods,
    /// Periods requested by [`Broker::watch`], ms.
    watched: Periods,
    /// Waker of [`Broker::supervise`], to run its next check early.
    waker: Option<Waker>,
}

impl<'b, C: Clock> Broker<'b, C> {
    /// Creates a broker for `board`. No other code may use the session of `board` to command it.
    #[must_use]
    pub fn new(board: &'b Board<C>) -> Self {
        Self { board, shared: RefCell::default(), guard: None }
    }

    /// Creates a broker for `board` that asks a guard about each request of its clients. The guard outlives the
    /// broker where the board's link is lost and comes back.
    #[must_use]
    pub fn guarded(board: &'b Board<C>, guard: Rc<Guarded>) -> Self {
        Self { guard: Some(guard), ..Self::new(board) }
    }

    /// True if a client may have what goes on between its requests: samples, the firmware's log, motion.
    fn is_welcome(&self, client: u64) -> bool {
        self.guard.as_ref().is_none_or(|guard| guard.is_authenticated(client))
    }

    /// Subscribes to a channel beside the clients, for a caller that reads the board's own session, such as a
    /// recording. Samples come at least every `period_ms`, more often if a client wants them so.
    ///
    /// # Errors
    /// Errors of [`Board::subscribe`]: the board has no room for it, or its link has ended.
    pub async fn watch(&self, channel: ChannelId, period_ms: u16) -> Result<(), Error> {
        self.shared.borrow_mut().watched.insert(channel, period_ms);
        match self.common_period(channel) {
            Some(period_ms) => self.board.subscribe(channel, period_ms).await,
            None => Ok(()),
        }
    }

    /// Returns true while a client commands the board, and until the board is disarmed after it.
    #[must_use]
    pub fn is_commanded(&self) -> bool {
        self.shared.borrow().command.is_taken()
    }

    /// Returns the number of damaged frames from the board that were dropped since its session was opened.
    #[must_use]
    pub fn bad_frames(&self) -> u64 {
        self.board.bad_frames()
    }

    /// Passes on what the board sends, and supervises the client that commands. Returns the error that ended the
    /// board's link.
    pub async fn run(&self) -> Error {
        let (mut telemetry, mut cycles) = (self.board.telemetry(), self.board.cycle_answers());
        let (mut log, mut heartbeats) = (self.board.log_chunks(), self.board.heartbeat_answers());
        let passing_on = join4(
            async {
                while let Ok(frame) = telemetry.next().await {
                    self.telemetry(&frame)
                }
            },
            async {
                while let Ok(answer) = cycles.next().await {
                    self.cycle(answer)
                }
            },
            async {
                while let Ok(chunk) = log.next().await {
                    self.log(&chunk)
                }
            },
            async {
                loop {
                    match heartbeats.next().await {
                        Ok(answer) => self.heartbeat(&answer),
                        Err(error) => return error,
                    }
                }
            },
        );
        match select(pin!(passing_on), pin!(self.supervise())).await {
            Either::Left(((.., error), _)) | Either::Right((error, _)) => error,
        }
    }

    fn telemetry(&self, frame: &Telemetry) {
        let Shared { clients, periods, .. } = &mut *self.shared.borrow_mut();
        for (number, client) in clients {
            if let Some(frame) = client.subscriptions.due(frame, periods)
                && self.is_welcome(*number)
            {
                client.outbox.push_if_room(&ToHost::Telemetry(frame));
            }
        }
    }

    fn log(&self, chunk: &LogChunk) {
        for (number, client) in &mut self.shared.borrow_mut().clients {
            if let Some(chunk) = client.log.as_mut().and_then(|reader| reader.unread(chunk))
                && self.is_welcome(*number)
            {
                client.outbox.push_if_room(&ToHost::Log(chunk));
            }
        }
    }

    fn cycle(&self, answer: CycleState) {
        let shared = &mut *self.shared.borrow_mut();
        if let Some(client) = shared.command.holder().and_then(|number| shared.clients.get_mut(&number)) {
            client.outbox.push(&ToHost::Cycle(answer));
        }
    }

    /// Answers the heartbeat of the commanding client, if it was for that one that the board got this heartbeat.
    fn heartbeat(&self, answer: &HeartbeatAnswer) {
        let shared = &mut *self.shared.borrow_mut();
        shared.command.heard(answer.host_us);
        let Some(client) = shared.command.holder().and_then(|number| shared.clients.get_mut(&number)) else { return };
        let Some((relayed_us, host_us)) = client.relayed else { return };
        if relayed_us == answer.host_us {
            client.relayed = None;
            let HeartbeatAnswer { device_us, state, causes, ref hot, .. } = *answer;
            let hot = hot.iter().copied().collect();
            client.outbox.push(&ToHost::Heartbeat { host_us, device_us, state, causes, hot });
        }
    }

    /// Supervises the commanding client: keeps the board's heartbeat while nothing can move, and disarms the board
    /// when the client is gone.
    async fn supervise(&self) -> Error {
        let timeout_us = u64::from(self.board.info().link_timeout_ms) * 1000;
        loop {
            let now_us = self.board.host_now_us();
            let (state, _) = self.board.safety();
            let look = {
                let shared = &mut *self.shared.borrow_mut();
                let heard_us = shared
                    .command
                    .holder()
                    .and_then(|number| shared.clients.get(&number))
                    .map(|client| client.heard_us);
                shared.command.look(now_us, timeout_us, state, heard_us)
            };
            self.board.keep_heartbeat(look.keeps_heartbeat);
            if look.disarms {
                match self.ended().await {
                    Ok(()) => {
                        self.shared.borrow_mut().command.ended();
                        continue;
                    }
                    // The loop continues without heartbeats, so the board trips, and disarms again at the next check.
                    Err(Error::TimedOut { .. } | Error::Refused(_)) => {}
                    Err(error) => return error,
                }
            }
            // A change wakes the loop earlier, so that a client waits for no check.
            let next_look = self.board.sleep_s(timeout_us as f64 * 1e-6 / LOOKS_PER_TIMEOUT);
            select(pin!(self.woken()), pin!(next_look)).await;
        }
    }

    /// Disarms the board and removes the binding that the former commanding client may have left.
    async fn ended(&self) -> Result<(), Error> {
        self.board.disarm().await?;
        let nothing = Request::Bind { channels: heapless::Vec::new(), ttl_ms: 0 };
        match self.board.pass_on(nothing).await {
            // A board that refuses an empty binding has none to remove.
            Ok(_) | Err(Error::Refused(_)) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Waits until something changes that [`Broker::supervise`] checks.
    async fn woken(&self) {
        let mut first = true;
        poll_fn(|context| {
            self.shared.borrow_mut().waker = Some(context.waker().clone());
            if std::mem::take(&mut first) { Poll::Pending } else { Poll::Ready(()) }
        })
        .await;
    }

    fn wake(&self) {
        let waker = self.shared.borrow_mut().waker.take();
        if let Some(waker) = waker {
            waker.wake();
        }
    }
}
