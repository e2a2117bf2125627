//! `r4 relay`: switches a relay for a time.

use r4_protocol::{Mode, Setpoint};
use r4_rig::{Error, Unsuitable};
use r4_sim::Pace;
use serde::Serialize;

use super::hold::HOLD_S;
use crate::{
    args::{Args, Contact, Relay},
    output, session,
};

/// Result of switching the relay.
#[derive(Serialize)]
struct Outcome {
    board: String,
    channel: String,
    set: bool,
    closed: bool,
    seconds: f64,
}

pub(crate) fn run(args: &Args, relay: &Relay) -> anyhow::Result<bool> {
    let (channel, set) = (relay.channel, relay.state == Contact::On);
    let seconds = relay.seconds.unwrap_or(HOLD_S);
    let (closed, _) = session::run(args, Pace::Free, async |session| {
        let board = session.board;
        if board.channel(channel)?.mode(Mode::Switch).is_none() {
            let why = "cannot be switched: `r4 info` lists what it can take".to_owned();
            return Err(Error::from(Unsuitable { channel, why }).into());
        }
        let setpoint = Setpoint { mode: Mode::Switch, value: set.into() };
        let level = session.armed(async || anyhow::Ok(board.hold(channel, setpoint, seconds).await?)).await?;
        Ok(level != 0.0)
    })?;
    if args.json {
        output::json(&Outcome { board: args.board.to_string(), channel: channel.to_string(), set, closed, seconds })?;
    } else {
        let contact = |closed| if closed { "closed" } else { "open" };
        let board = args.board.described();
        output::line(format_args!("{channel} was {} for {seconds} s, on {board}; now open", contact(closed)))?;
    }
    Ok(closed == set)
}
