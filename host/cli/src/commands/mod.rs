//! One module per verb, or per few verbs that are one thing.

pub(crate) mod bench;
pub(crate) mod bridge;
pub(crate) mod calibrate;
pub(crate) mod completions;
pub(crate) mod config;
pub(crate) mod debug;
pub(crate) mod demo;
pub(crate) mod drive;
pub(crate) mod faults;
pub(crate) mod flash;
pub(crate) mod hold;
pub(crate) mod identify;
pub(crate) mod info;
pub(crate) mod log;
pub(crate) mod man;
pub(crate) mod monitor;
pub(crate) mod motion;
pub(crate) mod ports;
pub(crate) mod raw;
pub(crate) mod relay;
pub(crate) mod report;
pub(crate) mod reveal;
pub(crate) mod scenario;
pub(crate) mod serve;
pub(crate) mod state;
pub(crate) mod tune;
pub(crate) mod watch;

use r4_protocol::{ChannelId, Mode, Setpoint, Unit};

use crate::session::Session;
use r4_rig::quantity::Quantity;

/// A channel does not take what it was asked for; nothing was sent.
#[derive(Debug, thiserror::Error)]
#[error("{channel} {why}")]
pub(crate) struct Unsuitable {
    pub(crate) channel: ChannelId,
    why: String,
}

/// A motor did not do what it was asked for in time.
#[derive(Debug, thiserror::Error)]
#[error("{channel} {how}")]
pub(crate) struct NotReached {
    pub(crate) channel: ChannelId,
    how: String,
}

/// The set point that a typed quantity means for a channel, checked against what the channel says it takes.
fn setpoint(session: &Session<'_>, channel: ChannelId, mode: Mode, quantity: Quantity) -> anyhow::Result<Setpoint> {
    let info = session.board.channel(channel)?;
    let unsuitable = |why| Unsuitable { channel, why };
    let Some(takes) = info.mode(mode) else {
        let why = format!("cannot be commanded by {mode}: `r4 info` lists what it can take");
        return Err(unsuitable(why).into());
    };
    if takes.unit != quantity.unit {
        let example = match takes.unit {
            Unit::Rad => "an angle, as in 90deg or 1.57rad",
            Unit::RadPerS => "a speed, as in 60deg/s, 1rad/s or 10rpm",
            Unit::M => "a length, as in 25mm or 0.025m",
            Unit::MPerS => "a speed, as in 5mm/s",
            Unit::Duty => "a share of the supply without a unit, as in 0.3 or 30%",
            Unit::V => "a voltage, as in 1.2V or 1200mV",
            Unit::Bool => "nothing that can be typed",
        };
        return Err(unsuitable(format!("takes as {mode} {example}")).into());
    }
    let setpoint = Setpoint { mode, value: quantity.value as f32 };
    if !takes.range.contains(setpoint.value) {
        let limit = |value: f32| quantity.like(value.into(), takes.unit);
        let (min, max) = (limit(takes.range.min), limit(takes.range.max));
        return Err(unsuitable(format!("takes a {mode} from {min} to {max}, not {quantity}")).into());
    }
    Ok(setpoint)
}

/// Unit of a motor's speed, from that of its position.
fn speed_unit(position: Unit) -> Unit {
    if position == Unit::M { Unit::MPerS } else { Unit::RadPerS }
}
