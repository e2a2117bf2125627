//! The page of a board in a browser: state, causes, channels, plots, arm and stop.
//!
//! A [`Page`] serves browsers over any byte link. Each browser is a client of the board's [`Broker`], as every other program is:
//!
//! ```text
//! browser ── HTTP, WebSocket (JSON) ── Page ── two clients of the broker: one watches, one commands while armed by this page ── Broker
//! ```
//!
//! - Heartbeats for the board are sent only for those that the page has sent, and only while the page has seen something that is not older
//!   than [`STALE_MS`]. A tab that is closed, hidden, asleep or cut off therefore trips the board within its link time-out, as any
//!   commanding program does.
//! - A stop is taken from every page, by its socket or, where that is gone, by a request of its own. It needs no heartbeats.
//! - Nothing arms by itself. A page commands from its `arm` to the disarming, or to the trip, and leaves the board to others then.
//! - [`Guard`] decides which requests may do that.
//!
//! What is shown in words is the program's own: [`r4_rig::next_step`], causes and refusals as the protocol describes them.
//!
//! | module | subject |
//! | --- | --- |
//! | [`http`] | heads of requests, answers |
//! | [`guard`] | who may see the page and use it |
//! | [`socket`] | the WebSocket without its link |
//! | `message` | what page and program say to each other |
//! | `view` | channels and samples as a person reads them |
//! | `floor` | the robot on the floor: outline, odometry, ranges |
//! | `browser` | one browser that has the page open |
//! | `seat` | the client that commands for a browser |
//!
//! Nothing here knows what the links are or whether time is real. `web/` has the page itself: plain HTML, CSS and JavaScript.

mod browser;
mod floor;
pub mod guard;
pub mod http;
mod message;
mod seat;
pub mod socket;
mod view;

use std::{
    cell::{Cell, OnceCell},
    pin::pin,
};

use embassy_sync::{blocking_mutex::raw::NoopRawMutex, pipe::Pipe};
use embedded_io_async::{Read, Write};
use futures::future::{Either, select};
use r4_broker::{Broker, Left as LeftBroker};
use r4_driver::{Board, Clock, Error, with_board};
use r4_rig::Footprint;

pub use browser::{BEATS_PER_TIMEOUT, LOOK_MS, STALE_MS};
pub use guard::{Denied, Guard, Token};
use http::{Head, HttpError, MOST_HEAD, Status, answer, switching};
use socket::SocketError;

/// Most browsers that have the page open at once.
pub const MOST_BROWSERS: usize = 16;
/// A connection has sent the head of its request, and a page its token, within this time, s.
const HEAD_S: f64 = 5.0;
/// Time limit for sending a message, s: a browser that does not read is dropped.
const ANSWER_S: f64 = 10.0;
/// Time for a browser to receive the reason why the board's link ended, s: two state messages.
pub const FAREWELL_S: f64 = 0.1;
/// Bytes under way between the broker and a client in this program. A message has some hundred at most.
const PIPE: usize = 4096;

/// The page, in parts that are put together when it is sent.
const HTML: &str = include_str!("../web/page.html");
const STYLE: &str = include_str!("../web/style.css");
const SCRIPTS: [&str; 3] =
    [include_str!("../web/plot.js"), include_str!("../web/floor.js"), include_str!("../web/page.js")];

/// Kind of board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Board simulated by this program.
    Simulated,
    /// One with an emulated processor.
    Emulated,
    /// Real board on a link.
    Real,
}

/// Facts about the board that the page shows and the board does not report.
#[derive(Clone, Debug)]
pub struct Facts {
    /// Its name, as `--board` takes it.
    pub address: String,
    /// Kind of the board.
    pub kind: Kind,
    /// Footprint of the robot; `None` if it is unknown, and the page then shows no floor.
    pub footprint: Option<Footprint>,
}

/// End of a connection.
#[derive(Debug)]
pub enum Left {
    /// A request was answered.
    Answered,
    /// The browser closed it, or its link failed.
    Gone,
    /// A page sent no heartbeats, or a connection no request.
    Silent,
    /// It did not read what it was sent.
    Slow,
    /// [`MOST_BROWSERS`] have the page open.
    Full,
    /// It may not see or use the page.
    Denied(Denied),
    /// Its request is none.
    Malformed(HttpError),
    /// Messages on its socket that are not the page's.
    Broken(SocketError),
    /// It sends something that the page does not say.
    Unknown,
}

/// The page of a board that is shared. Give [`Broker::run`] and the connections' futures to one executor, side by side.
pub struct Page<'p, 'b, C> {
    broker: &'p Broker<'b, C>,
    clock: C,
    facts: &'p Facts,
    guard: &'p Guard,
    open: Cell<usize>,
    /// Why the board's link has ended.
    lost: OnceCell<String>,
}

/// Returns the result of the first of two futures that ends.
async fn first<T>(one: impl Future<Output = T>, other: impl Future<Output = T>) -> T {
    select(pin!(one), pin!(other)).await.factor_first().0
}

impl<'p, 'b, C: Clock> Page<'p, 'b, C> {
    /// The page of `broker`'s board.
    #[must_use]
    pub fn new(broker: &'p Broker<'b, C>, clock: C, facts: &'p Facts, guard: &'p Guard) -> Self {
        Self { broker, clock, facts, guard, open: Cell::new(0), lost: OnceCell::new() }
    }

    /// Sends all browsers the reason why the board's link ended, with their next state message: serve them for [`FAREWELL_S`] longer.
    pub fn lose(&self, why: String) {
        // The first reason is the one.
        let _ = self.lost.set(why);
    }

    /// Serves a connection until it ends. Dropping the future is a browser that is gone.
    pub async fn serve<R: Read, W: Write>(&self, mut rx: R, mut tx: W) -> Left {
        let (head, rest) = match self.within(HEAD_S, head(&mut rx)).await {
            Ok(read) => read,
            Err(Left::Malformed(why)) => {
                self.say(&mut tx, Status::BadRequest, &why.to_string()).await;
                return Left::Malformed(why);
            }
            Err(left) => return left,
        };
        match (head.method.as_str(), head.path.as_str()) {
            ("GET", "/") => match self.guard.reads(&head) {
                Ok(()) => self.write(&mut tx, &answer(Status::Ok, "text/html", &self.html())).await,
                Err(denied) => self.deny(&mut tx, denied).await,
            },
            ("GET", "/socket") => match (self.guard.is_page(&head), head.websocket_accept()) {
                (Err(denied), _) => self.deny(&mut tx, denied).await,
                (Ok(()), None) => {
                    let why = "this address is for the page's own socket: open / in a browser";
                    self.say(&mut tx, Status::BadRequest, why).await
                }
                (Ok(()), Some(_)) if self.open.get() >= MOST_BROWSERS => {
                    let why = format!("{MOST_BROWSERS} browsers have the page open: close one of them");
                    self.say(&mut tx, Status::Unavailable, &why).await;
                    Left::Full
                }
                (Ok(()), Some(accept)) => {
                    let _open = Open::new(&self.open);
                    match self.write(&mut tx, &switching(&accept)).await {
                        Left::Answered => Box::pin(browser::serve(self, rx, tx, &rest)).await,
                        left => left,
                    }
                }
            },
            ("POST", "/stop") => {
                let token = head.field(guard::TOKEN_FIELD).unwrap_or_default();
                match self.guard.is_page(&head).and_then(|()| self.guard.has_token(token)) {
                    Ok(()) => Box::pin(self.stop(&mut tx)).await,
                    Err(denied) => self.deny(&mut tx, denied).await,
                }
            }
            ("GET", _) => self.say(&mut tx, Status::NotFound, "there is one page here: /").await,
            _ => self.say(&mut tx, Status::MethodNotAllowed, "there is one page here: GET /").await,
        }
    }

    /// Stops the board for a page whose socket is gone.
    async fn stop(&self, tx: &mut impl Write) -> Left {
        match self.client(async |board| board.stop().await).await.and_then(|stopped| stopped) {
            Ok(()) => self.say(tx, Status::Ok, "stopped").await,
            Err(why) => self.say(tx, Status::Unavailable, &why.to_string()).await,
        }
    }

    fn html(&self) -> String {
        HTML.replace("<!--style-->", STYLE)
            .replace("<!--token-->", &self.guard.in_page())
            .replace("<!--script-->", &SCRIPTS.concat())
    }

    async fn deny(&self, tx: &mut impl Write, denied: Denied) -> Left {
        self.say(tx, Status::Forbidden, &denied.to_string()).await;
        Left::Denied(denied)
    }

    async fn say(&self, tx: &mut impl Write, status: Status, text: &str) -> Left {
        self.write(tx, &answer(status, "text/plain", &format!("{text}\n"))).await
    }

    async fn write(&self, tx: &mut impl Write, text: &str) -> Left {
        self.write_bytes(tx, text.as_bytes()).await.map_or_else(|left| left, |()| Left::Answered)
    }

    /// Sends bytes; [`Left::Slow`] after [`ANSWER_S`].
    async fn write_bytes(&self, tx: &mut impl Write, bytes: &[u8]) -> Result<(), Left> {
        let written = async {
            match tx.write_all(bytes).await {
                Ok(()) if tx.flush().await.is_ok() => Ok(()),
                _ => Err(Left::Gone),
            }
        };
        self.within(ANSWER_S, written)
            .await
            .map_err(|left| if matches!(left, Left::Silent) { Left::Slow } else { left })
    }

    /// `work`, or [`Left::Silent`] after `seconds`.
    async fn within<T>(&self, seconds: f64, work: impl Future<Output = Result<T, Left>>) -> Result<T, Left> {
        let until_us = self.clock.now_us() + (seconds * 1e6) as u64;
        match select(pin!(work), pin!(self.clock.sleep_until(until_us))).await {
            Either::Left((result, _)) => result,
            Either::Right(((), _)) => Err(Left::Silent),
        }
    }

    /// Runs `work` as a client of the broker.
    ///
    /// # Errors
    /// When the client's session does not open, or the broker ends it.
    async fn client<T>(&self, work: impl AsyncFnOnce(&Board<C>) -> T) -> Result<T, Error> {
        let (up, down) = (Pipe::<NoopRawMutex, PIPE>::new(), Pipe::<NoopRawMutex, PIPE>::new());
        // In boxes: nested in one another, each future would be in those around it twice, and too large for a stack in the end.
        let session = Box::pin(with_board(&down, &up, self.clock.clone(), work));
        match select(session, Box::pin(self.broker.client(&up, &down))).await {
            Either::Left((result, _)) => result,
            Either::Right((left, _)) => Err(Error::LinkFailed {
                reason: match left {
                    LeftBroker::Gone => "the board is gone",
                    LeftBroker::Silent => "no heartbeats of the page",
                    LeftBroker::Slow => "the page does not read",
                }
                .into(),
            }),
        }
    }
}

/// Reads the head of a request, and what has come behind it.
async fn head(rx: &mut impl Read) -> Result<(Head, Vec<u8>), Left> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 1024];
    loop {
        let len = match rx.read(&mut buffer).await {
            Ok(len @ 1..) => len,
            Ok(_) | Err(_) => return Err(Left::Gone),
        };
        bytes.extend_from_slice(&buffer[..len]);
        debug_assert!(bytes.len() < MOST_HEAD + buffer.len());
        if let Some((head, len)) = Head::parse(&bytes).map_err(Left::Malformed)? {
            return Ok((head, bytes.split_off(len)));
        }
    }
}

/// Counts a browser while it is there.
struct Open<'c>(&'c Cell<usize>);

impl<'c> Open<'c> {
    fn new(count: &'c Cell<usize>) -> Self {
        count.set(count.get() + 1);
        Self(count)
    }
}

impl Drop for Open<'_> {
    fn drop(&mut self) {
        self.0.set(self.0.get() - 1);
    }
}
