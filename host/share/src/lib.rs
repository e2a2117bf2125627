//! One board for several programs: clients on a [`Listener`], and browsers on the board's page, all through one broker.
//!
//! ```text
//! programs ── Listener ── clients ──┐
//!                                   Broker ── session ── board
//! browsers ── Listener ── Page ─────┘
//! ```
//!
//! The code of `r4-broker` and `r4-page` is generic over clocks and links; here it is compiled once, for those of a
//! program. The program's tests of `r4 serve` are its tests.

use std::{
    convert::Infallible,
    future::poll_fn,
    io,
    pin::{Pin, pin},
    rc::Rc,
    task::Poll,
};

use futures::{
    Stream as _,
    future::{Either, FutureExt as _, LocalBoxFuture, select},
    stream::FuturesUnordered,
};
use r4_broker::{Broker, Guarded, Left};
use r4_links::{Accepted, Listener};
use r4_page::{FAREWELL_S, Facts, Guard, Kind, Left as BrowserLeft, MOST_BROWSERS, Page};
use r4_rig::{Footprint, Session, Target};

/// Most clients at once.
pub const CLIENTS: usize = 64;
/// Most connections of browsers at once: each browser has one for its socket, and a few for a moment.
const CONNECTIONS: usize = 4 * MOST_BROWSERS;
/// Period of the samples in live views, ms: 20 a second are smooth to the eye, and little on any link.
const LIVE_MS: u16 = 50;

/// Who may have a board, and where.
pub struct Sharing<'s> {
    /// Socket at which programs connect, with its key where it has one.
    pub clients: &'s mut Listener,
    /// Socket at which browsers connect, and which of them may see and use the page; `None` without a page.
    pub page: Option<(&'s mut Listener, &'s Guard)>,
    /// Policy by which each request is authorised; `None` where every client may do everything.
    pub policy: Option<Rc<Guarded>>,
    /// True to subscribe to all channels for a live view of the session, every 50 ms.
    pub is_live: bool,
    /// Called for each event.
    pub tell: &'s dyn Fn(Event),
}

/// Change among those who have the board.
#[derive(Debug)]
pub enum Event {
    /// A client was turned away: [`CLIENTS`] are connected.
    Full,
    /// A client was turned away: it does not have the key.
    Stranger,
    /// A client has left, or was dropped.
    Client(Left),
    /// A browser has left, or was turned away.
    Browser(BrowserLeft),
}

/// Error that ends the sharing of a board.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The listener's socket failed.
    #[error("cannot accept clients")]
    Accept(#[source] io::Error),
    /// The link to the board ended.
    #[error("the link to the board ended")]
    Board(#[from] r4_driver::Error),
}

/// Serves clients and browsers until the board's link ends.
///
/// # Errors
/// [`Error`]; it never ends otherwise.
pub fn share<'a>(session: &'a Session<'_>, sharing: Sharing<'a>) -> LocalBoxFuture<'a, Result<Infallible, Error>> {
    // Boxed here: an `async fn` would be compiled again in each crate that awaits it, as that crate is optimised.
    serve(session, sharing).boxed_local()
}

async fn serve(session: &Session<'_>, sharing: Sharing<'_>) -> Result<Infallible, Error> {
    let Sharing { clients: listener, page, policy, is_live, tell } = sharing;
    let broker = &match policy {
        Some(policy) => Broker::guarded(session.board, policy),
        None => Broker::new(session.board),
    };
    if is_live {
        for channel in session.board.channels() {
            broker.watch(channel.id, LIVE_MS).await?;
        }
    }
    let facts = facts(session);
    let (mut door, page) = page.map_or((None, None), |(listener, guard)| {
        (Some(listener), Some(Page::new(broker, session.clock.clone(), &facts, guard)))
    });
    let mut browsers = FuturesUnordered::new();
    let mut clients = FuturesUnordered::new();
    let serving = poll_fn(|context| {
        while let Poll::Ready(accepted) = listener.poll_accept(context) {
            match accepted {
                Ok(Accepted::Client(_)) if clients.len() >= CLIENTS => tell(Event::Full),
                Ok(Accepted::Client(link)) => clients.push(broker.client(link.rx, link.tx)),
                Ok(Accepted::Stranger) => tell(Event::Stranger),
                Err(error) => return Poll::Ready(error),
            }
        }
        while let Poll::Ready(Some(left)) = Pin::new(&mut clients).poll_next(context) {
            tell(Event::Client(left));
        }
        if let (Some(door), Some(page)) = (&mut door, &page) {
            while let Poll::Ready(accepted) = door.poll_accept(context) {
                match accepted {
                    // One more than there is room for finds no answer, and tries again.
                    Ok(Accepted::Client(link)) if browsers.len() < CONNECTIONS => {
                        browsers.push(page.serve(link.rx, link.tx));
                    }
                    Ok(_) => {}
                    Err(error) => return Poll::Ready(error),
                }
            }
            while let Poll::Ready(Some(left)) = Pin::new(&mut browsers).poll_next(context) {
                tell(Event::Browser(left));
            }
        }
        Poll::Pending
    });
    let mut serving = pin!(serving);
    match select(serving.as_mut(), pin!(broker.run())).await {
        Either::Left((error, _)) => Err(Error::Accept(error)),
        Either::Right((error, _)) => {
            if let Some(page) = &page {
                page.lose(error.to_string());
                select(serving, pin!(session.board.sleep_s(FAREWELL_S))).await;
            }
            Err(error.into())
        }
    }
}

/// What the page shows of a session's board that the board itself does not report.
fn facts(session: &Session<'_>) -> Facts {
    let target = session.target();
    let kind = match target {
        Target::Sim(_) => Kind::Simulated,
        Target::Emu(_) => Kind::Emulated,
        Target::Link(_) => Kind::Real,
    };
    Facts { address: target.to_string(), kind, footprint: session.robot().as_ref().and_then(Footprint::of) }
}
