//! `r4 serve`: one board for several programs.

mod page;

use std::{convert::Infallible, future::pending, mem, net::SocketAddr, path::Path, rc::Rc};

use anyhow::Context;
use page::Door;
use r4_access::{Guard, Policy, log::Files, unix_ms};
use r4_broker::{Guarded, Left};
use r4_links::Listener;
use r4_share::{CLIENTS, Event as Change, Sharing, share};
use r4_sim::Pace;
use serde::Serialize;

use super::access;
use super::serve::{
    Background, bind,
    clients::{DROPPED, TURNED_AWAY},
};
use crate::{
    args::{self, Args},
    output,
    session::{self, HostClock, Session, Target},
};

/// First line on stdout: where clients connect.
#[derive(Serialize)]
struct FirstLine {
    tcp: String,
    /// Address of the page, where there is one; without what has to be behind it where a key is asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    http: Option<String>,
}

pub(crate) fn run(args: &Args, asked: &args::Share) -> anyhow::Result<bool> {
    let board = asked.board.clone().unwrap_or_else(|| args.board.clone());
    let args = Args { board, live: asked.live.foxglove, ..args.clone() };
    session::catch_interrupts();
    let guard = asked.policy.as_deref().map(guard).transpose()?;
    // Before the board, which takes longer: a port that is taken is reported at once.
    let (socket, at) = bind(&args, asked.tcp, asked.public)?;
    // Once: it may come through a pipe.
    let key = session::key(&args)?;
    let door = asked.http.map(|address| Door::open(&args, address, asked.public, key.as_ref())).transpose()?;
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
        let sharing = Sharing {
            clients: &mut listener,
            page: door.as_mut().map(|door| (&mut door.listener, &door.guard)),
            policy: guard.cloned(),
            is_live: args.live.is_some(),
            tell: &|event| {
                if let Some(message) = told(&event) {
                    eprintln!("{message}");
                }
            },
        };
        Ok(share(session, sharing).await?)
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

/// Message about a change among the clients; `None` for one that has just left.
fn told(event: &Change) -> Option<String> {
    match event {
        Change::Full => Some(format!("r4: a client was turned away: {CLIENTS} are connected")),
        Change::Stranger => Some(TURNED_AWAY.to_owned()),
        Change::Client(Left::Gone) => None,
        Change::Client(Left::Silent) => Some(DROPPED.to_owned()),
        Change::Client(Left::Slow) => Some("r4: a client that does not read was dropped".to_owned()),
        Change::Browser(left) => page::told(left),
    }
}
