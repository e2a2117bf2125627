//! `r4 relay`

use r4_protocol::{Mode, Sample, Setpoint};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::{Args, Contact, Relay},
    output, session,
};

/// A relay is held this long unless told otherwise, s.
const HOLD_S: f64 = 2.0;
/// How often it is looked at, ms.
const LOOK_EVERY_MS: u16 = 20;

/// What became of the relay.
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
            anyhow::bail!("{channel} cannot be switched: `r4 info` lists what it can take");
        }
        let mut telemetry = board.telemetry();
        board.subscribe(channel, LOOK_EVERY_MS).await?;
        session
            .armed(async || {
                board.set(channel, Setpoint { mode: Mode::Switch, value: set.into() }).await?;
                let end_us = board.device_us() + (seconds * 1e6) as u64;
                let mut armed_once = false;
                loop {
                    let frame = telemetry.next().await?;
                    armed_once |= frame.state == r4_protocol::SafetyState::Armed;
                    // Frames from before the arming may still be under way.
                    if armed_once && frame.state != r4_protocol::SafetyState::Armed {
                        return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
                    }
                    let closed = frame.samples.iter().find_map(|sample| match *sample {
                        Sample::Scalar { channel: of, value } if of == channel => Some(value != 0.0),
                        _ => None,
                    });
                    if let Some(closed) = closed.filter(|_| frame.device_us >= end_us) {
                        return Ok(closed);
                    }
                }
            })
            .await
    })?;
    if args.json {
        output::json(&Outcome { board: args.board.to_string(), channel: channel.to_string(), set, closed, seconds })?;
    } else {
        let contact = |closed| if closed { "closed" } else { "open" };
        output::line(format_args!("{channel} was {} for {seconds} s; now open", contact(closed)))?;
    }
    Ok(closed == set)
}
