//! `r4 serve`: one board for several programs.

use std::{
    convert::Infallible,
    future::{pending, poll_fn},
    mem,
    net::SocketAddr,
    pin::{Pin, pin},
    task::Poll,
};

use futures::{
    Stream as _,
    future::{Either, select},
    stream::FuturesUnordered,
};
use r4_broker::{Broker, Left};
use r4_links::{Accepted, Listener};
use r4_sim::Pace;
use serde::Serialize;

use super::serve::{
    Background,
    clients::{DROPPED, TURNED_AWAY},
    listen,
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
}

pub(crate) fn run(args: &Args, share: &Share) -> anyhow::Result<bool> {
    let board = share.board.clone().unwrap_or_else(|| args.board.clone());
    let args = Args { board, live: share.live.foxglove, ..args.clone() };
    session::catch_interrupts();
    // Before the board, which takes longer: a port that is taken is reported at once.
    let listening = listen(&args, share.tcp, share.public)?;
    let virtual_board = match args.board {
        Target::Link(_) => None,
        Target::Sim(_) | Target::Emu(_) => Some(Background::start(&args)?),
    };
    let served = serve(&args, virtual_board.as_ref(), listening);
    let ended = virtual_board.map_or(Ok(()), Background::end);
    // A failure of a virtual board goes first: it is why the link to it ended.
    ended.and(served).map(|never| match never {})
}

fn serve(
    args: &Args,
    virtual_board: Option<&Background>,
    (mut listener, at): (Listener, SocketAddr),
) -> anyhow::Result<Infallible> {
    let mut is_told = false;
    let work = async |session: &Session<'_>| {
        if !mem::replace(&mut is_told, true) {
            output::json(&FirstLine { tcp: at.to_string() })?;
            let key = args.key.as_ref().map_or_else(String::new, |path| format!(" --key {}", path.display()));
            eprintln!("r4: {} is served at tcp:{at}; for example: r4 monitor --board tcp:{at}{key}", args.board);
        }
        serve_clients(session, &mut listener, args.live.is_some()).await
    };
    let tell = |event| eprintln!("r4: {}", session::told(&event));
    let meanwhile = async |_: &HostClock| pending().await;
    match virtual_board {
        None => session::keep(args, Pace::RealTime(1.0), work, tell, meanwhile),
        Some(Background { address, key, .. }) => session::keep_served(args, (address, key), work, tell, meanwhile),
    }
}

/// Serves clients until the board's link ends.
async fn serve_clients(session: &Session<'_>, listener: &mut Listener, is_live: bool) -> anyhow::Result<Infallible> {
    let broker = Broker::new(session.board);
    if is_live {
        for channel in session.board.channels() {
            broker.watch(channel.id, LIVE_MS).await?;
        }
    }
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
        Poll::Pending
    });
    match select(pin!(serving), pin!(broker.run())).await {
        Either::Left((error, _)) => Err(anyhow::Error::from(error).context("cannot accept clients")),
        Either::Right((error, _)) => Err(error.into()),
    }
}
