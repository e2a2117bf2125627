//! One browser that has the page open.

use std::{
    cell::{Cell, RefCell},
    collections::BTreeMap,
    future::poll_fn,
    task::{Poll, Waker},
};

use embedded_io_async::{Read, Write};
use futures::{
    StreamExt,
    channel::mpsc::{UnboundedReceiver, UnboundedSender, unbounded},
};
use r4_driver::{Board, Clock, Error};
use r4_protocol::{ChannelId, Sample};
use r4_rig::{Odometry, heat, next_step};

use crate::{
    HEAD_S, Left, MOST_BROWSERS, Page, first, floor,
    message::{Ask, Card, Counter, FromPage, Look, Reason, ToPage},
    seat::ToSeat,
    socket::Socket,
    view::{Channel, Values},
};

/// Period of the page's state messages and of its channels' samples, ms: 20 a second are smooth to the eye.
pub const LOOK_MS: u16 = 50;
/// Heartbeats of a page within the board's link time-out, as many as a driver sends.
pub const BEATS_PER_TIMEOUT: u32 = 4;
/// A beat counts while the newest look that the page has is not older than this, ms: five link time-outs of 200 ms, in which a user sees
/// that something is wrong. With half of it a page on a busy phone would lose beats.
pub const STALE_MS: u64 = 1000;
/// A page without beats is let go after this time, µs: browsers let hidden pages run each second, at first.
const SILENT_US: u64 = 10_000_000;
/// Period of requests for the counters, s.
const COUNT_EVERY_S: f64 = 1.0;
/// Bytes that may wait for a page, before it is sent no further looks: half a second of them.
const MOST_WAITING: usize = 64 * 1024;

/// A browser that is served.
pub(crate) struct Browser<'p, 'b, C> {
    pub(crate) page: &'p Page<'p, 'b, C>,
    socket: RefCell<Socket>,
    /// Waker of the sending task.
    sender: RefCell<Option<Waker>>,
    /// Time of the page's last message, on this program's clock, µs.
    heard_us: Cell<u64>,
    /// True while this page commands the board.
    pub(crate) is_seated: Cell<bool>,
}

/// Destinations of the page's messages.
struct Orders {
    seat: UnboundedSender<ToSeat>,
    stops: UnboundedSender<()>,
}

/// Serves a page on its socket, on which `rest` has come already.
pub(crate) async fn serve<C: Clock>(
    page: &Page<'_, '_, C>,
    mut rx: impl Read,
    mut tx: impl Write,
    rest: &[u8],
) -> Left {
    let browser = Browser {
        page,
        socket: RefCell::new(Socket::server()),
        sender: RefCell::default(),
        heard_us: Cell::new(page.clock.now_us()),
        is_seated: Cell::new(false),
    };
    let texts = match page.within(HEAD_S, browser.welcome(&mut rx, rest)).await {
        Ok(texts) => texts,
        Err(left) => {
            if let Left::Denied(denied) = &left {
                browser.tell(&ToPage::Refused { why: denied.to_string() });
                browser.socket.borrow_mut().close();
                let bytes = browser.socket.borrow_mut().take();
                let _ = page.write_bytes(&mut tx, &bytes).await;
            }
            return left;
        }
    };
    let (seat, of_seat) = unbounded();
    let (stops, of_stops) = unbounded();
    let orders = Orders { seat, stops };
    // In boxes, as in `Page::client`.
    let link = first(Box::pin(browser.receive(rx, texts, &orders)), Box::pin(browser.send(tx)));
    let board = first(Box::pin(browser.watch(of_stops)), Box::pin(browser.seat(of_seat)));
    first(first(link, board), browser.silence()).await
}

impl<C: Clock> Browser<'_, '_, C> {
    pub(crate) fn tell(&self, message: &ToPage<'_>) {
        // Numbers and texts: always JSON.
        if let Ok(text) = serde_json::to_string(message) {
            self.socket.borrow_mut().send(text);
            self.wake_sender();
        }
    }

    pub(crate) fn answer(&self, ask: Ask, result: &Result<(), Error>) {
        self.tell(&ToPage::Answer { ask, error: result.as_ref().err().map(ToString::to_string) });
    }

    fn wake_sender(&self) {
        if let Some(sender) = self.sender.borrow_mut().take() {
            sender.wake();
        }
    }

    /// Texts in what has come. What the socket answers by itself is sent.
    fn texts(&self, bytes: &[u8]) -> Result<Vec<String>, Left> {
        let texts = self.socket.borrow_mut().receive(bytes);
        self.wake_sender();
        texts.map_err(|why| match why {
            crate::socket::SocketError::Closed => Left::Gone,
            why => Left::Broken(why),
        })
    }

    /// Waits for the page's token. Returns what has come behind it.
    async fn welcome(&self, rx: &mut impl Read, rest: &[u8]) -> Result<Vec<String>, Left> {
        let mut texts = self.texts(rest)?;
        let mut buffer = [0; 1024];
        while texts.is_empty() {
            texts = match rx.read(&mut buffer).await {
                Ok(len @ 1..) => self.texts(&buffer[..len])?,
                Ok(_) | Err(_) => return Err(Left::Gone),
            };
        }
        match serde_json::from_str(&texts.remove(0)) {
            Ok(FromPage::Hello { token }) => self.page.guard.has_token(&token).map_err(Left::Denied)?,
            Ok(_) | Err(_) => return Err(Left::Unknown),
        }
        Ok(texts)
    }

    /// Handles all that the page says, until its link ends.
    async fn receive(&self, mut rx: impl Read, mut texts: Vec<String>, orders: &Orders) -> Left {
        let mut buffer = [0; 1024];
        loop {
            for text in texts.drain(..) {
                match serde_json::from_str(&text) {
                    Ok(FromPage::Beat { tick_ms }) => self.beat(tick_ms, orders),
                    // Both live as long as this.
                    Ok(FromPage::Ask(Ask::Stop)) => drop(orders.stops.unbounded_send(())),
                    Ok(FromPage::Ask(ask)) => drop(orders.seat.unbounded_send(ToSeat::Ask(ask))),
                    Ok(FromPage::Hello { .. }) | Err(_) => return Left::Unknown,
                }
            }
            texts = match rx.read(&mut buffer).await {
                Ok(len @ 1..) => match self.texts(&buffer[..len]) {
                    Ok(texts) => texts,
                    Err(left) => return left,
                },
                Ok(_) | Err(_) => return Left::Gone,
            };
        }
    }

    /// A beat is one for the board while the page sees what the board does.
    fn beat(&self, tick_ms: u64, orders: &Orders) {
        let now_us = self.page.clock.now_us();
        self.heard_us.set(now_us);
        if (now_us / 1000).checked_sub(tick_ms).is_some_and(|age_ms| age_ms <= STALE_MS) {
            let _ = orders.seat.unbounded_send(ToSeat::Beat);
        }
    }

    async fn send(&self, mut tx: impl Write) -> Left {
        loop {
            let bytes = poll_fn(|context| {
                let bytes = self.socket.borrow_mut().take();
                if bytes.is_empty() {
                    self.sender.replace(Some(context.waker().clone()));
                    return Poll::Pending;
                }
                Poll::Ready(bytes)
            })
            .await;
            if let Err(left) = self.page.write_bytes(&mut tx, &bytes).await {
                return left;
            }
        }
    }

    async fn silence(&self) -> Left {
        loop {
            let until_us = self.heard_us.get() + SILENT_US;
            if self.page.clock.now_us() >= until_us {
                return Left::Silent;
            }
            self.page.clock.sleep_until(until_us).await;
        }
    }

    /// Shows the board as a client that only watches, and stops it where the page asks for that.
    async fn watch(&self, stops: UnboundedReceiver<()>) -> Left {
        let watched = self.page.client(async |board| {
            let channels: Vec<Channel> = board.channels().iter().map(Channel::new).collect();
            self.tell(&ToPage::Board(self.card(board, &channels)));
            let stopping = async {
                stops.for_each_concurrent(None, |()| async { self.answer(Ask::Stop, &board.stop().await) }).await;
                std::future::pending::<Error>().await
            };
            first(first(stopping, Box::pin(self.count(board))), Box::pin(self.look(board, &channels))).await
        });
        // Why, the program says itself: it has the board's link.
        let _ = watched.await;
        Left::Gone
    }

    fn card<'c>(&'c self, board: &'c Board<C>, channels: &'c [Channel]) -> Card<'c> {
        let (facts, info) = (self.page.facts, board.info());
        Card {
            address: &facts.address,
            kind: match facts.kind {
                crate::Kind::Simulated => "simulated",
                crate::Kind::Emulated => "emulated",
                crate::Kind::Real => "real",
            },
            robot: &info.robot,
            firmware: &info.firmware,
            link_timeout_ms: info.link_timeout_ms,
            beat_ms: u32::from(info.link_timeout_ms) / BEATS_PER_TIMEOUT,
            channels,
            shape: facts.footprint.as_ref().map(floor::shape),
        }
    }

    /// Sends how the board is, every [`LOOK_MS`].
    async fn look(&self, board: &Board<C>, channels: &[Channel]) -> Error {
        let mut telemetry = board.telemetry();
        for info in board.channels() {
            if let Err(error) = board.subscribe(info.id, LOOK_MS).await {
                return error;
            }
        }
        let mut odometry = self.page.facts.footprint.as_ref().map(|footprint| Odometry::new(&footprint.drive));
        let mut newest = BTreeMap::<ChannelId, Sample>::new();
        let (mut board_us, mut heard_us) = (board.device_us(), self.page.clock.now_us());
        loop {
            if let Some(why) = self.page.lost.get() {
                self.tell(&ToPage::Lost { why });
                return std::future::pending().await;
            }
            let mut fresh = BTreeMap::<ChannelId, Sample>::new();
            while let Some(frame) = telemetry.try_next() {
                (board_us, heard_us) = (frame.device_us, self.page.clock.now_us());
                fresh.extend(frame.samples.iter().map(|sample| (sample.channel(), *sample)));
            }
            let has_news = !fresh.is_empty();
            newest.extend(&fresh);
            let samples: Vec<Sample> = newest.values().copied().collect();
            let place = self.page.facts.footprint.as_ref().zip(odometry.as_mut()).filter(|_| has_news);
            let place = place.and_then(|(footprint, odometry)| floor::place(footprint, board, odometry, &samples));
            if self.socket.borrow().waiting() <= MOST_WAITING {
                let infos = board.channels().iter().zip(channels).enumerate();
                let values: Vec<Values> = infos
                    .filter_map(|(at, (info, channel))| Some(channel.values(at, info, fresh.get(&info.id)?)))
                    .collect();
                self.tell(&ToPage::Look(Look { place, ..self.now(board, board_us, heard_us, &values) }));
            }
            board.sleep_s(f64::from(LOOK_MS) * 1e-3).await;
        }
    }

    fn now<'v>(&self, board: &Board<C>, board_us: u64, heard_us: u64, values: &'v [Values]) -> Look<'v> {
        let (state, causes) = board.safety();
        let now_us = self.page.clock.now_us();
        Look {
            tick_ms: now_us / 1000,
            board_s: board_us as f64 * 1e-6,
            silent_ms: now_us.saturating_sub(heard_us) / 1000,
            state: state.to_string(),
            causes: causes.iter().map(|cause| Reason { cause: cause.to_string(), advice: cause.advice() }).collect(),
            next: next_step(state, causes),
            hot: board.hot_windings().iter().map(heat::words).collect(),
            commands: match (self.is_seated.get(), self.page.broker.is_commanded()) {
                (true, _) => Some("this page"),
                (false, true) => Some("another program"),
                (false, false) => None,
            },
            values,
            place: None,
        }
    }

    /// Asks for what has been counted, which measures the round trip to the board, too.
    async fn count(&self, board: &Board<C>) -> Error {
        loop {
            let asked_us = self.page.clock.now_us();
            match board.stats().await {
                Ok(stats) => {
                    let round_trip_ms = (self.page.clock.now_us() - asked_us) as f64 * 1e-3;
                    let counted = |name, count: u64| Counter { name, value: count.to_string(), is_bad: count > 0 };
                    let shown = |name, value: String| Counter { name, value, is_bad: false };
                    self.tell(&ToPage::Counters(vec![
                        shown("round trip to the board", format!("{round_trip_ms:.1} ms")),
                        shown("longest control tick", format!("{} us", stats.worst_tick_us)),
                        counted("late control ticks", stats.late_ticks.into()),
                        counted("I2C retries", stats.bus_retries.into()),
                        counted("bad frames at the board", stats.bad_frames.into()),
                        counted("bad frames from the board", self.page.broker.bad_frames()),
                        counted("telemetry dropped", stats.telemetry_dropped.into()),
                        shown("requests refused", stats.refused.to_string()),
                        shown("pages open", format!("{} of {MOST_BROWSERS}", self.page.open.get())),
                    ]));
                }
                // The next may be answered; a link that has ended ends the client.
                Err(Error::TimedOut { .. } | Error::Refused(_)) => {}
                Err(error) => return error,
            }
            board.sleep_s(COUNT_EVERY_S).await;
        }
    }
}
