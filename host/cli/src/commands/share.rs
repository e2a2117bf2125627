//! `r4 serve`: one board for several programs.

mod page;

use std::{
    convert::Infallible,
    future::{pending, poll_fn},
    mem,
    net::SocketAddr,
    path::Path,
    pin::{Pin, pin},
    rc::Rc,
    task::Poll,
};

use anyhow::Context;
use futures::{
    Stream as _,
    future::{Either, select},
    stream::FuturesUnordered,
};
use page::{CONNECTIONS, Door};
use r4_access::{Guard, Policy, log::Files, unix_ms};
use r4_broker::{Broker, Guarded, Left};
use r4_links::{Accepted, Listener};
use r4_page::{FAREWELL_S, Page};
use r4_sim::Pace;
use serde::Serialize;

use super::access;
use super::serve::{
    Background, bind,
    clients::{DROPPED, TURNED_AWAY},
};
use crate::{
    args::{Args, Share},
    output,
    session::{self, HostClock, Session, Target},
};

/// Most clients at once.
const CLIENTS: usize = 64;

/// Period of the samples in live views, ms: 20 a second are smooth to the eye, and little on any link.
const LIVE_MS: u16 = 50;

/// First line on stdout: where clients connect.
#[derive(Serialize)]
struct FirstLine {
    tcp: String,
    /// Address of the page, where there is one; without what has to be behind it where a key is asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    http: Option<String>,
}

pub(crate) fn run(args: &Args, share: &Share) -> anyhow::Result<bool> {
    let board = share.board.clone().unwrap_or_else(|| args.board.clone());
    let args = Args { board, live: share.live.foxglove, ..args.clone() };
    session::catch_interrupts();
    let guard = share.policy.as_deref().map(guard).transpose()?;
    // Before the board, which takes longer: a port that is taken is reported at once.
    let (socket, at) = bind(&args, share.tcp, share.public)?;
    // Once: it may come through a pipe.
    let key = session::key(&args)?;
    let door = share.http.map(|address| Door::open(&args, address, share.public, key.as_ref())).transpose()?;
    let listening = (Listener::new(socket, key), at);
    let virtual_board = match args.board {
        Target::Link(_) => None,
        Target::Sim(_) | Target::Emu(_) => Some(Background::start(&args)?),
    };
    let served = serve(&args, virtual_board.as_ref(), listening, door, guard.as_ref());
    let ended = virtual_board.map_or(Ok(()), Background::end);
    // A failure of a virtual board goes first: it is why the link to it ended.
    ended.and(served).map(|never| match never {})
}

fn serve(
    args: &Args,
    virtual_board: Option<&Background>,
    (mut listener, at): (Listener, SocketAddr),
    mut door: Option<Door>,
    guard: Option<&Rc<Guarded>>,
) -> anyhow::Result<Infallible> {
    let mut is_told = false;
    let work = async |session: &Session<'_>| {
        if !mem::replace(&mut is_told, true) {
            output::json(&FirstLine { tcp: at.to_string(), http: door.as_ref().map(Door::address) })?;
            let key = args.key.as_ref().map_or_else(String::new, |path| format!(" --key {}", path.display()));
            let token = if guard.is_some() { " --token FILE" } else { "" };
            eprintln!("r4: {} is served at tcp:{at}; for example: r4 monitor --board tcp:{at}{key}{token}", args.board);
            if let Some(door) = &door {
                eprintln!("r4: open {} in a browser", door.to_be_opened());
            }
        }
        let broker = match guard {
            Some(guard) => Broker::guarded(session.board, guard.clone()),
            None => Broker::new(session.board),
        };
        serve_clients(session, &broker, &mut listener, door.as_mut(), args.live.is_some()).await
    };
    let tell = |event| eprintln!("r4: {}", session::told(&event));
    let meanwhile = async |_: &HostClock| pending().await;
    match virtual_board {
        None => session::keep(args, Pace::RealTime(1.0), work, tell, meanwhile),
        Some(Background { address, key, look, .. }) => {
            session::keep_served(args, (address, key, look), work, tell, meanwhile)
        }
    }
}

/// Makes the guard of a policy, with its log beside it.
fn guard(path: &Path) -> anyhow::Result<Rc<Guarded>> {
    let policy = Policy::read(path).with_context(|| path.display().to_string())?;
    let log = access::log_of(path);
    let opened = Files::open(&log)?;
    if opened.verified.unsigned > 0 {
        eprintln!("r4: {} entries follow the signed head of {}", opened.verified.unsigned, log.display());
    }
    eprintln!("r4: requests are authorised by the policy {}; log: {}", policy.name(), log.display());
    let guard = Guard::new(policy, Box::new(opened.files), opened.key, &opened.verified, unix_ms());
    Ok(Rc::new(Guarded::new(guard, unix_ms)))
}

/// Serves clients until the board's link ends.
async fn serve_clients(
    session: &Session<'_>,
    broker: &Broker<'_, HostClock>,
    listener: &mut Listener,
    door: Option<&mut Door>,
    is_live: bool,
) -> anyhow::Result<Infallible> {
    if is_live {
        for channel in session.board.channels() {
            broker.watch(channel.id, LIVE_MS).await?;
        }
    }
    let facts = page::facts(session);
    let (mut door, page) = door.map_or((None, None), |Door { listener, guard, .. }| {
        (Some(listener), Some(Page::new(broker, session.clock.clone(), &facts, guard)))
    });
    let mut browsers = FuturesUnordered::new();
    let mut clients = FuturesUnordered::new();
    let serving = poll_fn(|context| {
        while let Poll::Ready(accepted) = listener.poll_accept(context) {
            match accepted {
                Ok(Accepted::Client(_)) if clients.len() >= CLIENTS => {
                    eprintln!("r4: a client was turned away: {CLIENTS} are connected");
                }
                Ok(Accepted::Client(link)) => clients.push(broker.client(link.rx, link.tx)),
                Ok(Accepted::Stranger) => eprintln!("{TURNED_AWAY}"),
                Err(error) => return Poll::Ready(error),
            }
        }
        while let Poll::Ready(Some(left)) = Pin::new(&mut clients).poll_next(context) {
            match left {
                Left::Gone => {}
                Left::Silent => eprintln!("{DROPPED}"),
                Left::Slow => eprintln!("r4: a client that does not read was dropped"),
            }
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
                if let Some(told) = page::told(&left) {
                    eprintln!("{told}");
                }
            }
        }
        Poll::Pending
    });
    let mut serving = pin!(serving);
    match select(serving.as_mut(), pin!(broker.run())).await {
        Either::Left((error, _)) => Err(anyhow::Error::from(error).context("cannot accept clients")),
        Either::Right((error, _)) => {
            if let Some(page) = &page {
                page.lose(error.to_string());
                select(serving, pin!(session.board.sleep_s(FAREWELL_S))).await;
            }
            Err(error.into())
        }
    }
}
