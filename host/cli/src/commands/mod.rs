//! One module per verb, or per few verbs that are one thing.

pub(crate) mod demo;
pub(crate) mod info;
pub(crate) mod motion;
pub(crate) mod state;
pub(crate) mod watch;

use r4_protocol::{Mode, Setpoint};
use serde::Serialize;

use crate::{quantity::Quantity, session::Session};

/// Prints `value` as the one JSON object of a command.
fn print_json(value: &impl Serialize) -> anyhow::Result<()> {
    println!("{}", serde_json::to_string(value)?);
    Ok(())
}

/// The set point that a typed quantity means for a channel, checked against what the channel says it takes.
fn setpoint(
    session: &Session<'_>,
    channel: r4_protocol::ChannelId,
    mode: Mode,
    quantity: Quantity,
) -> anyhow::Result<Setpoint> {
    let info = session.board.channel(channel)?;
    let Some(takes) = info.mode(mode) else {
        anyhow::bail!("{channel} cannot be commanded by {mode}: `r4 info` lists what it can take");
    };
    if takes.unit != quantity.unit {
        let example = Quantity { value: f64::from(takes.range.max) / 2.0, unit: takes.unit };
        anyhow::bail!(
            "{channel} takes a {mode} in {}, for example {}, not one in {}",
            takes.unit,
            example.to_string().replace(' ', ""),
            quantity.unit,
        );
    }
    Ok(Setpoint { mode, value: quantity.value as f32 })
}
