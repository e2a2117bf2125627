//! `r4 move`, `r4 speed`, `r4 duty`

use anyhow::bail;
use r4_driver::{Error, Until};
use r4_protocol::{Mode, Unit};
use r4_sim::Pace;
use serde::Serialize;

use super::{setpoint, speed_unit};
use crate::{
    args::{Args, Motion},
    output,
    quantity::Quantity,
    session,
};

/// What became of one command, in SI.
#[derive(Serialize)]
struct Outcome {
    board: String,
    channel: String,
    mode: String,
    unit: String,
    set: f64,
    position: f64,
    speed: f64,
    duty: f64,
    seconds: f64,
    settled: bool,
    /// Whether what was asked for held at the end.
    held: bool,
}

/// A duty counts as held within this: the bridge has 1/4096.
const DUTY_WITHIN: f64 = 0.001;
/// A speed counts as held within this share of it, and what a motor's sensor resolves at low speed, rad/s and m/s.
const SPEED_WITHIN: f64 = 0.1;
const RAD_S_RESOLVED: f64 = 0.02;
const M_S_RESOLVED: f64 = 0.000_3;

/// A speed or duty is held this long unless told otherwise, s.
const HOLD_S: f64 = 2.0;
/// A position is given up after this long unless told otherwise, s.
const TIMEOUT_S: f64 = 30.0;

pub(crate) fn run(args: &Args, motion: &Motion, mode: Mode) -> anyhow::Result<bool> {
    let (channel, set) = (motion.channel, motion.value);
    let until = match mode {
        Mode::Position => Until::Settled { timeout_s: motion.seconds.unwrap_or(TIMEOUT_S) },
        _ => Until::Elapsed { seconds: motion.seconds.unwrap_or(HOLD_S) },
    };
    let ((end, position_unit), _) = session::run(args, Pace::Free, async |session| {
        let setpoint = setpoint(session, channel, mode, set)?;
        let position_unit = session.board.channel(channel)?.unit;
        let end = session.armed(async || Ok(session.board.drive(channel, setpoint, until).await)).await?;
        Ok((end, position_unit))
    })?;
    let end = match end {
        Err(Error::NotSettled { position, after_s, .. }) => {
            let position = Quantity { value: position, unit: position_unit };
            bail!("{channel} was not settled after {after_s:.1} s: at {position}, asked for {set}");
        }
        end => end?,
    };
    let held = match mode {
        Mode::Position => end.settled,
        Mode::Duty => (end.duty - set.value).abs() <= DUTY_WITHIN,
        _ => {
            let resolved = if position_unit == Unit::M { M_S_RESOLVED } else { RAD_S_RESOLVED };
            (end.speed - set.value).abs() <= SPEED_WITHIN * set.value.abs() + resolved
        }
    };
    if args.json {
        output::json(&Outcome {
            board: args.board.to_string(),
            channel: channel.to_string(),
            mode: mode.to_string(),
            unit: set.unit.to_string(),
            set: set.value,
            position: end.position,
            speed: end.speed,
            duty: end.duty,
            seconds: end.after_s,
            settled: end.settled,
            held,
        })?;
    }
    let position = Quantity { value: end.position, unit: position_unit };
    let speed = Quantity { value: end.speed, unit: speed_unit(position_unit) };
    match mode {
        _ if args.json => {}
        Mode::Position => {
            output::line(format_args!("{channel} rests at {position}, asked for {set}, after {:.2} s", end.after_s))?;
        }
        _ => output::line(format_args!(
            "{channel} at {position}, moving at {speed}, duty {:.3}, after {:.2} s of {mode} {set}; now stopped",
            end.duty, end.after_s
        ))?,
    }
    if !held {
        eprintln!("r4: {channel} did not hold {mode} {set}: at the end {speed}, duty {:.3}, at {position}", end.duty);
    }
    Ok(held)
}
