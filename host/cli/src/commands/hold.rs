//! `r4 servo`, `r4 bldc`, `r4 dac`: outputs with a set point and without a sensor.

use r4_protocol::{ChannelId, ChannelKind, Mode, Unit};
use r4_rig::{Error, HeldOutput, Quantity, Unsuitable};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::{Args, Bldc, Held},
    output, session,
};

/// Default hold time, s.
pub(super) const HOLD_S: f64 = 2.0;

/// Result of holding an output, in SI units.
#[derive(Serialize)]
struct Outcome {
    board: String,
    channel: String,
    mode: String,
    unit: String,
    set: f64,
    /// Set point of the output at the end; null for a servo without pulses.
    value: f64,
    seconds: f64,
    /// True if the output reached the requested set point.
    held: bool,
}

/// Requested output, and its description in messages.
struct Order {
    channel: ChannelId,
    kind: ChannelKind,
    mode: Mode,
    /// Set point; `None` for a brake.
    value: Option<Quantity>,
    seconds: f64,
    /// State of the output after disarming, for the message.
    afterwards: &'static str,
}

pub(crate) fn servo(args: &Args, servo: &Held) -> anyhow::Result<bool> {
    of_held(args, servo, ChannelKind::Servo, Mode::Position, "now disarmed")
}

pub(crate) fn dac(args: &Args, dac: &Held) -> anyhow::Result<bool> {
    of_held(args, dac, ChannelKind::Dac, Mode::Voltage, "now at its safe voltage")
}

fn of_held(args: &Args, held: &Held, kind: ChannelKind, mode: Mode, afterwards: &'static str) -> anyhow::Result<bool> {
    let (channel, value, seconds) = (held.channel, Some(held.value), held.seconds.unwrap_or(HOLD_S));
    run(args, Order { channel, kind, mode, value, seconds, afterwards })
}

pub(crate) fn bldc(args: &Args, bldc: &Bldc) -> anyhow::Result<bool> {
    let mode = if bldc.brake { Mode::Brake } else { Mode::Duty };
    let (channel, value, seconds) = (bldc.channel, bldc.value, bldc.seconds.unwrap_or(HOLD_S));
    run(args, Order { channel, kind: ChannelKind::Bldc, mode, value, seconds, afterwards: "now at neutral" })
}

fn run(args: &Args, order: Order) -> anyhow::Result<bool> {
    let Order { channel, kind, mode, value: asked, seconds, afterwards } = order;
    let (HeldOutput { unit, value, held }, _) = session::run(args, Pace::Free, async |session| {
        session.board.channel(channel)?;
        if channel.kind != kind {
            let why = format!("is no {}: `r4 info` lists the channels", kind.name());
            return Err(Error::from(Unsuitable { channel, why }).into());
        }
        Ok(session.hold(channel, mode, asked, seconds).await?)
    })?;
    let board = args.board.described();
    let set = asked.unwrap_or(Quantity::new(0.0, Unit::Duty));
    // A brake has no quantity.
    let what = if asked.is_some() { set.to_string() } else { mode.to_string() };
    if args.json {
        output::json(&Outcome {
            board: args.board.to_string(),
            channel: channel.to_string(),
            mode: mode.to_string(),
            unit: unit.to_string(),
            set: if asked.is_some() { set.value } else { 1.0 },
            value,
            seconds,
            held,
        })?;
    } else {
        output::line(format_args!("{channel} had the set point {what} for {seconds} s, on {board}; {afterwards}"))?;
    }
    if !held {
        let reached = set.like(value, unit);
        // A servo without pulses has no known angle.
        let reached = if value.is_nan() { "no angle".to_owned() } else { reached.to_string() };
        eprintln!("r4: {channel} reached only {reached} after {seconds} s, on {board}: allow more time with --for");
    }
    Ok(held)
}
